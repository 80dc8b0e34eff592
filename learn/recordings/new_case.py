"""A case folder from measured tables: in space a branch case, along one line or about one axis a joint case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...sim.base.errors import InputError, shortened
from ...sim.base.files import check_output
from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from ..cases.clock import Timed
from . import plausible
from .branch import Motions, branch_content, places_of
from .choose import Chosen, Quantity, choose
from .folder import Content, rate_of, starts_of, write_case
from .given import SOURCE, Given, quiet_of, repeats_of
from .mechanism import check_mjcf, mechanism_content
from .questions import Asker, Question
from .shape import Shape, shape_of
from .tables import Part, check_rate, column, parts_of, read_parts, tables_of, units_row
from .units import measure

UNIT_FLAGS = "--force-unit, --position-unit"
FLIPS = ("force", "motion", "none")
#: Share at the end of a free swing whose mean is where it rests.
REST = 0.1


@dataclass(frozen=True)
class Measured(Motions):
    """Recordings of tables.

    Attributes:
        chosen: Which columns hold what.
        parts: Where each recording comes from, N of them.
    """

    chosen: Chosen
    parts: list[Part]


def new_case(files: Sequence[Path], out: Path, given: Given, ask: Asker) -> BranchCase | JointCase:
    """Write a case folder from measured tables; what was guessed and assumed is in ``ask.notes`` and in the folder.

    Raises:
        InputError: A file cannot be read; something is missing and nobody can be asked; a unit cannot be right.
    """
    if given.flip not in (None, *FLIPS):
        raise InputError(SOURCE, "--flip", shortened(given.flip), ", ".join(FLIPS))
    check_output(out)
    check_rate(given)
    measured = _measured(files, given, ask)
    angle = measured.chosen.motion.kind == "angle"
    if given.mjcf is not None:
        check_mjcf(given.mjcf, angle)
        content = mechanism_content(measured, measured.chosen.effort is not None, given.mjcf, given, ask)
    elif measured.motion[0].shape[1] > 1:
        content = branch_content(measured, given, ask, UNIT_FLAGS)
    else:
        content = _joint(measured, given, ask)
    head = f"Made by bough new-case from {', '.join(dict.fromkeys(p.path.name for p in measured.parts))}:"
    return write_case(out, content, [*ask.notes, *(f"warning: {w}" for w in ask.warnings)], head)


def _measured(files: Sequence[Path], given: Given, ask: Asker) -> Measured:
    tables = tables_of(files, given, ask)
    chosen = choose(tables[0], units_row(tables[0]), given, ask)
    parts = parts_of(tables, given)
    read, step = read_parts(parts, chosen, given, ask)
    plausible.check_clock_unit(step, chosen.clock, ask)
    sign = {name: -1.0 if given.flip == name else 1.0 for name in FLIPS}
    quiet = [_quiet_rows(r, quiet_of(given.no_contact, i + 1)) for i, r in enumerate(read)]
    as_read = given.hangs or given.mjcf is not None
    at_rest = given.position_zero or ("0" if as_read else "start" if chosen.effort else "end")
    motion = [sign["motion"] * _taken(r, chosen.motion, at_rest, q) for r, q in zip(read, quiet, strict=True)]
    ask.notes.append(f"zero of the motion: {at_rest} (--position-zero)")
    if chosen.effort is None:
        effort = [np.zeros_like(m) for m in motion]
    else:
        zero = given.force_zero or "0"
        effort = [sign["force"] * _taken(r, chosen.effort, zero, q) for r, q in zip(read, quiet, strict=True)]
        ask.notes.append(f"zero of the {chosen.effort.kind}: {zero} (--force-zero)")
        plausible.check_effort(chosen.effort, np.concatenate(effort), ask)
    velocity = None
    if chosen.velocity is not None:
        velocity = [sign["motion"] * _taken(r, chosen.velocity, "0", 1) for r in read]
    plausible.check_motion(chosen.motion, np.concatenate(motion), _reach(given), ask)
    if chosen.effort is not None and given.mjcf is None:
        plausible.check_sign(effort, motion, given.flip, kind=chosen.effort.kind)
    return Measured(step, motion, effort, velocity, chosen, parts)


def _reach(given: Given) -> float | None:
    """Return the length of the branch [m] where it was said."""
    lengths = [measure(t, "position", SOURCE, "--length") for t in given.length]
    return sum(lengths) if lengths else None


def _quiet_rows(read: Timed, intervals: list[list[float]]) -> int:
    """Return how many samples at the start are known to be without contact; one where none is known."""
    return max([1, *(int((read.t <= stop + 1e-9).sum()) for start, stop in intervals if start <= 1e-9)])


def _taken(read: Timed, quantity: Quantity, zero: str, quiet: int) -> Array:
    """Return a quantity from its zero in SI units, shape [T, axes]."""
    values = np.stack([column(read, name) for name in quantity.columns], axis=-1)
    if zero == "start":
        values = values - values[:quiet].mean(axis=0)
    elif zero == "end":
        values = values - values[-max(1, int(REST * len(values))) :].mean(axis=0)
    else:
        flag = "--force-zero" if quantity.flag == "--force-unit" else "--position-zero"
        try:
            values = values - float(zero)
        except ValueError:
            raise InputError(
                SOURCE, flag, shortened(zero), "start, end, or what is read at zero, in the column's unit"
            ) from None
    return quantity.scale * values


# ---- along one line, or about one axis ------------------------------------------------------------------------------


def _joint(measured: Measured, given: Given, ask: Asker) -> Content:
    count = len(measured.parts)
    effort = measured.chosen.effort
    angle = measured.chosen.motion.kind == "angle"
    given = _with_lever(given, ask, angle=angle, effort=effort)
    shape = None
    if given.length and given.diameter:
        shape = shape_of(replace(given, segments=1, rises=given.rises or ("0",)), ask)
    motion, load = [m[:, 0] for m in measured.motion], [e[:, 0] for e in measured.effort]
    if given.at:
        at = places_of(given, count)
        if shape is not None and effort is not None and effort.kind == "force" and not angle:
            plausible.check_stiffness(np.concatenate(load), np.concatenate(motion), at[0], shape, ask, UNIT_FLAGS)
        about, torque = _about_base(motion, load, at, given, angle, ask)
        motion, load = about, load if effort is not None and effort.kind == "torque" else torque
    turns = angle or bool(given.at)
    names = ("torque_Nm", "angle_rad") if turns else ("force_N", "position_m")
    inertia = _inertia(given, shape if turns else None, effort is not None, turns, ask)
    meta = _joint_meta(given, names, inertia, effort is not None, [len(m) * measured.step for m in motion])
    rate = rate_of(measured.step)
    tables: list[tuple[Sequence[str], Array]] = []
    for f, x in zip(load, motion, strict=True):
        t = np.arange(len(x)) / rate
        tables.append((("t_s", *names), np.stack([t, f, x], axis=-1)) if effort else
                      (("t_s", names[1]), np.stack([t, x], axis=-1)))  # fmt: skip
    return Content(meta, tables)


def _with_lever(given: Given, ask: Asker, *, angle: bool, effort: Quantity | None) -> Given:
    """Return what was said with the place of the pull, if it is needed or somebody may want to say it."""
    force = effort is not None and effort.kind == "force"
    if effort is not None and effort.kind == "torque" and not angle and not given.at:
        raise InputError(SOURCE, "--at", "a torque and a displacement, without the lever between them", "the distance"
                         " of the displacement from the axis, such as 30cm; of an angle --angle COLUMN")  # fmt: skip
    if given.at or not force:
        return given
    question = Question(
        "--at", "How far from where the branch bends, along it, is the pull?", "a force and an angle without a lever",
        "the distance of the pull from the base, such as 90cm", None if angle else "",
    )  # fmt: skip
    text = ask(question, lambda t: (measure(t, "position", SOURCE, "--at"), t)[1] if t or angle else "")
    if not text:
        ask.notes.append("model: a mass on a spring and damper along the pull, in N/m; with --at (the distance of the "
                         "pull from the base) a joint at the base, in N m/rad")  # fmt: skip
    return replace(given, at=(text,) if text else ())


def _about_base(
    motion: list[Array], load: list[Array], at: list[float], given: Given, angle: bool, ask: Asker
) -> tuple[list[Array], list[Array]]:
    """Return angles [rad] and torques [N m] about the base from what was measured at a distance from it.

    A branch that turns by theta moves its point at the distance a, along a pull at the angle phi to the branch, by
    s = a (cos(phi - theta) - cos(phi)); the virtual work of the force F is that of the torque F a sin(phi - theta).

    Raises:
        InputError: No angle brings the point so far.
    """
    phi = measure(given.pull_angle or "90", "angle", SOURCE, "--pull-angle")
    if not 0.1 < phi < np.pi - 0.1:
        raise InputError(SOURCE, "--pull-angle", f"{np.degrees(phi):g} degrees", "6 to 174 degrees, 90 straight across")
    angles, torques = [], []
    for x, f, a in zip(motion, load, at, strict=True):
        reached = np.cos(phi) + x / a
        if not angle and (np.abs(reached) > 1).any():
            found = f"a motion of {np.abs(x).max():.4g} m at {a:g} m from the base"
            raise InputError(
                SOURCE, "--at", found, "a distance that lets it turn so far; --position-unit; --pull-angle"
            )
        theta = x if angle else phi - np.arccos(reached)
        angles.append(theta)
        torques.append(f * a * np.sin(phi - theta))
    places = ", ".join(f"{a:g}" for a in dict.fromkeys(at))
    ask.notes.append(f"model: one joint at the base, pulled at {places} m from it along a fixed line at "
                     f"{np.degrees(phi):g} degrees to the branch (--at, --pull-angle); what the weight adds to the "
                     "spring is part of it")  # fmt: skip
    return angles, torques


def _inertia(given: Given, shape: Shape | None, driven: bool, turns: bool, ask: Asker) -> float | None:
    """Return the inertia that is known [kg m^2 or kg], None where it is learnt."""
    unit = "kg m^2" if turns else "kg"
    if given.inertia is not None:
        if given.inertia <= 0:
            raise InputError(SOURCE, "--inertia", f"{given.inertia:g}", f"above zero [{unit}]")
        return given.inertia
    if shape is not None:
        value = shape.inertia()
        ask.notes.append(f"inertia: {value:.4g} kg m^2 about the base, of a cone of {shape.mass.sum():.4g} kg and "
                         f"{shape.length.sum():g} m (--inertia)")  # fmt: skip
        return value
    if driven:
        ask.notes.append("inertia: learnt (--inertia, or --length and --diameter where --at is given)")
        return None
    ask.notes.append(f"inertia: 1 {unit}; free motion shows springs and dampers only over it (--inertia)")
    return 1.0


def _joint_meta(
    given: Given, names: tuple[str, str], inertia: float | None, driven: bool, lengths: list[float]
) -> dict[str, Any]:
    turns = names[1] == "angle_rad"
    joint: dict[str, Any] = {"name": "base" if turns else "pull", "type": "revolute" if turns else "prismatic",
                             "inertia": inertia, "stiffness": None, "damping": None}  # fmt: skip
    if given.hangs:
        joint["stiffness"], joint["gravity_torque"] = 0.0, {"amplitude": None, "zero_angle": None}
    starts = starts_of(given.starts, lengths)
    repeats = repeats_of(given.repeats, len(lengths))
    meta: dict[str, Any] = {
        "format": "joint-gap-case/1", "name": given.name, "time_column": "t_s", "time_scale": 1.0,
        "mechanism": {"joints": [joint]},
        "input": {"joint": joint["name"], "column": names[0], "scale": 1.0, "hold": "linear"} if driven else None,
        "outputs": [{"joint": joint["name"], "quantity": "position", "column": names[1], "scale": 1.0}],
        "trajectories": [{"file": f"traj_{i + 1:02d}.csv", "t_start_s": start, "replicate_of": repeats.get(i + 1)}
                         for i, start in enumerate(starts)],
        "noise_nominal": given.noise,
    }  # fmt: skip
    return {key: value for key, value in meta.items() if key != "name" or value}
