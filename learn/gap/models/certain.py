"""Whether an effect is on for certain: whether the interval of its strength keeps away from the neutral value."""

from __future__ import annotations

import torch
from scipy.stats import chi2

from .contest import Contest
from .fitted import QUIET, FittedModels, Model, overdispersion
from .nested import switches
from .refit import filled, normal_equations

#: Probability of the interval.
CONFIDENCE = 0.95
#: Probability of the interval by the likelihood, which a search of minima gives: wider by as much as it is less sure.
SURE = 1.0 - 1e-6


def covariance(contest: Contest, model: Model) -> tuple[torch.Tensor, list[int]]:
    """Return the covariance [q, q] of a model's active free coordinates by the curvature at the fit, and their columns.

    It is that of noise as large as what the model leaves, with start states and nuisance columns free.
    """
    residual, derivative, columns = contest.linearise(model.fit.batch)
    normal, _ = normal_equations(contest, model.fit.batch, residual, derivative, columns)
    own = [int(c) for c in columns[0] if c >= 0]
    spread = torch.linalg.inv(filled(normal[0]) / overdispersion(contest, model.chi2))
    return spread[: len(own), : len(own)], own


def doubtful(fitted: FittedModels, model: Model) -> tuple[int, ...]:
    """Return the effects of a model that may as well be off, as indices of candidates.

    Curvature misleads where a strength stands beside others that act only with it: a slip whose yield force and share
    of flow are free, too. A model that leaves noise alone is right without one, so an effect is on for certain if the
    model with that effect off, all else fitted anew, is outside the interval by the likelihood (Wilks 1938).
    """
    off = uncertain(fitted.contest, model)
    if fitted.reduced_chi2(model) > QUIET or model.rests:
        return off
    return tuple(c for c in off if not _needed(fitted, model, c))


def _needed(fitted: FittedModels, model: Model, member: int) -> bool:
    """Return whether a model without one of its effects is outside the interval by the likelihood."""
    others = set(model.members) - {member}
    without = [m for m in fitted.contained(model) if set(m.members) == others]
    freedom = len(fitted.contest.candidates[member].columns)
    gained = min((m.chi2 for m in without), default=model.chi2) - model.chi2
    return gained / overdispersion(fitted.contest, model.chi2) > float(chi2.ppf(SURE, freedom))


def uncertain(contest: Contest, model: Model) -> tuple[int, ...]:
    """Return the effects of a model whose strength may as well be neutral by the curvature, as indices of candidates.

    Several strengths are neutral together, so the joint interval of their values counts. A single one on a logarithmic
    scale is neutral at zero, which an interval of the value touches that is as wide as the value. Of any other, neutral
    is the end of its box that is next to it.
    """
    if model.rests:
        return model.members
    spread, columns = covariance(contest, model)
    return tuple(c for c in model.members if _touches(contest, model, c, spread, columns))


def _touches(contest: Contest, model: Model, member: int, spread: torch.Tensor, columns: list[int]) -> bool:
    own = list(switches(contest, contest.candidates[member]))
    at = [columns.index(c) for c in own]
    free, part = model.fit.batch.free[0, own], spread[at][:, at]
    parameter, neutral = contest.parameters[own[0]], float(contest.neutral[own[0]])
    if parameter.low < neutral < parameter.high:
        off = torch.tensor([contest.parameters[c].free(float(contest.neutral[c])) for c in own]).to(free)
        return _within(free - off, part)
    if len(own) > 1:  # to first order a value on a logarithmic scale moves by itself times its free coordinate
        value = contest.values(model.fit.batch)[0, own]
        slope = torch.tensor([contest.parameters[c].scale == "log" for c in own]).to(value.device)
        slope = torch.where(slope, value, torch.ones_like(value))
        return _within(value - contest.neutral[own], part * slope[:, None] * slope)
    reach = float(chi2.ppf(CONFIDENCE, 1)) ** 0.5 * float(part[0, 0].clamp(min=0.0)) ** 0.5
    if parameter.scale == "log":  # to first order the motion follows the value, whose interval is its share
        return reach >= 1.0
    low, high = float(contest.low[own[0]]), float(contest.high[own[0]])
    return float(free[0]) - reach <= low if neutral <= parameter.low else float(free[0]) + reach >= high


def _within(apart: torch.Tensor, spread: torch.Tensor) -> bool:
    """Return whether numbers may as well all be zero, from their covariance."""
    return distance(apart, spread) < float(chi2.ppf(CONFIDENCE, len(apart)))


def distance(apart: torch.Tensor, spread: torch.Tensor) -> float:
    """Return how far numbers [q] are from zero in deviations squared, from their covariance [q, q]."""
    return float(apart @ torch.linalg.lstsq(spread, apart[:, None]).solution[:, 0])
