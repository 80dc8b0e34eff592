"""Modes of a density as particles see them: which belong together, and how much mass each mode has.

Particles are linked to their nearest neighbour of higher log density (quick shift: Vedaldi and Soatto 2008); a link is
cut where the density falls between its ends. The mass of each mode is estimated by importance sampling from the mixture
of normal densities fitted to the modes (deterministic mixture weights: Owen and Zhou 2000).
"""

from __future__ import annotations

import torch

from .base import Density, spread

BARRIER = 0.7
"""Drop of the log density between two particles, below the lower of them, that separates their modes."""

ROUGHNESS = 0.25
"""The same relative to the interquartile range of the particles' log densities; the larger applies, so that small
local maxima do not separate particles far from convergence."""

ROUNDS = 4
"""Batches of P draws that estimate the masses."""

WIDER = 1.2
"""Factor by which proposals are wider than the particles' normal fit, which keeps the weights bounded."""


def find_basins(density: Density, x: torch.Tensor, log_density: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """Return the number of the mode that each particle belongs to, shape [P].

    In a log-concave density no link is ever cut, whatever the number of particles: the log density half-way is at least
    that of the lower end. Modes nearer than about five standard deviations count as one, and so do all where there are
    more than one for every four particles: that is roughness, or too few particles to tell.

    Args:
        density: The log density, evaluated in batches of P positions.
        x: Positions, shape [P, D].
        log_density: Log density there, shape [P]; particles without a finite one go with their nearest neighbour.
        gradient: Its gradient there, shape [P, D]; its covariance is the metric, which modes far apart do not distort.
    """
    known = log_density.isfinite()
    every = torch.arange(len(x), device=x.device)
    if int(known.sum()) < 2:
        return torch.zeros_like(every)
    barrier = _barrier(log_density[known])
    parent = _nearest_higher(x @ spread(gradient), log_density)
    apart = _separated(density, x, log_density - barrier, every, parent, (0.5,))
    root = torch.where(apart, every, parent)
    for _ in range(len(x).bit_length()):
        root = root[root]
    root = _merge(density, x, log_density - barrier, root)
    number = torch.unique(root, return_inverse=True)[1]
    return number if 4 * (int(number.max()) + 1) <= len(x) else torch.zeros_like(number)


def _barrier(log_density: torch.Tensor) -> float:
    low, high = torch.quantile(log_density, torch.tensor([0.25, 0.75]).to(log_density)).tolist()
    return max(BARRIER, ROUGHNESS * (high - low))


def _nearest_higher(z: torch.Tensor, log_density: torch.Tensor) -> torch.Tensor:
    """Return each particle's nearest neighbour of higher log density, itself at the top, shape [P]."""
    order = log_density.argsort(descending=True, stable=True)
    rank = torch.empty_like(order)
    rank[order] = torch.arange(len(z)).to(order)
    distance = torch.where(rank[None, :] < rank[:, None], torch.cdist(z, z), torch.inf)
    return torch.where(rank == 0, order[0], distance.argmin(1))


def _separated(
    density: Density, x: torch.Tensor, floor: torch.Tensor, a: torch.Tensor, b: torch.Tensor, at: tuple[float, ...]
) -> torch.Tensor:
    """Return whether the log density between particles a and b, N pairs, falls below both floors, shape [N]."""
    fractions = torch.tensor(at).to(x)
    between = x[a, None] + fractions[:, None] * (x[b] - x[a])[:, None]
    value = in_batches(density, between.flatten(0, 1), len(x)).reshape(len(a), len(at))
    return torch.nan_to_num(value, nan=-torch.inf).amin(1) < torch.minimum(floor[a], floor[b])


def _merge(density: Density, x: torch.Tensor, floor: torch.Tensor, root: torch.Tensor) -> torch.Tensor:
    """Merge modes if the density does not drop between their maxima."""
    tops = root.unique()
    if len(tops) == 1:
        return root
    i, j = torch.triu_indices(len(tops), len(tops), 1, device=x.device)
    joined = ~_separated(density, x, floor, tops[i], tops[j], (0.25, 0.5, 0.75))
    for a, b in zip(tops[i[joined]], tops[j[joined]], strict=True):
        root = torch.where(root == root[b], root[a], root)
    return root


def in_batches(density: Density, x: torch.Tensor, size: int) -> torch.Tensor:
    """Return log densities [N] of positions [N, D], evaluated in batches of one size.

    A simulator keeps the worlds of one batch size; the last batch is padded with copies of the last position.
    """
    filled = torch.cat([x, x[-1:].expand(-len(x) % size, -1)])
    return torch.cat([density.log_density(part) for part in filled.split(size)])[: len(x)]


def mode_masses(
    density: Density, centres: torch.Tensor, factors: torch.Tensor, batch: int, generator: torch.Generator
) -> torch.Tensor:
    """Return the share of the total mass that each of M modes has, shape [M].

    Args:
        density: The log density.
        centres: Means of the modes, shape [M, D].
        factors: Lower Cholesky factors of their covariances, shape [M, D, D].
        batch: Number of positions evaluated at a time.
        generator: Random stream.
    """
    count = ROUNDS * batch
    noise = torch.randn(count, centres.shape[1], generator=generator, dtype=torch.float64, device=centres.device)
    source = torch.arange(count, device=centres.device) % len(centres)
    x = centres[source] + WIDER * torch.einsum("nij,nj->ni", factors[source], noise)
    offset = (x - centres[:, None]).transpose(1, 2)
    squared = (torch.linalg.solve_triangular(factors, offset, upper=False) ** 2).sum(1)
    log_volume = factors.diagonal(dim1=1, dim2=2).log().sum(1)[:, None]
    log_proposal = -0.5 * squared / WIDER**2 - log_volume
    weight = in_batches(density, x, batch) - torch.logsumexp(log_proposal, 0)
    weight = torch.where(weight.isfinite(), weight, -torch.inf)
    belongs = torch.nn.functional.one_hot((-squared).argmax(0), len(centres)).bool()
    each = torch.logsumexp(torch.where(belongs.T, weight, -torch.inf), 1)
    if not each.isfinite().any():
        return torch.full_like(each, 1.0 / len(each))
    return torch.softmax(each, 0)


def count_members(masses: torch.Tensor, count: int) -> torch.Tensor:
    """Return whole numbers nearest to masses * count that add up to count (largest remainders), shape [M]."""
    exact = masses * count
    whole = exact.floor().to(torch.int64)
    missing = count - int(whole.sum())
    whole[(exact - whole).argsort(descending=True, stable=True)[:missing]] += 1
    return whole
