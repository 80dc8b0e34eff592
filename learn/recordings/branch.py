"""A branch case from forces and motions in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..cases.case import BRANCH_COLUMNS
from . import plausible
from .folder import Content, rate_of, starts_of
from .given import SOURCE, Given, quiet_of, repeats_of
from .questions import Asker, Question
from .shape import Shape, shape_of
from .units import measure


@dataclass(frozen=True)
class Motions:
    """N recordings on one uniform clock.

    Attributes:
        step: Step of the clock [s].
        motion: Motion from its zero [m or rad], N arrays [T, axes].
        effort: Force or torque [N or N m], N arrays [T, axes]; zero where nothing acts.
        velocity: Velocity [m/s], N arrays [T, axes], or None.
    """

    step: float
    motion: list[Array]
    effort: list[Array]
    velocity: list[Array] | None


def places_of(given: Given, count: int) -> list[float]:
    """Return where each recording pulls, from the base along the branch [m].

    Raises:
        InputError: There is neither one place nor one for each recording.
    """
    places = [measure(t, "position", SOURCE, "--at") for t in given.at]
    if len(places) not in (1, count) or min(places) <= 0:
        raise InputError(SOURCE, "--at", ", ".join(given.at), f"one distance above zero, or {count}: one per recording")
    return places if len(places) == count else places * count


def branch_content(measured: Motions, given: Given, ask: Asker, units: str) -> Content:
    """Return a branch case of recordings in space; ``units`` are the flags that state those of force and motion.

    Raises:
        InputError: The branch's shape or where it is held is missing; a unit cannot be right.
    """
    shape = shape_of(given, ask)
    if not given.at:
        question = Question("--at", "How far from the base, along the branch, is it held?", "no place where it is held",
                            "a distance from the base along the branch, such as 0.9 or 90cm")  # fmt: skip
        given = replace(given, at=(ask(question, lambda t: (measure(t, "position", SOURCE, "--at"), t)[1]),))
    count = len(measured.motion)
    at = places_of(given, count)
    samples = min(len(m) for m in measured.motion)
    if samples < max(len(m) for m in measured.motion):
        ask.notes.append(f"length: recordings of a branch are equally long; cut to {samples} samples")
    motion, effort = ([_axes(a[:samples]) for a in arrays] for arrays in (measured.motion, measured.effort))
    along = _largest_direction(np.concatenate(motion))
    plausible.check_stiffness(np.concatenate(effort) @ along, np.concatenate(motion) @ along, at[0], shape, ask, units)
    rate = rate_of(measured.step)
    rows = [np.hstack([np.arange(samples)[:, None] / rate, f, x]) for f, x in zip(effort, motion, strict=True)]
    header: Sequence[str] = BRANCH_COLUMNS[:7]
    if measured.velocity is not None:
        header = BRANCH_COLUMNS
        rows = [np.hstack([r, _axes(v[:samples])]) for r, v in zip(rows, measured.velocity, strict=True)]
    ask.notes.append("frame: forces and motion in the world frame, z up; the force is that of the hand on the branch")
    if count < 2:
        ask.warnings.append("one recording cannot support a verdict on a branch in space: pull in other directions too")
    planar = all(not r[:, 2::3].any() for r in rows)
    meta = _branch_meta(shape, given, at, rate, samples, count, planar)
    return Content(meta, [(header, r) for r in rows])


def _axes(values: Array) -> Array:
    """Return columns x y z [T, 3]; two columns are x and z."""
    return values if values.shape[1] == 3 else np.insert(values, 1, 0.0, axis=1)


def _largest_direction(motion: Array) -> Array:
    """Return the unit direction in which most of a motion [T, 3] goes."""
    out: Array = np.linalg.eigh(motion.T @ motion)[1][:, -1]
    return out


def _branch_meta(
    shape: Shape, given: Given, at: list[float], rate: float, samples: int, count: int, planar: bool
) -> dict[str, Any]:
    repeats = repeats_of(given.repeats, count)
    starts = starts_of(given.starts, [samples / rate] * count)
    held = [dict(zip(("segment", "distance_from_lower_end_m"), shape.place(a), strict=True)) for a in at]
    items: list[dict[str, Any]] = []
    for i in range(count):
        item = {"file": f"traj_{i + 1:02d}.csv", "t_start_s": starts[i], "replicate_of": repeats.get(i + 1),
                "no_contact": quiet_of(given.no_contact, i + 1)}  # fmt: skip
        items.append(item | ({} if held[i] == held[0] else {"grasp": dict(held[i])}))
    meta: dict[str, Any] = {
        "format": "branch-gap-case/1", "name": given.name, "sample_rate_hz": rate, "n_samples": samples,
        "time_scale": 1.0, "gravity_mps2": 9.81, "planar": planar, "density_kgpm3": shape.density,
        "base_position_m": list(given.base or (0.0, 0.0, 0.0)), "segments": shape.segments(), "grasp": held[0],
        "noise_nominal": given.noise, "trajectories": items,
    }  # fmt: skip
    return {key: value for key, value in meta.items() if key != "name" or value}
