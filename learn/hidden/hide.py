"""A synthetic measured case with hidden effects, recorded by another simulator than bough."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...sim.base.errors import InputError, check_seed
from ...sim.base.mujoco_log import without_log
from . import forms as all_forms
from .drive import drive
from .measurement import HARD, Hard
from .names import NAMES, equivalents
from .parts import Part, Readings, Scale
from .probes import MOST_SAMPLES, SAMPLES, Experiment, recorded, truth, write_case
from .sizing import REFIT_STEP, Bench, readings, strength, visible_gap

#: Sizes of effects: rms change of displacement at the true springs, over its rms; log-uniform between these.
SIZES = (0.05, 0.30)
#: How often an effect that cannot reach its size is redrawn, with another sign or shape.
REDRAWS = 3
_WHO = "bough hide"


@dataclass(frozen=True)
class Found:
    """An effect whose strength has been found.

    Attributes:
        name: Of the effect.
        part: What is put into the rig.
        size: Rms change of displacement over its rms.
        form: Of its law.
    """

    name: str
    part: Part
    size: float
    form: str


def hide(
    folder: str | Path,
    *,
    effects: Sequence[str] = (),
    joint: int | None = None,
    outside: str | None = None,
    seed: int,
    segments: int = 3,
    noise: float = 0.03,
    rate: float | None = None,
    samples: int | None = None,
    size: float | None = None,
    hard: Sequence[Hard] = (),
    held_back: bool = False,
    forms: Mapping[str, str] | None = None,
    sub: int = 3,
    wood: float = 0.08,
    dt: float = 2.5e-4,
    reach: float = 0.22,
) -> dict[str, Any]:
    """Write a case folder with effects hidden and ``<folder>_answer.json`` beside it; return the answer.

    The branch, the experiment and the noise depend on the seed alone, not on what is hidden.

    Args:
        folder: Case folder to write.
        effects: Names of `names.NAMES`; none for a case without effects.
        joint: Joint that they act at, 0 nearest the base; drawn for each if None.
        outside: One of `names.OUTSIDE` beside them.
        seed: Seed of everything random.
        segments: Number of segments R.
        noise: Noise on displacement and velocity as a fraction of their rms; the force has half of it.
        rate: Sampling rate [Hz]; drawn from 20, 25 and 40 if None, with hard probes from 50 to 500.
        samples: Samples per recording T; 110 if None, with hard probes 3 to 5 s of them.
        size: Size of each effect, as in `SIZES`; drawn if None.
        hard: In what the case is harder, of `measurement.HARD`.
        held_back: Draw forms that are held back, and allow effects on no list that are.
        forms: Form of each effect's law, any there is; the others have the plain form, or with hard forms one drawn.
        sub: Sub-links per segment.
        wood: Bend of a segment's wood, see `rig.build`.
        dt: Largest step [s].
        reach: Peak displacement aimed at, as a fraction of the branch's length.

    Returns:
        What is hidden: effects, springs [N m/rad], dampers [N m s/rad] and noise, as in the JSON file.

    Raises:
        InputError: A name or a number is not allowed, or the folder cannot be written.
    """
    names = (*effects, *([outside] if outside else []))
    _check(seed, effects, outside, joint, segments, noise, rate, samples, size)
    _check_hard(outside, hard, held_back)
    experiment = Experiment(seed, segments, rate, samples, reach, hard)
    chosen = _forms(seed, names, hard, held_back) | dict(forms or {})
    options: dict[str, Any] = {"sub": sub, "wood": wood}
    with without_log():  # a strength that is too great is found out by its numbers
        if names:
            found, seen = _hidden(experiment, names, chosen, joint, size, options, dt)
            gap = visible_gap(experiment, seen, options)
        else:
            found, seen, gap = [], recorded(experiment, options | {"dt": dt}), 0.0
        blind = _measurement_gap(experiment, options, hard)
    seen = experiment.mounting.seen(seen) if experiment.mounting else seen
    tables, sigma = experiment.noisy(seen, noise)
    answer = _answer(found, outside, gap, blind, experiment, noise) | {"hard": list(hard)}
    answer |= {
        k: v for k, v in truth(experiment, seen, sigma, noise, sub, wood).items() if k not in ("K", "D", "noise")
    }
    write_case(folder, experiment, tables, noise, answer)
    return answer


def _hidden(
    experiment: Experiment,
    names: Sequence[str],
    forms: Mapping[str, str],
    joint: int | None,
    size: float | None,
    options: dict[str, Any],
    dt: float,
) -> tuple[list[Found], Readings]:
    """Draw the effects and record the branch; random numbers of their own, so that the noise is that of the null."""
    rng = np.random.default_rng([experiment.seed, 20])
    bench = Bench(experiment, options)
    scale = bench.scale()
    for _ in range(REDRAWS):
        found = [
            _drawn(name, forms[name], rng, bench, scale, joint, _size(rng) if size is None else size) for name in names
        ]
        if all(f is not None for f in found):
            kept = [f for f in found if f is not None]
            seen = _recorded(experiment, [f.part for f in kept], options | {"dt": dt})
            if np.isfinite(seen.moved).all():
                return kept, seen
    raise InputError(_WHO, "--seed", f"{experiment.seed}, a branch that leaves the finite", "another seed")


def _size(rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(SIZES))))


def _drawn(
    name: str, form: str, rng: np.random.Generator, bench: Bench, scale: Scale, joint: int | None, target: float
) -> Found | None:
    """Draw an effect until it can be as large as wanted; the nearest if none can, None if none stays finite."""
    best = None
    for _ in range(REDRAWS):
        at = int(rng.integers(len(scale.angle))) if joint is None else joint
        part, found = strength(bench, all_forms.recipe(name, form)(rng, scale, at), target)
        if np.isfinite(found) and (best is None or abs(np.log(found / target)) < abs(np.log(best.size / target))):
            best = Found(name, part, found, form)
        if best and abs(np.log(best.size / target)) < np.log(1.5):
            break
    return best


def _recorded(experiment: Experiment, parts: list[Part], options: dict[str, Any]) -> Readings:
    motion = drive(
        experiment.branch, experiment.forces, experiment.rate, parts=parts, clock=experiment.clock, **options
    )
    return readings(experiment, motion, parts)


def _forms(seed: int, names: Sequence[str], hard: Sequence[Hard], held_back: bool) -> dict[str, str]:
    """Return the form of every effect's law; random numbers of their own, so that nothing else depends on them."""
    if "forms" not in hard:
        return dict.fromkeys(names, all_forms.PLAIN)
    rng = np.random.default_rng([seed, 24])
    return {name: all_forms.draw(name, rng, held_back) for name in names}


def _measurement_gap(experiment: Experiment, options: dict[str, Any], hard: Sequence[Hard]) -> float:
    """Return what springs and dampers refitted to the measured branch leave without effects and noise, over the rms."""
    if not {"shape", "geometry", "sensors"} & set(hard):
        return 0.0
    motion = drive(experiment.branch, experiment.forces, experiment.rate, **options | {"dt": REFIT_STEP})
    seen = readings(experiment, motion, [])
    seen = experiment.mounting.seen(seen) if experiment.mounting else seen
    return visible_gap(experiment, seen, options, branch=experiment.measured)


def _answer(
    found: list[Found], outside: str | None, gap: float, blind: float, experiment: Experiment, noise: float
) -> dict[str, Any]:
    """Return what is hidden, in the form of the practice cases' answers."""
    return {
        "null": not found,
        "out_of_library": outside is not None,
        "effects": [
            {"name": f.name, "joint": f.part.joint, "params": dict(f.part.params), "form": f.form} for f in found
        ],
        "equivalents": equivalents([f.name for f in found]),
        "size_raw": {f.name: round(f.size, 4) for f in found},
        "weak": [f.name for f in found if f.size < SIZES[0] / 1.5 or gap < max(noise, blind)],
        "truth": {"K": experiment.branch.stiffness, "D": experiment.branch.damping},
        "options": {"noise": noise, "force_noise": noise / 2, "planar": False,
                    "n_traj": len(experiment.recordings), "rate": experiment.rate},
        "visible_gap": round(gap, 5), "measurement_gap": round(blind, 5),
    }  # fmt: skip


def _check(
    seed: int, effects: Sequence[str], outside: str | None, joint: int | None, segments: int, noise: float,
    rate: float | None, samples: int | None, size: float | None,
) -> None:  # fmt: skip
    check_seed(_WHO, seed)
    for name in effects:
        if name not in NAMES:
            raise InputError(_WHO, "--effects", repr(name), ", ".join(NAMES))
    if len(set(effects)) < len(effects):
        raise InputError(_WHO, "--effects", "a name twice", "each name once")
    if joint is not None and not 0 <= joint < segments:
        raise InputError(_WHO, "--joint", str(joint), f"0 to {segments - 1}, counted from the base")
    for option, value, low, high in (
        ("--segments", segments, 1, 6), ("--samples", SAMPLES if samples is None else samples, 20, MOST_SAMPLES),
        ("--noise", noise, 0.0, 0.5), ("--rate", 25.0 if rate is None else rate, 5.0, 500.0),
        ("--size", 0.1 if size is None else size, 0.01, 1.0),
    ):  # fmt: skip
        if not low <= value <= high:
            raise InputError(_WHO, option, str(value), f"{low} to {high}")


def _check_hard(outside: str | None, hard: Sequence[str], held_back: bool) -> None:
    for kind in hard:
        if kind not in HARD:
            raise InputError(_WHO, "--hard", repr(kind), ", ".join(HARD))
    allowed = {*all_forms.outside_names(False), *(all_forms.outside_names(True) if held_back else ())}
    if outside is not None and outside not in allowed:
        raise InputError(_WHO, "--outside", repr(outside), ", ".join(sorted(allowed)))
