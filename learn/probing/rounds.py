"""One round: what the recordings so far say, and which pull would tell most.

It is `learn.gap`'s diagnosis up to its decision. The posterior, the repaired model and the report wait for the end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter
from scipy.stats import chi2, ncx2

from ...sim.base.types import Array
from ..cases.case import BranchCase
from ..gap.decide import TIED, Decision, decide
from ..gap.diagnosis import Settings
from ..gap.evidence import ALARM, bootstrap_test
from ..gap.models.fitted import FittedModels, Model
from ..gap.models.scan import Basis, all_probes, signatures
from ..gap.next_probe import narrowing, worths
from ..gap.posterior import intervals
from ..gap.prepare import Base, prepare
from ..gap.run import Run
from ..gap.search import search
from ..replay.probes import ArmProbe
from ..runs.schema import validated
from ..runs.threads import one_thread
from .menu import PLAIN


@dataclass(frozen=True)
class Finding:
    """What so many recordings say.

    Attributes:
        recordings: Their number.
        verdict: ``none``, ``effects`` or ``unknown``.
        effects: Labels of the effects that are named, such as ``dry_friction@1``.
        names: Their names.
        rival: Best rival with other names, as labels; empty for the base model.
        lead: Its information criterion minus that of the preferred model; 12 and more is clearly behind.
        p_null: Family-wise p-value of the best candidate under the base model.
        width: Half of the 95 % interval of the first effect's first parameter over its value; infinite without one.
        power: For ``none``, by name, how likely an effect of `MATTERS` would have been seen.
        propose: Name of the next pull; empty where nothing can be said. A name that leads by `CLEAR` is confirmed by a
            plain pull, the one that narrows its interval most; else it is what tells the contenders apart best.
        gain: What it is expected to add to twice the log likelihood ratio against the rival; 0 of a plain one.
        reason: Why nothing can be said yet; empty where it can.
    """

    recordings: int
    verdict: str
    effects: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    rival: tuple[str, ...] = ()
    lead: float = 0.0
    p_null: float = 1.0
    width: float = math.inf
    power: dict[str, float] | None = None
    propose: str = ""
    gain: float = 0.0
    reason: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return it as plain values; an interval that is infinite is null."""
        out = asdict(self)
        return out | {"width": None if math.isinf(self.width) else self.width}

    @staticmethod
    def of_json(data: dict[str, Any], file: str | Path) -> Finding:
        """Return what `as_json` has made plain and a file has kept.

        Raises:
            InputError: The file has a field of another type, or lacks one.
        """
        width = {"width": math.inf} if data.get("width") is None else {}
        found: Finding = validated(TypeAdapter(Finding), {**data, **width}, file, allowed="what bough probe wrote")
        return found


CLEAR = TIED
"""Lead in the information criterion from which a name stands apart from all others."""
MATTERS = 0.05
"""Change of the motion, as a share of its rms, by an effect that must not stay unseen: the least of an exam."""


def examine(case: BranchCase, settings: Settings, pulls: Mapping[str, ArmProbe]) -> Finding:
    """Return what a case says, and the best of some pulls to do next."""
    run = Run(replace(settings, particles=0))
    with one_thread():
        base = prepare(case, run)
        if base.unusable:
            return Finding(len(case.trajectories), "unknown", reason=base.unusable)
        searched = search(base, bootstrap_test(base, run), run)
        decision = decide(base, searched, run.settings)
        return _found(case, base, searched.fitted, searched.p_value, decision, pulls)


def _found(
    case: BranchCase, base: Base, fitted: FittedModels, p_value: float, decision: Decision,
    pulls: Mapping[str, ArmProbe],
) -> Finding:  # fmt: skip
    model, rival = _contenders(fitted, decision)
    nothing, named = decision.verdict == "none", decision.verdict == "effects"
    lead = fitted.criterion(rival) - fitted.criterion(model)
    propose, gain = _next(fitted, decision.verdict, model, rival, lead, pulls)
    return Finding(
        len(case.trajectories), decision.verdict, tuple(a.label for a in decision.named),
        tuple(a.name for a in decision.named), fitted.labels(rival), lead, p_value,
        _width(fitted, decision) if named else math.inf, _power(base, fitted) if nothing else None, propose, gain,
    )  # fmt: skip


def _next(
    fitted: FittedModels, verdict: str, model: Model, rival: Model, lead: float, pulls: Mapping[str, ArmProbe]
) -> tuple[str, float]:  # fmt: skip
    """Return the next pull, and what it is expected to add to twice the log likelihood ratio; see `Finding`."""
    plain = {name: pulls[name] for name in PLAIN if name in pulls}
    if verdict == "effects" and lead >= CLEAR and plain:
        shares = dict(zip(plain, narrowing(fitted.contest, model, list(plain.values())), strict=True))
        return min(plain, key=lambda name: shares[name]), 0.0
    # of an effect and the base the base can never look like the effect
    pair = (rival, model) if verdict == "none" else (model, rival)
    return _best(fitted, *pair, pulls)


def _contenders(fitted: FittedModels, decision: Decision) -> tuple[Model, Model]:
    """Return the two models between which the next pull decides: the preferred one and the best with other names.

    Where nothing is named, the preferred one is the base, against the effect that comes nearest.
    """
    if decision.verdict == "none":
        return fitted.base, next(iter(fitted.of_size(1)), fitted.base)
    names = set(fitted.names(decision.model))
    others = [m for m in fitted.of_size(len(decision.model.members)) if set(fitted.names(m)) != names]
    return decision.model, next(iter(others), fitted.base)


def _best(fitted: FittedModels, model: Model, rival: Model, pulls: Mapping[str, ArmProbe]) -> tuple[str, float]:
    """Return the pull that tells two models apart best, per recording that it costs, and what it is expected to add."""
    found = worths(fitted.contest, model, rival, list(pulls.values()))
    worth = {name: w.evidence / len(pulls[name].pushes) for name, w in zip(pulls, found, strict=True)}
    best = max(worth, key=lambda name: worth[name], default="")
    return best, worth.get(best, 0.0)


def _width(fitted: FittedModels, decision: Decision) -> float:
    found = intervals(fitted.contest, decision, decision.model.fit.batch, range(len(fitted.contest.recordings)), None)
    first = next(iter(next(iter(found.values())).values()))
    return float((first.high - first.low) / 2.0 / max(abs(first.median), 1e-300))


def _power(base: Base, fitted: FittedModels) -> dict[str, float]:
    """Return by name the probability that an effect which changes the motion by `MATTERS` would have been found.

    Its signature is scaled to that change; what springs, dampers and nuisances cannot imitate of it is the
    noncentrality of the score test, whose threshold is that of `ALARM` over all tests (Bonferroni).
    """
    contest = fitted.contest
    probes = all_probes(contest)
    change, beyond, owner = signatures(contest, Basis(contest, fitted.base.fit), probes)
    wanted = MATTERS**2 * base.motion**2 * contest.num_samples
    out: dict[str, float] = {}
    for k, probe in enumerate(probes):
        seen = _noncentrality(change[owner == k].cpu().numpy(), beyond[owner == k].cpu().numpy(), wanted)
        free = max(1, int((owner == k).sum()))
        level = chi2.isf(ALARM / len(probes), free)
        name = contest.candidates[probe.candidate].name
        out[name] = max(out.get(name, 0.0), float(ncx2.sf(level, free, seen / fitted.overdispersion)))
    return out


def _noncentrality(change: Array, beyond: Array, wanted: float) -> float:
    """Return what is left of a signature's square, once it is ``wanted``; the least over its columns."""
    whole, left = (change**2).sum(axis=1), (change * beyond).sum(axis=1)
    acts = whole > 0.0
    return float(wanted * np.min(left[acts] / whole[acts])) if acts.any() else 0.0
