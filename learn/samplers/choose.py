"""Samplers behind one interface, by name, and one function that draws from any density.

| name | sampler | gradients | draws |
|---|---|---|---|
| ``svgd`` | Stein variational gradient descent | yes | the last positions |
| ``mh`` | Metropolis-Hastings, random walk | no | every chain after the warm-up |
| ``sgld`` | stochastic gradient Langevin dynamics | yes | every chain after the warm-up |
| ``sghmc`` | stochastic gradient Hamiltonian Monte Carlo | yes | every chain after the warm-up |
| ``emcee`` | affine-invariant ensemble | no | every chain after the warm-up |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from ...sim.base.errors import InputError
from .base import AutogradDensity, Density, Sampler, State
from .registry import SAMPLERS

__all__ = ["METHODS", "AutogradDensity", "Density", "Draws", "Sampler", "State", "make_sampler", "sample"]

METHODS = tuple(SAMPLERS.own)
"""Names of bough's samplers."""


@dataclass(frozen=True)
class Draws:
    """Result of a run.

    Attributes:
        method: Name of the sampler.
        particles: Last positions, shape [P, D].
        log_density: Their log densities, shape [P].
        gradient: Their gradients, shape [P, D]; zero for samplers that take none.
        trace: Positions after every iteration, shape [I, P, D].
        log_density_trace: Log densities after every iteration, shape [I, P].
        warm_up: Iterations at the start of the trace that are discarded.
        chain: Whether the trace after the warm-up holds draws, or the last positions alone.
    """

    method: str
    particles: torch.Tensor
    log_density: torch.Tensor
    gradient: torch.Tensor
    trace: torch.Tensor
    log_density_trace: torch.Tensor
    warm_up: int
    chain: bool

    @property
    def draws(self) -> torch.Tensor:
        """All draws, shape [N, D]: chains after the warm-up concatenated, or the particles."""
        return self.trace[self.warm_up :].flatten(0, 1) if self.chain else self.particles


def make_sampler(
    name: str, particles: torch.Tensor, *, iterations: int, seed: int, step_size: float | None = None
) -> Sampler:
    """Make a sampler.

    Args:
        name: One of `METHODS`, or of an installed package (`registry.SAMPLERS`).
        particles: Where particles or chains start, shape [P, D].
        iterations: Length of the run, which schedules of steps and the warm-up (the first half) refer to.
        seed: Of every random number.
        step_size: Step of svgd, sgld or sghmc instead of their own, in units of the population's spread.

    Raises:
        InputError: The name is unknown, the sampler has no step, its particles or iterations cannot be used, or a
            package's sampler raises an error.
    """
    kind = SAMPLERS.of(name, "sampler", "method")
    if step_size is not None and not kind.has_step:
        raise InputError(name, "step_size", f"{step_size:g}", "none: this sampler finds its own")
    if step_size is not None and not 0.0 < step_size <= 1.0:
        raise InputError(name, "step_size", f"{step_size:g}", "above 0, at most 1")
    step = {} if step_size is None else {"step_size": step_size}
    with SAMPLERS.running(name):
        return kind.make(particles, iterations=iterations, seed=seed, **step)


def sample(
    density: Density,
    particles: torch.Tensor,
    *,
    method: str = "svgd",
    iterations: int = 200,
    seed: int = 0,
    step_size: float | None = None,
    progress: Callable[[int], None] = lambda iteration: None,
) -> Draws:
    """Draw from a density.

    Args:
        density: What to draw from; `AutogradDensity` makes one of a torch function.
        particles: Where particles or chains start, shape [P, D].
        method: As the name of `make_sampler`.
        iterations: Number of iterations.
        seed: Of every random number: the same seed gives the same bits.
        step_size: As in `make_sampler`.
        progress: Called with the number of iterations done, after each.

    Raises:
        InputError: As `make_sampler`, or a package's sampler raises an error.
    """
    sampler = make_sampler(method, particles, iterations=iterations, seed=seed, step_size=step_size)
    trace, values = [], []
    for k in range(iterations):
        with SAMPLERS.running(method):
            trace.append(sampler.step(density).clone())
        values.append(sampler.log_density.clone())
        progress(k + 1)
    return Draws(
        method=method,
        particles=sampler.particles,
        log_density=sampler.log_density,
        gradient=sampler.gradient,
        trace=torch.stack(trace),
        log_density_trace=torch.stack(values),
        warm_up=sampler.warm_up,
        chain=sampler.chain,
    )
