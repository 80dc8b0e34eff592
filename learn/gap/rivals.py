"""The ranking of the fitted models, and how the leading ones do in recordings that they were not fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from .decide import Decision
from .diagnosis import Rival
from .models.contest import Contest, Rows
from .models.field import Field, Model
from .models.refit import Fits, fit

#: Models in the ranking, and steps of a refit without one profile.
RANKED, REFIT = 12, 4


def rank(field: Field, decision: Decision) -> tuple[Rival, ...]:
    """Return base and rivals, best first; the leading ones with their misfit in profiles they were not fitted to."""
    model = decision.model
    best = field.criterion(model)
    scores = _cross_validated(field, model) if decision.verdict != "none" else {}
    return tuple(
        Rival(field.labels(m), field.reduced_chi2(m), field.criterion(m) - best, field.explained(m), scores.get(id(m)))
        for m in _listed(field, model)
    )


def _listed(field: Field, model: Model) -> list[Model]:
    """Return the models of the ranking, best first.

    Of models with more effects than the preferred one the best is shown: what one more would be good for.
    """
    every = sorted([field.base, *field.models], key=field.criterion)
    ahead = {m.members: m for m in reversed(every)}  # the same effects may have been fitted from two sides
    each = [m for m in every if ahead[m.members] is m]
    larger = [m.members for m in each if len(m.members) > len(model.members)][1:]
    listed = [m for m in each if m.members not in larger][:RANKED]
    return listed if field.base in listed else [*listed, field.base]


def _cross_validated(field: Field, model: Model) -> dict[int, float]:
    """Return the reduced chi-squared in left-out profiles of a model, its nearest rival and the base, by identity."""
    groups = profiles(field.contest)
    if len(groups) < 2:
        return {}
    rivals = [m for m in field.of_size(len(model.members)) if m.members != model.members]
    tried = [model, *rivals[:1], field.base]
    chi2 = left_out(field.contest, [m.fit for m in tried], groups).sum(1) / field.contest.num_samples
    return {id(m): float(x) for m, x in zip(tried, chi2, strict=True)}


def profiles(contest: Contest) -> list[list[int]]:
    """Return groups of recordings that repeat one experiment."""
    groups: dict[int, list[int]] = {}
    for i, t in enumerate(contest.case.trajectories):
        groups.setdefault(i if t.replicate_of is None else t.replicate_of, []).append(i)
    return list(groups.values())


def left_out(contest: Contest, models: Sequence[Fits], groups: Sequence[Sequence[int]]) -> torch.Tensor:
    """Return the squares left in every profile by models [S] that were refitted without it, shape [S, G]."""
    rows = []
    for model in models:
        for group in groups:
            weight = model.rows.weight.clone()
            weight[:, list(group)] = 0.0
            rows.append(Rows(model.rows.free, model.rows.active, model.rows.start, weight))
    fitted = fit(contest, Rows.joined(rows), REFIT)
    full = Rows(fitted.rows.free, fitted.rows.active, fitted.rows.start, torch.ones_like(fitted.rows.weight))
    residual = contest.residual(full)
    if len(contest.nuisance):
        residual = residual - (fitted.nuisance @ contest.nuisance).view_as(residual)
    by_recording = (residual**2).sum((-1, -2)).view(len(models), len(groups), -1)
    return torch.stack([by_recording[:, g, list(group)].sum(-1) for g, group in enumerate(groups)], 1)
