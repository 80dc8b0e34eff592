"""The checks of `bough check-law`, one function each; each says what it looked at in a line."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from ...sim.base.types import Array
from ...sim.effects import Effect, EffectParameter, Law, effects
from ...sim.effects.registry import Form
from ..cases.case import BranchCase, JointCase
from ..replay.recording import recordings
from ..replay.rollout import Rollout
from ..systems.acting import Acting
from ..systems.branch import Unknowns
from .bench import (
    SAMPLES,
    SECONDS,
    SETTING,
    Answer,
    ask_joint,
    ask_link,
    closed_path,
    effort_along,
    parameter_in,
    values_in,
)
from .recovery import Verdict, recover
from .simulated import DAMPER, SPRING, case_for
from .units import ASTRAY, POWERS, astray, scale_of

#: Samples of the closed path at which torques are differentiated, size of the differences as a share,
#: and samples of the path that leads there.
PLACES, NUDGE, SHORT = np.linspace(0.03, 0.97, 41), 1e-5, 481
#: Samples of the path at which jumps are looked for, and twice as many.
DENSE = SAMPLES // 2
#: Share of the work moved to and fro that may be out of balance: the path's steps are of first order, 0.1 ms.
BALANCE = 2e-3
#: How far off its rest a branch is held [m], and the share of that by which it may move: the turn changes its weight's
#: lever a little.
OFF, HELD = 0.002, 0.1
#: Suffixes of names that stand for a unit, as in ``torque_Nm``; a share has none.
SUFFIX = {"1": "", "N": "_N", "N m": "_Nm", "N m or N": "_N", "rad": "_rad", "s": "_s", "kg": "_kg", "Hz": "_Hz",
          "Pa": "_Pa", "kg/m^3": "_kgpm3", "1/rad^2": "_radm2", "rad/(N m)": "_radpNm", "kg m^2": "_kgm2",
          "m/(N s)": "_mpNs", "N m s^2/rad^2": "_Nms2", "N m s/rad": "_Nmsprad"}  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """What one check found.

    Attributes:
        check: Its name.
        form: ``branch`` or ``joint``; empty for a check of the whole row.
        verdict: ``ok``, ``missing`` for what must be mended, ``unclear`` for what the small case cannot tell.
        text: What was seen.
    """

    check: str
    form: Form | Literal[""]
    verdict: Verdict
    text: str


def check_law(effect: Effect) -> Iterator[Finding]:
    """Yield what is right and what is missing of a law, in the order in which it is easiest to mend."""
    yield _row(effect)
    forms: tuple[Form, ...] = ("branch", "joint")
    for form in forms:
        law = getattr(effect, form)
        if law is None:
            continue
        yield _boxes(law, form)
        if law.kind in ("joint", "link"):
            yield _units(law, form)
            yield _continuity(law, form)
            yield _energy(law, form)
        if law.kind == "joint":
            yield _derivatives(law, form)
        with tempfile.TemporaryDirectory() as folder:
            case = case_for(form, Path(folder) / "case")
        yield _neutral(effect, form, case)
        if law.holds is not None and isinstance(case, BranchCase):
            yield _holding(effect, case)
        yield Finding("recovery", form, *recover(effect, form, case))


def _row(effect: Effect) -> Finding:
    """Ask for everything that a report prints of an effect."""
    empty = [k for k in ("summary", "source", "signature", "probe") if len(str(getattr(effect, k)).split()) < 2]
    strange = [n for n in effect.mistaken_for if n not in {e.name for e in effects()} - {effect.name}]
    wrong = [f"no {k}" for k in empty] + [f"mistaken_for {n}, which no effect is called" for n in strange]
    if not effect.mistaken_for:
        wrong.append("no effect that it is mistaken for")
    if wrong:
        return Finding("row", "", "missing", "; ".join(wrong))
    return Finding("row", "", "ok", f"{effect.name}: law, source, signature, rivals and a probe that tells them apart")


def _boxes(law: Law, form: Form) -> Finding:
    """Ask for boxes of priors in order, and names that end with their units."""
    wrong = [text for p in law.parameters for text in _faults(p)]
    if wrong:
        return Finding("parameters", form, "missing", "; ".join(wrong))
    shown = (parameter_in(p, SETTING) for p in law.parameters)
    return Finding("parameters", form, "ok", ", ".join(f"{p.name} {p.low:.3g} to {p.high:.3g} {p.unit}" for p in shown))


def _faults(spec: EffectParameter) -> Iterator[str]:
    p = parameter_in(spec, SETTING)
    if not p.low < p.high or not np.isfinite([p.low, p.high]).all():
        yield f"{p.name}: a box from {p.low:g} to {p.high:g}"
    elif p.scale == "log" and p.low <= 0.0:
        yield f"{p.name}: a logarithm of {p.low:g}"
    elif p.typical is not None and not p.low <= p.typical <= p.high:
        yield f"{p.name}: typical {p.typical:g} outside of {p.low:g} to {p.high:g}"
    suffix = SUFFIX.get(spec.unit)
    if not spec.unit:
        yield f"{p.name}: no unit (1 for a share)"
    elif suffix is None and not re.search(r"_\w+$", spec.name):
        yield f"{p.name}: the name does not end with the unit, {spec.unit}"
    elif suffix and not spec.name.endswith(suffix):
        yield f"{p.name}: the name does not end with {suffix}, for {spec.unit}"


def _units(law: Law, form: Form) -> Finding:
    """Ask that the law is the same where seconds and joules are others: that its parameters have the units it says."""
    stated = ", ".join(f"{p.name} [{p.unit}]" for p in law.parameters)
    unknown = [p.unit for p in law.parameters if scale_of(p.unit) is None]
    if unknown:
        return Finding("units", form, "unclear", f"not known: {', '.join(unknown)}; known: {', '.join(POWERS)}")
    away = astray(law, 1 if form == "joint" else 3)
    if away > ASTRAY:
        text = f"in other units of time and energy the effort is off by {away:.2g} of it: one of {stated} is no such"
        return Finding("units", form, "missing", text)
    return Finding("units", form, "ok", f"{stated}: the effort keeps to them")


def _continuity(law: Law, form: Form) -> Finding:
    """Ask that the effort does not jump: its largest change from sample to sample halves where there are twice as many.

    Largest changes below a hundredth of the effort are not looked at.
    """
    axes, values = 1 if form == "joint" else 3, values_in(law)
    fine, coarse = (effort_along(law, values, *closed_path(SETTING.angle, axes, n)) for n in (2 * DENSE, DENSE))
    change, before = (float(np.abs(np.diff(e, axis=0)).max()) for e in (fine, coarse))
    share = change / max(float(np.abs(fine).max()), 1e-300)
    if share > 0.01 and change > 0.75 * before:
        text = f"the effort jumps by {share:.2g} of its largest value: let it change over an angle, a rate or a time"
        return Finding("continuity", form, "missing", text)
    return Finding("continuity", form, "ok", f"no jump in {2 * DENSE} samples of a closed path")


def _energy(law: Law, form: Form) -> Finding:
    """Ask that over a way out and back a passive law takes energy or gives none.

    Work W = -integral of torque (damper's included) times rate, angles as vectors: over a closed path from an empty
    memory W is what was lost and what a memory still stores, neither of them negative. A link goes the same way.
    """
    where, rate = closed_path(SETTING.angle, 1 if form == "joint" else 3)
    effort = effort_along(law, values_in(law), where, rate)
    if law.kind == "link":
        rate = rate * SETTING.speed / np.abs(rate).max()
    power = -(effort * rate).sum(1) * 2.0 / (len(rate) - 1)
    taken, moved = float(power.sum()), float(np.abs(power).sum())
    text = f"takes {taken:.3g} J of the {moved:.3g} J that it moves along a closed path"
    if not np.isfinite(effort).all():
        return Finding("energy", form, "missing", "not finite along a closed path")
    if taken < -BALANCE * moved and not law.active:
        return Finding("energy", form, "missing", f"gives energy: {text}; active=True if it may, as a gust does")
    return Finding("energy", form, "ok", text + (", and may give (active)" if law.active else ""))


def _derivatives(law: Law, form: Form) -> Finding:
    """Ask that the stiffness and damping which a law returns cover the slopes of its effort.

    With the effort f = torque - damping x rate, S = stiffness, D = damping and h the step, the step is implicit in D
    alone. One step is stable down to an inertia of h (-df/d rate - 2 D) / 2, which must be a hundredth of the bench's
    at most. A ball joint gets its least damper of S: -d torque/d angle <= S, to a thousandth of the joint's spring.
    """
    base, slopes = _slopes(law, 1 if form == "joint" else 3)
    steep = float((slopes[0] - base.stiffness).max()) / SETTING.stiffness
    step = SECONDS / (SHORT - 1)
    inertia = SETTING.mass * SETTING.length**2 / 3.0
    least = max(0.0, 0.5 * step * float((slopes[1] - 2.0 * base.damping).max()))
    if not np.isfinite([steep, least]).all():
        return Finding("derivatives", form, "missing", "not finite")
    if steep > 1e-3:
        text = f"the torque falls faster with the angle than the stiffness returned, by {steep:.2g} of the joint's own"
        return Finding("derivatives", form, "missing", text)
    down = f"down to an inertia of {least:.1g} kg m^2" if least > 1e-9 else "at any inertia"
    text = f"a step of {1e3 * step:.1f} ms is stable {down}"
    if least > 0.01 * inertia:
        return Finding("derivatives", form, "missing", f"{text}: return more of the slope as damping")
    return Finding("derivatives", form, "ok", f"{text}; stiffness covers the torque's slopes at {len(PLACES)} places")


def _slopes(law: Law, axes: int) -> tuple[Answer, Array]:
    """Return the answer at P places and the steepest falls there, of torque by angle and of effort by rate, [2, P].

    Each place is reached along the path, so that the memory is that of the motion; only the last sample is nudged.
    """
    where, rate = closed_path(SETTING.angle, axes, SHORT)
    ends = (PLACES * (SHORT - 1)).astype(int)
    nudges = np.array([np.zeros(6), *(sign * row for row in _nudges(axes) for sign in (1.0, -1.0))])
    last, turned = np.repeat(ends, len(nudges)), np.tile(nudges, (len(ends), 1))
    own = np.arange(len(last))
    angles, rates = (np.repeat(x[None], len(last), 0) for x in (where, rate))
    angles[own, last] += turned[:, :3]
    rates[own, last] += turned[:, 3:]
    found = ask_joint(law, values_in(law), angles, rates)
    torque, damping, first = found.torque[own, last], found.damping[own, last], slice(None, None, len(nudges))
    base = Answer(torque[first], found.stiffness[own, last][first], damping[first])
    by_rate = np.abs(turned[:, 3:]).sum(1) > 0.0
    seen = (torque - np.where(by_rate, damping, 0.0)[:, None] * rates[own, last]).reshape(len(ends), len(nudges), 3)
    fall = (seen[:, 2::2] - seen[:, 1::2]) / (2.0 * np.abs(nudges[1::2]).sum(1))[None, :, None]
    along = np.stack([fall[:, a, a % axes] for a in range(2 * axes)])
    return base, along.reshape(2, axes, len(ends)).max(1)


def _nudges(axes: int) -> Array:
    """Return a small change of each angle, then of each rate, shape [2 axes, 6]."""
    size = NUDGE * np.array([SETTING.angle] * 3 + [SETTING.rate] * 3)
    return (np.eye(6) * size)[[*range(axes), *range(3, 3 + axes)]]


def _answer_when_neutral(law: Law, axes: int) -> float:
    """Return the largest torque, stiffness and damping, or force, of a law whose parameters are all neutral."""
    where, rate = (x[None] for x in closed_path(SETTING.angle, axes, SHORT))
    values = [p.neutral for p in law.parameters]
    if law.kind == "link":
        return float(np.abs(ask_link(law, values, rate)).max())
    answer = ask_joint(law, values, where, rate)
    return float(max(np.abs(x).max() for x in (answer.torque, answer.stiffness, answer.damping)))


def _neutral(effect: Effect, form: Form, case: BranchCase | JointCase) -> Finding:
    """Ask that a neutral law answers zero, and that a kernel with it moves a world as the one without it, to the bit.

    Kernels skip terms whose parameters are all neutral, so that the second does not follow from the first.
    """
    law = effect.law(form)
    if law.kind in ("joint", "link") and (size := _answer_when_neutral(law, 1 if form == "joint" else 3)) != 0.0:
        return Finding("neutral", form, "missing", f"answers {size:.2g} where every parameter is neutral, not zero")
    place = 0 if law.per_joint else None
    off = Acting(effect.name, place, {p.name: p.neutral for p in law.parameters})
    plain, built = (
        Rollout(case, recordings(case), 1, unknowns=unknowns) for unknowns in (Unknowns(), Unknowns(effects=(off,)))
    )
    springs = [SPRING, DAMPER] + [0.0] * (len(plain.system.parameters) - 2)
    values = torch.tensor([springs], dtype=torch.float64)
    one, two = plain(values).clone(), built(values).clone()
    if torch.equal(one, two) and bool(torch.isfinite(one).all()):
        return Finding("neutral", form, "ok", f"{one.numel()} numbers to the bit as without it")
    apart = float((one - two).abs().max() / one.abs().max())
    return Finding("neutral", form, "missing", f"a neutral law changes the motion, by {apart:.2g} of its largest value")


def _holding(effect: Effect, case: BranchCase) -> Finding:
    """Ask that a branch which the law holds off its rest stays there while nothing pulls."""
    law = effect.law("branch")
    acting = Acting(effect.name, 0, dict(zip((p.name for p in law.parameters), values_in(law), strict=True)))
    first = recordings(case)[0]
    across = np.linalg.svd(case.axis[:1])[2][1]
    still = replace(first, input=0.0 * first.input, sensed=0.0 * first.input, off=OFF * across)
    rollout = Rollout(case, [still], 1, unknowns=Unknowns(effects=(acting,)))
    values = torch.tensor([[SPRING, DAMPER]], dtype=torch.float64)
    way = rollout(values)[0, 0, :, :3].double().cpu().numpy()
    begins = float(np.linalg.norm(way[0]))
    moved = float(np.linalg.norm(way - way[0], axis=1).max())
    if begins > 0.0 and moved <= HELD * begins:
        return Finding("holding", "branch", "ok", f"a branch found {begins * 1e3:.2g} mm off its rest stays there")
    text = (
        f"a branch found {OFF * 1e3:.2g} mm off its rest begins at {begins * 1e3:.2g} mm and moves {moved * 1e3:.2g} mm"
    )
    return Finding("holding", "branch", "missing", f"{text} by itself: what it holds is not what it answers")
