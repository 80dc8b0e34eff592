"""The force of the arm on the branch out of a bag: of a wrench, a scale, or the torques of the arm's joints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.arms.statics import statics
from ...sim.base.errors import InputError
from ...sim.base.rotation import quat_multiply, quat_rotate
from ...sim.base.types import Array
from .bag import Bag, Stream, StreamKind
from .questions import Asker
from .units import UNITS, checked_unit

Source = Literal["wrench", "scale", "joints"]
#: Frames that stand still, where a wrench's header says so.
_WORLD = ("world", "map", "odom", "base", "root")


@dataclass(frozen=True)
class BagGiven:
    """What a user says of a bag; None or empty where nothing was said. The fields are flags of ``import-case``.

    ``arm`` is None where the bag's joint states are of no known arm.
    """

    force_from: Source | None = None
    wrench: str | None = None
    scale: str | None = None
    joints: str | None = None
    pose: str | None = None
    frame: str | None = None
    scale_unit: str | None = None
    direction: tuple[float, ...] = ()
    wrench_frame: Literal["world", "hand", "link"] | None = None
    gravity: Literal["in", "out"] | None = None
    during: tuple[str, ...] = ()
    clock_offset: float | None = None
    most_offset: float = 10.0


def topic_of(bag: Bag, kind: StreamKind, name: str | None, flag: str) -> Stream | None:
    """Return the topic of a kind: the one that was named, or the only one; None where there is none.

    Raises:
        InputError: The named topic is not there, or there are several and none was named.
    """
    found = bag.of(kind)
    if name is not None:
        chosen = bag.streams.get(name)
        if chosen not in found:
            listed = ", ".join(s.name for s in found) or "none of this kind with ten messages"
            raise InputError(bag.path, flag, f"no topic {name} of this kind", f"one of: {listed}")
        return chosen
    if len(found) > 1:
        raise InputError(bag.path, flag, f"{len(found)} topics: {', '.join(s.name for s in found)}", "one of them")
    return found[0] if found else None


def source_of(bag: Bag, given: BagGiven) -> Source:
    """Return where the force comes from: as said, or the most direct that the bag has.

    Raises:
        InputError: The bag has none.
    """
    if given.force_from is not None:
        return given.force_from
    for kind, name in (("wrench", given.wrench), ("scale", given.scale)):
        if name is not None or bag.of(kind):  # type: ignore[arg-type]
            return kind  # type: ignore[return-value]
    if not bag.of("joints"):
        held = ", ".join(bag.streams) or "none of the types that are read"
        allowed = "WrenchStamped, Float64 (a scale) or JointState with efforts, ten messages or more"
        raise InputError(bag.path, "", f"no force (topics: {held})", allowed)
    return "joints"


def required(bag: Bag, kind: StreamKind, name: str | None, flag: str) -> Stream:
    """Return the topic of a kind as `topic_of`, where one is needed.

    Raises:
        InputError: There is none.
    """
    stream = topic_of(bag, kind, name, flag)
    if stream is None:
        raise InputError(
            bag.path, flag, f"no {kind} topic with ten messages", ", ".join(bag.streams) or "a bag with one"
        )
    return stream


@dataclass(frozen=True)
class Timeline:
    """Rows on their own clock.

    Attributes:
        stream: Where they come from.
        t: Times [s], shape [T].
        rows: Forces [N] or positions [m], shape [T, 3].
        turns: Orientations w, x, y, z that came with them, shape [T, 4], or None.
    """

    stream: Stream
    t: Array
    rows: Array
    turns: Array | None = None


def hand_path(bag: Bag, stream: Stream, arm: Arm) -> Timeline:
    """Return where an arm's end-effector was, by its joint positions, in its base frame."""
    t, q, _ = stream.arrays()
    end, turn = forward_kinematics(arm, _of_arm(bag, stream, q, arm))[2]
    return Timeline(stream, t, end, turn)


def _of_arm(bag: Bag, stream: Stream, rows: Array, arm: Arm) -> Array:
    if rows.shape[1] < arm.num_dofs:
        found = f"{rows.shape[1]} joints in {stream.name}: {', '.join(stream.names)}"
        raise InputError(bag.path, "--arm", found, f"the {arm.num_dofs} joints of {arm.name}, or another arm")
    return rows[:, : arm.num_dofs]


def force_of_joints(bag: Bag, stream: Stream, arm: Arm, given: BagGiven, ask: Asker) -> Timeline:
    """Return the force that joint torques show: (J J^T)^-1 J (tau - g), the force closest to them.

    Raises:
        InputError: The joint states have no efforts, or not enough joints.
    """
    t, q, effort = stream.arrays()
    if not np.isfinite(effort).all():
        missing = int((~np.isfinite(effort).all(axis=1)).sum())
        found = f"{missing} of {len(t)} joint states of {stream.name} without efforts"
        raise InputError(bag.path, "", found, "joint states with efforts, a wrench (--wrench) or a scale (--scale)")
    hold, jacobian = statics(arm, _of_arm(bag, stream, q, arm))
    told = _of_arm(bag, stream, effort, arm)
    torque = told - hold if _gravity(told, hold, stream, arm, given, ask) == "in" else told
    square = jacobian @ np.swapaxes(jacobian, -1, -2)
    force = np.linalg.solve(square, jacobian @ torque[..., None])[..., 0].astype(np.float64)
    left = torque - np.einsum("tkd,tk->td", jacobian, force)
    ask.notes.append(f"force: joint torques of {stream.name} by J^T at the end-effector, which carries a "
                     f"force alone and moves slowly; {np.sqrt(np.mean(left**2)):.3g} N m rms are left")  # fmt: skip
    return Timeline(stream, t, force)


def _gravity(told: Array, hold: Array, stream: Stream, arm: Arm, given: BagGiven, ask: Asker) -> Literal["in", "out"]:
    """Return whether torques hold the arm's own weight: as said, or by which of both leaves less of them.

    Some drivers take it out (Kinova's, when asked to), some do not. A branch pulls with less than an arm weighs.
    """
    with_it, without = (float(np.sqrt(np.mean(x**2))) for x in (told, told - hold))
    chosen: Literal["in", "out"] = given.gravity or ("in" if without < with_it else "out")
    how = f"less what holds {arm.name} against gravity" if chosen == "in" else "taken to be without the arm's weight"
    ask.notes.append(f"gravity: torques of {stream.name} {how} (--gravity); {with_it:.3g} N m rms as they are, "
                     f"{without:.3g} less gravity")  # fmt: skip
    return chosen


def force_of_wrench(
    bag: Bag, stream: Stream, arm: Arm, given: BagGiven, turns: Timeline | None, ask: Asker
) -> Timeline:
    """Return the force of a wrench in world axes; a sensor at the hand turns with ``turns``.

    Raises:
        InputError: The sensor turns with the hand, and nothing says how the hand is turned.
    """
    t, rows, _ = stream.arrays()
    still = any(word in stream.frame.lower() for word in _WORLD)
    if given.wrench_frame == "world" or (given.wrench_frame is None and still):
        ask.notes.append(f"force: wrench of {stream.name}, in the world's axes (frame '{stream.frame}')")
        return Timeline(stream, t, rows)
    if turns is None or turns.turns is None:
        raise InputError(bag.path, "--wrench-frame", f"a wrench in the frame '{stream.frame}' and no orientation of it",
                         "world if its axes stand still; else joint states of --arm, or a pose")  # fmt: skip
    link = given.wrench_frame == "link" or (given.wrench_frame is None and "link" in stream.frame.lower())
    by_joints = link and turns.stream.kind == "joints"
    turn = quat_multiply(turns.turns, arm.end_rotation * [1, -1, -1, -1]) if by_joints else turns.turns
    near = np.clip(np.searchsorted(turns.t, t), 0, len(turns.t) - 1)
    which = "the last link" if by_joints else "the end-effector" if turns.stream.kind == "joints" else "the pose"
    ask.notes.append(f"force: wrench of {stream.name} (frame '{stream.frame}'), turned as {which} of "
                     f"{turns.stream.name} (--wrench-frame); the weight of what it carries stays in")  # fmt: skip
    return Timeline(stream, t, quat_rotate(turn[near], rows))


def force_of_scale(bag: Bag, stream: Stream, given: BagGiven, motion: Array, ask: Asker) -> Timeline:
    """Return the force of a scale along the pull: as said, or where most of the motion [S, 3] goes.

    Raises:
        InputError: The direction is none.
    """
    t, rows, _ = stream.arrays()
    unit = checked_unit(given.scale_unit or "N", "force", "", "--scale-unit")
    along = np.array(given.direction)
    if not given.direction:
        from_start = motion - motion[0]
        along = np.linalg.eigh(from_start.T @ from_start)[1][:, -1]
        along = along * (1.0 if float((from_start @ along).sum()) >= 0 else -1.0)
    size = float(np.linalg.norm(along))
    if len(along) != 3 or size == 0:
        raise InputError("", "--direction", " ".join(map(str, given.direction)), "three numbers, x y z of the pull")
    said = " ".join(f"{x:.3g}" for x in along / size)
    how = "--direction" if given.direction else "the way of most of the motion; --direction says another"
    stated = "" if given.scale_unit else ", --scale-unit"
    ask.notes.append(f"force: scale of {stream.name} [{unit}{stated}] along {said} ({how})")
    return Timeline(stream, t, UNITS["force"][unit] * rows * (along / size))
