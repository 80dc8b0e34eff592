"""What runs in the processes between cameras and a policy: taking pictures, key frames, clouds."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.base.errors import InputError
from ...sim.base.types import Array
from .calibration import Rig
from .clouds import capsules_at, cloud_of, joined
from .frames import Frame
from .ring import Ring
from .source import Source

MOST_BRANCHES, MOST_LINE = 8192, 2048
"""Points of clouds that are handed on."""

APART = 0.06
"""Most time between a picture and the joint positions that the arm is cut out with [s]."""

_POLL = 0.003  # s
_SAID = 240  # bytes

Labels = NDArray[np.uint8]


class Segmenter(Protocol):
    """Tells what the pixels of a picture show."""

    def label(self, frame: Frame) -> Labels:
        """Return `sim.cameras.label.Label` of each pixel, [H, W]."""
        ...


class Tracker(Protocol):
    """Carries masks from key frames to the pictures after them."""

    def begin(self, frame: Frame, labels: Labels) -> None:
        """Take a key frame and what its pixels show."""
        ...

    def label(self, frame: Frame) -> Labels | None:
        """Return what the pixels of a later picture show, None before the first key frame."""
        ...


@dataclass
class Board:
    """The shared memory of all processes.

    Attributes:
        pictures: Of each camera.
        keys: Key frames of each camera, with masks; empty where every picture is looked at.
        joints: What `Clouds` sources are told.
        clouds: The clouds.
        said: Why a process ended or waits, by its name.
    """

    pictures: list[Ring]
    keys: list[Ring]
    joints: Ring
    clouds: Ring
    said: dict[str, Ring] = field(default_factory=dict)

    @staticmethod
    def of(sizes: tuple[tuple[int, int], ...], dofs: int, names: tuple[str, ...], *, keyed: bool) -> Board:
        """Allocate for cameras of these sizes, an arm of so many joints and processes of these names."""
        joints: tuple[int, ...] = (dofs,)

        def picture(height: int, width: int, more: dict[str, tuple[str, tuple[int, ...]]]) -> Ring:
            """Return the ring of a camera's pictures, depths, intrinsics and arm's angles, and ``more`` beside."""
            return Ring({"time": ("f8", ()), "colour": ("u1", (height, width, 3)), "depth": ("f4", (height, width)),
                         "intrinsics": ("f8", (4,)), "q": ("f8", joints), "ground": ("f8", ())} | more)  # fmt: skip

        pictures = [picture(h, w, {}) for h, w in sizes]
        keys = [picture(h, w, {"labels": ("u1", (h, w))}) for h, w in sizes] if keyed else []
        clouds = Ring({"time": ("f8", ()), "counts": ("i8", (2,)), "branches": ("f4", (MOST_BRANCHES, 3)),
                       "line": ("f4", (MOST_LINE, 3))})  # fmt: skip
        told = Ring({"time": ("f8", ()), "q": ("f8", joints)}, slots=256)
        return Board(pictures, keys, told, clouds, {n: Ring({"text": (f"S{_SAID}", ())}) for n in names})

    def say(self, name: str, text: str) -> None:
        """Write why a process ends or waits; nothing for all is well."""
        line = " ".join(text.split()).encode()[:_SAID]
        ring = self.said[name]
        before = ring.read()
        if (b"" if before is None else before["text"]) != line:
            ring.write(text=line)

    def heard(self, name: str) -> str:
        """Return what a process said last."""
        said = self.said[name].read()
        return "" if said is None else bytes(said["text"]).decode(errors="replace")


def run(work: Callable[..., None], board: Board, name: str, *rest: Any) -> None:
    """Do a process's work after what all have in common: no Ctrl-C, less haste than the arm, an end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent closes
    os.nice(5)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        work(board, *rest)
    except InputError as error:
        board.say(name, str(error))
        raise SystemExit(2) from None
    except Exception as error:
        board.say(name, f"{type(error).__name__}: {error}")
        raise SystemExit(1) from None


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


# ---- cameras ---------------------------------------------------------------------------------------------------------


def take(board: Board, source: Source) -> None:
    """Write every picture of a source into its ring; one that is the same as the last is none: its camera is frozen."""
    last: dict[int, tuple[NDArray[np.uint8], NDArray[np.float32]]] = {}
    frozen: set[int] = set()
    for taken in source.frames():
        k = taken.camera
        before = last.get(k)
        if before is not None and np.array_equal(before[1], taken.depth) and np.array_equal(before[0], taken.colour):
            frozen.add(k)
        else:
            frozen.discard(k)
            last[k] = (taken.colour, taken.depth)
            q = _joints(board.joints.read_shape("q"), taken.q)
            board.pictures[k].write(time=taken.time, colour=taken.colour, depth=taken.depth,
                                    intrinsics=taken.intrinsics, q=q, ground=taken.ground)  # fmt: skip
        board.say("camera", f"the same picture again and again of camera {sorted(frozen)}" if frozen else "")
    board.say("camera", "the recording is over")


def _joints(shape: tuple[int, ...], q: Array | None) -> Array:
    """Return joint positions as the pictures' ring holds them: no numbers where nobody knows or nobody needs them.

    Raises:
        InputError: They are another arm's.
    """
    if q is None or shape == (0,):
        return np.full(shape, np.nan)
    if q.shape != shape:
        raise InputError("camera", "joints", f"{len(q)} with the pictures", f"{shape[0]}, as the arm has")
    return q


# ---- key frames ------------------------------------------------------------------------------------------------------


def segment(board: Board, make: Callable[[], Segmenter]) -> None:
    """Look at the newest picture of each camera in turn, however long that takes, and write it with its masks."""
    segmenter = make()
    seen = [0] * len(board.pictures)
    while True:
        idle = True
        for k, ring in enumerate(board.pictures):
            if ring.count == seen[k]:
                continue
            seen[k], row, idle = ring.count, ring.read(), False
            assert row is not None
            board.keys[k].write(**row, labels=segmenter.label(_unplaced(row)))
        if idle:
            time.sleep(_POLL)


def _unplaced(row: dict[str, Any]) -> Frame:
    fx, fy, cx, cy = row["intrinsics"].tolist()
    return Frame(
        float(row["time"]), row["colour"], row["depth"], (fx, fy, cx, cy), np.zeros(3), np.array([1.0, 0, 0, 0])
    )


# ---- clouds ----------------------------------------------------------------------------------------------------------


class Clouder:
    """Makes clouds of labelled pictures as they come."""

    def __init__(self, board: Board, rig: Rig, arm: Arm | None) -> None:
        """Take the memory, the cameras and the arm that is cut out of what they see."""
        self._board, self._rig, self._arm = board, rig, arm
        self._parts: dict[int, tuple[float, Array, Array]] = {}
        self._random = np.random.default_rng(0)

    def add(self, camera: int, row: dict[str, Any], labels: Labels) -> None:
        """Take a picture and what it shows; write clouds once there is one of every camera."""
        q = self._joints(row)
        if self._arm is not None and q is None:
            self._board.say("clouds", "nobody told joint positions for the time of the pictures")
            return
        hand = None if self._arm is None or q is None else forward_kinematics(self._arm, q)[2]
        pose = self._rig.cameras[camera].pose(hand)
        if pose is None:
            self._board.say("clouds", f"camera {self._rig.cameras[camera].name} is on a hand, and there is no arm")
            return
        frame = Frame(float(row["time"]), row["colour"], row["depth"], tuple(row["intrinsics"].tolist()), *pose)
        body = None if self._arm is None or q is None else capsules_at(self._arm, q)
        known = self._rig.ground is None and np.isfinite(row["ground"])
        rig = replace(self._rig, ground=float(row["ground"])) if known else self._rig
        self._parts[camera] = (frame.time, *cloud_of(frame, labels, rig, body))
        if len(self._parts) == len(self._rig.cameras):
            self._board.say("clouds", "")
            self._write()

    def _joints(self, row: dict[str, Any]) -> Array | None:
        """Return joint positions at a picture's time: the source's own, or the nearest that were told."""
        if row["q"].size and np.isfinite(row["q"]).all():
            return np.asarray(row["q"])
        told = self._board.joints.history()
        if not len(told):
            return None
        off = np.abs(told["time"] - row["time"])
        nearest = int(off.argmin())
        return np.asarray(told["q"][nearest]) if off[nearest] <= APART else None

    def _write(self) -> None:
        clouds = joined(list(self._parts.values()), self._rig.grain)
        branches, line = (
            self._few(p, most) for p, most in ((clouds.branches, MOST_BRANCHES), (clouds.line, MOST_LINE))
        )
        padded = [np.zeros((most, 3), np.float32) for most in (MOST_BRANCHES, MOST_LINE)]
        padded[0][: len(branches)], padded[1][: len(line)] = branches, line
        self._board.clouds.write(time=clouds.time, counts=(len(branches), len(line)), branches=padded[0],
                                 line=padded[1])  # fmt: skip

    def _few(self, points: NDArray[np.float32], most: int) -> NDArray[np.float32]:
        return points if len(points) <= most else points[self._random.choice(len(points), most, replace=False)]


def cloud(
    board: Board, rig: Rig, arm: Arm | None, make: Callable[[], Segmenter] | None, track: Callable[[], Tracker] | None
) -> None:  # fmt: skip
    """Make clouds of pictures for good.

    Args:
        board: The shared memory.
        rig: The cameras.
        arm: The arm that is cut out of what they see.
        make: Returns what looks at every picture; None where key frames come from another process.
        track: Returns, for each camera, what carries masks from key frames on; None where only key frames make clouds.
    """
    clouder = Clouder(board, rig, arm)
    trackers = [] if track is None else [track() for _ in board.pictures]
    segmenter = None if make is None else make()
    looked = board.keys if segmenter is None and not trackers else board.pictures
    seen, keyed = [0] * len(looked), [0] * len(board.keys)
    while True:
        idle = True
        for k, ring in enumerate(looked):
            if trackers and board.keys[k].count != keyed[k]:
                keyed[k], row = board.keys[k].count, board.keys[k].read()
                assert row is not None
                trackers[k].begin(_unplaced(row), row["labels"])
            if ring.count == seen[k]:
                continue
            seen[k], row, idle = ring.count, ring.read(), False
            assert row is not None
            labels = _labels(row, segmenter, trackers[k] if trackers else None)
            if labels is not None:
                clouder.add(k, row, labels)
        if idle:
            time.sleep(_POLL)


def _labels(row: dict[str, Any], segmenter: Segmenter | None, tracker: Tracker | None) -> Labels | None:
    if segmenter is not None:
        return segmenter.label(_unplaced(row))
    if tracker is not None:
        return tracker.label(_unplaced(row))
    return np.asarray(row["labels"])
