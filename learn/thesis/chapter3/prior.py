"""Table 3.1 and figure 3.6: what the inequality prior does to SVGD, at the thesis's temperature and at weaker ones."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from ...inference.posterior import Whitened, infer
from ...inference.target import Target
from ...samplers.diagnostics import Convergence
from .bench import KT, Bench, Scores

ETA = 10.0
"""Sharpness of the inequality prior unless it is swept, in logarithms; the thesis does not state its own."""
MOST_ITERATIONS = 70
"""Updates that the thesis takes at most (table A.1)."""
TEMPERATURES = (KT, 1.0, 10.0, 100.0)
ETAS = (1.0, 10.0, 100.0)
ETA_KT = 10.0
"""Temperature at which eta is swept: where the data are too weak to outweigh the prior."""

Advance = Callable[[], None]


@dataclass(frozen=True)
class Run:
    """One run of SVGD on a bench.

    Attributes:
        theta: Particles, shape [P, 2 R].
        scores: How they do.
        convergence: Whether they are at rest.
        seconds, simulating: Wall time of the inference and of the simulation in it [s].
        world_steps: World-steps simulated.
    """

    theta: torch.Tensor
    scores: Scores
    convergence: Convergence
    seconds: float
    simulating: float
    world_steps: int


@dataclass(frozen=True)
class Pair:
    """Runs of one branch at one temperature without and with the inequality prior."""

    branch: int
    kt: float
    eta: float
    without: Run
    with_prior: Run

    @property
    def width_ratio(self) -> float:
        """Width without the prior over that with it; the thesis reports 1.7."""
        return self.without.scores.width / self.with_prior.scores.width

    @property
    def nll_ratio(self) -> float:
        """Negative log-likelihood without the prior over that with it; the thesis reports 1.35."""
        return self.without.scores.nll / self.with_prior.scores.nll

    @property
    def spread_ratio(self) -> float:
        """Geometric mean over the parameters of the spread of their logs without the prior over that with it."""
        ratio = torch.tensor(self.without.scores.spread) / torch.tensor(self.with_prior.scores.spread)
        return float(ratio.log().mean().exp())


def plain(target: Target) -> Whitened:
    """Return the target's density in its own coordinates, the logarithms."""
    zero = torch.zeros(target.num_dims, dtype=torch.float64, device=target.place)
    return Whitened(target, zero, torch.diag(torch.ones_like(zero)))


def run_svgd(bench: Bench, eta: float | None, kt: float, *, particles: int, iterations: int, seed: int) -> Run:
    """Infer a bench's posterior as `bough identify` does, modes first, by SVGD; score where the particles end."""
    target = bench.target(eta, kt)
    began = time.perf_counter()
    posterior = infer(target, method="svgd", particles=particles, iterations=iterations, seed=seed)
    seconds = time.perf_counter() - began
    scores = bench.score(posterior.theta, kt)
    return Run(posterior.theta, scores, posterior.convergence, seconds, target.simulation_seconds, target.world_steps)


def temperature_sweep(
    benches: Sequence[Bench], temperatures: Sequence[float], *, particles: int, iterations: int, seed: int,
    advance: Advance,
) -> list[Pair]:  # fmt: skip
    """Run every branch at every temperature without and with the prior of sharpness `ETA`."""
    pairs = []
    for b, bench in enumerate(benches):
        for kt in temperatures:
            runs = []
            for eta in (None, ETA):
                runs.append(run_svgd(bench, eta, kt, particles=particles, iterations=iterations, seed=seed))
                advance()
            pairs.append(Pair(b, kt, ETA, *runs))
    return pairs


def eta_sweep(pair: Pair, bench: Bench, *, particles: int, iterations: int, seed: int, advance: Advance) -> list[Pair]:
    """Repeat a pair with other sharpnesses of the prior; the run without it is the pair's."""
    out = []
    for eta in ETAS:
        run = pair.with_prior
        if eta != pair.eta:
            run = run_svgd(bench, eta, pair.kt, particles=particles, iterations=iterations, seed=seed)
        advance()
        out.append(Pair(pair.branch, pair.kt, eta, pair.without, run))
    return out
