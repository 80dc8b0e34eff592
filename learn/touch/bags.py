"""ROS bags as recordings: joint states with efforts, commanded joint speeds, and times of contact written beside them.

Read are ROS 1 bags, and ROS 2's MCAP and SQLite files, through the rosbags library. Of the joint states all joints
count whose name holds no ``finger``. Commanded speeds are read of messages of the type ``JointVelocity`` of Kinova's
driver (degrees a second) and of ``Float64MultiArray`` (rad/s) on a topic that is called after a velocity; the command
of a row is the mean of those since the row before. A file ``meta/collision_timestamps.csv`` beside the bags has a row
for each, in the order of their names: ``start_time,end_time`` on a clock on the wall, and ``link``. The clock's zone is
the one, in quarters of an hour, in which the times fall into the recording. Bags in a folder called ``free`` are
without contact.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint
from ...sim.base.files import read_text
from ...sim.base.types import Array, IntArray
from .recording import LEAST_ROWS, UNKNOWN, Recording, warn_of_commands

STAMPS = Path("meta") / "collision_timestamps.csv"
#: Offsets of clocks from UTC end at 14 hours and are whole quarters of an hour.
_ZONE, _QUARTER = 14 * 3600.0, 900.0


@dataclass
class _Rows:
    """What a bag holds: times [s] and rows."""

    time: list[float] = field(default_factory=list)
    velocity: list[Any] = field(default_factory=list)
    effort: list[Any] = field(default_factory=list)
    command_time: list[float] = field(default_factory=list)
    command: list[Any] = field(default_factory=list)
    states: int = 0


def read_bags(folder: Path, files: Sequence[Path]) -> list[Recording]:
    """Read bags below ``folder``.

    Raises:
        InputError: The rosbags library is missing; a bag cannot be read or holds no efforts; its times of contact do
            not fit.
    """
    try:
        import rosbags  # noqa: F401
    except ImportError:
        raise InputError(files[0], "", "a ROS bag, without the rosbags library", install_hint("touch")) from None
    stamps: dict[Path, list[dict[str, str]] | None] = {}
    out, bare = [], []
    for file in files:
        name = str(file.relative_to(folder))
        rows = _read(file)
        time, order = np.array(rows.time), np.argsort(rows.time, kind="stable")
        keep = order[np.concatenate([[True], np.diff(time[order]) > 0])]
        recording = _recording(name, time[keep], np.array(rows.effort)[keep], np.array(rows.velocity)[keep], rows)
        if not rows.command:
            bare.append(name)
        known = stamps.setdefault(file.parent, _stamps(file.parent / STAMPS))
        out.append(_labelled(recording, file, known, float(time[keep][0])))
    warn_of_commands(bare)
    return out


def _read(path: Path) -> _Rows:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    rows = _Rows()
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS1_NOETIC)) as reader:
            wanted = [c for c in reader.connections if _is_state(c) or _is_command(c)]
            for connection, stamp, raw in reader.messages(connections=wanted) if wanted else ():
                _take(rows, _is_state(connection), stamp * 1e-9, reader.deserialize(raw, connection.msgtype))
    except Exception as error:
        found = " ".join(str(error).split()) or type(error).__name__
        raise InputError(path, "", f"no bag that can be read ({found[:80]})", "a ROS bag") from None
    if not rows.states:
        raise InputError(path, "", "no joint states", "messages of sensor_msgs/JointState with efforts")
    if not rows.effort:
        raise InputError(path, "", f"{rows.states} joint states without efforts", "joint states with efforts")
    if len(set(rows.time)) < LEAST_ROWS:
        raise InputError(path, "", f"{len(rows.time)} joint states with efforts", f"{LEAST_ROWS} or more")
    return rows


def _is_state(connection: Any) -> bool:
    return bool(connection.msgtype.endswith("/JointState"))


def _is_command(connection: Any) -> bool:
    array = connection.msgtype.endswith("/Float64MultiArray") and "velocity" in connection.topic
    return bool(connection.msgtype.endswith("/JointVelocity")) or array


def _take(rows: _Rows, state: bool, time: float, message: Any) -> None:
    if not state:
        named = [f"joint{k}" for k in range(1, 8) if hasattr(message, f"joint{k}")]
        speeds = [np.deg2rad(getattr(message, k)) for k in named] if named else list(message.data)
        rows.command_time.append(time)
        rows.command.append(speeds)
        return
    rows.states += 1
    use = [k for k, name in enumerate(message.name) if "finger" not in name] or list(range(len(message.effort)))
    if use and len(message.effort) > max(use) and len(message.velocity) > max(use):
        if rows.effort and len(rows.effort[0]) != len(use):
            return  # another arm's
        rows.time.append(time)
        rows.effort.append(np.asarray(message.effort, float)[use])
        rows.velocity.append(np.asarray(message.velocity, float)[use])


def _recording(name: str, time: Array, effort: Array, velocity: Array, rows: _Rows) -> Recording:
    joints = effort.shape[1]
    usable = [k for k, c in enumerate(rows.command) if len(c) >= joints]
    if usable:
        given = np.array([rows.command[k][:joints] for k in usable])
        command = _mean_since(time, np.array([rows.command_time[k] for k in usable]), given)
    else:
        command = velocity
    unknown = np.full(len(time), UNKNOWN)
    return Recording(name, time - time[0], effort, velocity, command, np.zeros_like(effort), unknown)


def _mean_since(time: Array, given_at: Array, given: Array) -> Array:
    """Return the mean of what was given between a time and the one before, or what was given last, [T, D]."""
    order = np.argsort(given_at, kind="stable")
    last = np.searchsorted(given_at[order], time, side="right")
    first = np.concatenate([[max(0, int(last[0]) - 1)], last[:-1]])
    total = np.concatenate([np.zeros((1, given.shape[1])), np.cumsum(given[order], axis=0)])
    first = np.maximum(np.minimum(first, last - 1), 0)
    last = np.maximum(last, 1)  # before the first command: the first
    out: Array = (total[last] - total[first]) / (last - first)[:, None]
    return out


def _stamps(path: Path) -> list[dict[str, str]] | None:
    if not path.exists():
        return None
    rows = csv.DictReader(read_text(path).splitlines())
    missing = [name for name in ("start_time", "end_time") if name not in (rows.fieldnames or [])]
    if missing:
        raise InputError(path, "line 1 (header)", f"no column {missing[0]}", "start_time,end_time,link")
    return list(rows)


def _labelled(recording: Recording, file: Path, stamps: list[dict[str, str]] | None, begin: float) -> Recording:
    """Write contact, link and the uncertainty of the times into a recording."""
    if stamps is None or "free" in file.parent.parts[-1:]:
        free = file.parent.name == "free"
        return replace(recording, contact=np.full(len(recording.time), 0 if free else UNKNOWN))
    number = sorted(file.parent.glob(f"*{file.suffix}")).index(file)
    path = file.parent / STAMPS
    if number >= len(stamps):
        raise InputError(path, "", f"{len(stamps)} rows", f"a row for every bag; {file.name} is number {number + 1}")
    row, place = stamps[number], f"row {number + 2}"
    start, end = (_seconds(path, place, row[name]) for name in ("start_time", "end_time"))
    if end < start:
        raise InputError(path, place, "an end before the start", "end_time after start_time")
    contact = _between(recording.time + begin, start, end)
    link = row.get("link", "") if contact.any() else ""
    fraction = "." in row["start_time"]
    return replace(recording, contact=contact, link=link, tolerance=0.0 if fraction else 0.5)


def _seconds(path: Path, place: str, text: str) -> float:
    try:
        return datetime.fromisoformat(text).replace(tzinfo=timezone.utc).timestamp()
    except ValueError:
        raise InputError(path, place, f"'{text}'", "a time such as 2024-02-29 16:25:00") from None


def _between(time: Array, start: float, end: float) -> IntArray:
    """Return 1 where a time lies between two on a clock of an unknown zone, as far as one brings them there, [T]."""
    behind = ((start + end) - (time[0] + time[-1])) / 2
    zone = round(behind / _QUARTER) * _QUARTER
    if abs(zone) > _ZONE:
        return np.zeros(len(time), np.int64)
    return ((time >= start - zone) & (time <= end - zone)).astype(np.int64)
