"""Nested models: none that was fitted may leave more than one that it contains.

A model contains another if the other's effects are among its own: with the further effects at their neutral values it
is the other model. A fit that ended in a local minimum can nevertheless leave more. The guarantee is about chi-squared
as it is reported, without prior terms, of all fitted models under one noise model: each is fitted again from the models
that it contains, and where it still leaves more, it is the contained model with the further effects off (it *rests*).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from .candidates import Candidate, passes_neutral
from .contest import Batch, Contest
from .fitted import FittedModels, Model, overdispersion, penalty
from .refit import Fits, evaluated, fit

#: Steps of the base's fits from all models, how many go on, and for how many steps.
FEW, AHEAD, FURTHER = 2, 2, 10
#: Steps of a fit from a contained model; how many of those that then leave less go on, and for how many steps.
AGAIN, LEADING, MORE = 3, 4, 12


def switches(contest: Contest, candidate: Candidate) -> tuple[int, ...]:
    """Return the columns of the parameters that switch an effect on: it is off where all of them are neutral.

    They are those that the registry names, or the amplitudes, which may have either sign, or else the first parameter.
    """
    named = candidate.law.strengths
    if named:
        return tuple(c for c, s in zip(candidate.columns, candidate.specs, strict=True) if s.name in named)
    through = [c for c, s in zip(candidate.columns, candidate.specs, strict=True)
               if passes_neutral(s, contest.parameters[c])]  # fmt: skip
    return tuple(through) if through and through[0] == candidate.columns[0] else candidate.columns[:1]


def neutral_of(contest: Contest, column: int) -> float:
    """Return the free coordinate nearest to a parameter's neutral value that is inside its box."""
    parameter, value = contest.parameters[column], float(contest.neutral[column])
    return parameter.free(min(max(value, parameter.low), parameter.high))


def rebased(contest: Contest, base: Model, models: Sequence[Model]) -> Model:
    """Return the base refitted from the springs and start states of every model, their effects off; the best of all."""
    starts = Batch.joined([m.fit.batch for m in (base, *models)]).copy()
    starts.active[:, contest.num_base :] = False
    few = fit(contest, starts, FEW)
    ahead = few.batch[few.cost.argsort()[:AHEAD]]
    every = Fits.joined([evaluated(contest, base.fit.batch), few, fit(contest, ahead, FURTHER)])
    return Model((), every.one(int(every.cost.argmin())), True)


def from_contained(contest: Contest, model: Model, inner: Model) -> Batch:
    """Return the start point of a model at a contained one: further effects neutral, or as nearly as their box allows.

    Where neutral values are inside the boxes, chi-squared there is that of the contained model.
    """
    out = inner.fit.batch.copy()
    for c in set(model.members) - set(inner.members):
        candidate = contest.candidates[c]
        own = list(candidate.columns)
        out.active[:, own] = True
        out.free[:, own] = torch.minimum(torch.maximum(model.fit.batch.free[:, own], contest.low[own]),
                                         contest.high[own])  # fmt: skip
        for column in switches(contest, candidate):
            out.free[:, column] = neutral_of(contest, column)
    return out


def fitted_again(fitted: FittedModels, size: int, *, every: bool = False) -> None:
    """Fit models of a size from the models with one effect less that they contain, and keep what leaves less.

    Those do that leave more than the contained model; with ``every`` all that were fitted to the last round. A few that
    are worth their effect after the first steps go on.
    """
    contest = fitted.contest
    pairs = [(m, inner) for m in fitted.models if len(m.members) == size for inner in fitted.contained(m)
             if len(inner.members) == size - 1 and (m.chi2 > inner.chi2 or (every and m.settled))]  # fmt: skip
    if not pairs:
        return
    fits = fit(contest, Batch.joined([from_contained(contest, m, inner) for m, inner in pairs]), AGAIN)
    ahead: dict[tuple[int, ...], int] = {}
    for s in fits.cost.argsort(descending=True).tolist():
        m, inner = pairs[s]
        if float(fits.cost[s]) < m.cost:
            m.fit = fits.one(s)
        if m.fit.cost == fits.cost[s] and m.cost + contest.overdispersion * penalty(contest, m.members) < inner.cost:
            ahead[m.members] = s
    chosen = list(ahead.values())[-LEADING:]
    if chosen:
        more = fit(contest, fits.batch[torch.tensor(chosen, device=contest.place)], MORE)
        for k, s in enumerate(chosen):
            pairs[s][0].fit = more.one(k)


def close(fitted: FittedModels) -> None:
    """Make the guarantee hold: all models under the present noise model, each no worse than those that it contains.

    Of models with the same effects the best is kept.
    """
    contest = fitted.contest
    contest.overdispersion = overdispersion(contest, fitted.best.chi2)
    every = [fitted.base, *fitted.models]
    fits = evaluated(contest, Batch.joined([m.fit.batch for m in every]))
    for s, m in enumerate(every):
        m.fit = fits.one(s)
    kept: dict[tuple[int, ...], Model] = {}
    for m in sorted(fitted.models, key=lambda m: (m.cost, not m.settled)):
        kept.setdefault(m.members, m)
    fitted.models = sorted(kept.values(), key=lambda m: len(m.members))
    for m in fitted.models:
        best = min(fitted.contained(m), key=lambda inner: inner.chi2)
        if m.chi2 > best.chi2:
            m.fit, m.rests = best.fit, True
