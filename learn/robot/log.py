"""The log of a service: one line of CSV for every tick, written by a thread of its own, read back after any end.

A line goes to the file in one write, and only what is in the file is told to anyone: whoever saw a tick finds it in the
log, even after ``kill -9``. After a power cut up to a second may be missing. A line that a full disk cut short is taken
out again, and the log goes on when there is room. Its columns are also those that `learn.touch.read` reads.
"""

from __future__ import annotations

import contextlib
import math
import os
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.files import TEXT_LIMIT, check_regular
from ...sim.base.types import Array
from .backend import unmeasured

TICKS = "ticks.csv"
_BACKLOG = 30  # ticks, half a second
_SYNC = 1.0  # s


@dataclass(frozen=True)
class Tick:
    """All that is known of one tick of an arm of D joints; SI units.

    Attributes:
        number: Of the tick, from 1.
        time: Since the service began [s].
        unix: Of the day [s].
        age: Of the measurement [s]; infinite where there is none.
        q, qd, torque: Measured, [D]; NaN where nothing is.
        asked: Speeds that the controller asked for, [D].
        sent: Speeds that the arm was sent, [D].
        hand_position, hand_rotation: Of the end-effector, [3], and w, x, y, z, [4].
        touch: Probability of touch, 0 without a model.
        state: ``ready``, ``moving`` or ``stopped``.
        stop: Number of the stop that holds, 0 for none.
        cause: Of that stop.
        controller: Who holds the arm.
        sequence: Number of the command that runs, -1 for none.
        accepted, refused: Commands since the service began.
        last_refusal: Reason of the last refusal.
        gripper: How far it is closed, NaN without one.
        force, tag: Of the hand, and of a tag, [3]; NaN where nothing measures them.
    """

    number: int
    time: float
    unix: float
    age: float
    q: Array
    qd: Array
    torque: Array
    asked: Array
    sent: Array
    hand_position: Array
    hand_rotation: Array
    touch: float
    state: str
    stop: int
    cause: str
    controller: str
    sequence: int
    accepted: int
    refused: int
    last_refusal: str
    gripper: float = math.nan
    force: Array = field(default_factory=unmeasured)
    tag: Array = field(default_factory=unmeasured)


def columns(joints: int) -> list[str]:
    """Return the names of the columns for so many joints, counted from 1."""
    numbers = range(1, joints + 1)
    forms = ("q{}_rad", "dq{}_rad_s", "tau{}_Nm", "dq_asked{}_rad_s", "dq_cmd{}_rad_s")
    return [
        "tick", "time_s", "unix_time_s", "age_s", *(form.format(k) for form in forms for k in numbers),
        "hand_x_m", "hand_y_m", "hand_z_m", "hand_qw", "hand_qx", "hand_qy", "hand_qz", "touch", "state", "stop",
        "cause", "controller", "sequence", "accepted", "refused", "last_refusal", "gripper", "hand_fx_N", "hand_fy_N",
        "hand_fz_N", "tag_x_m", "tag_y_m", "tag_z_m",
    ]  # fmt: skip


def line_of(tick: Tick) -> str:
    """Return a tick as a line of the log."""
    t = tick
    numbers = [*t.q, *t.qd, *t.torque, *t.asked, *t.sent, *t.hand_position, *t.hand_rotation, t.touch]
    before = f"{t.number},{t.time:.6f},{t.unix:.6f},{t.age:.4f}"
    after = f"{t.state},{t.stop},{_plain(t.cause)},{_plain(t.controller)},{t.sequence},{t.accepted},{t.refused}"
    sensed = ",".join("" if math.isnan(x) else f"{x:.6g}" for x in (t.gripper, *t.force, *t.tag))
    return f"{before},{','.join(f'{x:.6g}' for x in numbers)},{after},{t.last_refusal},{sensed}\n"


def _plain(text: str) -> str:
    """Return text that fits a cell: printable, on one line, without commas and quotes."""
    return "".join(c if c.isprintable() and c not in ',"' else " " for c in text)


def check_new(folder: Path) -> None:
    """Raise `InputError` where a folder holds a log already."""
    if (folder / TICKS).exists():
        raise _taken(folder / TICKS)


def _taken(path: Path) -> InputError:
    return InputError(path, "--out", "a log", "a folder without one: logs are never overwritten")


class Log:
    """Writes ticks, and then tells of them.

    Attributes:
        path: The file.
        trouble: Why ticks cannot be written at present, "" where they can.
    """

    def __init__(self, folder: Path, joints: int, tell: Callable[[Tick], None]) -> None:
        """Begin a log in a folder.

        Args:
            folder: Where; `TICKS` must not be there yet.
            joints: Number of joints.
            tell: Called in the log's thread with every tick, once it is written or cannot be.

        Raises:
            InputError: There is a log already.
            OSError: The file cannot be made.
        """
        self.path, self.trouble, self._tell = folder / TICKS, "", tell
        try:
            self._file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644)
        except FileExistsError:
            raise _taken(self.path) from None
        self._queue: queue.SimpleQueue[Tick | None] = queue.SimpleQueue()
        self._size, self._ended = 0, threading.Event()
        self._write(",".join(columns(joints)) + "\n")
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()
        self._syncing = threading.Thread(target=self._sync, name="sync", daemon=True)
        self._syncing.start()

    def put(self, tick: Tick) -> None:
        """Hand over a tick; never waits."""
        self._queue.put(tick)

    @property
    def problem(self) -> str:
        """Why the log is not whole at present, "" where it is; asked in every tick."""
        if self.trouble:
            return self.trouble
        behind = self._queue.qsize()
        return f"the log is {behind} ticks behind" if behind > _BACKLOG else ""

    def close(self) -> None:
        """Write what is waiting and end."""
        self._queue.put(None)
        self._ended.set()
        self._thread.join()
        self._syncing.join()
        os.close(self._file)

    def _run(self) -> None:
        while (tick := self._queue.get()) is not None:
            self._write(line_of(tick))
            self._tell(tick)

    def _sync(self) -> None:
        """Have the disk keep what was written, once a second; a slow disk must not hold up the next line."""
        while not self._ended.wait(_SYNC):
            with contextlib.suppress(OSError):  # a disk that is full is told by the next write
                os.fsync(self._file)

    def _write(self, line: str) -> None:
        data = line.encode()
        try:
            written = os.write(self._file, data)
            if written != len(data):
                raise OSError(28, "no room for a whole line")
            self._size += written
            self.trouble = ""
        except OSError as error:
            self.trouble = f"the log cannot be written: {(error.strerror or 'an error').lower()}"
            self._cut()

    def _cut(self) -> None:
        """Take a line out again that was written in part."""
        with contextlib.suppress(OSError):  # the reader leaves a torn line out
            os.ftruncate(self._file, self._size)


def read_log(path: Path) -> dict[str, list[str]]:
    """Read a log as columns of text, whatever ended its service: a line that was cut short is left out.

    Args:
        path: The file, or its folder.

    Returns:
        Cells by the name of their column, one for each tick.

    Raises:
        InputError: The file is missing or no log.
    """
    names, lines = read_lines(path, TICKS, ["tick", "time_s", "unix_time_s"], "bough robot serve")
    rows = [row for row in (line.split(",") for line in lines) if len(row) == len(names)]
    cells = list(zip(*rows, strict=True)) or [()] * len(names)
    return {name: list(column) for name, column in zip(names, cells, strict=True)}


def joint_columns(log: dict[str, list[str]], form: str) -> Array:
    """Return the columns of all joints in a form such as ``dq_cmd{}_rad_s``, [ticks, D]."""
    found = [form.format(k) for k in range(1, len(log) + 1) if form.format(k) in log]
    return np.stack([np.array(log[name], float) for name in found], axis=1)


def read_lines(path: Path, name: str, first: list[str], writer: str) -> tuple[list[str], list[str]]:
    """Return the columns' names and the whole lines of a log; a last line that was torn is left out.

    Args:
        path: The log, or the folder that it lies in.
        name: Of the log in its folder.
        first: What its first columns are called.
        writer: The command that writes it.

    Raises:
        InputError: The file is missing or no such log.
    """
    path = path / name if path.is_dir() else path
    check_regular(path, 64 * TEXT_LIMIT)
    if not path.is_file():
        raise InputError(path, "", "no such file", f"a log that {writer} wrote")
    whole, newline, _torn = path.read_bytes().decode(errors="replace").rpartition("\n")
    header, *lines = whole.split("\n") if newline else [""]
    names = header.split(",")
    if names[: len(first)] != first:
        raise InputError(path, "line 1 (header)", f"'{header[:40]}'", f"a log that {writer} wrote")
    return names, lines
