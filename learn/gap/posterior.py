"""Joint posterior of base and effects, and intervals of the effects' parameters, about the repaired model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ..cases.case import BranchCase
from ..inference.correlated import correlation, sandwich, score_covariance
from ..inference.fit import Modes, climb_until_converged, precision_at
from ..inference.posterior import Posterior, sample
from ..inference.settings import default_iterations
from ..inference.target import Target
from ..systems.branch import Unknowns
from ..systems.system import Parameter
from .decide import NEAR, Decision
from .diagnosis import Bound, Interval
from .models.contest import Batch, Contest
from .models.fitted import QUIET
from .models.refit import evaluated, filled, fit, normal_equations
from .models.simulations import JOINTED
from .run import Run

#: Parameters of each named effect, by its label.
Intervals = dict[str, dict[str, Interval]]
#: Steps of fits to one recording alone.
ALONE = 8


def infer(contest: Contest, decision: Decision, fitted: Batch, train: Sequence[int], run: Run) -> Posterior | None:
    """Infer base and effects together by Stein variational gradient descent, if effects are named and settings ask.

    Args:
        contest: What simulates the models.
        decision: The verdict.
        fitted: The repaired model fitted to the training recordings, a batch of one.
        train: Those recordings: the posterior is of the data that the fit is of.
        run: Settings, checkpoint and progress.
    """
    if decision.verdict != "effects" or not run.settings.particles:
        return None
    with run.timed("posterior"):
        return posterior_of(contest, decision, fitted, train, run)


def posterior_of(contest: Contest, decision: Decision, fitted: Batch, train: Sequence[int], run: Run) -> Posterior:
    """Infer the base's and the effects' parameters of a model together, about its fit.

    The simulator's kernel is that of the search, with the effects outside the model fixed at neutral.
    """
    chosen = [contest.recordings[j] for j in train]
    target = Target(contest.case, chosen, torch.as_tensor(contest.sigma), unknowns=only(contest, fitted))
    target.colour = None if contest.colour is None else contest.colour.of(train)
    start = fitted.start[:, list(train)].flatten(1)
    theta = torch.cat([fitted.free[fitted.active][None], start, target.log_noise0[None]], 1)
    theta = climb_until_converged(target, theta)
    modes = Modes(theta, target.log_density(theta), precision_at(target, theta))
    count = max(run.settings.particles, 2 * target.num_dims)
    return sample(
        target, modes, particles=count, iterations=default_iterations("svgd"), seed=run.settings.seed,
        checkpoint=run.keep, progress=lambda stage, done: run.progress("sampling", done),
        beyond=_beyond(contest.rigid(), decision, fitted, train),
    )  # fmt: skip


def only(contest: Contest, fitted: Batch) -> Unknowns:
    """Return unknowns of which those active in a model, a batch of one, are inferred and all others are neutral.

    A trunk that does not give way is left out: its joints would be simulated with the branch's.
    """
    acting, active = [], fitted.active[0].tolist()
    for candidate in contest.candidates:
        if candidate.name == JOINTED and not any(active[k] for k in candidate.columns):
            continue
        columns = zip(candidate.specs, candidate.columns, strict=True)
        off = {s.name: s.neutral for s, k in columns if not active[k]}
        acting.append(replace(candidate.acting, known={**candidate.acting.known, **off}) if off else candidate.acting)
    return Unknowns(effects=tuple(acting))


def intervals(
    contest: Contest, decision: Decision, fitted: Batch, train: Sequence[int], posterior: Posterior | None
) -> Intervals:
    """Return medians and 95 % intervals of the named effects' parameters, by the posterior or the curvature at the fit.

    Medians are the repaired model's values. No end of an interval is outside its parameter's box. What does nothing and
    was not fitted has none.
    """
    if decision.verdict != "effects":
        return {}
    widths = {} if posterior is not None else _deviations(contest.rigid(), decision, fitted, train)
    values = [] if posterior is not None else contest.values(fitted)[0].tolist()
    ends = {} if posterior is None else _rows(posterior)
    out: Intervals = {}
    for c in decision.model.members:
        candidate = contest.candidates[c]
        own = out.setdefault(candidate.acting.label, {})
        columns = zip(candidate.specs, candidate.columns, strict=True)
        for spec, k in ((s, k) for s, k in columns if fitted.active[0, k]):
            p, free = contest.parameters[k], float(fitted.free[0, k])
            row = ends[p.name] if ends else _by_curvature(p, values[k], free, widths[k])
            own[spec.name] = Interval(*_boxed(p, row), p.unit, at_bound(p, free, row))
    return out


def _rows(posterior: Posterior) -> dict[str, tuple[float, float, float]]:
    columns = (x.tolist() for x in posterior.interval())
    return {n: (m, a, b) for n, m, a, b in zip(posterior.names, *columns, strict=True)}


def _by_curvature(p: Parameter, value: float, free: float, spread: float) -> tuple[float, float, float]:
    """Return value and ends of an interval."""
    low, high = (float(np.exp(x)) if p.scale == "log" else x for x in (free - 1.96 * spread, free + 1.96 * spread))
    return value, low, high


def _boxed(p: Parameter, row: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a median and ends of an interval inside a parameter's box: beyond its ends there is nothing to be told.

    Particles of a parameter on a logarithmic scale may leave it, such as of a bend that may be anything.
    """
    middle, low, high = row
    return middle, min(middle, max(low, p.low)), max(middle, min(high, p.high))


def at_bound(p: Parameter, free: float, row: tuple[float, float, float]) -> Bound:
    """Return the end of its box that a parameter is at.

    Its median is there to within `NEAR` of the box, or its fit is and its interval is in that half of the box.

    Args:
        p: The parameter.
        free: Its free coordinate in the fit.
        row: Median and ends of its interval.
    """
    low, high = p.free(p.low), p.free(p.high)
    middle, *ends = ((p.free(x) - low) / (high - low) for x in row)
    if middle <= NEAR or (free <= low and ends[1] < 0.5):
        return "low"
    return "high" if middle >= 1.0 - NEAR or (free >= high and ends[0] > 0.5) else None


def _deviations(contest: Contest, decision: Decision, fitted: Batch, train: Sequence[int]) -> dict[int, float]:
    """Return the standard deviation of each active free coordinate at the fit, by parameter index.

    By the curvature there and the residuals' size and correlation (`inference.correlated`); at joints also by what the
    recordings say apart, where the model is not quite right, by what is not named, and by how they are replayed.
    """
    residual, derivative, columns = contest.linearise(fitted)
    normal, _ = normal_equations(contest, fitted, residual, derivative, columns)
    rows, used = derivative[0][:, list(train)], int((normal[0].diagonal() > 0.0).sum())
    seen = correlation(residual[0][list(train)], [len(contest.recordings[j].t) for j in train], used)
    curvature = rows.flatten(1) @ rows.flatten(1).T
    spread = sandwich(filled(normal[0]), curvature, score_covariance(seen, rows)).diagonal().sqrt()
    spread = spread[: columns.shape[1]].hypot(_beyond(contest, decision, fitted, train))
    return {int(c): float(s) for c, s in zip(columns[0], spread, strict=True) if c >= 0}


def _beyond(contest: Contest, decision: Decision, fitted: Batch, train: Sequence[int]) -> torch.Tensor:
    """Return the deviations of the active free coordinates that neither noise nor correlation explains, shape [q]."""
    own = _apart(contest, fitted, train).hypot(_simulated(contest, decision, fitted))
    return own.hypot(_otherwise(decision, fitted))


def _otherwise(decision: Decision, fitted: Batch) -> torch.Tensor:
    """Return by how much the active free coordinates differ beside one effect more that is not named, shape [q]."""
    active = fitted.active[0]
    if decision.further is None:
        return fitted.free.new_zeros(int(active.sum()))
    return (decision.further.fit.batch.free - decision.final.fit.batch.free)[0, active].abs()


def _simulated(contest: Contest, decision: Decision, fitted: Batch) -> torch.Tensor:
    """Return the error of the active free coordinates by how joints are replayed; zero where they are not. Shape [q].

    Twice the change that half the step makes: laws such as friction are of first order in the step. Beside a delay also
    what the force does between samples, where one that is late is looked up on a line; one that is smooth differs by an
    eighth of its second difference at most (de Boor 2001, A Practical Guide to Splines, II).
    """
    active = fitted.active[0]
    if not fitted.start.numel():
        return fitted.free.new_zeros(int(active.sum()))
    own = fit(contest, fitted, ALONE).batch.free
    fine = fit(contest.finely(), fitted, ALONE).batch.free
    error = 2.0 * (fine - own)[0, active].abs()
    if not any(contest.candidates[c].law.kind == "time_delay" for c in decision.model.members):
        return error
    return error.hypot((fit(contest.smoothly(), fitted, ALONE).batch.free - own)[0, active].abs())


def _apart(contest: Contest, fitted: Batch, train: Sequence[int]) -> torch.Tensor:
    """Return by how much the active free coordinates differ from recording to recording, beyond what noise explains.

    A law of a slightly other form has another best value at every amplitude. What is left of it follows the motion, so
    that no correlation of the residuals tells how far the value is from the truth; fits to each recording alone do.
    The deviation between recordings is that of DerSimonian and Laird (1986, Controlled Clinical Trials 7:177): each
    counts by the inverse of its own variance, so that one which says little does not widen what the others say. Zero
    for branches, for a single recording, and where the residuals are no larger than noise. Shape [q].
    """
    batch = fitted[torch.zeros(len(train), dtype=torch.long, device=contest.place)]
    batch.weight = torch.zeros_like(batch.weight)
    batch.weight[range(len(train)), list(train)] = 1.0
    samples = sum(contest.recordings[j].output.size for j in train)
    count = int(fitted.active[0].sum())
    left = float(evaluated(contest, fitted).chi2[0]) / samples
    if isinstance(contest.case, BranchCase) or len(train) < 2 or left <= QUIET:
        return batch.free.new_zeros(count)
    fits = fit(contest, batch, ALONE)
    residual, derivative, columns = contest.linearise(fits.batch)
    normal, _ = normal_equations(contest, fits.batch, residual, derivative, columns)
    size = (fits.chi2 * len(train) / samples).clamp(min=1.0)
    noise = torch.stack([torch.linalg.inv(filled(n)).diagonal()[:count] for n in normal]) * size[:, None]
    weight, values = 1.0 / noise.clamp(min=1e-12), fits.batch.free[:, fitted.active[0]]
    whole = weight.sum(0)
    apart = (weight * (values - (weight * values).sum(0) / whole) ** 2).sum(0) - (len(train) - 1)
    return (apart / (whole - (weight**2).sum(0) / whole)).clamp(min=0.0).sqrt()
