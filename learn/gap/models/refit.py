"""Levenberg-Marquardt fits of a batch of models, with one damping factor per model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from .contest import NARROW, NARROWEST, STEP, Batch, Contest, prior_of
from .nuisance import Nuisances

#: Models whose derivatives are held in memory at once.
TOGETHER = 24
#: Initial damping.
DAMPING = 1e-3
#: Damping at which wide finite differences are given up for narrower ones, after five steps in a row that went astray:
#: in a curved valley they miss the slope; and at which a fit with the narrowest is.
ASTRAY, STUCK = 20.0, 1e6
#: Largest step of a free coordinate, relative to its reach.
LONGEST = 1.0
#: Most passes of the solution of one bounded problem; two to five settle it.
PASSES = 12


@dataclass
class Fits:
    """A batch of models and how well they fit.

    Attributes:
        batch: The models.
        chi2: Sum of squared whitened residuals after the nuisance columns are fitted, plus the squares of their
            coefficients' deviations from the prior's means, shape [S]: chi-squared of the covariance that has both.
        cost: Chi-squared plus prior terms, times the overdispersion, the objective, shape [S].
        nuisance: Coefficients of the nuisance columns, shape [S, m].
        damping: Damping of the next step, shape [S].
    """

    batch: Batch
    chi2: torch.Tensor
    cost: torch.Tensor
    nuisance: torch.Tensor
    damping: torch.Tensor

    def __getitem__(self, index: torch.Tensor) -> Fits:
        return Fits(self.batch[index], self.chi2[index], self.cost[index], self.nuisance[index], self.damping[index])

    def one(self, s: int) -> Fits:
        """Return one model's fit."""
        return self[torch.tensor([s], device=self.chi2.device)]

    def __len__(self) -> int:
        return len(self.chi2)

    @staticmethod
    def joined(parts: list[Fits]) -> Fits:
        """Return several fits as one."""
        return Fits(
            Batch.joined([p.batch for p in parts]),
            *(torch.cat([getattr(p, k) for p in parts]) for k in ("chi2", "cost", "nuisance", "damping")),
        )


def fit(contest: Contest, batch: Batch, iterations: int, progress: Callable[[int], None] = lambda _: None) -> Fits:
    """Fit each model independently with at most ``iterations`` steps."""
    parts = []
    for k in range(0, len(batch), TOGETHER):
        parts.append(_fit(contest, batch[slice(k, k + TOGETHER)], iterations))
        progress(1)
    return Fits.joined(parts)


def _fit(contest: Contest, batch: Batch, iterations: int) -> Fits:
    """Fit with wide finite-difference steps; each model that has converged goes on with narrow ones.

    Phases of joints drift over many swings, so that their derivatives need narrower ones still.
    """
    contest = contest.remembering()
    fits = evaluated(contest, batch)
    steps, last = torch.full_like(fits.cost, STEP), NARROWEST if batch.start.numel() else NARROW
    for _ in range(iterations):
        residual, derivative, columns = contest.linearise(fits.batch, steps)
        moved = _step(contest, fits, residual, derivative, columns)
        trial = evaluated(contest, moved)
        better = trial.cost < fits.cost
        settled = better & (fits.cost - trial.cost < 1e-4 * fits.cost.clamp(min=1.0))
        fits = _where(better, trial, fits)
        settled |= fits.damping > torch.where(steps > 1.01 * last, ASTRAY, STUCK)
        if bool((settled & (steps < 1.01 * last)).all()):
            break
        fits.damping = torch.where(settled & (steps > 1.01 * last), DAMPING, fits.damping)
        steps = torch.where(settled, (steps * NARROW / STEP).clamp(min=last), steps)
    return fits


def evaluated(contest: Contest, batch: Batch) -> Fits:
    """Return a batch with its chi-squared, without a step."""
    residual = contest.residual(batch).flatten(1)
    nuisance, left, away = _absorbed(contest, residual, batch)
    cost = left + contest.overdispersion * away + prior_of(contest, batch)
    return Fits(batch, left + away, cost, nuisance, torch.full_like(cost, DAMPING))


def _absorbed(
    contest: Contest, residual: torch.Tensor, batch: Batch
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Best coefficients of nuisance columns [S, m], what they leave [S], and their squared distance from the means."""
    own, od = contest.nuisance, contest.overdispersion
    if not len(own):
        return residual.new_zeros(len(residual), 0), (residual**2).sum(1), residual.new_zeros(len(residual))
    found = _coefficients(own, od, residual, batch)[0]
    left = residual - own.change(found, batch.weight)
    return found, (left**2).sum(1), ((found - own.mean) ** 2).sum(1)


def _coefficients(
    own: Nuisances, od: float, residual: torch.Tensor, batch: Batch
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return the best coefficients [S, M] for residuals [S, N], their precision [S, M, M] and its product with them.

    That product is of the best coefficients without bounds.
    """
    pull = own.along(residual[:, None], batch.weight)[:, 0] + od * own.mean
    precision = own.precision(batch.weight, od)
    low, high = (x.expand_as(pull) for x in (own.low, own.high))
    return bounded(precision, pull, low, high), precision, pull


def _step(
    contest: Contest, fits: Fits, residual: torch.Tensor, derivative: torch.Tensor, columns: torch.Tensor
) -> Batch:
    """Return a batch after a damped Gauss-Newton step, inside the box and within each coordinate's reach."""
    batch = fits.batch
    normal, pull = normal_equations(contest, batch, residual, derivative, columns)
    diagonal = normal.diagonal(dim1=1, dim2=2)
    empty = diagonal <= 0.0
    damped = normal + torch.diag_embed(torch.where(empty, 1.0, diagonal * fits.damping[:, None]))
    used, at, most = columns >= 0, columns.clamp(min=0), columns.shape[1]
    low, high = (torch.full_like(pull, x) for x in (-torch.inf, torch.inf))
    here, longest = torch.gather(batch.free, 1, at), LONGEST * contest.reach[at]
    low[:, :most] = torch.maximum(contest.low[at] - here, -longest)
    high[:, :most] = torch.minimum(contest.high[at] - here, longest)
    step = bounded(damped, pull, low, high)
    free = batch.free.scatter_add(1, at, torch.where(used, step[:, :most], 0.0))
    local = step[:, most : derivative.shape[1]]
    start = batch.start + local.view_as(batch.start) if local.shape[1] else batch.start
    return Batch(free, batch.active, start, batch.weight)


def bounded(matrix: torch.Tensor, right: torch.Tensor, low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
    """Return the x [S, p] between ``low`` and ``high`` at which ``x' matrix x / 2 - right' x`` is least.

    By block principal pivoting (Júdice and Pires 1994, Computers & Operations Research 21:587): entries that leave
    their bounds are held there, those that the slope pulls back inside are let go, the others are solved for. Clipping
    alone would spoil the others; shortening the whole step would stop a fit at the first bound it touches. Pivoting may
    go round in circles; the least of what it visited is returned.
    """
    at_low, at_high = (torch.zeros_like(right, dtype=torch.bool) for _ in range(2))
    best, least = torch.zeros_like(right), torch.full_like(right[:, 0], torch.inf)
    for _ in range(PASSES):
        exact = _solved(matrix, right, torch.where(at_low, low, high), at_low | at_high)
        x = torch.maximum(torch.minimum(exact, high), low)
        value = (x * (0.5 * (matrix @ x[..., None])[..., 0] - right)).sum(1)
        best, least = torch.where((value < least)[:, None], x, best), torch.minimum(value, least)
        slope = (matrix @ exact[..., None])[..., 0] - right
        free = ~(at_low | at_high)
        now_low = torch.where(free, exact < low, at_low & (slope > 0.0))
        now_high = torch.where(free, exact > high, at_high & (slope < 0.0))
        if bool(((now_low == at_low) & (now_high == at_high)).all()):
            break
        at_low, at_high = now_low, now_high
    return best


def _solved(matrix: torch.Tensor, right: torch.Tensor, at: torch.Tensor, held: torch.Tensor) -> torch.Tensor:
    """Solve ``matrix x = right`` [S, p] for the entries that are not held; the held ones are ``at``."""
    known = torch.where(held, at, 0.0)
    rest = torch.where(held, at, right - (matrix @ known[..., None])[..., 0])
    return torch.nan_to_num(torch.linalg.solve(_without(matrix, held), rest[..., None])[..., 0])


def _without(matrix: torch.Tensor, held: torch.Tensor) -> torch.Tensor:
    """Return matrices [S, p, p] with the rows and columns of the entries that are held [S, p] from the identity."""
    return torch.where(held[:, :, None] | held[:, None], torch.diag_embed(held.to(matrix)), matrix)


def normal_equations(
    contest: Contest, batch: Batch, residual: torch.Tensor, derivative: torch.Tensor, columns: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return Gauss-Newton matrix [S, p, p] and right-hand side [S, p], coefficients of nuisance columns eliminated."""
    flat, r = derivative.flatten(2), residual.flatten(1)
    normal = flat @ flat.transpose(1, 2)
    pull = (flat @ r[..., None])[..., 0]
    at = columns.clamp(min=0)
    used = columns >= 0
    precision = torch.where(used, contest.overdispersion * contest.spread[at] ** -2, 0.0)
    lean = torch.where(used, (contest.centre[at] - torch.gather(batch.free, 1, at)) * precision, 0.0)
    extra = torch.zeros_like(pull)
    extra[:, : columns.shape[1]] = precision
    pull[:, : columns.shape[1]] += lean
    if len(contest.nuisance):
        less, away = _eliminated(contest, batch, flat, r)
        normal, pull = normal - less, pull - away
    return normal + torch.diag_embed(extra), pull


def _eliminated(
    contest: Contest, batch: Batch, flat: torch.Tensor, r: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return what nuisance columns take from the normal matrix [S, p, p] and the right-hand side [S, p] (Schur).

    Coefficients at their bounds stay there: they take their part of the residual, and nothing of the matrix.
    """
    own = contest.nuisance
    found, precision, pull = _coefficients(own, contest.overdispersion, r, batch)
    held = own.held(found)
    fixed = torch.where(held, found, 0.0)
    mixed = own.along(flat, batch.weight)
    loose = torch.where(held[:, None], 0.0, mixed)
    factor = torch.linalg.cholesky(_without(precision, held))
    rest = torch.where(held, 0.0, pull - (precision @ fixed[..., None])[..., 0])
    through = torch.cholesky_solve(torch.cat([loose.transpose(1, 2), rest[..., None]], 2), factor)
    out = loose @ through
    return out[..., :-1], out[..., -1] + (mixed @ fixed[..., None])[..., 0]


def filled(normal: torch.Tensor) -> torch.Tensor:
    """Return one model's Gauss-Newton matrix [p, p] with ones where nothing is fitted, so that it has an inverse."""
    return normal + torch.diag(torch.where(normal.diagonal() > 0.0, 0.0, 1.0))


def _where(better: torch.Tensor, trial: Fits, fits: Fits) -> Fits:
    def pick(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        """Return the rows of ``a`` of the models that got better, those of ``b`` of the others."""
        return torch.where(better.view(-1, *[1] * (a.dim() - 1)), a, b)

    batch = Batch(pick(trial.batch.free, fits.batch.free), fits.batch.active, pick(trial.batch.start, fits.batch.start),
                fits.batch.weight)  # fmt: skip
    damping = torch.where(better, fits.damping * 0.15, fits.damping * 8.0).clamp(1e-8, 1e9)
    return Fits(batch, pick(trial.chi2, fits.chi2), pick(trial.cost, fits.cost), pick(trial.nuisance, fits.nuisance),
                damping)  # fmt: skip
