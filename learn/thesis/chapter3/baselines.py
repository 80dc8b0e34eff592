"""Figure 3.5: samplers at equal simulator calls, against an outside sampler's long run on the same posterior.

A call is one rollout of one training trajectory with one set of parameters. Methods that use gradients climb to the
modes first and work in coordinates whitened there; their finite differences and the climb count as calls.
Metropolis-Hastings knows no gradients and starts from the prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from ...inference.posterior import Whitened, infer
from ...inference.target import Target
from ...samplers.base import Sampler, spread
from ...samplers.chains import MetropolisHastings
from ...samplers.choose import make_sampler
from ...samplers.diagnostics import r_hat
from .bench import Bench, Scores
from .prior import ETA, Advance, plain

GRADIENT = {"SVGD": "svgd", "NNSVGD": "svgd", "SGLD": "sgld", "SGHMC": "sghmc"}
WALKS = (0.015, 0.05, 0.15)
"""Fixed steps of the classical random walk, as shares of the box: the thesis's, and larger ones."""
ADAPTIVE = "MH, adaptive"
SHARES = (0.25, 0.5, 1.0)
"""Shares of the iterations at which the methods are compared."""
WALKERS = 12
"""Walkers of the reference for each coordinate."""
MOST_PAIRED = 1024
"""Draws of the reference that distances are taken to."""


@dataclass(frozen=True)
class Reference:
    """Draws that stand for the posterior, from a long run of emcee.

    Attributes:
        draws: Shape [N, D].
        factor: Lower Cholesky factor of their covariance, shape [D, D].
        worst_r_hat: Largest split R-hat of a coordinate.
        exact: Median energy distance of P of the draws, chosen at random, to the rest: what no method can beat.
    """

    draws: torch.Tensor
    factor: torch.Tensor
    worst_r_hat: float
    exact: float

    def distance(self, theta: torch.Tensor) -> float:
        """Return the energy distance of particles [P, D] to the posterior, in its own deviations."""
        white = torch.linalg.solve_triangular(self.factor, torch.cat([theta, self.draws]).T, upper=False).T
        return energy_distance(white[: len(theta)], white[len(theta) :])

    def worst_mean(self, theta: torch.Tensor) -> float:
        """Return the largest error of a coordinate's mean, in posterior deviations."""
        return float(((theta.mean(0) - self.draws.mean(0)) / self.draws.std(0)).abs().max())


@dataclass(frozen=True)
class Entry:
    """One method after one budget on one branch.

    Attributes:
        branch: Number of the branch.
        method: Name.
        share: Share of the full budget, nominal.
        calls: Rollouts of one training trajectory.
        scores: As in table 3.1.
        distance: Energy distance to the posterior, in that of exact draws (1 is perfect).
        worst_mean: Largest error of a coordinate's mean, in posterior deviations.
        theta: Its particles, shape [P, D].
    """

    branch: int
    method: str
    share: float
    calls: int
    scores: Scores
    distance: float
    worst_mean: float
    theta: torch.Tensor


def energy_distance(x: torch.Tensor, y: torch.Tensor) -> float:
    """Return 2 E|X - Y| - E|X - X'| - E|Y - Y'| of draws [P, D] and [N, D] (Szekely and Rizzo 2013), V-statistic."""
    return float(2.0 * torch.cdist(x, y).mean() - torch.cdist(x, x).mean() - torch.cdist(y, y).mean())


class RandomWalk(MetropolisHastings):
    """Classical Metropolis-Hastings with a fixed isotropic proposal: nothing adapts.

    Args:
        particles: Where the chains start, shape [P, D].
        iterations: Length of the run.
        seed: Of the random stream.
        step: Standard deviation of the proposal, in the coordinates' unit.
    """

    def __init__(self, particles: torch.Tensor, *, iterations: int, seed: int, step: float) -> None:
        super().__init__(particles, iterations=iterations, seed=seed)
        self.log_scale = torch.zeros_like(self.log_scale)
        self.factor = step * torch.eye(self.particles.shape[1]).to(self.particles)

    def _adapt(self, acceptance: torch.Tensor) -> None:
        """Keep the proposal."""


def calls_of(target: Target) -> int:
    """Return the rollouts of single trajectories that a target has asked for, padding included."""
    rollout = target.rollout(1)
    return target.world_steps // (len(target.recordings[0].t) * rollout.substeps)


def make_references(bench: Bench, *, particles: int, length: int, seed: int) -> dict[float | None, Reference]:
    """Draw from a bench's posterior with emcee, from SVGD's particles, and keep the second half of the walkers' paths.

    Returns:
        References without the inequality prior, under None, and with it, under `ETA`: the same draws, resampled in
        proportion to the prior.
    """
    target = bench.target()
    walkers = WALKERS * target.num_dims
    first = infer(target, method="svgd", particles=walkers, iterations=20, seed=seed).theta
    sampler = make_sampler("emcee", first, iterations=length, seed=seed)
    density = plain(target)
    trace = torch.stack([sampler.step(density).clone() for _ in range(length)])[length // 2 :]
    flat, worst = trace.flatten(0, 1), float(r_hat(trace).max())
    weight = torch.softmax(bench.target(ETA).prior(flat) - target.prior(flat), 0)
    flat_weight = torch.full_like(weight, 1.0 / len(weight))
    return {eta: _reference(flat, w, worst, particles, seed) for eta, w in ((None, flat_weight), (ETA, weight))}


def _reference(flat: torch.Tensor, weight: torch.Tensor, worst: float, particles: int, seed: int) -> Reference:
    """Resample draws [N, D] by weights [N] and measure what exact draws of P particles score."""
    generator = torch.Generator().manual_seed(seed)

    def some(count: int) -> torch.Tensor:
        return flat[torch.multinomial(weight.cpu(), count, replacement=True, generator=generator).to(flat.device)]

    draws = some(MOST_PAIRED)
    made = Reference(draws, spread(draws, 0.0), worst, 1.0)
    exact = float(torch.tensor([made.distance(some(particles)) for _ in range(20)]).median())
    return replace(made, exact=exact)


def compare(
    bench: Bench, branch: int, shares: Sequence[float], *, particles: int, iterations: int, reference: int, seed: int,
    advance: Advance,
) -> tuple[list[Entry], Reference]:  # fmt: skip
    """Run every method on one branch.

    Args:
        bench: The branch.
        branch: Its number.
        shares: Shares of the iterations to compare at.
        particles: Particles and chains.
        iterations: Updates of the gradient methods at the full budget.
        reference: Iterations of the reference.
        seed: Of everything random.
        advance: Called after each run.
    """
    truth = make_references(bench, particles=particles, length=reference, seed=seed)
    advance()
    entries = []
    for share in shares:
        count = round(share * iterations)
        calls = 0
        for name, method in GRADIENT.items():
            eta = ETA if name == "NNSVGD" else None
            target = bench.target(eta)
            theta = infer(target, method=method, particles=particles, iterations=count, seed=seed).theta
            entries.append(_entry(bench, branch, name, share, calls_of(target), theta, particles, truth[eta]))
            calls = max(calls, entries[-1].calls)
            advance()
        entries += _without_gradients(bench, branch, share, calls, particles, seed, truth[None], advance)
    return entries, truth[None]


def _without_gradients(
    bench: Bench, branch: int, share: float, calls: int, particles: int, seed: int, truth: Reference, advance: Advance
) -> list[Entry]:
    """Metropolis-Hastings from the prior, fixed and adaptive, with at least as many calls as any gradient method."""
    target = bench.target()
    start = bench.uniform(particles, seed)
    length = -(-calls // (particles * len(target.recordings)))
    size = float((target.box[1] - target.box[0]).mean())
    out = []
    for step in (*WALKS, None):
        before = calls_of(target)
        if step is None:
            name, sampler = ADAPTIVE, make_sampler("mh", start, iterations=length, seed=seed)
        else:
            name = f"MH, step {100 * step:g} %"
            sampler = RandomWalk(start, iterations=length, seed=seed, step=step * size)
        theta = _second_half(sampler, plain(target), length, particles)
        out.append(_entry(bench, branch, name, share, calls_of(target) - before, theta, particles, truth))
        advance()
    return out


def _second_half(sampler: Sampler, density: Whitened, length: int, count: int) -> torch.Tensor:
    """Run a chain sampler and return ``count`` draws, evenly from the second half of all chains."""
    trace = torch.stack([sampler.step(density).clone() for _ in range(length)])
    flat = trace[length // 2 :].flatten(0, 1)
    return flat[torch.linspace(0, len(flat) - 1, count).round().long().to(flat.device)]


def _entry(
    bench: Bench, branch: int, name: str, share: float, calls: int, theta: torch.Tensor, particles: int,
    truth: Reference,
) -> Entry:  # fmt: skip
    """Score a method by as many draws as SVGD has particles."""
    kept = theta[torch.linspace(0, len(theta) - 1, particles).round().long().to(theta.device)]
    distance = truth.distance(kept) / truth.exact
    return Entry(branch, name, share, calls, bench.score(kept), distance, truth.worst_mean(kept), kept)
