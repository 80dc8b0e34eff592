"""What an arm is to the service: one class of three methods, which twins, drivers and bridges have.

A backend of your own is any class with these methods and the attribute; hand it to `learn.robot.serve.serve`. All are
called from the control loop's thread, 60 times a second, and none may wait: a read returns the newest sample there is.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from ...sim.base.types import Array


def unmeasured() -> Array:
    """Return a vector of three that nothing measures: NaN."""
    return np.full(3, np.nan)


@dataclass(frozen=True)
class Sample:
    """One measurement of an arm of D joints.

    Attributes:
        time: When it was measured, on the clock of `time.monotonic` [s].
        q: Joint positions [rad], [D].
        qd: Joint speeds [rad/s], [D].
        torque: Joint torques without what carries the arm's own weight [N m], [D].
        hand_position: Of the end-effector in the base frame [m], [3].
        hand_rotation: Its orientation, w, x, y, z, [4].
        gripper: How far it is closed, 0 to 1; NaN for an arm without one.
        force: Of the hand on what it holds, by a sensor at the wrist, base frame [N], [3]; NaN without one.
        tag: Of a tag that a camera follows, base frame [m], [3]; NaN without one.
    """

    time: float
    q: Array
    qd: Array
    torque: Array
    hand_position: Array
    hand_rotation: Array
    gripper: float = np.nan
    force: Array = field(default_factory=unmeasured)
    tag: Array = field(default_factory=unmeasured)


class Backend(Protocol):
    """An arm.

    Attributes:
        num_dofs: Number of joints D.
    """

    num_dofs: int

    def read(self, now: float) -> Sample | None:
        """Return the newest measurement, None where there is none yet; raise where the arm is lost.

        Args:
            now: The clock of `time.monotonic` [s].
        """
        ...

    def send(self, velocity: Array) -> None:
        """Ask the arm for joint speeds [rad/s], [D], until the next call; raise where that cannot be done.

        An arm whose driver does not stand still by itself when calls stay out for 0.1 s needs a watchdog of its own:
        nothing in the service survives its process.
        """
        ...

    def close(self) -> None:
        """Let go of the arm. The last speeds sent were zero."""
        ...


@runtime_checkable
class Gripping(Protocol):
    """What a backend with a gripper has besides; without it commands for a gripper are refused."""

    def grip(self, closed: float) -> None:
        """Ask the gripper for how far it should be closed, 0 to 1; raise where that cannot be done. A stop keeps it."""
        ...


@runtime_checkable
class Staged(Protocol):
    """What a twin has besides, whose scenes begin anew and are known. Both are called from the network's threads."""

    def begin(self, number: int) -> None:
        """Put the arm at rest at home in the scene of this number; may take its time, and is called while stopped."""
        ...

    def truth(self) -> dict[str, Array]:
        """Return what is true of the scene now, by name."""
        ...
