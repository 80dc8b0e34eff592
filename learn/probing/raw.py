"""What a pull measures, tick by tick as it comes, and the samples of a case that are made of it.

A line goes to ``NAME.csv.part`` in one write as soon as its tick has come; a whole recording loses the ``.part``. So
all that was measured before a kill, a stop or a full disk is in a file, and a whole file is whole.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import TracebackType

import numpy as np

from ...sim.arms.arm import Arm
from ...sim.arms.statics import statics
from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..robot.client import State

COLUMNS = ("tick", "time_s", "closed", "fx_N", "fy_N", "fz_N", "x_m", "y_m", "z_m")
OPEN = 0.5
"""Share of its way below which a gripper is known to be open; above, the force is the one that is measured."""


def force_of(arm: Arm, state: State) -> Array:
    """Return the force of the hand [N], [3]: of its sensor; without one that closest to the joint torques.

    Torques are without the arm's weight, so that tau = J' f; the closest f is (J J')^-1 J tau.
    """
    if np.isfinite(state.force).all():
        return state.force
    jacobian = statics(arm, state.q)[1]
    return np.linalg.solve(jacobian @ jacobian.T, jacobian @ state.torque).astype(np.float64)


def place_of(state: State) -> Array:
    """Return where the grasp point is [m], [3]: the tag, or the hand, which is there while it holds."""
    return state.tag if np.isfinite(state.tag).all() else state.hand_position


class RawRecording:
    """Writes states to a file as they come; use it in a ``with``, as one of a client's listeners.

    Attributes:
        path: The file once it is whole.
        ticks: Ticks in it.
    """

    def __init__(self, path: Path, arm: Arm) -> None:
        """Begin; a part that an earlier process left is kept beside it.

        Raises:
            OSError: The file cannot be made.
        """
        self.path, self.ticks, self._arm = path, 0, arm
        part = path.with_name(path.name + ".part")
        if part.exists():
            part.rename(_free(path))
        self._part = part
        self._file = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        self._problem: OSError | None = None
        joints = [f"q{k}_rad" for k in range(1, arm.num_dofs + 1)] + [f"tau{k}_Nm" for k in range(1, arm.num_dofs + 1)]
        os.write(self._file, (",".join((*COLUMNS, *joints)) + "\n").encode())

    def __call__(self, state: State) -> None:
        """Write a state."""
        closed = 1.0 if np.isnan(state.gripper) else state.gripper
        numbers = [closed, *force_of(self._arm, state), *place_of(state), *state.q, *state.torque]
        line = f"{state.tick},{state.time:.6f},{','.join(f'{x:.7g}' for x in numbers)}\n"
        try:
            os.write(self._file, line.encode())
            self.ticks += 1
        except OSError as error:  # in the client's thread: raised where the arm is steered
            self._problem = error

    def check(self) -> None:
        """Raise `OSError` where a line could not be written."""
        if self._problem is not None:
            raise self._problem

    def __enter__(self) -> RawRecording:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Make it whole; after an error leave it as a part under a name that nothing writes to again."""
        os.fsync(self._file)
        os.close(self._file)
        os.replace(self._part, self.path if kind is None else _free(self.path))


def _free(path: Path) -> Path:
    """Return a name for what was cut off, ``pull_3.cut-1.csv``, that is not taken."""
    number = 1
    while (found := path.with_name(f"{path.stem}.cut-{number}.csv")).exists():
        number += 1
    return found


def samples_of(path: Path, zero: Array, rate: float, count: int) -> tuple[Array, list[list[float]], float]:
    """Return a recording's samples for a case, linear between the ticks, which they meet where the rate divides 60 Hz.

    Means over a sample's time would take away what moves quickly, and the case is compared at instants.

    Args:
        path: A whole recording.
        zero: Where the grasp point is at rest [m], [3].
        rate: Sampling rate [Hz].
        count: Number of samples T.

    Returns:
        Rows t, f, x [T, 7]; intervals in which the gripper was open [s]; the service's time of the first sample [s].

    Raises:
        InputError: The file is too short.
    """
    rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    t = np.arange(count) / rate
    if len(rows) < 2 or rows[-1, 1] - rows[0, 1] < t[-1] - 0.5 / rate:
        found = f"{len(rows)} ticks"
        raise InputError(path, "", found, f"ticks over {t[-1]:g} s, as a whole recording has")
    begin, own = float(rows[0, 1]), rows[:, 1] - rows[0, 1]
    middle = np.column_stack([np.interp(t, own, rows[:, k]) for k in range(3, 9)])
    opened = np.flatnonzero(rows[:, 2] < OPEN)
    quiet = [[float(own[opened[0]]), float(t[-1])]] if len(opened) and own[opened[0]] < t[-1] else []
    return np.column_stack([t, middle[:, :3], middle[:, 3:] - zero]), quiet, begin
