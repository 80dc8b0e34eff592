"""Joint posterior of base and effects, and intervals of the effects' parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ..inference.fit import Modes, climb_until_converged, precision_at
from ..inference.posterior import Posterior, sample
from ..inference.settings import default_iterations
from ..inference.target import Target
from ..systems.branch import Unknowns
from ..systems.system import Parameter
from .decide import Decision
from .diagnosis import Interval
from .models.contest import Contest
from .models.fitted import FittedModels, Model, overdispersion
from .models.refit import normal_equations
from .run import Run

#: Parameters of each named effect, by its label.
Intervals = dict[str, dict[str, Interval]]


def infer(fitted: FittedModels, decision: Decision, run: Run) -> Posterior | None:
    """Infer base and effects together by Stein variational gradient descent, if effects are named and settings ask."""
    if decision.verdict != "effects" or not run.settings.particles:
        return None
    with run.timed("posterior"):
        return posterior_of(fitted.contest, decision.model, run)


def posterior_of(contest: Contest, model: Model, run: Run) -> Posterior:
    """Infer the base's and the effects' parameters of a model together, about its fit.

    The simulator's kernel is that of the search, with the effects outside the model fixed at neutral.
    """
    target = Target(contest.case, contest.recordings, torch.as_tensor(contest.sigma), unknowns=only(contest, model))
    target.colour = contest.colour
    batch = model.fit.batch
    theta = torch.cat([batch.free[batch.active][None], batch.start.flatten(1), target.log_noise0[None]], 1)
    theta = climb_until_converged(target, theta)
    modes = Modes(theta, target.log_density(theta), precision_at(target, theta))
    count = max(run.settings.particles, 2 * target.num_dims)
    return sample(
        target, modes, particles=count, iterations=default_iterations("svgd"), seed=run.settings.seed,
        checkpoint=run.keep, progress=lambda stage, done: run.progress("sampling", done),
    )  # fmt: skip


def only(contest: Contest, model: Model) -> Unknowns:
    """Return unknowns in which a model's effects are inferred and all other candidates are off."""
    acting = []
    for c, candidate in enumerate(contest.candidates):
        off = {s.name: s.neutral for s in candidate.specs}
        acting.append(candidate.acting if c in model.members else replace(candidate.acting, known=off))
    return Unknowns(effects=tuple(acting))


def intervals(fitted: FittedModels, decision: Decision, posterior: Posterior | None) -> Intervals:
    """Return medians and 95 % intervals of the named effects' parameters, by the posterior or the curvature at the fit.

    Intervals are clipped to the parameters' boxes.
    """
    if decision.verdict != "effects":
        return {}
    if posterior is None:
        return _by_curvature(fitted.contest, decision.model)
    return _by_posterior(fitted.contest, decision.model, posterior)


def _by_posterior(contest: Contest, model: Model, posterior: Posterior) -> Intervals:
    ends = zip(*posterior.interval(), strict=True)
    found = {p.name: _inside(p, [float(x) for x in row]) for p, row in zip(posterior.parameters, ends, strict=True)}
    own = [contest.candidates[c] for c in model.members]
    return {c.acting.label: {s.name: found[f"{c.acting.label} {s.name}"] for s in c.specs} for c in own}


def _by_curvature(contest: Contest, model: Model) -> Intervals:
    batch, width = model.fit.batch, _deviations(contest, model)
    own = [contest.candidates[c] for c in model.members]
    return {
        candidate.acting.label: {
            spec.name: _interval(contest.parameters[k], float(batch.free[0, k]), width[k])
            for spec, k in zip(candidate.specs, candidate.columns, strict=True)
        }
        for candidate in own
    }


def _deviations(contest: Contest, model: Model) -> dict[int, float]:
    """Return the standard deviation of each active free coordinate by the curvature at the fit, by parameter index."""
    residual, derivative, columns = contest.linearise(model.fit.batch)
    normal, _ = normal_equations(contest, model.fit.batch, residual, derivative, columns)
    diagonal = normal[0].diagonal()
    filled = normal[0] + torch.diag(torch.where(diagonal > 0.0, 0.0, 1.0))
    spread = torch.linalg.inv(filled / overdispersion(contest, model.chi2)).diagonal().clamp(min=0.0).sqrt()
    return {int(c): float(s) for c, s in zip(columns[0], spread, strict=False) if c >= 0}


def _interval(parameter: Parameter, free: float, spread: float) -> Interval:
    ends = [free, free - 1.96 * spread, free + 1.96 * spread]
    return _inside(parameter, [float(np.exp(min(x, 700.0))) if parameter.scale == "log" else x for x in ends])


def _inside(parameter: Parameter, values: Sequence[float]) -> Interval:
    middle, low, high = (min(max(x, parameter.low), parameter.high) for x in values)
    return Interval(middle, low, high, parameter.unit)
