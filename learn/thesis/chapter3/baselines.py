"""Figure 3.5: samplers from the same starts at equal simulator calls, against an outside sampler's long run.

A call is one rollout of one training trajectory with one set of parameters; finite differences count. All methods are
run twice: from draws of the prior, in logarithms; and from draws about the modes, in coordinates whitened there, where
the climb to the modes counts as calls of every method. Only the classical random walk always steps in logarithms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import torch

from ....sim.base.types import Array
from ...inference.fit import find_modes, jacobian_rows
from ...inference.posterior import Whitened, initial_vectors
from ...inference.posterior import spread as about
from ...inference.target import Target
from ...samplers.base import Sampler, spread
from ...samplers.chains import MetropolisHastings
from ...samplers.choose import make_sampler
from ...samplers.diagnostics import MAX_R_HAT, r_hat
from .bench import CLIMB, Bench, Scores
from .prior import ETA, Advance, plain

GRADIENT = {"SVGD": "svgd", "NNSVGD": "svgd", "SGLD": "sgld", "SGHMC": "sghmc"}
WALKS = (0.015, 0.05)
"""Fixed steps of the classical random walk, as shares of the box: the thesis's, and a larger one."""
ADAPTIVE = "MH, adaptive"
SHARES = (0.25, 1.0)
"""Shares of the iterations at which the methods are compared."""
Origin = Literal["prior", "modes"]
ORIGINS: tuple[Origin, ...] = get_args(Origin)
"""Where all methods start."""
MODE_STARTS = 16
"""Starts of the search for modes, as `bough identify` takes."""
WALKERS = 4
"""Walkers of the reference for each coordinate: few, since R-hat asks for long paths."""
OVERDISPERSED = 2.0
"""How much wider than the linearised posterior the reference starts, about the truth."""
ROUND = 500
"""Iterations of the reference between two looks at its R-hat."""
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

    @property
    def settled(self) -> bool:
        """Whether its chains agree: without that nothing is ranked by it."""
        return self.worst_r_hat < MAX_R_HAT

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
        origin: Where it started.
        method: Name.
        share: Share of the full budget, nominal.
        calls: Rollouts of one training trajectory.
        scores: As in table 3.1.
        distance: Energy distance to the posterior, in that of exact draws (1 is perfect).
        worst_mean: Largest error of a coordinate's mean, in posterior deviations.
        theta: Its particles, shape [P, D].
    """

    branch: int
    origin: Origin
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
    """Draw from a bench's posterior with emcee and keep the second half of the walkers' paths.

    No particle that is judged by it is where it starts: walkers begin about the true parameters, `OVERDISPERSED` times
    as wide as the posterior linearised there. They propose by differential evolution (emcee's DE and snooker moves,
    four to one), which follows a narrow ridge where stretch moves hardly mix, until R-hat is below `MAX_R_HAT` or
    ``length`` is reached.

    Returns:
        References without the inequality prior, under None, and with it, under `ETA`: the same draws, resampled in
        proportion to the prior.
    """
    target = bench.target()
    trace, worst = _walk(target, _overdispersed(target, bench.truth, WALKERS * target.num_dims, seed), length, seed)
    flat = trace.flatten(0, 1)
    weight = torch.softmax(bench.target(ETA).prior(flat) - target.prior(flat), 0)
    flat_weight = torch.full_like(weight, 1.0 / len(weight))
    return {eta: _reference(flat, w, worst, particles, seed) for eta, w in ((None, flat_weight), (ETA, weight))}


def _overdispersed(target: Target, truth: torch.Tensor, count: int, seed: int) -> torch.Tensor:
    """Return positions [P, D] about the truth [D], wider than the posterior linearised there."""
    _, derivative = target.linearise(truth[None].to(target.place))
    rows = jacobian_rows(target, derivative)[0] * target.weight[..., None]
    rows = (rows / torch.where(CLIMB > 0.0, CLIMB, 1.0).to(rows)[:, None]).flatten(0, -2)
    precision = rows.T @ rows + torch.eye(len(truth)).to(rows)  # an e-fold where the data say nothing
    generator = torch.Generator().manual_seed(seed)
    z = torch.randn(count, len(truth), generator=generator, dtype=torch.float64).to(rows)
    factor = torch.linalg.cholesky(precision)
    return truth.to(rows) + OVERDISPERSED * torch.linalg.solve_triangular(factor.T, z.T, upper=True).T


def _walk(target: Target, start: torch.Tensor, length: int, seed: int) -> tuple[torch.Tensor, float]:
    """Run emcee from positions [P, D]; return the second half of the paths [I, P, D] and its largest R-hat."""
    import emcee

    def log_density(x: Array) -> Array:
        """Return the log density of positions [P, D], shape [P], -inf where it is not finite."""
        value = target.log_density(torch.as_tensor(x).to(start)).cpu().numpy()
        return np.where(np.isfinite(value), value, -np.inf)

    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    sampler = emcee.EnsembleSampler(*start.shape, log_density, vectorize=True, moves=moves)
    sampler.random_state = np.random.RandomState(seed).get_state()
    paths = sampler.sample(start.cpu().numpy(), iterations=length, store=False, skip_initial_state_check=True)
    trace, worst = [], float("inf")
    for k, state in enumerate(paths, 1):
        trace.append(torch.as_tensor(state.coords.copy()))
        if k % ROUND == 0 or k == length:
            worst = float(r_hat(torch.stack(trace[k // 2 :])).max())
            if worst < MAX_R_HAT:
                break
    return torch.stack(trace[len(trace) // 2 :]).to(start), worst


def _reference(flat: torch.Tensor, weight: torch.Tensor, worst: float, particles: int, seed: int) -> Reference:
    """Resample draws [N, D] by weights [N] and measure what exact draws of P particles score."""
    generator = torch.Generator().manual_seed(seed)

    def some(count: int) -> torch.Tensor:
        """Resample so many draws with replacement, in proportion to their weights, [count, D]."""
        return flat[torch.multinomial(weight.cpu(), count, replacement=True, generator=generator).to(flat.device)]

    draws = some(MOST_PAIRED)
    made = Reference(draws, spread(draws, 0.0), worst, 1.0)
    exact = float(torch.tensor([made.distance(some(particles)) for _ in range(20)]).median())
    return replace(made, exact=exact)


def compare(
    bench: Bench, branch: int, shares: Sequence[float], *, particles: int, iterations: int, reference: int, seed: int,
    advance: Advance,
) -> tuple[list[Entry], Reference]:  # fmt: skip
    """Run every method on one branch, from the prior and from the modes.

    Args:
        bench: The branch.
        branch: Its number.
        shares: Shares of the iterations to compare at.
        particles: Particles and chains.
        iterations: Updates of the gradient methods at the full budget.
        reference: Most iterations of the reference.
        seed: Of everything random.
        advance: Called after each run.
    """
    truth = make_references(bench, particles=particles, length=reference, seed=seed)
    advance()
    contest = _Contest(bench, branch, particles, seed, truth, advance)
    entries = []
    for origin in ORIGINS:
        start = _start(bench, origin, particles, seed)
        for share in shares:
            entries += contest.run(origin, start, share, round(share * iterations))
    return entries, truth[None]


@dataclass(frozen=True)
class _Start:
    """Positions that all methods start from [P, D], the coordinates they work in, and what finding them cost."""

    theta: torch.Tensor
    centre: torch.Tensor
    precision: torch.Tensor
    calls: int

    def density(self, target: Target) -> Whitened:
        """Return the target's density in the coordinates that methods work in."""
        return Whitened(target, self.centre, self.precision)


def _start(bench: Bench, origin: Origin, particles: int, seed: int) -> _Start:
    target = bench.target()
    if origin == "prior":
        unit = torch.eye(target.num_dims, dtype=torch.float64, device=target.place)
        return _Start(bench.uniform(particles, seed), torch.zeros_like(unit[0]), unit, 0)
    generator = torch.Generator().manual_seed(seed)
    modes = find_modes(target, initial_vectors(target, MODE_STARTS, generator), lambda k: None)
    best = int(modes.log_posterior.argmax())
    return _Start(about(modes, particles, generator), modes.theta[best], modes.precision[best], calls_of(target))


@dataclass(frozen=True)
class _Contest:
    """All methods on one branch."""

    bench: Bench
    branch: int
    particles: int
    seed: int
    truth: dict[float | None, Reference]
    advance: Advance

    def run(self, origin: Origin, start: _Start, share: float, count: int) -> list[Entry]:
        """Run the gradient methods for a number of updates, and Metropolis-Hastings for as many calls as the most."""
        out = []
        for name, method in GRADIENT.items():
            eta = ETA if name == "NNSVGD" else None
            target = self.bench.target(eta)
            density = start.density(target)
            sampler = make_sampler(method, density.z(start.theta), iterations=count, seed=self.seed)
            theta = density.theta(self._draws(sampler, density, count))
            out.append(self._entry(origin, name, share, start.calls + calls_of(target), theta, self.truth[eta]))
        calls = max(e.calls for e in out) - start.calls
        return out + [self._walk(origin, start, share, step, calls) for step in (*WALKS, None)]

    def _walk(self, origin: Origin, start: _Start, share: float, step: float | None, calls: int) -> Entry:
        """Run Metropolis-Hastings, with a fixed ``step`` (a share of the box) or adaptive, for a number of calls."""
        target = self.bench.target()
        length = max(2, -(-calls // (self.particles * len(target.recordings))))
        density = start.density(target) if step is None else plain(target)
        first = density.z(start.theta)
        if step is None:
            name, sampler = ADAPTIVE, make_sampler("mh", first, iterations=length, seed=self.seed)
        else:
            size = step * float((target.box[1] - target.box[0]).mean())
            name = f"MH, step {100 * step:g} %"
            sampler = RandomWalk(first, iterations=length, seed=self.seed, step=size)
        theta = density.theta(self._draws(sampler, density, length))
        return self._entry(origin, name, share, start.calls + calls_of(target), theta, self.truth[None])

    def _draws(self, sampler: Sampler, density: Whitened, length: int) -> torch.Tensor:
        """Run a sampler; return its particles, or as many draws, evenly from the second half of all chains."""
        trace = torch.stack([sampler.step(density).clone() for _ in range(length)])
        flat = trace[length // 2 :].flatten(0, 1) if sampler.chain else trace[-1]
        return flat[torch.linspace(0, len(flat) - 1, self.particles).round().long().to(flat.device)]

    def _entry(
        self, origin: Origin, name: str, share: float, calls: int, theta: torch.Tensor, truth: Reference
    ) -> Entry:
        self.advance()
        distance = truth.distance(theta) / truth.exact
        scores = self.bench.score(theta)
        return Entry(self.branch, origin, name, share, calls, scores, distance, truth.worst_mean(theta), theta)
