"""Fits of many models side by side: Levenberg-Marquardt, a damping for each row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from .contest import NARROW, STEP, Contest, Rows, prior_of

#: Rows of which derivatives are held at once.
TOGETHER = 24
#: Damping that a fit sets out with.
DAMPING = 1e-3
#: Longest step of a free coordinate, in its reach.
LONGEST = 1.0
#: Solutions of one step at most, each with the entries held that left their bounds in the one before.
PASSES = 4


@dataclass
class Fits:
    """Rows and how well they fit.

    Attributes:
        rows: The models.
        chi2: Squares of whitened residuals, the nuisance's share taken out, shape [S].
        cost: The same with the priors' terms: what is minimised, shape [S].
        nuisance: Coefficients of the nuisance columns, shape [S, m].
        damping: Of the next step, shape [S].
    """

    rows: Rows
    chi2: torch.Tensor
    cost: torch.Tensor
    nuisance: torch.Tensor
    damping: torch.Tensor

    def __getitem__(self, index: torch.Tensor) -> Fits:
        return Fits(self.rows[index], self.chi2[index], self.cost[index], self.nuisance[index], self.damping[index])

    def one(self, s: int) -> Fits:
        """Return one row."""
        return self[torch.tensor([s], device=self.chi2.device)]

    def __len__(self) -> int:
        return len(self.chi2)

    @staticmethod
    def joined(parts: list[Fits]) -> Fits:
        """Return fits one after the other."""
        return Fits(
            Rows.joined([p.rows for p in parts]),
            *(torch.cat([getattr(p, k) for p in parts]) for k in ("chi2", "cost", "nuisance", "damping")),
        )


def fit(contest: Contest, rows: Rows, iterations: int, progress: Callable[[int], None] = lambda _: None) -> Fits:
    """Fit every row by itself, at most ``iterations`` steps each."""
    parts = []
    for k in range(0, len(rows), TOGETHER):
        parts.append(_climb(contest, rows[slice(k, k + TOGETHER)], iterations))
        progress(1)
    return Fits.joined(parts)


def _climb(contest: Contest, rows: Rows, iterations: int) -> Fits:
    """Fit with derivatives over wide steps, and each row that has settled with narrow ones on from there."""
    fits = evaluated(contest, rows)
    steps = torch.full_like(fits.cost, STEP)
    for _ in range(iterations):
        residual, derivative, columns = contest.linearise(fits.rows, steps)
        moved = _step(contest, fits, residual, derivative, columns)
        trial = evaluated(contest, moved)
        better = trial.cost < fits.cost
        settled = better & (fits.cost - trial.cost < 1e-4 * fits.cost.clamp(min=1.0))
        fits = _where(better, trial, fits)
        settled |= fits.damping > 1e6
        if bool((settled & (steps == NARROW)).all()):
            break
        fits.damping = torch.where(settled & (steps == STEP), DAMPING, fits.damping)
        steps = torch.where(settled, NARROW, steps)
    return fits


def evaluated(contest: Contest, rows: Rows) -> Fits:
    """Return rows with their misfit, without a step."""
    residual = contest.residual(rows).flatten(1)
    nuisance, chi2, penalty = _absorbed(contest, residual, rows)
    return Fits(rows, chi2, chi2 + penalty + prior_of(contest, rows), nuisance, torch.full_like(chi2, DAMPING))


def _absorbed(contest: Contest, residual: torch.Tensor, rows: Rows) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Best coefficients of the nuisance columns [S, m], what is left of the squares [S], and the prior's term [S]."""
    basis, mean = contest.nuisance, contest.nuisance_mean
    precision = contest.overdispersion * contest.nuisance_spread**-2
    if not len(basis):
        zero = residual.new_zeros(len(residual))
        return residual.new_zeros(len(residual), 0), (residual**2).sum(1), zero
    weight = rows.weight[:, :, None].expand(-1, -1, basis.shape[1] // rows.weight.shape[1]).flatten(1)
    own = basis[None] * weight[:, None]
    normal = own @ own.transpose(1, 2) + torch.diag(precision)
    pull = (own @ residual[..., None])[..., 0] + mean * precision
    found = torch.linalg.solve(normal, pull[..., None])[..., 0]
    left = residual - (found[:, None] @ own)[:, 0]
    return found, (left**2).sum(1), (precision * (found - mean) ** 2).sum(1)


def _step(
    contest: Contest, fits: Fits, residual: torch.Tensor, derivative: torch.Tensor, columns: torch.Tensor
) -> Rows:
    """Return rows moved by a damped Gauss-Newton step, inside the box and no farther than each coordinate's reach."""
    rows = fits.rows
    normal, pull = normal_equations(contest, rows, residual, derivative, columns)
    diagonal = normal.diagonal(dim1=1, dim2=2)
    empty = diagonal <= 0.0
    damped = normal + torch.diag_embed(torch.where(empty, 1.0, diagonal * fits.damping[:, None]))
    used, at, most = columns >= 0, columns.clamp(min=0), columns.shape[1]
    low, high = (torch.full_like(pull, x) for x in (-torch.inf, torch.inf))
    here, longest = torch.gather(rows.free, 1, at), LONGEST * contest.reach[at]
    low[:, :most] = torch.maximum(contest.low[at] - here, -longest)
    high[:, :most] = torch.minimum(contest.high[at] - here, longest)
    step = bounded(damped, pull, low, high)
    free = rows.free.scatter_add(1, at, torch.where(used, step[:, :most], 0.0))
    local = step[:, most : derivative.shape[1]]
    start = rows.start + local.view_as(rows.start) if local.shape[1] else rows.start
    return Rows(free, rows.active, start, rows.weight)


def bounded(matrix: torch.Tensor, right: torch.Tensor, low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
    """Solve ``matrix x = right`` [S, p] with x between ``low`` and ``high``.

    Entries that leave their bounds are held there and the others solved anew. To cut them off alone, or to shorten the
    whole step, would stop a fit at the first bound that it touches, or let one entry that the data do not show hold
    up all others.
    """
    held = torch.zeros_like(right, dtype=torch.bool)
    out = torch.zeros_like(right)
    for _ in range(PASSES):
        known = torch.where(held, out, 0.0)
        rest = torch.where(held, out, right - (matrix @ known[..., None])[..., 0])
        apart = held[:, :, None] | held[:, None]
        own = torch.where(apart, torch.diag_embed(held.to(matrix)), matrix)
        exact = torch.nan_to_num(torch.linalg.solve(own, rest[..., None])[..., 0])
        out = torch.maximum(torch.minimum(exact, high), low)
        left = held | (out != exact)
        if bool((left == held).all()):
            break
        held = left
    return out


def normal_equations(
    contest: Contest, rows: Rows, residual: torch.Tensor, derivative: torch.Tensor, columns: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return Gauss-Newton matrix [S, p + m, p + m] and pull [S, p + m] of the cost, nuisance columns last."""
    flat, r = derivative.flatten(2), residual.flatten(1)
    basis = contest.nuisance
    if len(basis):
        weight = rows.weight[:, :, None].expand(-1, -1, basis.shape[1] // rows.weight.shape[1]).flatten(1)
        flat = torch.cat([flat, basis[None] * weight[:, None]], 1)
    normal = flat @ flat.transpose(1, 2)
    pull = (flat @ r[..., None])[..., 0]
    at = columns.clamp(min=0)
    used = columns >= 0
    precision = torch.where(used, contest.overdispersion * contest.spread[at] ** -2, 0.0)
    lean = torch.where(used, (contest.centre[at] - torch.gather(rows.free, 1, at)) * precision, 0.0)
    q, p = columns.shape[1], derivative.shape[1]
    extra = torch.zeros_like(pull)
    extra[:, :q] = precision
    pull[:, :q] += lean
    if len(basis):
        extra[:, p:] = contest.overdispersion * contest.nuisance_spread**-2
        pull[:, p:] += contest.nuisance_mean * extra[:, p:]
    return normal + torch.diag_embed(extra), pull


def _where(better: torch.Tensor, trial: Fits, fits: Fits) -> Fits:
    def pick(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        return torch.where(better.view(-1, *[1] * (a.dim() - 1)), a, b)

    rows = Rows(pick(trial.rows.free, fits.rows.free), fits.rows.active, pick(trial.rows.start, fits.rows.start),
                fits.rows.weight)  # fmt: skip
    damping = torch.where(better, fits.damping * 0.15, fits.damping * 8.0).clamp(1e-8, 1e9)
    return Fits(rows, pick(trial.chi2, fits.chi2), pick(trial.cost, fits.cost), pick(trial.nuisance, fits.nuisance),
                damping)  # fmt: skip
