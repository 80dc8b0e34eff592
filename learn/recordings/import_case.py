"""A case folder from ROS bags: force and motion of a branch on one clock, and what was assumed for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...sim.arms.arm import Arm
from ...sim.base.errors import InputError, shortened
from ...sim.base.files import check_output
from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from ..cases.clock import GAP, interpolated
from . import plausible
from .align import clock_offset, force_on_grid
from .bag import LEAST, Bag, Stream, read_bag
from .bag_force import (
    BagGiven,
    Timeline,
    force_of_joints,
    force_of_scale,
    force_of_wrench,
    hand_path,
    required,
    source_of,
    topic_of,
)
from .branch import Motions, branch_content
from .folder import write_case
from .given import Given, quiet_of
from .questions import Asker
from .shape import Shape, shape_of

#: Clocks that are further apart than this, by when their messages arrived, are brought together by that first [s].
ARRIVED = 1.0
#: A clock is moved where the signals are at least so much alike afterwards, and what they lacked falls by this factor.
ALIKE, BETTER = 0.8, 0.5
#: Share of the largest force that may be there at a recording's begin, where the branch is at rest.
AT_REST = 0.2
#: Farthest that the hand may be from the branch that it holds [m].
NEAR = 0.1


@dataclass(frozen=True)
class Window:
    """A recording out of a bag.

    Attributes:
        force: Force [N], times from the recording's begin.
        motion: Position [m], times from the recording's begin.
        seconds: Its length [s].
    """

    force: Timeline
    motion: Timeline
    seconds: float


def import_case(
    files: Sequence[Path], out: Path, arm: Arm, bag_given: BagGiven, given: Given, ask: Asker
) -> BranchCase | JointCase:
    """Write a case folder from bags; what was assumed is in ``ask.notes`` and in the folder.

    Args:
        files: Bags, or folders of ROS 2.
        out: Case folder to write.
        arm: The arm of the joint states.
        bag_given: What was said of topics and clocks.
        given: What was said of the branch.
        ask: Who is asked for what is missing.

    Raises:
        InputError: A bag cannot be read or lacks force or motion; something is missing and nobody can be asked.
    """
    check_output(out)
    windows = []
    for path in files:
        bag = read_bag(path)
        if len(files) > 1:
            ask.notes.append(f"bag {path.name}:")
        pair = _pair(bag, arm, bag_given, ask)
        windows += [_window(bag, pair, i) for i in map(_interval, bag_given.during or ("0:inf",))]
    step = _step([part for w in windows for part in (w.force, w.motion)], given, ask)
    rows = [_on_grid(w, step) for w in windows]
    given = _held(given, rows[0][1][0], ask)
    motions = _from_zero(rows, step, given, ask)
    if windows[0].force.stream.kind != "joints":
        motions = _turned(motions, given, ask)
    plausible.check_sign(motions.effort, motions.motion, given.flip, tables=False)
    head = f"Made by bough import-case from {', '.join(dict.fromkeys(p.name for p in files))}:"
    content = branch_content(motions, given, ask, "--scale-unit, --gravity, --arm")
    return write_case(out, content, [*ask.notes, *(f"warning: {w}" for w in ask.warnings)], head)


def _pair(bag: Bag, arm: Arm, given: BagGiven, ask: Asker) -> tuple[Timeline, Timeline]:
    """Return force and motion of a bag, both on the force's clock."""
    source = source_of(bag, given)
    joints = topic_of(bag, "joints", given.joints, "--joints")
    hand = None if joints is None else hand_path(bag, joints, arm)
    motion = _motion(bag, given, hand, ask)
    if source == "joints":
        force = force_of_joints(bag, required(bag, "joints", given.joints, "--joints"), arm, given, ask)
    elif source == "wrench":
        wrench = required(bag, "wrench", given.wrench, "--wrench")
        force = force_of_wrench(bag, wrench, arm, given, hand or motion, ask)
    else:
        force = force_of_scale(bag, required(bag, "scale", given.scale, "--scale"), given, motion.rows, ask)
    same = hand if source == "joints" else None  # what moves as the motion does, on the force's clock
    return force, _on_clock_of(force, motion, same, given, ask)


def _motion(bag: Bag, given: BagGiven, hand: Timeline | None, ask: Asker) -> Timeline:
    """Return the motion of the grasp point: a frame, a pose, or the hand by the arm's joint positions.

    Raises:
        InputError: The bag has none of them.
    """
    stream: Stream | None
    if given.frame is not None:
        stream = bag.streams.get(f"tf:{given.frame}")
        if stream is None or len(set(stream.time)) < LEAST:
            frames = ", ".join(n.removeprefix("tf:") for n in bag.streams if n.startswith("tf:")) or "none that moves"
            raise InputError(bag.path, "--frame", f"no frame {shortened(given.frame)} that moves", f"one of: {frames}")
    else:
        stream = topic_of(bag, "pose", given.pose, "--pose")
    if stream is not None:
        t, rows, turns = stream.arrays()
        ask.notes.append(f"motion: {stream.name} in the frame '{stream.frame}', taken for the world's with z up")
        return Timeline(stream, t, rows, turns)
    if hand is None:
        frames = ", ".join(n.removeprefix("tf:") for n in bag.streams if n.startswith("tf:")) or "none"
        raise InputError(bag.path, "", "no motion: neither poses nor joint states",
                         f"PoseStamped, Odometry, PointStamped, JointState, or --frame of TF ({frames})")  # fmt: skip
    ask.notes.append(f"motion: the hand by joint positions of {hand.stream.name}, in the arm's base frame, z up; the "
                     "branch does not move in the hand")  # fmt: skip
    return hand


# ---- clocks ---------------------------------------------------------------------------------------------------------


def _on_clock_of(force: Timeline, motion: Timeline, same: Timeline | None, given: BagGiven, ask: Asker) -> Timeline:
    """Return the motion on the force's clock.

    Args:
        force: The force.
        motion: The motion, on its own clock.
        same: What moves as the motion does, on the force's clock, where there is such a thing: else the force itself is
            compared with the motion.
        given: What was said.
        ask: Who keeps notes and warnings.
    """
    if force.stream is motion.stream:
        return motion
    if given.clock_offset is not None:
        ask.notes.append(f"clock: {given.clock_offset:g} s are taken from the times of {motion.stream.name} "
                         "(--clock-offset)")  # fmt: skip
        return replace(motion, t=motion.t - given.clock_offset)
    apart = _late(force.stream) - _late(motion.stream)
    if abs(apart) > ARRIVED:
        ask.notes.append(f"clock: {motion.stream.name} is {apart:.4f} s ahead by when messages arrived")
        motion = replace(motion, t=motion.t - apart)
    first = same or force
    found = clock_offset((first.t, _line(first.rows)), (motion.t, _line(motion.rows)), given.most_offset)
    what = "the hand" if same is not None else "the force"
    said = f"correlation with {what} {found.correlation:.4f}, {found.before:.4f} without"
    if found.correlation < ALIKE or 1.0 - found.correlation > BETTER * (1.0 - found.before):
        ask.notes.append(f"clock: {motion.stream.name} and {force.stream.name} taken to be on one clock ({said}); "
                         "--clock-offset says otherwise")  # fmt: skip
        if found.correlation < ALIKE:
            ask.warnings.append(f"the motion of {motion.stream.name} is not like {what} at any offset of up to "
                                f"{given.most_offset:g} s ({said})")  # fmt: skip
        return motion
    ask.notes.append(f"clock: {found.seconds:.4f} s are taken from the times of {motion.stream.name} ({said})")
    return replace(motion, t=motion.t - found.seconds)


def _late(stream: Stream) -> float:
    """Return how long after its own time a stream's messages arrive [s], the median."""
    return float(np.median(np.array(stream.arrived) - np.array(stream.time)))


def _line(rows: Array) -> Array:
    """Return rows [T, 3] along the direction in which they vary most, shape [T]."""
    centred = rows - rows.mean(axis=0)
    out: Array = centred @ np.linalg.eigh(centred.T @ centred)[1][:, -1]
    return out


def _interval(text: str) -> tuple[float, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low, high = 1.0, 0.0
    if not 0 <= low < high:
        raise InputError("", "--during", shortened(text), "A:B, seconds from where force and motion have begun")
    return low, high


def _window(bag: Bag, pair: tuple[Timeline, Timeline], interval: tuple[float, float]) -> Window:
    """Return force and motion where both are, within an interval from there on.

    Raises:
        InputError: Too little is left, or a stream has a gap there.
    """
    begin, end = max(p.t[0] for p in pair), min(p.t[-1] for p in pair)
    low, high = begin + interval[0], min(end, begin + interval[1])
    force, motion = (_cut(bag, part, low, high, begin) for part in pair)
    return Window(force, motion, high - low)


def _cut(bag: Bag, part: Timeline, low: float, high: float, begin: float) -> Timeline:
    """Return what lies between two times, and a sample on either side; its time counts from the first of them."""
    keep = np.flatnonzero((part.t >= low - 1e-9) & (part.t <= high + 1e-9))
    if len(keep) < LEAST:
        found = f"{len(keep)} messages of {part.stream.name} in {low - begin:.4g} to {high - begin:.4g} s"
        raise InputError(bag.path, "--during", found, "ten or more in which both force and motion are there")
    use = slice(max(0, keep[0] - 1), min(len(part.t), keep[-1] + 2))
    steps = np.diff(part.t[use])
    long = int(np.argmax(steps))
    if steps[long] >= GAP * np.median(steps):
        at = float(part.t[use][long]) - begin
        found = f"{steps[long]:.3g} s without a message of {part.stream.name} at {at:.4g} s"
        raise InputError(bag.path, "--during", found, f"parts without a gap, such as --during 0:{max(at, 0.0):.4g}")
    return replace(part, t=part.t[use] - low, rows=part.rows[use])


def _step(parts: Sequence[Timeline], given: Given, ask: Asker) -> float:
    """Return the step of the common clock [s]: that of the slowest stream, rounded, or as said."""
    slowest = max(parts, key=lambda p: float(np.median(np.diff(p.t))))
    rate = 1.0 / float(np.median(np.diff(slowest.t)))
    rate = given.resample or (float(round(rate)) if rate >= 2 else rate)
    ask.notes.append(f"clock: a grid of {rate:g} Hz (--resample; {slowest.stream.name} is the slowest); positions by"
                     " linear interpolation, a faster force by least squares")  # fmt: skip
    return 1.0 / rate


def _on_grid(window: Window, step: float) -> tuple[Array, Array]:
    """Return forces and positions on a grid from zero on, shapes [T, 3]."""
    t: Array = np.arange(int(np.floor(window.seconds / step + 1e-9)) + 1) * np.float64(step)
    return force_on_grid(window.force.t, window.force.rows, t), interpolated(window.motion.t, window.motion.rows, t)


# ---- zeros, grasp ---------------------------------------------------------------------------------------------------


def _from_zero(rows: list[tuple[Array, Array]], step: float, given: Given, ask: Asker) -> Motions:
    """Return forces from their zero and displacements from rest."""
    known = [_free_samples(given, i, step) for i in range(len(rows))]
    force = [f - _zero(f, free, given) for (f, _), free in zip(rows, known, strict=True)]
    motion = [x - x[: max(1, free)].mean(axis=0) for (_, x), free in zip(rows, known, strict=True)]
    taken = given.force_zero or ("its mean before contact" if any(known) else "0, as the sensor says")
    ask.notes.append(f"zero of the force: {taken} (--force-zero, --no-contact)")
    at_rest = max(float(np.linalg.norm(f[0])) for f in force)
    most = max(float(np.linalg.norm(f, axis=1).max()) for f in force)
    if at_rest > AT_REST * most:
        ask.warnings.append(f"the force is {at_rest:.3g} N where the branch is at rest, {most:.3g} N at most: the zero "
                            "of the sensor (--force-zero start, --no-contact), gravity that torques hold "
                            "(--gravity), another arm (--arm), or torques of the other sign")  # fmt: skip
    ask.notes.append(f"zero of the motion: {'its mean before contact' if any(known) else 'the first sample'}")
    return Motions(step, motion, force, None)


def _free_samples(given: Given, recording: int, step: float) -> int:
    """Return how many samples at a recording's begin are known to be without contact."""
    return max([0, *(round(b / step) + 1 for a, b in quiet_of(given.no_contact, recording + 1) if a <= 1e-9)])


def _zero(force: Array, free: int, given: Given) -> Array:
    if given.force_zero == "0" or (given.force_zero is None and not free):
        return np.zeros(3)
    out: Array = force[: max(1, free)].mean(axis=0)
    return out


def _turned(motions: Motions, given: Given, ask: Asker) -> Motions:
    """Return forces of the hand on the branch: a wrist sensor reads the other one, against the motion."""
    f, x = (np.concatenate(a).ravel() for a in (motions.effort, motions.motion))
    size = float(np.sqrt((f @ f) * (x @ x)))
    against = given.flip is None and size > 0 and float(f @ x) / size < plausible.OPPOSITE
    if against:
        ask.notes.append("sign: the sensor reads the force on the hand, against the motion; turned (--flip none)")
    if not against and given.flip != "force":
        return motions
    return replace(motions, effort=[-e for e in motions.effort])


def _held(given: Given, first: Array, ask: Asker) -> Given:
    """Return where the branch is held, by the grasp point's first position [m] where only the base is known.

    Raises:
        InputError: The point is not on the branch.
    """
    if given.at or not given.base:
        return given
    shape = shape_of(given, Asker(ask.source, ask.terminal, ask.helps))
    at, away = _nearest(shape, np.array(given.base), first)
    where = f"{at:.4g} m from the base along the branch, {1e3 * away:.3g} mm beside it"
    if away > NEAR:
        raise InputError("", "--base", f"a grasp point {where}", f"{1e3 * NEAR:g} mm beside it at most; or --at")
    ask.notes.append(f"grasp: {where}, by its first position and --base")
    return replace(given, at=(repr(at),))


def _nearest(shape: Shape, base: Array, point: Array) -> tuple[float, float]:
    """Return the place on a branch nearest to a point, from the base along it, and how far the point is from it [m]."""
    up, about = np.radians(shape.elevation), np.radians(shape.azimuth)
    axis = np.stack([np.cos(up) * np.cos(about), np.cos(up) * np.sin(about), np.sin(up)], axis=-1)
    along = axis * shape.length[:, None]
    low = base + np.cumsum(along, axis=0) - along
    share = np.clip(np.sum((point - low) * axis, axis=-1), 0.0, shape.length)
    away = np.linalg.norm(low + share[:, None] * axis - point, axis=-1)
    i = int(np.argmin(away))
    return float(shape.length[:i].sum() + share[i]), float(away[i])
