"""What a ROS bag holds of an experiment: joint states, wrenches, scales, poses and frames, each on its own clock.

Read are ROS 1 bags and ROS 2's MCAP and SQLite files through the rosbags library. Times are those of the messages'
headers, where they have one, else those of their arrival in the bag.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint
from ...sim.base.rotation import quat_multiply, quat_rotate
from ...sim.base.types import Array

StreamKind = Literal["joints", "wrench", "scale", "pose", "command"]
_KINDS: dict[str, StreamKind] = {
    "sensor_msgs/msg/JointState": "joints",
    "geometry_msgs/msg/WrenchStamped": "wrench", "geometry_msgs/msg/Wrench": "wrench",
    "std_msgs/msg/Float64": "scale", "std_msgs/msg/Float32": "scale",
    **{f"geometry_msgs/msg/{name}": "pose" for name in ("Pose", "PoseStamped", "PoseWithCovarianceStamped",
                                                        "PointStamped", "TransformStamped")},
    "nav_msgs/msg/Odometry": "pose",
    "kinova_msgs/msg/JointVelocity": "command", "std_msgs/msg/Float64MultiArray": "command",
}  # fmt: skip
_FRAMES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
#: Shortest stream that is used.
LEAST = 10


@dataclass
class Stream:
    """Messages of one topic, or of one frame of TF.

    Attributes:
        name: The topic, or ``tf:`` and the frame.
        kind: What they are.
        frame: Frame of the numbers, may be empty.
        time: Times of the headers [s], length T.
        arrived: Times of arrival in the bag [s], length T.
        values: Rows: positions of joints, force [N], reading, position [m], commanded speeds [rad/s].
        turns: Quaternions w, x, y, z of poses; efforts of joint states [N m].
        names: Names of joints.
    """

    name: str
    kind: StreamKind
    frame: str = ""
    time: list[float] = field(default_factory=list)
    arrived: list[float] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)
    turns: list[Any] = field(default_factory=list)
    names: tuple[str, ...] = ()

    def add(self, time: float, arrived: float, values: Sequence[float] | Array, turn: Sequence[float] | Array) -> None:
        """Append a message."""
        self.time.append(time)
        self.arrived.append(arrived)
        self.values.append(np.asarray(values, dtype=np.float64))
        self.turns.append(np.asarray(turn, dtype=np.float64))

    def arrays(self) -> tuple[Array, Array, Array]:
        """Return times [T], values [T, C] and turns [T, K], sorted by time, repeated times left out."""
        time = np.array(self.time)
        order = np.argsort(time, kind="stable")
        keep = order[np.concatenate([[True], np.diff(time[order]) > 0])]
        return time[keep], np.array(self.values)[keep], np.array(self.turns)[keep]


@dataclass(frozen=True)
class Bag:
    """Streams of a bag.

    Attributes:
        path: The bag.
        streams: By topic; frames of TF by ``tf:`` and their name.
    """

    path: Path
    streams: dict[str, Stream]

    def of(self, kind: StreamKind) -> list[Stream]:
        """Return the topics of a kind that are long enough; frames of TF are not among them."""
        return [s for s in self.streams.values() if s.kind == kind and not s.name.startswith("tf:") and _long(s)]


def _long(stream: Stream) -> bool:
    return len(set(stream.time)) >= LEAST


def read_bag(path: Path) -> Bag:
    """Read a bag.

    Raises:
        InputError: The rosbags library is missing, or the bag cannot be read.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(path, "", "a ROS bag, without the rosbags library", install_hint("touch")) from None
    path = _file_of(path)
    _heal(path)
    streams: dict[str, Stream] = {}
    fixed: dict[str, tuple[str, Array, Array]] = {}
    store = get_typestore(Stores.ROS1_NOETIC if path.suffix == ".bag" else Stores.ROS2_HUMBLE)
    try:
        with AnyReader([path], default_typestore=store) as reader:
            wanted = [c for c in reader.connections if _known(c)]
            begin = reader.start_time if wanted else 0
            for connection, stamp, raw in reader.messages(connections=wanted) if wanted else ():
                message = reader.deserialize(raw, connection.msgtype)
                if connection.msgtype in _FRAMES:
                    _take_frames(streams, fixed, message, stamp, begin, "static" in connection.topic)
                else:
                    _take(streams, connection, message, stamp, begin)
    except Exception as error:
        found = " ".join(str(error).split()) or type(error).__name__
        raise InputError(path, "", f"no bag that can be read ({found[:80]})", "a ROS 1 or ROS 2 bag") from None
    for stream in streams.values():
        if stream.name.startswith("tf:"):
            _to_root(stream, fixed)
    return Bag(path, streams)


def _known(connection: Any) -> bool:
    """Return whether messages are read; an array is a command on a topic that is called after a velocity."""
    if connection.msgtype.endswith("/Float64MultiArray"):
        return "velocity" in connection.topic
    return connection.msgtype in _KINDS or connection.msgtype in _FRAMES


def _file_of(path: Path) -> Path:
    """Return a bag as rosbags reads it: of a folder that a killed recorder left without metadata.yaml, its SQLite."""
    files = list(path.glob("*.db3")) if path.is_dir() and not (path / "metadata.yaml").exists() else []
    return files[0] if len(files) == 1 else path


def _heal(path: Path) -> None:
    """Take back what a killed recorder has half written, which rosbags would read as it is."""
    if path.suffix == ".db3" and path.with_name(f"{path.name}-journal").exists():
        with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(path)) as base:
            base.execute("SELECT count(*) FROM sqlite_master").fetchone()


def _seconds(message: Any, stamp: int, begin: int) -> float:
    """Return a message's time from the bag's begin [s], in integers as long as it is nanoseconds since 1970."""
    header = getattr(message, "header", None)
    own = 0 if header is None else header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    return ((own or stamp) - begin) * 1e-9


def _take(streams: dict[str, Stream], connection: Any, message: Any, stamp: int, begin: int) -> None:
    kind = _KINDS[connection.msgtype]
    header = getattr(message, "header", None)
    stream = streams.setdefault(connection.topic, Stream(connection.topic, kind, getattr(header, "frame_id", "")))
    time, arrived = _seconds(message, stamp, begin), (stamp - begin) * 1e-9
    if kind == "joints":
        _take_joints(stream, time, arrived, message)
    elif kind == "wrench":
        stream.add(time, arrived, _xyz(getattr(message, "wrench", message).force), ())
    elif kind == "scale":
        stream.add(time, arrived, [message.data], ())
    elif kind == "command":
        stream.add(time, arrived, _asked(message), ())
    else:
        stream.add(time, arrived, *_pose(message))


def _take_joints(stream: Stream, time: float, arrived: float, message: Any) -> None:
    use = [k for k, name in enumerate(message.name) if "finger" not in name]
    names = tuple(message.name[k] for k in use)
    if not use or len(message.position) <= max(use) or names != (stream.names or names):
        return  # another arm's, or fingers alone
    stream.names = names
    effort = message.effort if len(message.effort) > max(use) else np.full(max(use) + 1, np.nan)
    stream.add(time, arrived, np.asarray(message.position)[use], np.asarray(effort)[use])


def _asked(message: Any) -> list[float]:
    """Return commanded joint speeds [rad/s]: Kinova's messages are in degrees a second."""
    named = [f"joint{k}" for k in range(1, 8) if hasattr(message, f"joint{k}")]
    return [float(np.deg2rad(getattr(message, k))) for k in named] if named else [float(v) for v in message.data]


def _pose(message: Any) -> tuple[list[float], list[float]]:
    """Return position and quaternion w, x, y, z of a message that holds a pose, a transform or a point."""
    if hasattr(message, "point"):
        return _xyz(message.point), [1.0, 0.0, 0.0, 0.0]
    part = getattr(message, "transform", None)
    if part is not None:
        return _xyz(part.translation), _wxyz(part.rotation)
    part = getattr(message, "pose", message)
    part = getattr(part, "pose", part)  # with a covariance
    return _xyz(part.position), _wxyz(part.orientation)


def _xyz(v: Any) -> list[float]:
    return [v.x, v.y, v.z]


def _wxyz(q: Any) -> list[float]:
    return [q.w, q.x, q.y, q.z]


def _take_frames(
    streams: dict[str, Stream], fixed: dict[str, tuple[str, Array, Array]], message: Any, stamp: int, begin: int,
    static: bool,
) -> None:  # fmt: skip
    for item in message.transforms:
        child, parent = item.child_frame_id.lstrip("/"), item.header.frame_id.lstrip("/")
        position, turn = _pose(item)
        if static:
            fixed[child] = (parent, np.array(position), np.array(turn))
            continue
        stream = streams.setdefault(f"tf:{child}", Stream(f"tf:{child}", "pose", parent))
        stream.add(_seconds(item, stamp, begin), (stamp - begin) * 1e-9, position, turn)


def _to_root(stream: Stream, fixed: dict[str, tuple[str, Array, Array]]) -> None:
    """Bring a frame's poses through the fixed frames above it."""
    seen = set()
    while stream.frame in fixed and stream.frame not in seen:
        seen.add(stream.frame)
        stream.frame, position, turn = fixed[stream.frame]
        stream.values = [position + quat_rotate(turn, v) for v in stream.values]
        stream.turns = [quat_multiply(turn, t) for t in stream.turns]
