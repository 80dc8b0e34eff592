"""Whether an effect is on for certain: whether the interval of its strength keeps away from the neutral value."""

from __future__ import annotations

import torch
from scipy.stats import chi2

from .contest import Contest
from .fitted import Model, overdispersion
from .nested import switches
from .refit import filled, normal_equations

#: Probability of the interval.
CONFIDENCE = 0.95


def covariance(contest: Contest, model: Model) -> tuple[torch.Tensor, list[int]]:
    """Return the covariance [q, q] of a model's active free coordinates by the curvature at the fit, and their columns.

    It is that of noise as large as what the model leaves, with start states and nuisance columns free.
    """
    residual, derivative, columns = contest.linearise(model.fit.batch)
    normal, _ = normal_equations(contest, model.fit.batch, residual, derivative, columns)
    own = [int(c) for c in columns[0] if c >= 0]
    spread = torch.linalg.inv(filled(normal[0]) / overdispersion(contest, model.chi2))
    return spread[: len(own), : len(own)], own


def uncertain(contest: Contest, model: Model) -> tuple[int, ...]:
    """Return the effects of a model whose strength may as well be neutral, as indices of candidates.

    Strengths of either sign are neutral together, so their joint interval counts. One that is positive on a logarithmic
    scale is never neutral; its interval then touches the end of its box that is next to neutral.
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
        apart = float((free - off) @ torch.linalg.lstsq(part, (free - off)[:, None]).solution[:, 0])
        return apart < float(chi2.ppf(CONFIDENCE, len(own)))
    reach = float(chi2.ppf(CONFIDENCE, 1)) ** 0.5 * float(part[0, 0].clamp(min=0.0)) ** 0.5
    low, high = float(contest.low[own[0]]), float(contest.high[own[0]])
    return float(free[0]) - reach <= low if neutral <= parameter.low else float(free[0]) + reach >= high
