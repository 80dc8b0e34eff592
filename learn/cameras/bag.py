"""Pictures in ROS bags: image topics of colour and depth, matched by their stamps, and joint states.

Read are ``sensor_msgs/Image`` of the encodings rgb8, bgr8 (colour), 16UC1 and mono16 [mm], 32FC1 [m] (depth), with the
depth registered to colour, through the rosbags library.
"""

from __future__ import annotations

import time
from bisect import insort
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...sim.base.errors import InputError, shortened
from ...sim.base.extras import install_hint
from ...sim.base.types import Array
from .calibration import Rig
from .source import Taken

APART = 0.02
"""Most time between the stamps of a colour picture and of its depth [s]."""

_IMAGE, _JOINTS = "sensor_msgs/msg/Image", "sensor_msgs/msg/JointState"
_COLOUR, _DEPTH = ("rgb8", "bgr8"), ("16UC1", "mono16", "32FC1")
_WAITING = 8  # pictures of a topic that wait for their other half


@dataclass
class _Half:
    """Pictures of a camera's two topics that wait for each other, by stamp."""

    colour: list[tuple[float, Any]] = field(default_factory=list)
    depth: list[tuple[float, Any]] = field(default_factory=list)


class BagSource:
    """Plays a bag at the pace at which it was recorded (`learn.cameras.source.Source`)."""

    def __init__(self, path: Path, rig: Rig) -> None:
        """Read the first picture of each camera.

        Raises:
            InputError: The bag cannot be read, lacks a topic or a picture, or cameras.yaml lacks topics or intrinsics.
        """
        self._path, self._rig = path, rig
        for camera in rig.cameras:
            for name in ("colour_topic", "depth_topic", "intrinsics_px"):
                if getattr(camera, name) is None:
                    raise InputError("cameras.yaml", camera.name, f"no {name}", f"{name}, which a bag needs")
        sizes: dict[int, tuple[int, int]] = {}
        for taken in self.still():
            sizes.setdefault(taken.camera, (taken.depth.shape[0], taken.depth.shape[1]))
            if len(sizes) == len(rig.cameras):
                break
        for k, camera in enumerate(rig.cameras):
            if k not in sizes:
                allowed = f"pictures of {camera.colour_topic} and {camera.depth_topic} within {APART:g} s"
                raise InputError(path, camera.name, "no picture with its depth", allowed)
        self.sizes = tuple(sizes[k] for k in range(len(rig.cameras)))

    def frames(self) -> Iterator[Taken]:
        """Yield the pictures, the first one now.

        Raises:
            InputError: A picture cannot be read, or has another size than the first of its camera.
        """
        begun, first = time.monotonic(), None
        for taken in self.still():
            first = taken.time if first is None else first
            at = begun + taken.time - first
            time.sleep(max(0.0, at - time.monotonic()))
            yield Taken(taken.camera, at, taken.colour, taken.depth, taken.intrinsics, taken.q)

    def still(self) -> Iterator[Taken]:
        """Yield the pictures at their own times [s], without waiting.

        Raises:
            InputError: The bag or a picture cannot be read.
        """
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise InputError(self._path, "", "a ROS bag, without the rosbags library", install_hint("vision")) from None
        try:
            with AnyReader([self._path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
                yield from self._played(reader)
        except InputError:
            raise
        except Exception as error:  # whatever a damaged bag makes the library raise
            raise InputError(self._path, "", shortened(f"{type(error).__name__}: {error}"), "a ROS bag") from None

    def _played(self, reader: Any) -> Iterator[Taken]:
        topics = {}
        for k, camera in enumerate(self._rig.cameras):
            topics[camera.colour_topic], topics[camera.depth_topic] = (k, "colour"), (k, "depth")
        wanted = [c for c in reader.connections if (c.topic in topics and c.msgtype == _IMAGE) or c.msgtype == _JOINTS]
        halves, joints = [_Half() for _ in self._rig.cameras], None
        for connection, arrived, raw in reader.messages(connections=wanted):
            message = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype == _JOINTS:
                joints = _positions(message)
                continue
            at = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec or 1e-9 * arrived
            k, kind = topics[connection.topic]
            insort(getattr(halves[k], kind), (at, message), key=lambda pair: pair[0])
            pair = _matched(halves[k])
            if pair is not None:
                yield self._taken(k, *pair, joints)

    def _taken(self, k: int, at: float, colour: Any, depth: Any, q: Array | None) -> Taken:
        camera = self._rig.cameras[k]
        pixels, metres = self._pixels(colour, _COLOUR), self._pixels(depth, _DEPTH)
        if pixels.shape[:2] != metres.shape[:2]:
            found = f"depth of {metres.shape[:2]} for a picture of {pixels.shape[:2]}"
            raise InputError(self._path, str(camera.depth_topic), found, "depth registered to colour")
        given = camera.intrinsics_px
        assert given is not None
        return Taken(k, at, pixels, metres, (given[0], given[1], given[2], given[3]), q)

    def _pixels(self, message: Any, allowed: tuple[str, ...]) -> NDArray[Any]:
        """Return an image as numbers: colour uint8 [H, W, 3], depth float32 [H, W] in m."""
        kind, height, width, step = message.encoding, message.height, message.width, message.step
        if kind not in allowed:
            raise InputError(self._path, "encoding", shortened(kind), ", ".join(allowed))
        item = {"rgb8": 3, "bgr8": 3, "32FC1": 4}.get(kind, 2)
        data = np.frombuffer(bytes(message.data), np.uint8)
        if step < item * width or len(data) < step * height or not height * width:
            raise InputError(self._path, "image", f"{len(data)} bytes for {width} x {height}", "a whole picture")
        rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, : item * width])
        if item == 3:
            colour = rows.reshape(height, width, 3)
            return colour[..., ::-1].copy() if kind == "bgr8" else colour
        order = ">" if message.is_bigendian else "<"
        if kind == "32FC1":
            depth = rows.view(f"{order}f4").astype(np.float32)
        else:
            depth = rows.view(f"{order}u2").astype(np.float32) / np.float32(1000.0)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0.0))


def _positions(message: Any) -> Array:
    """Return the positions of a joint state's joints [rad], those of fingers left out."""
    names = list(message.name)
    kept = [k for k in range(len(message.position)) if k >= len(names) or "finger" not in names[k]]
    return np.asarray(message.position, float)[kept]


def _matched(half: _Half) -> tuple[float, Any, Any] | None:
    """Return the oldest colour and depth within `APART` of each other; forget what came before them."""
    for i, (at, colour) in enumerate(half.colour):
        for j, (other, depth) in enumerate(half.depth):
            if abs(at - other) <= APART:
                del half.colour[: i + 1], half.depth[: j + 1]
                return at, colour, depth
    del half.colour[:-_WAITING], half.depth[:-_WAITING]
    return None
