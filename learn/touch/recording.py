"""One recording of an arm that is touched, or is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...sim.base.console import warn
from ...sim.base.errors import InputError
from ...sim.base.types import Array, IntArray

UNKNOWN = -1
#: Rows of a recording.
LEAST_ROWS = 3


@dataclass(frozen=True)
class Recording:
    """An arm's joints over time, T rows of D joints.

    Attributes:
        name: The file, relative to the folder that was read.
        time: [s], increasing, [T].
        torque: Joint torque [N m], or motor current [A]; gravity and what else free motion needs may be in it, [T, D].
        velocity: Executed joint speed [rad/s], [T, D].
        command: Commanded joint speed [rad/s]; the executed one where the source has none, [T, D].
        expected: What the robot's own model expects of the torque, in its unit; zero where the source says nothing.
        contact: 1 in contact, 0 free, -1 unknown, [T].
        link: Where it is touched, such as ``forearm``; empty if nowhere or unknown.
        direction: From where, in the words of the source; may be empty.
        tolerance: How uncertain the times of contact are [s]: half of the unit that they are written in.
    """

    name: str
    time: Array
    torque: Array
    velocity: Array
    command: Array
    expected: Array
    contact: IntArray
    link: str = ""
    direction: str = ""
    tolerance: float = 0.0

    @property
    def num_dofs(self) -> int:
        """Number of joints D."""
        return self.torque.shape[1]

    @property
    def rate(self) -> float:
        """Samples a second [Hz]: of the median step."""
        return float(1.0 / np.median(np.diff(self.time)))

    @property
    def certain(self) -> IntArray:
        """Rows whose label is known and further from a change of it than ``tolerance``, bool, [T]."""
        out = self.contact != UNKNOWN
        for k in np.nonzero(np.diff(self.contact))[0]:
            edge = (self.time[k] + self.time[k + 1]) / 2
            out = out & (np.abs(self.time - edge) > self.tolerance)
        return out


def check_joints(recordings: Sequence[Recording], source: str, joints: int | None = None) -> int:
    """Return the number of joints, the same in all recordings.

    Args:
        recordings: One or more.
        source: What they are called in an error.
        joints: How many a model has, if one is given.

    Raises:
        InputError: A recording has another number.
    """
    wanted = recordings[0].num_dofs if joints is None else joints
    for r in recordings:
        if r.num_dofs != wanted:
            said = "as the model has" if joints is not None else f"as {recordings[0].name} has"
            raise InputError(f"{source}/{r.name}", "", f"{r.num_dofs} joints", f"{wanted} joints, {said}")
    return wanted


def check_labels(recordings: Sequence[Recording], source: str) -> None:
    """Check that contact and free motion are both known somewhere.

    Raises:
        InputError: They are not.
    """
    labels = np.concatenate([r.contact for r in recordings])
    for value, name in ((1, "with contact"), (0, "without contact")):
        if not (labels == value).any():
            allowed = "rows of both: a column contact, or meta/collision_timestamps.csv beside bags"
            raise InputError(source, "contact", f"no row {name} in {len(recordings)} recordings", allowed)


def warn_of_commands(names: Sequence[str]) -> None:
    """Say which recordings have no commanded speeds."""
    if names:
        others = f" and {len(names) - 1} others" if len(names) > 1 else ""
        warn(f"{names[0]}{others}: no commanded joint speeds; the executed ones stand for them")
