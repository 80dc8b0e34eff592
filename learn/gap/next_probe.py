"""The probe that best discriminates two models: T-optimal design over pushes that an arm can make.

Atkinson & Fedorov 1975 (Biometrika 62:57): choose the experiment in which the rival, refitted to it, stays farthest
from the named model. Here the rival keeps its posterior from the case as a prior, so to first order in the rival's free
coordinates the criterion is

    T = min_x |r - J x|^2 + x' P x,

with r the difference of the two predictions in units of the noise, J the rival's Jacobian in the probe and P its
precision given the case. T is the expected gain of twice the log likelihood ratio against the rival.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...sim.base.types import Array
from ...sim.trees.measured import MeasuredBranch
from ..cases.case import BranchCase
from ..replay.probes import PROBES, ArmProbe
from ..replay.recording import Recording
from .decide import Decision, probe_for
from .models.contest import Batch, Contest
from .models.fitted import FittedModels, Model, overdispersion
from .models.refit import normal_equations

#: Least T of a probe that is recommended.
ENOUGH = 12.0


@dataclass(frozen=True)
class Worth:
    """A probe and its expected gain of twice the log likelihood ratio against a rival."""

    probe: ArmProbe
    evidence: float


def next_experiment(fitted: FittedModels, decision: Decision) -> str:
    """Return in words what to probe next: the push that best tells the preferred model from its nearest rival.

    For joints, or if no push tells them apart, the registry's recommendation for the names in question.
    """
    if decision.verdict == "none":
        return "none needed; larger pushes would show smaller effects"
    model = decision.model
    rival = _rival(fitted, model)
    found = best_probe(fitted.contest, model, rival) if rival is not None else None
    names = fitted.names(model)
    if rival is None or found is None or found.evidence < ENOUGH:
        return probe_for(names, [n for own in decision.alternatives.values() for n in own])
    own, other = (" and ".join(fitted.names(m)) or "no effect" for m in (model, rival))
    return f"{found.probe.words}: it would tell {own} from {other} by {found.evidence:.0f} in twice the log likelihood"


def _rival(fitted: FittedModels, model: Model) -> Model | None:
    """Return the best model of the same size whose names differ."""
    names = set(fitted.names(model))
    others = [m for m in fitted.of_size(len(model.members)) if set(fitted.names(m)) != names]
    return others[0] if others else None


def best_probe(
    contest: Contest, model: Model, rival: Model, probes: Sequence[ArmProbe] | None = None
) -> Worth | None:  # fmt: skip
    """Return the probe that tells a model from its rival best, of all known if none are given.

    None where the case is not a branch.
    """
    if not isinstance(contest.case, BranchCase):
        return None
    known = tuple(PROBES.everything().values()) if probes is None else probes
    return max(worths(contest, model, rival, known), key=lambda w: w.evidence)


def worths(contest: Contest, model: Model, rival: Model, probes: Sequence[ArmProbe]) -> list[Worth]:
    """Return what each of some probes of a branch is worth for telling a model from its rival."""
    precision = _precision(contest, rival)
    return [Worth(p, _worth(contest, p, model, rival, precision)) for p in probes]


def _precision(contest: Contest, model: Model) -> tuple[torch.Tensor, torch.Tensor]:
    """Precision [q, q] of a model's free coordinates given the case, marginal of nuisance, and their indices [q]."""
    residual, derivative, columns = contest.linearise(model.fit.batch)
    normal, _ = normal_equations(contest, model.fit.batch, residual, derivative, columns)
    q = columns.shape[1]
    return normal[0, :q, :q] / overdispersion(contest, model.chi2), columns[0]


def _worth(
    contest: Contest, probe: ArmProbe, model: Model, rival: Model, precision: tuple[torch.Tensor, torch.Tensor]
) -> float:  # fmt: skip
    """Return T: the rival's chi-squared against the model's prediction of a probe, minimised over its parameters."""
    other, batches = _probed(contest, probe, [model, rival])
    other.measured = other.simulate(other.values(batches[0]), batches[0].start)[0].double()  # the data of the rival
    residual, derivative, _ = other.linearise(batches[1])
    missed, j = residual.flatten(), derivative[0, : len(precision[1])].flatten(1)
    right = j @ missed
    adapted = float(right @ torch.linalg.solve(j @ j.T + precision[0], right))
    return max(float(missed @ missed) - adapted, 0.0) / overdispersion(contest, model.chi2)


def narrowing(contest: Contest, model: Model, probes: Sequence[ArmProbe]) -> list[float]:
    """Return what probes of a branch make of the deviation of a model's first effect's first parameter, a share of it.

    c-optimal design (Elfving 1952, Ann. Math. Stat. 23:255): with P the precision of the model's free coordinates given
    the case and J its Jacobian in the probe, the deviation of the one coordinate after it is that of (P + J J')^-1.
    """
    precision, columns = _precision(contest, model)
    at = columns.tolist().index(contest.candidates[model.members[0]].columns[0])
    before = torch.linalg.inv(precision)[at, at]
    out = []
    for probe in probes:
        other, (batch,) = _probed(contest, probe, [model])
        j = other.linearise(batch)[1][0, : len(columns)].flatten(1)
        after = torch.linalg.inv(precision + j @ j.T / overdispersion(contest, model.chi2))[at, at]
        out.append(float((after / before).sqrt()))
    return out


def _probed(contest: Contest, probe: ArmProbe, models: Sequence[Model]) -> tuple[Contest, list[Batch]]:
    """Return the contest of a probe, and models of the case at its start."""
    case = contest.case
    assert isinstance(case, BranchCase)
    made = recordings_of(case, contest.recordings, probe)
    other = Contest(case, made, contest.sigma.cpu().numpy(), contest.names, device=contest.device)
    fits, start = [m.fit.batch for m in models], other.start0[None]
    return other, [Batch(b.free, b.active, start.clone(), b.free.new_ones(1, len(made))) for b in fits]


def recordings_of(case: BranchCase, before: Sequence[Recording], probe: ArmProbe) -> list[Recording]:
    """Return a probe as recordings of a case's rate, after its last one, held where the first is held."""
    largest = max(float(np.linalg.norm(r.input, axis=1).max()) for r in before)
    longest = max(float(r.t[-1]) for r in before)
    begin = max(r.t_start + float(r.t[-1]) for r in before) + longest
    axes = push_axes(case)
    out: list[Recording] = []
    for push in probe.pushes:
        t = np.arange(0.0, push.length * longest, case.dt)
        share = t / max(t[-1], case.dt)
        held = share < push.free_from
        force = push.size * largest * np.where(held, push.course(share), 0.0)
        out.append(replace(before[0], t=t, input=force[:, None] * push.direction(axes), output=np.zeros((len(t), 6)),
                           contact=held, t_start=begin, sensed=None))  # fmt: skip
        begin += 2.0 * float(t[-1])
    return out


def push_axes(case: MeasuredBranch) -> Array:
    """Return directions [3, 3] at the held segment: across it in its own plane, across that plane, and along it."""
    up, turn = case.elevation[case.grasp_segment], case.azimuth[case.grasp_segment]
    along = np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
    across = np.array([-np.sin(turn), np.cos(turn), 0.0])
    return np.array([np.cross(along, across), across, along])
