"""Ranking of the fitted models, and cross-validation of the leading ones."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from .decide import Decision
from .diagnosis import Rival
from .models.contest import Batch, Contest
from .models.fitted import FittedModels, Model
from .models.refit import Fits, fit

#: Models in the ranking, and steps of a refit with one profile left out.
RANKED, REFIT = 12, 4


def rank(fitted: FittedModels, decision: Decision) -> tuple[Rival, ...]:
    """Return base and rivals, best first; the leading ones with their cross-validated reduced chi-squared."""
    model = decision.model
    best = fitted.criterion(model)
    scores = _cross_validated(fitted, model) if decision.verdict != "none" else {}
    return tuple(
        Rival(
            fitted.labels(m), fitted.reduced_chi2(m), fitted.criterion(m) - best, fitted.explained(m), scores.get(id(m))
        )
        for m in _listed(fitted, model)
    )


def _listed(fitted: FittedModels, model: Model) -> list[Model]:
    """Return the models of the ranking, best first.

    Of models with more effects than the preferred one only the best is listed.
    """
    every = sorted([fitted.base, *fitted.models], key=fitted.criterion)
    ahead = {m.members: m for m in reversed(every)}  # the same effects may have been fitted from two sides
    each = [m for m in every if ahead[m.members] is m]
    larger = [m.members for m in each if len(m.members) > len(model.members)][1:]
    listed = [m for m in each if m.members not in larger][:RANKED]
    return listed if fitted.base in listed else [*listed, fitted.base]


def _cross_validated(fitted: FittedModels, model: Model) -> dict[int, float]:
    """Return the cross-validated reduced chi-squared of a model, its nearest rival and the base, by identity."""
    groups = profiles(fitted.contest)
    if len(groups) < 2:
        return {}
    rivals = [m for m in fitted.of_size(len(model.members)) if m.members != model.members]
    tried = [model, *rivals[:1], fitted.base]
    chi2 = left_out_chi2(fitted.contest, [m.fit for m in tried], groups).sum(1) / fitted.contest.num_samples
    return {id(m): float(x) for m, x in zip(tried, chi2, strict=True)}


def profiles(contest: Contest) -> list[list[int]]:
    """Return groups of recordings that are replicates of one experiment."""
    groups: dict[int, list[int]] = {}
    for i, t in enumerate(contest.case.trajectories):
        groups.setdefault(i if t.replicate_of is None else t.replicate_of, []).append(i)
    return list(groups.values())


def left_out_chi2(contest: Contest, models: Sequence[Fits], groups: Sequence[Sequence[int]]) -> torch.Tensor:
    """Return chi-squared in each group by models [S] that were refitted without it, shape [S, G]."""
    batches = []
    for model in models:
        for group in groups:
            weight = model.batch.weight.clone()
            weight[:, list(group)] = 0.0
            batches.append(Batch(model.batch.free, model.batch.active, model.batch.start, weight))
    fitted = fit(contest, Batch.joined(batches), REFIT)
    full = Batch(fitted.batch.free, fitted.batch.active, fitted.batch.start, torch.ones_like(fitted.batch.weight))
    residual = contest.residual(full)
    if len(contest.nuisance):
        residual = residual - (fitted.nuisance @ contest.nuisance).view_as(residual)
    by_recording = (residual**2).sum((-1, -2)).view(len(models), len(groups), -1)
    return torch.stack([by_recording[:, g, list(group)].sum(-1) for g, group in enumerate(groups)], 1)
