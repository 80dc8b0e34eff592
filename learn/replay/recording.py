"""One trajectory of a case as inference uses it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...sim.base.types import Array
from ..cases.case import BranchCase, BranchTrajectory, JointCase
from ..cases.noise import NoiseEstimate, estimate_noise

#: Most samples of a branch that stands untouched, and how many deviations of their mean count as off its rest.
MOST_STILL, FAR = 10, 4.0
#: Level part of a pull's direction below which it has no heading, and distance of two headings that turns a tool.
LEVEL, ASIDE = 0.02, 0.3
#: Deviations of its noise within which a force may be none.
NONE = 3.0
#: Share of the falls of a force that may lie beside the samples in which the gripper opens.
QUARTER = 0.25


@dataclass(frozen=True)
class Recording:
    """One trajectory as inference uses it.

    Attributes:
        t: Times [s], shape [T].
        input: What acts at the samples: force [N] shape [T, 3], or efforts of the driven joints, shape [T, I].
        output: Measured channels, shape [T, C].
        start: Coordinate and rate of the joints at the first sample, shape [J, 2]; empty where it starts at rest.
        contact: Whether the gripper may hold the branch, so that the force is a measurement, shape [T].
        grasp: Link that is held and the grasp point in its body frame [m]; None where joints are driven.
        t_start: When it starts on the case's absolute clock [s].
        sensed: What a branch's force sensor read, gripper open or not [N], shape [T, 3]; None: the same as ``input``.
        fine: Of a torque fit, motion and efforts under a wider filter, at all samples, shape [T, 3 J + I].
        every: Of a torque fit, how many samples of ``fine`` there are to one that is kept; 0 before any are left out.
        off: Displacement at which a branch stands before it is pulled [m], shape [3]; zero where that is only noise.
        opened: What a branch's force sensor reads while the gripper is open [N], shape [3], zero where it never is or
            where that is only noise: the median, which its way back to that reading does not move.
        heading: Level unit vector along which a branch's gripper pulls, shape [3]; zero where the case gives no
            direction, or one for all recordings: a force that turns with it cannot be told from one that does not.
        sways: Whether the branch is off its calm pose or moves where a recording of the case begins: what acts by the
            clock has acted before.
        course: Pressure of gusts over its rms, along x and y, as in `BranchTrajectory`; None where there is none.
        together: Whether a branch's gripper is timed with its force, which falls as it opens; else with the motion.
    """

    t: Array
    input: Array
    output: Array
    start: Array
    contact: NDArray[np.bool_]
    grasp: tuple[int, Array] | None = None
    t_start: float = 0.0
    sensed: Array | None = None
    fine: Array | None = None
    every: int = 0
    off: Array = field(default_factory=lambda: np.zeros(3))
    opened: Array = field(default_factory=lambda: np.zeros(3))
    heading: Array = field(default_factory=lambda: np.zeros(3))
    sways: bool = False
    course: Array | None = None
    together: bool = True


def beginning(recording: Recording, count: int) -> Recording:
    """Return the first ``count`` samples of a recording."""
    sensed = None if recording.sensed is None else recording.sensed[:count]
    columns = {name: getattr(recording, name)[:count] for name in ("t", "input", "output", "contact")}
    return replace(recording, **columns, sensed=sensed)


def recordings(case: BranchCase | JointCase) -> list[Recording]:
    """Return a case's trajectories; a branch's force is exactly zero where the gripper is known to be open."""
    if isinstance(case, BranchCase):
        noise, ways = estimate_noise(case), headings(case)
        together = timed_together(case, noise)
        sways = any(t.course is not None or any(_away(t, noise, 1)) for t in case.trajectories)
        return [
            Recording(t.t, np.where(t.no_contact[:, None], 0.0, t.force), np.hstack([t.displacement, t.velocity]),
                      np.zeros((0, 2)), ~t.no_contact, t.grasp, t.t_start, t.force,
                      off=standing(t, noise), opened=_of_open_gripper(t, noise), heading=way, sways=sways,
                      course=t.course, together=together)
            for t, way in zip(case.trajectories, ways, strict=True)
        ]  # fmt: skip
    return [
        Recording(t.t, t.effort, t.output,
                  _first_state(case, t.output, t.t), np.zeros(len(t.t), dtype=bool), None, t.t_start)
        for t in case.trajectories
    ]  # fmt: skip


def timed_together(case: BranchCase, noise: NoiseEstimate) -> bool:
    """Return whether forces fall where the gripper opens: one clock times both.

    A force that is late or early falls in part before the gripper opens, or is read of an open one. By more than a
    quarter in all it has a clock of its own. A gripper that never lets go of a force counts as timed with it: there it
    makes no difference.
    """
    on, off = np.sum([_falls(t, _of_open_gripper(t, noise), noise.force) for t in case.trajectories], axis=0)
    return bool(off <= QUARTER * (on + off))


def _falls(t: BranchTrajectory, opened: Array, sigma: Array) -> tuple[float, float]:
    """Return how much force goes within one sample as the gripper opens, and split about that [N], beyond noise."""
    opens = np.flatnonzero(t.no_contact[3:] & ~t.no_contact[2:-1]) + 3
    size, floor = np.linalg.norm(t.force - opened, axis=1), FAR * float(np.linalg.norm(sigma))
    earlier, before, last, after = (size[opens + k] for k in (-3, -2, -1, 0))
    ahead = before - last - 2.0 * np.abs(earlier - before)
    at_once, before, after = (np.where(fall > floor, fall, 0.0) for fall in (last - after, ahead, after))
    split = last > floor
    return float(at_once.sum() + before[~split].sum()), float(before[split].sum() + after.sum())


def headings(case: BranchCase) -> list[Array]:
    """Return for every trajectory of a branch where its gripper faces, see `Recording`."""
    given = [np.zeros(3) if t.direction is None else t.direction for t in case.trajectories]
    ways = [_level(d) for d in given]
    known = [way for way in ways if way.any()]
    apart = max((float(np.linalg.norm(a - b)) for a in known for b in known), default=0.0)
    return ways if apart > ASIDE else [np.zeros(3)] * len(ways)


def _level(direction: Array) -> Array:
    level, whole = direction * [1.0, 1.0, 0.0], np.linalg.norm(direction)
    size = np.linalg.norm(level)
    return level / size if size > LEVEL * whole else np.zeros(3)


def _of_open_gripper(t: BranchTrajectory, noise: NoiseEstimate) -> Array:
    count = int(t.no_contact.sum())
    read = np.median(t.force[t.no_contact], axis=0) if count else np.zeros(3)
    told = np.abs(read) > FAR * np.sqrt(0.5 * np.pi / max(count, 1)) * noise.force  # a median scatters more than a mean
    return np.asarray(read * told.any())


def standing(t: BranchTrajectory, noise: NoiseEstimate) -> Array:
    """Return the displacement at which a branch stands still before a force acts [m], shape [3].

    It is zero where the recording begins with a force or a motion, or no further off than noise.
    """
    untouched = t.no_contact | (np.abs(t.force) <= NONE * noise.force).all(axis=1)
    count = int(np.logical_and.accumulate(untouched[:MOST_STILL]).sum())
    if count == 0:
        return np.zeros(3)
    off, moves = _away(t, noise, count)
    return np.asarray(t.displacement[:count].mean(axis=0) * (off and not moves))


def _away(t: BranchTrajectory, noise: NoiseEstimate, count: int) -> tuple[bool, bool]:
    """Return whether the mean displacement of the first samples, and their mean velocity, are more than noise."""
    place, speed = t.displacement[:count].mean(axis=0), t.velocity[:count].mean(axis=0)
    off = np.abs(place) > FAR * noise.displacement / np.sqrt(count)
    moves = np.abs(speed) > FAR * noise.velocity / np.sqrt(count)
    return bool(off.any()), bool(moves.any())


def _first_state(case: JointCase, output: Array, t: Array) -> Array:
    """Guess coordinate and rate of every joint at the first sample by a parabola through the first samples."""
    start = np.zeros((len(case.joints), 2))
    n = max(3, min(len(t), int(0.02 * len(t)) + 1, 40))
    names = [j.name for j in case.joints]
    for c, channel in enumerate(case.outputs):
        joint = names.index(channel.joint)
        if channel.quantity == "position":
            coefficients = np.polynomial.polynomial.polyfit(t[:n], output[:n, c], 2 if n > 4 else 1)
            start[joint] = coefficients[:2]
        elif channel.quantity == "velocity":
            start[joint, 1] = output[:n, c].mean()
    return start
