"""Stein variational gradient descent (Liu and Wang 2016; thesis eq. 3.10), preconditioned and aware of modes.

The particles of each mode are whitened by their own covariance (a matrix-valued kernel: Wang, Tang, Bajaj and Liu
2019, "Stein variational gradient descent with matrix-valued kernels") and moved by the sum of two kernels: a Gaussian
one, which gives their shape, and a linear one, x . y + 1, whose fixed points have the mean and the covariance of a
normal target exactly (Liu and Wang 2018, "Stein variational gradient descent as moment matching"). The Gaussian kernel
alone loses variance as the dimension grows: with 32 particles in 8 dimensions and the bandwidth of Liu and Wang a third
of it is left.

No kernel moves particles between distant modes: SVGD leaves in each mode as many particles as started near it. Here
each mode has its own kernel, its mass is estimated by importance sampling, and particles are moved between modes to
match. A mode that no particle reaches is not found.
"""

from __future__ import annotations

from typing import ClassVar

import torch

from .base import Density, Population, spread
from .modes import count_members, find_basins, mode_masses


def gaussian_direction(x: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """Return the steepest direction under a Gaussian kernel, shape [P, D].

    phi(x_i) = 1/P sum_j k(x_j, x_i) grad log p(x_j) + grad_{x_j} k(x_j, x_i), with k = exp(-|x_j - x_i|^2 / b) and b
    the median of the squared distances of pairs. Liu and Wang divide that by log P; in several dimensions
    particles then hardly interact, and one that lags behind moves by its own gradient over P alone.
    """
    difference = x[:, None] - x[None, :]
    squared = (difference**2).sum(-1)
    bandwidth = _median_of_pairs(squared)
    k = torch.exp(-squared / bandwidth)
    repulsion = (-2.0 / bandwidth * k[..., None] * difference).sum(0)
    return (k.T @ gradient + repulsion) / len(x)


def linear_direction(x: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """Return the steepest direction under the kernel (x - m) . (y - m) + 1, m the mean of the particles, shape [P, D].

    phi(x_i) = E[g] + (E[g (x - m)^T] + I) (x_i - m): zero exactly where Stein's identity holds for all linear
    functions. Repulsion and pull are those of the mean-field limit, in which m does not depend on one particle.
    """
    centred = x - x.mean(0)
    identity = torch.eye(x.shape[1]).to(x)
    return gradient.mean(0) + centred @ (centred.T @ gradient / len(x) + identity)


def _median_of_pairs(squared: torch.Tensor) -> torch.Tensor:
    count = len(squared)
    if count < 2:
        return torch.ones_like(squared[0, 0])
    i, j = torch.triu_indices(count, count, 1, device=squared.device)
    return squared[i, j].median().clamp(min=1e-12)


def whitened_step(x: torch.Tensor, gradient: torch.Tensor, factor: torch.Tensor, size: float) -> torch.Tensor:
    """Return the displacement [P, D] of the particles of one mode.

    Args:
        x: Positions, shape [P, D].
        gradient: Gradients of the log density there, shape [P, D].
        factor: Lower Cholesky factor of the covariance that whitens them, shape [D, D].
        size: Step in whitened coordinates, at most 1. Far from rest, where the direction's root mean square exceeds 1,
            it is scaled to 1, so that a population too wide or too far away contracts by this factor per iteration.
    """
    z = torch.linalg.solve_triangular(factor, (x - x.mean(0)).T, upper=False).T
    g = gradient @ factor
    # one extreme gradient must not dominate; in a normal density no gradient is ten times the median
    length = g.norm(dim=1, keepdim=True)
    g = g * (10.0 * length.median() / length.clamp(min=1e-300)).clamp(max=1.0)
    phi = gaussian_direction(z, g) + linear_direction(z, g)
    phi = phi / (phi**2).mean(0).sqrt().clamp(min=1.0)
    return (size * phi).clamp(-3.0 * size, 3.0 * size) @ factor.T


class Svgd(Population):
    """Particles that flow to the target, deterministic but for those that change mode.

    The step is constant over the first half and then falls linearly to zero, so that the particles come to rest. At
    the start and after one, two and three fifths of the iterations the modes are found, and after two and three fifths
    their masses are estimated (see `modes`): one evaluation of log densities where there is one mode, about six
    where there are several.

    Attributes:
        mode: Number of the mode that each particle belongs to, shape [P].

    Args:
        particles: Where they start, shape [P, D].
        iterations: Length of the run.
        seed: Of the numbers that estimate the masses.
        step_size: Step in units of the particles' own standard deviations.
    """

    name = "svgd"
    chain: ClassVar[bool] = False
    kept = ("mode",)

    def __init__(self, particles: torch.Tensor, *, iterations: int, seed: int, step_size: float = 0.3) -> None:
        super().__init__(particles, iterations=iterations, seed=seed)
        self.step_size = step_size
        self.mode = torch.zeros(len(particles), dtype=torch.int64, device=self.particles.device)

    def step(self, density: Density) -> torch.Tensor:
        """Do one iteration and return the positions after it, shape [P, D]."""
        if self.iteration == 0:
            self.begin(density)
        fifth, part = divmod(5 * self.iteration, self.iterations)
        if fifth <= 3 and part < 5:
            self.mode = find_basins(density, self.particles, self.log_density, self.gradient)
            if fifth >= 2:
                self._reallocate(density)
        size = self.step_size * min(1.0, 2.0 * (1.0 - self.iteration / self.iterations))
        proposal = self.particles.clone()
        for label in self.mode.unique():
            members = self.mode == label
            x = self.particles[members]
            proposal[members] = x + whitened_step(x, self.gradient[members], self._factor(members), size)
        self.move(density, proposal)
        self.iteration += 1
        return self.particles

    def _factor(self, members: torch.Tensor) -> torch.Tensor:
        """Return the whitening factor of a mode; small modes use the pooled covariance of all modes."""
        if int(members.sum()) > self.particles.shape[1]:
            return spread(self.particles[members])
        return self._pooled()

    def _pooled(self) -> torch.Tensor:
        """Return the Cholesky factor of the covariance within the modes."""
        centred = self.particles.clone()
        for label in self.mode.unique():
            members = self.mode == label
            centred[members] -= self.particles[members].mean(0)
        return spread(centred)

    def _reallocate(self, density: Density) -> None:
        """Estimate the masses of the modes and move particles between modes to match them."""
        labels = self.mode.unique()
        if len(labels) < 2:
            return
        members = [self.mode == label for label in labels]
        centres = torch.stack([self.particles[m].mean(0) for m in members])
        factors = torch.stack([self._factor(m) for m in members])
        masses = mode_masses(density, centres, factors, len(self.particles), self.generator)
        have = torch.stack([m.sum() for m in members])
        surplus = have - count_members(masses, len(self.particles))
        if not surplus.any():
            return
        movers = torch.cat([self._some(m, int(n)) for m, n in zip(members, surplus, strict=True) if n > 0])
        into = torch.repeat_interleave(torch.arange(len(labels)).to(surplus), (-surplus).clamp(min=0))
        proposal = self.particles.clone()
        noise = self.normal(len(movers), self.particles.shape[1])
        proposal[movers] = centres[into] + torch.einsum("nij,nj->ni", factors[into], noise)
        moved = self.move(density, proposal)[movers]
        self.mode[movers[moved]] = labels[into[moved]]

    def _some(self, members: torch.Tensor, count: int) -> torch.Tensor:
        """Return the indices of some members, chosen at random."""
        index = members.nonzero()[:, 0]
        order = torch.randperm(len(index), generator=self.generator, device=index.device)
        return index[order[:count]]
