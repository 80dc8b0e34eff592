"""Probes: pushes that an arm can make at the grasp point, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.plugins import Registry
from ...sim.base.types import Array

#: Force over the largest of the case, at a time over the probe's length.
Course = Callable[[Array], Array]


@dataclass(frozen=True)
class Push:
    """One push: in which direction at the held segment, how hard, how long, and its course.

    Attributes:
        axis: Direction: 0 across the segment in its own plane, 1 across that plane, 2 along it; or three numbers of
            any length, parts along these.
        size: Largest force over the case's largest.
        length: Duration over the case's longest recording.
        course: Force over its largest at a time over the duration, in [-1, 1].
        free_from: Share of the duration after which the gripper is open.
    """

    axis: int | tuple[float, float, float]
    size: float
    length: float
    course: Course
    free_from: float = 1.0

    def direction(self, axes: Array) -> Array:
        """Return the unit vector, shape [3], of this push, of the three ``axes`` [3, 3] at the held segment."""
        if isinstance(self.axis, tuple):
            along = np.asarray(self.axis) @ axes
            return np.asarray(along / np.linalg.norm(along))
        return np.asarray(axes[self.axis])


@dataclass(frozen=True)
class ArmProbe:
    """A probe in words, and its pushes one after the other with the gripper open in between."""

    words: str
    pushes: tuple[Push, ...]

    def check(self) -> ArmProbe:
        """Return self if an arm can be told to do it.

        Raises:
            InputError: No words, no push, or a number or a course out of its range.
        """
        if not self.words or not self.pushes:
            raise InputError("probe", "", "no words" if not self.words else "no push", "words and one push or more")
        for push in self.pushes:
            force = np.asarray(push.course(np.linspace(0.0, 1.0, 101)), dtype=np.float64)
            _need(_points(push.axis), "axis", push.axis, "0, 1, 2, or a tuple of three numbers that are not all 0")
            _need(0.0 <= push.size < np.inf, "size", push.size, "0 or more")
            _need(0.0 < push.length < np.inf, "length", push.length, "above 0")
            _need(force.shape == (101,), "course", force.shape, "a number for each of 101 times")
            _need(bool((np.abs(force) <= 1.0).all()), "course", force[~(np.abs(force) <= 1.0)][:1], "-1 to 1")
        return self


def _points(axis: object) -> bool:
    if not isinstance(axis, tuple):
        return axis in (0, 1, 2)
    numbers = len(axis) == 3 and all(isinstance(x, (int, float)) for x in axis)
    return numbers and bool(np.isfinite(axis).all()) and any(axis)


def _need(fine: bool, place: str, found: object, allowed: str) -> None:
    if not fine:
        raise InputError("probe", place, str(found), allowed)


def _hold(t: Array) -> Array:
    return np.clip(t / 0.1, 0.0, 1.0)


def _back(t: Array) -> Array:
    return np.interp(t, [0.0, 0.12, 0.36, 0.48], [0.0, 1.0, -1.0, -1.0])


def _triangle(t: Array) -> Array:
    return np.interp(t, [0.0, 0.25, 0.75, 1.0], [0.0, 1.0, -1.0, 0.0])


def _sweep(t: Array) -> Array:
    return np.sin(2.0 * np.pi * (2.0 * t + 6.0 * t**2))


_THRICE = (Push(0, 1 / 3, 1.0, _hold, 0.7), Push(0, 1.0, 1.0, _hold, 0.7), Push(0, 1 / 3, 1.0, _hold, 0.7))

#: Words of a probe across the held segment, in or across its own plane, and its size, length, course and release.
_ACROSS: dict[str, tuple[str, tuple[float, float, Course, float]]] = {
    "gentle_swing": (
        "push {} with a third of the force, hold, release, and record the free swing", (1 / 3, 1.0, _hold, 0.5),
    ),
    "full_swing": ("push {} with all of the force, hold, release, and record the free swing", (1.0, 1.0, _hold, 0.5)),
    "back_swing": (
        "push {} with all of the force both ways, release, and record the free swing", (1.0, 1.0, _back, 0.5),
    ),
    "long_hold": ("push {} and hold for three times as long", (1.0, 3.0, _hold, 1.0)),
    "triangle": ("a slow triangle of force {}, both ways", (1.0, 3.0, _triangle, 1.0)),
    "sweep": ("a sweep of frequencies {} with a third of the force", (1 / 3, 1.0, _sweep, 1.0)),
}  # fmt: skip

_OWN = {
    f"{name}_{plane}": ArmProbe(words.format(f"{plane} its own plane"), (Push(axis, *numbers),))
    for name, (words, numbers) in _ACROSS.items() for axis, plane in enumerate(("in", "across"))
} | {
    "pull": ArmProbe("pull along the segment and hold, gripper closed", (Push(2, 1.0, 1.0, _hold),)),
    "thrice": ArmProbe(
        "push with a third of the force, with all of it, and with a third again, gripper open in between", _THRICE,
    ),
    "still": ArmProbe("record without a push, gripper open", (Push(0, 0.0, 3.0, _hold, 0.0),)),
}  # fmt: skip


def _check(probe: ArmProbe, _name: str) -> None:
    probe.check()


#: Entry points of the group ``bough_probes`` name an `ArmProbe`, or a function that returns one.
PROBES = Registry("bough_probes", "probe", ArmProbe, _OWN, check=_check)
