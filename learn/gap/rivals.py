"""Ranking of the fitted models, and cross-validation of the leading ones."""

from __future__ import annotations

from dataclasses import replace

from .decide import Decision
from .diagnosis import Rival
from .models.fitted import FittedModels, Model
from .models.left_out import left_out_chi2, profiles

#: Models in the ranking.
RANKED = 12


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


def ahead(fitted: FittedModels, model: Model, ranking: tuple[Rival, ...]) -> tuple[Rival, ...]:
    """Return a ranking with a model before the others, by the chi-squared that it leaves, not cross-validated."""
    first = Rival(fitted.labels(model), fitted.reduced_chi2(model), 0.0, fitted.explained(model))
    more = (ranking[0].reduced_chi2 - first.reduced_chi2) * fitted.contest.num_samples
    return (first, *(replace(own, delta=own.delta + more) for own in ranking))


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
    chi2 = left_out_chi2(fitted.contest, tried, groups).sum(1) / fitted.contest.num_samples
    return {id(m): float(x) for m, x in zip(tried, chi2, strict=True)}
