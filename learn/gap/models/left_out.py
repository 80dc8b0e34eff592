"""Cross-validation: what models leave in recordings that they were not fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from .contest import Batch, Contest
from .fitted import Model
from .refit import fit

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
    fitted = fit(contest, Batch.joined(batches), REFIT)
    full = Batch(fitted.batch.free, fitted.batch.active, fitted.batch.start, torch.ones_like(fitted.batch.weight))
    residual = contest.residual(full)
    if len(contest.nuisance):
        residual = residual - contest.nuisance.change(fitted.nuisance, full.weight).view_as(residual)
    by_recording = (residual**2).sum((-1, -2)).view(len(models), len(groups), -1)
    return torch.stack([by_recording[:, g, list(group)].sum(-1) for g, group in enumerate(groups)], 1)
