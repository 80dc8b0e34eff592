"""Parameters that do nothing: what a model saves without them.

The information criterion charges every parameter of a model's effects. One that only refines a law (`optional` in the
registry) and may as well be neutral is not needed: without it the model leaves z^2 more and costs log(N) less, by the
curvature at the fit (Wald 1943, Trans. Am. Math. Soc. 54:426). The best of the models without some of them counts, so
that a law is not the worse for forms that it need not have.

A model of joints that is named is fitted without them: a friction that may grow towards rest says little of its size,
and particles that wander where nothing changes say nothing. Of torques it is also fitted without those that do not pay
on recordings left out: where a law is not quite right they follow one recording's peculiarity, and take a part of the
law's size with them. (Of a replay the recordings left out have no start of their own.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from ...cases.case import BranchCase
from ...replay.equation_error import fits_torque
from .certain import covariance, distance
from .contest import Contest
from .fitted import FURTHER, FittedModels, Model, price
from .left_out import left_out_chi2, profiles
from .nested import neutral_of
from .refit import fit

#: Steps of a fit without parameters that do nothing.
WITHOUT = 12
#: Fewest experiments of which one is left out in turn: from one or two no law's form can be foretold.
LEFT_OUT = 3
#: Most effects of a model whose parameters are left out one by one.
FEW = 2


@dataclass(frozen=True)
class Optional:
    """A parameter of a model that may be left out.

    Attributes:
        column: Its place among all parameters.
        price: What the criterion charges it.
    """

    column: int
    price: float


def spare(fitted: FittedModels) -> None:
    """Set what models save that may be among the best, see `Model.idle`."""
    contest = fitted.contest
    for m in fitted.models:
        m.idle = 0.0
    least = min((fitted.criterion(m) for m in fitted.models), default=0.0)
    for m in fitted.models:
        own = optional(contest, m)
        if own and not m.rests and fitted.criterion(m) - sum(x.price for x in own) < least + FURTHER:
            m.idle = saved(contest, m, own)[0]


def lean(fitted: FittedModels, model: Model) -> Model:
    """Return a model of joints without the parameters that do nothing or do not pay, fitted without them.

    The model itself where there are none, and for branches.
    """
    if isinstance(fitted.contest.case, BranchCase) or model.rests:
        return model
    needed = _needed(fitted, model)
    return _paying(fitted, needed) if fits_torque(fitted.contest.case) else needed


def _needed(fitted: FittedModels, model: Model) -> Model:
    """Return a model without the parameters that may as well be neutral.

    The model itself where it leaves more without them than they cost. Without one of them another may do nothing
    either, such as the rate towards which friction grows that does not.
    """
    own = optional(fitted.contest, model)
    gone = saved(fitted.contest, model, own)[1] if own else []
    if not gone:
        return model
    less = _without(fitted.contest, model, gone)
    more = (less.cost - model.cost) / fitted.overdispersion
    return model if more > sum(x.price for x in gone) else _needed(fitted, less)


def _paying(fitted: FittedModels, model: Model) -> Model:
    """Return a model without the parameters without which it predicts recordings left out no worse, one by one.

    No worse to one unit of chi-squared, far more than where a fit stops: what does nothing must not stay by rounding.
    One law at many joints keeps its own: they are too many to be tried so.
    """
    contest, groups = fitted.contest, profiles(fitted.contest)
    own = [x for x in optional(contest, model) if bool(model.fit.batch.active[0, x.column])]
    if not own or len(groups) < LEFT_OUT or len(model.members) > FEW:
        return model
    less = [_without(contest, model, [x]) for x in own]
    left = left_out_chi2(contest, [model, *less], groups).sum(1)
    best = int(left[1:].argmin())
    return model if left[1 + best] - left[0] > fitted.overdispersion else _paying(fitted, less[best])


def _without(contest: Contest, model: Model, gone: Sequence[Optional]) -> Model:
    """Return a model fitted without parameters."""
    batch = model.fit.batch.copy()
    batch.active[:, [x.column for x in gone]] = False
    return replace(model, fit=fit(contest, batch, WITHOUT), idle=0.0)


def optional(contest: Contest, model: Model) -> list[Optional]:
    """Return the parameters of a model's effects that may be left out."""
    chosen = (contest.candidates[c] for c in model.members)
    return [Optional(k, price(contest, s)) for x in chosen for k, s in zip(x.columns, x.specs, strict=True)
            if s.optional]  # fmt: skip


def saved(contest: Contest, model: Model, own: Sequence[Optional]) -> tuple[float, list[Optional]]:
    """Return what a model saves without those of its parameters that may as well be neutral, and which these are."""
    spread, columns = covariance(contest, model)
    left, best = [x for x in own if x.column in columns], 0.0
    out: list[Optional] = []
    while left:
        gains = [sum(y.price for y in (*out, x)) - _left_more(contest, model, spread, columns, [*out, x]) for x in left]
        k = max(range(len(left)), key=gains.__getitem__)
        if gains[k] <= best:
            break
        best = gains[k]
        out.append(left.pop(k))
    return best, out


def _left_more(
    contest: Contest, model: Model, spread: torch.Tensor, columns: list[int], chosen: Sequence[Optional]
) -> float:
    """Return what a model leaves more without parameters, in deviations squared: how far they are from neutral.

    Their priors are part of the curvature, and are no more counted once they are left out.
    """
    at, own = [columns.index(x.column) for x in chosen], [x.column for x in chosen]
    neutral = model.fit.batch.free.new_tensor([neutral_of(contest, c) for c in own])
    apart = model.fit.batch.free[0, own] - neutral
    prior = (((neutral - contest.centre[own]) / contest.spread[own]) ** 2).sum()
    return distance(apart, spread[at][:, at]) - float(prior)
