"""Chains, many in one batch: Metropolis-Hastings, stochastic gradient Langevin and Hamiltonian dynamics.

During the warm-up the covariance of the population scales the proposals; for the second half of the run it is frozen,
so that each chain is Markov.
"""

from __future__ import annotations

from typing import ClassVar

import torch

from .base import Density, Population, spread

ACCEPTANCE = 0.234
"""Share of accepted proposals that random walks are tuned to (Roberts, Gelman and Gilks 1997)."""


class MetropolisHastings(Population):
    """Random-walk Metropolis-Hastings with adaptive proposals (Andrieu and Thoms 2008, algorithm 4).

    During the warm-up the scale follows Robbins and Monro to an acceptance of 0.234 and the covariance the population;
    both have gain k^-0.6. Asks for log densities alone.

    Attributes:
        log_scale: Logarithm of the proposal's scale, shape [].
        factor: Lower Cholesky factor of the proposal's covariance, shape [D, D].
        accepted: Share of proposals accepted since the warm-up, shape [P].
    """

    name = "mh"
    kept = ("log_scale", "factor", "accepted")

    def __init__(self, particles: torch.Tensor, *, iterations: int, seed: int) -> None:
        super().__init__(particles, iterations=iterations, seed=seed)
        dims = self.particles.shape[1]
        self.log_scale = torch.tensor(2.38 / dims**0.5).to(self.particles).log()
        self.factor = spread(self.particles)
        self.accepted = torch.zeros_like(self.log_density)

    def begin(self, density: Density) -> None:
        """Evaluate the start positions, without gradients."""
        value = density.log_density(self.particles)
        self.log_density = torch.where(value.isfinite(), value, -torch.inf)

    def step(self, density: Density) -> torch.Tensor:
        """Do one iteration and return the positions after it, shape [P, D]."""
        if self.iteration == 0:
            self.begin(density)
        noise = self.normal(*self.particles.shape)
        uniform = torch.rand(len(noise), generator=self.generator, dtype=torch.float64, device=noise.device)
        proposal = self.particles + self.log_scale.exp() * noise @ self.factor.T
        value = density.log_density(proposal)
        ratio = torch.where(value.isfinite(), value - self.log_density, -torch.inf)
        accept = uniform.log() < ratio
        self.particles = torch.where(accept[:, None], proposal, self.particles)
        self.log_density = torch.where(accept, value, self.log_density)
        self.iteration += 1
        if self.iteration <= self.warm_up:
            self._adapt(ratio.exp().clamp(max=1.0).mean())
        else:
            done = self.iteration - self.warm_up
            self.accepted += (accept.double() - self.accepted) / done
        return self.particles

    def _adapt(self, acceptance: torch.Tensor) -> None:
        gain = (self.iteration + 1.0) ** -0.6
        # a gain of one at the start: the scale may have to fall by a factor of a hundred from a wide prior
        self.log_scale = self.log_scale + 3.0 * gain * (acceptance - ACCEPTANCE)
        self.factor = _towards(self.factor, spread(self.particles), gain)


class Dynamics(Population):
    """Base of the samplers that follow the gradient, without an acceptance test.

    They move in coordinates whitened by a preconditioner that adapts in the warm-up and is constant afterwards: the
    covariance of the population, scaled down where gradients are larger than that covariance explains (as in
    RMSprop: Li, Chen, Carlson and Carin 2016). Starts that are far too wide therefore contract geometrically. The drift
    is bounded by 2 sqrt(h) per coordinate (tamed), which affects no draw within four standard deviations; during the
    warm-up by three times its root mean square over the population, if that is more.

    Attributes:
        factor: Lower triangular factor of the preconditioner, shape [D, D].
    """

    kept: ClassVar[tuple[str, ...]] = ("factor",)

    def __init__(self, particles: torch.Tensor, *, iterations: int, seed: int) -> None:
        super().__init__(particles, iterations=iterations, seed=seed)
        self.factor = spread(self.particles)

    def begin(self, density: Density) -> None:
        """Evaluate the start positions and scale the preconditioner to the gradients there."""
        super().begin(density)
        self.factor = self._scaled()

    def drift(self, h: float) -> torch.Tensor:
        """Return h times the whitened gradient, bounded, shape [P, D]."""
        drift = h * self.gradient @ self.factor
        bound = torch.full_like(drift[0], 2.0 * h**0.5)
        if self.iteration < self.warm_up:
            bound = torch.maximum(bound, 3.0 * (drift**2).mean(0).sqrt())
        return torch.maximum(torch.minimum(drift, bound), -bound)

    def count(self) -> None:
        """Count an iteration, and adapt the preconditioner while the warm-up lasts."""
        self.iteration += 1
        if self.iteration <= self.warm_up:
            self.factor = _towards(self.factor, self._scaled(), 0.2)

    def _scaled(self) -> torch.Tensor:
        """Return the population's Cholesky factor, scaled so that whitened gradients are about one or less, [D, D]."""
        factor = spread(self.particles)
        size = ((self.gradient @ factor) ** 2).mean(0).sqrt()
        return factor / size.clamp(min=1.0).sqrt()


class Langevin(Dynamics):
    """Stochastic gradient Langevin dynamics (Welling and Teh 2011), preconditioned.

    x' = x + h/2 grad log p(x) + sqrt(h) xi in whitened coordinates. As published there is no acceptance test: h falls
    during the warm-up as (1 + k)^(-1/3) to the value that it keeps, and the variance of a normal target comes out
    1 / (1 - h/4) times too large.

    Args:
        particles: Where the chains start, shape [P, D].
        iterations: Length of the run.
        seed: Of the random stream.
        step_size: Step h after the warm-up, in squared standard deviations.
    """

    name = "sgld"

    def __init__(self, particles: torch.Tensor, *, iterations: int, seed: int, step_size: float = 0.2) -> None:
        super().__init__(particles, iterations=iterations, seed=seed)
        self.step_size = step_size

    def step(self, density: Density) -> torch.Tensor:
        """Do one iteration and return the positions after it, shape [P, D]."""
        if self.iteration == 0:
            self.begin(density)
        h = self.step_size
        if self.iteration < self.warm_up:
            h = min(1.0, max(h, 4.0 * h * (1.0 + self.iteration) ** (-1 / 3)))
        noise = h**0.5 * self.normal(*self.particles.shape)
        # half of h: the bound is then 2 sqrt(h / 2)
        self.move(density, self.particles + (self.drift(0.5 * h) + noise) @ self.factor.T)
        self.count()
        return self.particles


class Hamiltonian(Dynamics):
    """Stochastic gradient Hamiltonian Monte Carlo (Chen, Fox and Guestrin 2014, eq. 15), preconditioned.

    v' = (1 - a) v + h grad log p(x) + sqrt(2 a h) xi and x' = x + v' in whitened coordinates, with no estimate of the
    gradient's noise. As published there is no acceptance test: the variance of a normal target comes out
    1 / (1 - h / (2 (2 - a))) times too large. A chain that meets a density that is not finite stays and turns round.

    Attributes:
        velocity: Velocity in whitened coordinates, shape [P, D].

    Args:
        particles: Where the chains start, shape [P, D].
        iterations: Length of the run.
        seed: Of the random stream.
        step_size: Learning rate h, in squared standard deviations.
        friction: Friction a of one iteration, in (0, 1).
    """

    name = "sghmc"
    kept = ("factor", "velocity")

    def __init__(
        self, particles: torch.Tensor, *, iterations: int, seed: int, step_size: float = 0.1, friction: float = 0.5
    ) -> None:
        super().__init__(particles, iterations=iterations, seed=seed)
        self.step_size, self.friction = step_size, friction
        self.velocity = torch.zeros_like(self.particles)

    def step(self, density: Density) -> torch.Tensor:
        """Do one iteration and return the positions after it, shape [P, D]."""
        if self.iteration == 0:
            self.begin(density)
        a, h = self.friction, self.step_size
        noise = (2.0 * a * h) ** 0.5 * self.normal(*self.particles.shape)
        velocity = (1.0 - a) * self.velocity + self.drift(h) + noise
        fine = self.move(density, self.particles + velocity @ self.factor.T)
        self.velocity = torch.where(fine[:, None], velocity, -velocity)
        self.count()
        return self.particles


def _towards(factor: torch.Tensor, now: torch.Tensor, gain: float) -> torch.Tensor:
    """Move the matrix with Cholesky factor [D, D] towards that of another factor by a share ``gain``."""
    return torch.linalg.cholesky((1.0 - gain) * factor @ factor.T + gain * now @ now.T)
