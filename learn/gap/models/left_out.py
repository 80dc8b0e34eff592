"""Cross-validation: what models leave in recordings that they were not fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ....sim.effects import effect_of
from .contest import Batch, Contest
from .fitted import Model
from .refit import Fits, fit

#: Steps of a refit with one profile left out.
REFIT = 4


def profiles(contest: Contest) -> list[list[int]]:
    """Return groups of recordings that are replicates of one experiment."""
    groups: dict[int, list[int]] = {}
    for i, t in enumerate(contest.case.trajectories):
        groups.setdefault(i if t.replicate_of is None else t.replicate_of, []).append(i)
    return list(groups.values())


def left_out_chi2(contest: Contest, models: Sequence[Model], groups: Sequence[Sequence[int]]) -> torch.Tensor:
    """Return chi-squared in each group by models [S] that were refitted without it, shape [S, G]."""
    batches = []
    for model in models:
        for group in groups:
            own = model.fit.batch
            weight = own.weight.clone()
            weight[:, list(group)] = 0.0
            batches.append(Batch(own.free, own.active, own.start, weight))
    by_recording = _by_recording(contest, fit(contest, Batch.joined(batches), REFIT)).view(len(models), len(groups), -1)
    return torch.stack([by_recording[:, g, list(group)].sum(-1) for g, group in enumerate(groups)], 1)


def fitted_chi2(contest: Contest, models: Sequence[Model], groups: Sequence[Sequence[int]]) -> torch.Tensor:
    """Return chi-squared in each group by models [S] as they were fitted to all, shape [S, G]."""
    by_recording = torch.cat([_by_recording(contest, m.fit) for m in models])
    return torch.stack([by_recording[:, list(group)].sum(-1) for group in groups], 1)


def without_event(contest: Contest, added: Sequence[int], model: Model, groups: list[list[int]]) -> list[list[int]]:
    """Return the groups in which none of a model's ``added`` effects happens once and for good.

    When it happened cannot be known without the recording in which it did, whatever the other recordings say.
    """
    values = contest.values(model.fit.batch)[0]
    laws = {c: effect_of(contest.candidates[c].name).law("branch") for c in added}
    moments = [float(values[k]) for c, law in laws.items()
               for k, spec in zip(contest.candidates[c].columns, contest.candidates[c].specs, strict=True)
               if spec.name == law.moment]  # fmt: skip
    spans = [(r.t_start + r.t[0], r.t_start + r.t[-1]) for r in contest.recordings]
    return [g for g in groups if not any(spans[i][0] <= t <= spans[i][1] for i in g for t in moments)]


def _by_recording(contest: Contest, fitted: Fits) -> torch.Tensor:
    """Return chi-squared in every recording, also those that were not fitted, shape [S, R]."""
    full = Batch(fitted.batch.free, fitted.batch.active, fitted.batch.start, torch.ones_like(fitted.batch.weight))
    residual = contest.residual(full)
    if len(contest.nuisance):
        residual = residual - contest.nuisance.change(fitted.nuisance, full.weight).view_as(residual)
    return (residual**2).sum((-1, -2))
