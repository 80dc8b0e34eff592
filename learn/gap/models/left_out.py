"""Cross-validation: what models leave in recordings that they were not fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import torch

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


def without_event(contest: Contest, models: Sequence[Model], groups: list[list[int]]) -> list[list[int]]:
    """Return the groups in which, or just before which, no law of the models sets in or breaks.

    When that was cannot be known without the recording in which it was, whatever the other recordings say. A wind that
    fell between two recordings shows in the second by how the branch still sways.
    """
    ends = [float(r.t_start + r.t[-1]) for r in contest.recordings]
    moments = [t for m in models for t in _moments(contest, m) if t <= max(ends)]
    shown = {min((end, i) for i, end in enumerate(ends) if t <= end)[1] for t in moments}
    return [g for g in groups if not shown.intersection(g)]


def _moments(contest: Contest, model: Model) -> list[float]:
    """Return the moments on the absolute clock [s] at which laws of a model set in or break."""
    batch = model.fit.batch
    values = contest.values(batch)[0]
    own = [contest.candidates[c] for c in model.members]
    return [float(values[k]) for c in own for k, spec in zip(c.columns, c.specs, strict=True)
            if spec.name == c.law.moment and bool(batch.active[0, k])]  # fmt: skip


def _by_recording(contest: Contest, fitted: Fits) -> torch.Tensor:
    """Return chi-squared in every recording, also those that were not fitted, shape [S, R]."""
    full = Batch(fitted.batch.free, fitted.batch.active, fitted.batch.start, torch.ones_like(fitted.batch.weight))
    residual = contest.residual(full)
    if len(contest.nuisance):
        residual = residual - contest.nuisance.change(fitted.nuisance, full.weight).view_as(residual)
    return (residual**2).sum((-1, -2))
