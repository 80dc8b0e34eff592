"""Base of all samplers: the density interface, a population of positions, and a state that can be saved.

A population moves to proposed positions and evaluates there. A proposal whose log density or gradient is not finite is
rejected and the member stays, so that a world that diverged does not affect the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Protocol

import torch

from ...sim.base.errors import InputError

State = dict[str, torch.Tensor]


class Density(Protocol):
    """A log density up to a constant, evaluated for a batch of positions [P, D], float64."""

    def evaluate(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the log density [P] and its gradient [P, D]."""
        ...

    def log_density(self, x: torch.Tensor) -> torch.Tensor:
        """Return the log density [P] alone, where that is cheaper."""
        ...


@dataclass(frozen=True)
class AutogradDensity:
    """A `Density` from a differentiable torch function of positions [P, D] to log densities [P]."""

    function: Callable[[torch.Tensor], torch.Tensor]

    def evaluate(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the log density [P] and its gradient [P, D]."""
        leaf = x.detach().requires_grad_()
        value = self.function(leaf)
        (gradient,) = torch.autograd.grad(value.sum(), leaf)
        return value.detach(), gradient

    def log_density(self, x: torch.Tensor) -> torch.Tensor:
        """Return the log density [P]."""
        with torch.no_grad():
            return self.function(x)


class Sampler(Protocol):
    """One way to turn a density into draws.

    Attributes:
        name: What `choose.make_sampler` calls it.
        chain: Whether positions over iterations after the warm-up are draws (chains), or the last positions alone are
            (particles).
        particles: Positions now, shape [P, D].
        log_density: Log density of the positions, shape [P]; -inf where nothing finite is known.
        gradient: Its gradient, shape [P, D]; zero for samplers that take none.
        iteration: Iterations done.
        warm_up: Iterations whose draws are to be dropped.
    """

    name: ClassVar[str]
    chain: ClassVar[bool]
    particles: torch.Tensor
    log_density: torch.Tensor
    gradient: torch.Tensor
    iteration: int
    warm_up: int

    def step(self, density: Density) -> torch.Tensor:
        """Do one iteration and return the positions after it, shape [P, D]."""
        ...

    def state(self) -> State:
        """Return everything needed to go on to the same bits, as tensors."""
        ...

    def load(self, state: State) -> None:
        """Go on from a state of a sampler made with the same arguments."""
        ...


class Population:
    """Positions with their log densities and gradients, a random stream and a counter; base of the samplers.

    Args:
        particles: Where the members start, shape [P, D]; at least two, finite.
        iterations: Length of the run, of which the first half is warm-up.
        seed: Of the random stream.

    Raises:
        InputError: The start positions or the number of iterations cannot be used.
    """

    name: ClassVar[str]
    chain: ClassVar[bool] = True
    kept: ClassVar[tuple[str, ...]] = ()
    """Names of the tensors that a subclass adds to the state."""

    def __init__(self, particles: torch.Tensor, *, iterations: int, seed: int) -> None:
        _check(particles, iterations, self.name)
        self.particles = particles.detach().to(torch.float64).clone()
        self.log_density = torch.full_like(self.particles[:, 0], -torch.inf)
        self.gradient = torch.zeros_like(self.particles)
        self.iteration, self.iterations, self.warm_up = 0, iterations, iterations // 2
        self.generator = torch.Generator(self.particles.device).manual_seed(seed)

    def state(self) -> State:
        """Return everything needed to go on to the same bits, as tensors."""
        names = ("particles", "log_density", "gradient", *self.kept)
        out: State = {name: getattr(self, name).clone() for name in names}
        return out | {"generator": self.generator.get_state(), "iteration": torch.tensor(self.iteration)}

    def load(self, state: State) -> None:
        """Go on from a state of a sampler made with the same arguments."""
        for name in ("particles", "log_density", "gradient", *self.kept):
            setattr(self, name, state[name].to(self.particles.device).clone())
        self.generator.set_state(state["generator"].cpu())
        self.iteration = int(state["iteration"])

    def normal(self, *shape: int) -> torch.Tensor:
        """Return standard normal numbers of the population's random stream."""
        return torch.randn(*shape, generator=self.generator, dtype=torch.float64, device=self.particles.device)

    def begin(self, density: Density) -> None:
        """Evaluate the start positions; members where nothing is finite start with log density -inf."""
        value, gradient = density.evaluate(self.particles)
        fine = finite(value, gradient)
        self.log_density = torch.where(fine, value, -torch.inf)
        self.gradient = torch.where(fine[:, None], gradient, 0.0)

    def move(self, density: Density, proposal: torch.Tensor) -> torch.Tensor:
        """Evaluate the proposal [P, D], move the members for which all is finite there and return who moved, [P]."""
        value, gradient = density.evaluate(proposal)
        fine = finite(value, gradient) & proposal.isfinite().all(1)
        # a member that never had a finite density may move until it finds one
        lost = ~fine & ~self.log_density.isfinite() & proposal.isfinite().all(1)
        self.particles = torch.where((fine | lost)[:, None], proposal, self.particles)
        self.log_density = torch.where(fine, value, self.log_density)
        self.gradient = torch.where(fine[:, None], gradient, self.gradient)
        return fine


def finite(value: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """Return which members' log density [P] and gradient [P, D] are finite, shape [P]."""
    return value.isfinite() & gradient.isfinite().all(1)


def spread(x: torch.Tensor, weight: float = 0.1) -> torch.Tensor:
    """Return the lower Cholesky factor [D, D] of the covariance of positions [P, D], usable for any P >= 2.

    The covariance is shrunk to its diagonal by weight D / (P + weight D), which makes it regular where there are fewer
    members than coordinates, and no standard deviation falls below 1e-9 of the largest coordinate.
    """
    count, dims = x.shape
    centred = x - x.mean(0)
    covariance = centred.T @ centred / count
    floor = (1e-9 * x.abs().max().clamp(min=1e-9)) ** 2
    diagonal = torch.diag(covariance.diagonal() + floor)
    share = weight * dims / (count + weight * dims)
    return torch.linalg.cholesky((1.0 - share) * covariance + share * diagonal + floor * torch.eye(dims).to(x))


def _check(particles: torch.Tensor, iterations: int, name: str) -> None:
    if particles.ndim != 2 or len(particles) < 2 or particles.shape[1] < 1:
        raise InputError(name, "particles", f"shape {list(particles.shape)}", "[P, D] with P >= 2 and D >= 1")
    if not particles.isfinite().all():
        row = int((~particles.isfinite()).any(1).nonzero()[0, 0])
        raise InputError(name, f"particle {row}", "a position that is not finite", "finite start positions")
    if iterations < 2:
        raise InputError(name, "iterations", str(iterations), "2 or more, of which half are warm-up")
