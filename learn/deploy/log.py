"""The log of a run: one line of CSV for every tick that was answered, whole to the last one whatever ends it."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..robot.log import read_lines

LOG = "run.csv"


@dataclass(frozen=True)
class Answer:
    """What a loop did with one tick of an arm of D joints; SI units.

    Attributes:
        time: Since the run began [s].
        tick: The service's number of it.
        episode, step, period: Where it is: period 0 of a policy step is when an action is chosen.
        age: Of the clouds that the last action was chosen by [s], NaN without a camera.
        latency: From the tick's arrival until it was answered [s].
        q, qd: Measured, [D].
        action: Of the policy, [D].
        asked: Speeds that the service was asked for, [D].
        hand: Of the end-effector, [3].
        occlusion: As the policy saw it last, NaN where it sees none.
        distance: Of the hand from its target [m], NaN where there is none.
        touch: Probability of touch as it was told, NaN where none is.
    """

    time: float
    tick: int
    episode: int
    step: int
    period: int
    age: float
    latency: float
    q: Array
    qd: Array
    action: Array
    asked: Array
    hand: Array
    occlusion: float
    distance: float
    touch: float


def columns(joints: int) -> list[str]:
    """Return the names of the columns for so many joints, counted from 1."""
    forms = ("q{}_rad", "dq{}_rad_s", "action{}", "dq_asked{}_rad_s")
    return ["time_s", "tick", "episode", "step", "period", "age_s", "latency_s",
            *(form.format(k) for form in forms for k in range(1, joints + 1)),
            "hand_x_m", "hand_y_m", "hand_z_m", "occlusion", "distance_m", "touch"]  # fmt: skip


def line_of(a: Answer) -> str:
    """Return an answer as a line of the log."""
    numbers = [a.age, a.latency, *a.q, *a.qd, *a.action, *a.asked, *a.hand, a.occlusion, a.distance, a.touch]
    return f"{a.time:.6f},{a.tick},{a.episode},{a.step},{a.period},{','.join(f'{x:.6g}' for x in numbers)}\n"


class RunLog:
    """Writes answers, each in one write, so that ``kill -9`` tears none."""

    def __init__(self, path: Path, joints: int) -> None:
        """Begin a log.

        Raises:
            InputError: There is one already.
            OSError: The file cannot be made, or there is no room.
        """
        self.path, self._size = path, 0
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644)
        except FileExistsError:
            raise InputError(path, "--out", "a log", "a folder without one: logs are never overwritten") from None
        self._write(",".join(columns(joints)) + "\n")

    def put(self, answer: Answer) -> None:
        """Write an answer.

        Raises:
            OSError: There is no room for the whole line; what was written of it is taken out again.
        """
        self._write(line_of(answer))

    def close(self) -> None:
        """End."""
        os.close(self._file)

    def _write(self, line: str) -> None:
        data, written = line.encode(), 0
        try:
            written = os.write(self._file, data)
            if written != len(data):
                raise OSError(28, "No space left on device")
        except OSError as error:
            with contextlib.suppress(OSError):  # the reader leaves a torn line out
                os.ftruncate(self._file, self._size)
            raise OSError(error.errno, error.strerror, str(self.path)) from None
        self._size += written


def read_run(path: Path) -> dict[str, Array]:
    """Read a run's log, whatever ended it: a line that was cut short is left out.

    Args:
        path: The file, or its folder.

    Returns:
        Numbers by the name of their column, [ticks] each.

    Raises:
        InputError: The file is missing or no such log.
    """
    names, lines = read_lines(path, LOG, ["time_s", "tick", "episode"], "bough run")
    rows = np.array([line.split(",") for line in lines], dtype=np.float64).reshape(len(lines), len(names))
    return {name: rows[:, k] for k, name in enumerate(names)}
