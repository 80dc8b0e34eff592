"""The course of gusts in every recording, as a normal process: what the pressure was, and how likely all of it is.

The horizontal pressure on a branch is taken for m + q(t), m one mean for all recordings and q a normal process that
begins anew in each, of covariance S k(t - t'), S [2, 2] and k Matern's of order 3/2 with one time (Rasmussen &
Williams, Gaussian Processes for Machine Learning (2006), sections 2.2 and 4.2). To first order the whitened residual of
recording j is

    r_j = X_j b + G_j q_j + e,   e white,   cov r_j = 1 + G_j C G_j^T,

with the answers G to a pressure at every knot, and X the derivatives of the base model, its nuisances under their
priors, and the answers to the mean. S and the time are the likeliest, b is generalised least squares, and the course is
the mean of q given all that was measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize

from ....sim.base.types import Array
from ...cases.case import BranchCase
from ..models.contest import Batch, Contest
from .answers import Knots, answers, axes_of, knots_of

#: Time of the process at which its search begins [s], first steps of it on logarithms, and evaluations at most.
TIME, AWAY, EVALUATIONS = 0.25, 0.5, 100
#: Share of the largest eigenvalue below which a direction of the process is left out.
LEAST = 1e-6
#: Precision of what has no prior, as a share of its own.
LOOSE = 1e-9


@dataclass(frozen=True)
class Gusts:
    """What a normal process of gusts makes of the recordings.

    Attributes:
        knots: Where the knots of each recording's course lie.
        pressure: Pressure at the knots of each recording [Pa], shape [K, 2] each.
        free: Free coordinates of the base's parameters beside it, shape [n].
        deviance: Minus twice the log likelihood, up to the constant of white noise: a chi-squared and a determinant.
        process: Logarithms of the sizes along two axes, which way these are turned, and logarithm of the time, [4]; of
            a planar case, which shows one axis alone, of size and time, [2].
    """

    knots: tuple[Knots, ...]
    pressure: tuple[Array, ...]
    free: torch.Tensor
    deviance: float
    process: Array

    @property
    def time(self) -> float:
        """Time over which the pressure changes [s]."""
        return math.exp(self.process[-1])


@dataclass(frozen=True)
class _Part:
    """One recording: products of the answers G [K, N] with themselves, with X [P, N] and with r [N]."""

    knots: Knots
    gram: torch.Tensor
    with_columns: torch.Tensor
    with_residual: torch.Tensor


class Process:
    """A normal process of gusts beside the base's parameters of a model.

    Args:
        contest: What simulates the model.
        model: A batch of one; what it simulates may have a course already.
        known: Pressures at the knots of that course [Pa], to be read off anew; none where it has none.
    """

    def __init__(self, contest: Contest, model: Batch, known: Sequence[Array] = ()) -> None:
        residual, derivative, columns = contest.linearise(model)
        derivative = derivative[:, columns[0] < contest.num_base]
        self._base, self._own = model.free[0, : contest.num_base], contest.num_base
        case, nuisance = contest.case, contest.nuisance
        assert isinstance(case, BranchCase)
        self._axes = axes_of(case)
        knots = [knots_of(r, case) for r in contest.recordings]
        of_knot = [answers(contest, model, j, k) for j, k in enumerate(knots)]
        mean = torch.stack([torch.stack([half.sum(0) for half in own.chunk(self._axes)]) for own in of_knot], 1)
        self._columns = torch.cat([derivative[0].flatten(2), nuisance.columns, mean])
        self._residual = residual[0].flatten(1)
        for j, own in enumerate(known):
            seen = own.T[: self._axes].ravel()
            self._residual[j] += torch.as_tensor(seen).to(of_knot[j]) @ of_knot[j]
        held = (self._columns**2).sum((1, 2)).clamp(min=1.0) * LOOSE
        held[self._own : self._own + len(nuisance)] = 1.0
        self._held, self._centre = held, torch.zeros_like(held)
        self._centre[self._own : self._own + len(nuisance)] = nuisance.mean
        self._parts = [self._part(j, k, g) for j, (k, g) in enumerate(zip(knots, of_knot, strict=True))]
        flat = self._columns.flatten(1)
        self._whole = (flat @ flat.T, flat @ self._residual.flatten(), float((self._residual**2).sum()))

    def _part(self, j: int, knots: Knots, g: torch.Tensor) -> _Part:
        return _Part(knots, g @ g.T, g @ self._columns[:, j].T, g @ self._residual[j])

    def fit(self) -> Gusts:
        """Return the likeliest process, what blew, and the base beside it."""
        size = math.log(self._rough_size())
        begin = np.array([size, size, 0.0, math.log(TIME)] if self._axes == 2 else [size, math.log(TIME)])
        options = {"maxfev": EVALUATIONS, "xatol": 0.03, "fatol": 0.5,
                   "initial_simplex": np.vstack([begin, begin + AWAY * np.eye(len(begin))])}  # fmt: skip
        return self.given(minimize(self._deviance, begin, method="Nelder-Mead", options=options).x)

    def _rough_size(self) -> float:
        """Return a pressure that moves the branch about as far as it was moved [Pa]."""
        power = sum(float(p.gram.diagonal().sum()) for p in self._parts)
        return math.sqrt(self._whole[2] / max(power, 1e-30))

    def _deviance(self, at: Array) -> float:
        chi2, volume, *_ = self._solved(at)
        return chi2 + volume

    def given(self, at: Array) -> Gusts:
        """Return what blew, and the base beside it, of a process that is known."""
        chi2, volume, found, halves = self._solved(at)
        mean = found[-self._axes :]
        pressure = []
        for part, (half, root) in zip(self._parts, halves, strict=True):
            left = half.T @ (part.with_residual - part.with_columns @ found)
            own = half @ torch.cholesky_solve(left[:, None], root)[:, 0]
            blew = (own.view(self._axes, -1) + mean[:, None]).T.cpu().numpy()
            pressure.append(np.pad(blew, ((0, 0), (0, 2 - self._axes))))
        knots = tuple(p.knots for p in self._parts)
        return Gusts(knots, tuple(pressure), self._base + found[: self._own], chi2 + volume, at)

    def _solved(self, at: Array) -> tuple[float, float, torch.Tensor, list[tuple[torch.Tensor, torch.Tensor]]]:
        """Return chi-squared, log determinant, coefficients of the columns, and of each recording C^1/2 and a root.

        The root is the Cholesky factor of 1 + C^1/2 G G^T C^1/2.
        """
        matrix, right, rest = self._whole[0] + torch.diag(self._held), self._whole[1].clone(), self._whole[2]
        right, volume, halves = right + self._held * self._centre, 0.0, []
        for part in self._parts:
            half = _half(at, part.knots).to(matrix)
            inner = half.T @ part.gram @ half
            root = torch.linalg.cholesky(inner + torch.eye(len(inner)).to(inner))
            mixed = torch.cat([half.T @ part.with_columns, (half.T @ part.with_residual)[:, None]], 1)
            mixed = torch.linalg.solve_triangular(root, mixed, upper=False)
            columns, residual = mixed[:, :-1], mixed[:, -1]
            matrix, right = matrix - columns.T @ columns, right - columns.T @ residual
            rest, volume = rest - float(residual @ residual), volume + 2.0 * float(root.diagonal().log().sum())
            halves.append((half, root))
        found = torch.linalg.solve(matrix, right)
        chi2 = rest - float(right @ found) + float((self._held * self._centre**2).sum())
        return chi2, volume, found, halves


def _half(at: Array, knots: Knots) -> torch.Tensor:
    """Return a root H [A K, q] of the process's covariance C = H H^T at the knots along A axes, x before y."""
    time = math.exp(at[-1])
    away = np.sqrt(3.0) * np.abs(knots.time[:, None] - knots.time) / time
    value, vector = np.linalg.eigh((1.0 + away) * np.exp(-away))
    keep = value > LEAST * value[-1]
    root = vector[:, keep] * np.sqrt(value[keep])
    return torch.as_tensor(np.kron(_sizes(at), root))


def _sizes(at: Array) -> Array:
    """Return a root of the covariance S of the axes, [A, A]."""
    if len(at) == 2:
        return np.array([[math.exp(at[0])]])
    size, other, turn = math.exp(at[0]), math.exp(at[1]), math.tanh(at[2])
    return np.array([[size, 0.0], [turn * other, math.sqrt(1.0 - turn**2) * other]])


def rms_of(courses: Sequence[Array]) -> float:
    """Return the rms of the pressure of some courses, of its size and not of each component [Pa]."""
    return float(np.sqrt((np.concatenate(courses) ** 2).sum(1).mean()))
