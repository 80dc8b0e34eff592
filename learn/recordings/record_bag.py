"""What a robot's service streams, written into a ROS 2 bag tick by tick.

While it records, the bag is SQLite: every tick is a transaction of its own, so that the file holds every tick up to the
last after ``kill -9`` (not after a power cut: nothing waits for the disk). The MCAP writer of rosbags keeps up to a
mebibyte in memory, and its reader refuses a file without an end; so MCAP is written once the recording has ended, and
takes the place of SQLite when it is whole. The folder's metadata.yaml is written at the end: without it the recording
was cut short, and its ``.db3`` is what can be read.
"""

from __future__ import annotations

import errno
import itertools
import math
import os
import sqlite3
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from ...sim.base.console import uninterrupted
from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint
from ...sim.base.files import check_output

JOINTS, HAND = "/joint_states", "/hand_pose"
_STATE, _POSE = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"


class BagRecorder:
    """Writes ticks of `learn.robot.wire.streamed` as joint states and poses of the hand; use it in a ``with``.

    Stamps are the service's clock, put on the day's at the first tick; messages arrive when they were received.

    Attributes:
        path: Folder of the bag.
        ticks: Ticks that are in it.
        missed: Ticks that the service numbered and that did not come.
    """

    def __init__(self, path: Path) -> None:
        """Make the folder.

        Raises:
            InputError: The rosbags library is missing, or the folder is there already or cannot be made.
        """
        check_new_bag(path)
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        path.parent.mkdir(parents=True, exist_ok=True)
        self.path, self.ticks, self.missed = path, 0, 0
        self._last, self._begin = -1, 0
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
        self._writer.open()
        self._base: sqlite3.Connection = self._writer.storage.conn  # type: ignore[union-attr]
        self._base.execute("PRAGMA synchronous = OFF")  # waiting for the disk takes longer than a tick
        self._topics = {topic: self._writer.add_connection(topic, kind, typestore=self._store)
                        for topic, kind in ((JOINTS, _STATE), (HAND, _POSE))}  # fmt: skip
        self._base.commit()

    @property
    def file(self) -> Path:
        """The SQLite file."""
        return self.path / f"{self.path.name}.db3"

    def add(self, tick: Mapping[str, Any], received: int) -> None:
        """Write a tick, received at a time of the day [ns]; a tick that is there already is left out.

        Raises:
            OSError: There is no room for it; what came before stays.
        """
        number = int(tick["tick"])
        if number <= self._last:
            return
        self.missed += number - self._last - 1 if self._last >= 0 else 0
        own = round(float(tick["time_s"]) * 1e9)
        self._begin = self._begin or received - own
        try:
            for topic, message, kind in self._messages(tick, self._begin + own):
                self._writer.write(self._topics[topic], received, self._store.serialize_cdr(message, kind))
            self._base.commit()
        except sqlite3.Error as error:
            with suppress(sqlite3.Error):
                self._base.rollback()
            raise OSError(errno.ENOSPC, f"{error}; the {self.ticks} ticks before are in it", str(self.file)) from None
        self._last = number
        self.ticks += 1

    def _messages(self, tick: Mapping[str, Any], stamp: int) -> Iterator[tuple[str, object, str]]:
        types = self._store.types
        time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        header = types["std_msgs/msg/Header"](time, "base")
        q, speed, torque = (_numbers(tick[f"robot_dof_{name}"]) for name in ("pos", "vel", "torque"))
        names = [f"joint_{k + 1}" for k in range(len(q))]
        yield JOINTS, types[_STATE](header, names, q, speed, torque), _STATE
        point = types["geometry_msgs/msg/Point"](*_numbers(tick["hand_pos"]).tolist())
        turn = types["geometry_msgs/msg/Quaternion"](*_numbers(tick["hand_rot"]).tolist())
        yield HAND, types[_POSE](header, types["geometry_msgs/msg/Pose"](point, turn)), _POSE

    def __enter__(self) -> BagRecorder:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the bag with its metadata.yaml; after an error close it as it is."""
        if kind is None:
            self._writer.close()
        else:
            with suppress(sqlite3.Error):
                self._writer.abort()


def _numbers(values: list[float | None]) -> np.ndarray:
    return np.array([math.nan if v is None else v for v in values], dtype=np.float64)


@dataclass(frozen=True)
class Recorded:
    """What was recorded.

    Attributes:
        ticks: Ticks in the bag.
        missed: Ticks that did not come.
        seconds: From the first to the last, by the service's clock [s].
        cut_off: Whether the service ended it.
    """

    ticks: int
    missed: int
    seconds: float
    cut_off: bool


def record(
    url: str, stream: Iterator[tuple[dict[str, Any], int]], out: Path, seconds: float | None,
    ready: Callable[[Path], None],
) -> Recorded:  # fmt: skip
    """Record a stream of ticks into a new bag until it ends, Ctrl-C, or so many seconds of its clock have passed.

    Args:
        url: Where the stream comes from, for errors.
        stream: Ticks and when they were received [ns], as `stream.ticks` yields them.
        out: Folder of the bag.
        seconds: How long, None for as long as it goes.
        ready: Called with the folder once it records.

    Raises:
        InputError: The folder is there already, or no tick came.
        OSError: There is no room left; what came before is kept.
    """
    first = next(stream, None)
    if first is None:
        raise InputError(url, "", "a service without a tick", "a running bough robot serve")
    begin = last = float(first[0]["time_s"])
    cut_off = True
    with BagRecorder(out) as bag:
        try:
            ready(out)
            for tick, received in itertools.chain([first], stream):
                if seconds is not None and float(tick["time_s"]) - begin > seconds:
                    cut_off = False
                    break
                with uninterrupted():  # a tick is both of its messages, counted
                    bag.add(tick, received)
                    last = float(tick["time_s"])
        except KeyboardInterrupt:
            cut_off = False
    return Recorded(bag.ticks, bag.missed, last - begin, cut_off)


def check_new_bag(path: Path) -> None:
    """Refuse what cannot become a bag's folder, before anything is asked of a robot.

    Raises:
        InputError: The rosbags library is missing, or the folder is there already or cannot be made.
    """
    try:
        import rosbags  # noqa: F401
    except ImportError:
        raise InputError("record", "", "no rosbags library", install_hint("touch")) from None
    if path.exists() or path.is_symlink():
        raise InputError(path, "--out", "something is there", "a new folder: recordings are never overwritten")
    check_output(path)


def into_mcap(path: Path) -> None:
    """Turn a finished bag's SQLite into MCAP; the SQLite file goes once the other is whole.

    Raises:
        OSError: There is no room; the bag stays as it is.
    """
    from rosbags.rosbag2 import Reader, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as work:
        fresh = Path(work) / path.name
        with Reader(path) as reader, Writer(fresh, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topics = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
            for connection, stamp, raw in reader.messages():
                writer.write(topics[connection.id], stamp, raw)
        os.replace(fresh / f"{path.name}.mcap", path / f"{path.name}.mcap")
        os.replace(fresh / "metadata.yaml", path / "metadata.yaml")
    (path / f"{path.name}.db3").unlink()
