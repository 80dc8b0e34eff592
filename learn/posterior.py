"""From a target to particles: modes first, then SVGD in coordinates whitened at the best of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ..sim.tree import Array
from .fit import Modes, find_modes
from .plant import box_of
from .svgd import svgd
from .target import Target


@dataclass(frozen=True)
class Posterior:
    """Particles of a target.

    Attributes:
        names, units: Of the n parameters.
        particles: Parameters in SI units, shape [P, n].
        theta: The target's own vectors, shape [P, D].
        noise: Inferred noise of every channel, shape [P, C].
        log_posterior: Up to a constant, shape [P].
        trace_log_posterior, trace_misfit: Of every particle at every iteration, shape [I, P].
        agreement: Share of starts that ended within 3 of the best log posterior.
        drift: Largest change of a parameter's mean over the last tenth of the iterations, in posterior deviations.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    particles: Array
    theta: torch.Tensor
    noise: Array
    log_posterior: Array
    trace_log_posterior: Array
    trace_misfit: Array
    agreement: float
    drift: float

    def interval(self) -> tuple[Array, Array, Array]:
        """Return median, lower and upper end of every parameter's 95 % interval, by a normal fit to its logarithm."""
        logs = np.log(self.particles)
        mean, spread = logs.mean(0), logs.std(0, ddof=1)
        return np.exp(mean), np.exp(mean - 1.96 * spread), np.exp(mean + 1.96 * spread)

    def save(self, path: Path) -> None:
        """Write ``posterior.npz``: names, units, particles [P, n], noise [P, C], log_posterior [P]."""
        np.savez(path, names=np.array(self.names), units=np.array(self.units), particles=self.particles,
                 noise=self.noise, log_posterior=self.log_posterior)  # fmt: skip


def initial_vectors(target: Target, count: int, generator: torch.Generator) -> torch.Tensor:
    """Return start vectors [S, D]: the plant's typical values, scattered, and the recordings' guessed start states."""
    n = target.num_parameters
    typical = torch.as_tensor(target.plant.typical).log()
    low, high = box_of(target.plant.parameters)
    scatter = torch.randn(count, n, generator=generator, dtype=torch.float64) * ((high - low) / 8.0).clamp(max=2.0)
    # half of the starts scale all parameters together: the overall size is the least known
    together = torch.randn(count, 1, generator=generator, dtype=torch.float64) * ((high - low) / 8.0).clamp(max=1.5)
    scatter = torch.where(torch.arange(count)[:, None] % 2 == 0, together, scatter)
    scatter[0] = 0.0
    logs = torch.maximum(torch.minimum(typical + scatter, high), low).to(target.place)
    rows = [logs, target.start0.flatten().expand(count, -1)]
    if target.num_noise:
        rows.append(target.log_noise0.expand(count, -1))
    return torch.cat(rows, 1)


def infer(
    target: Target,
    *,
    particles: int,
    iterations: int,
    seed: int,
    starts: int = 16,
    progress: Callable[[str, int], None] = lambda stage, done: None,
) -> Posterior:
    """Infer a target's posterior.

    Args:
        target: What to infer.
        particles: Number of particles P.
        iterations: SVGD updates.
        seed: Of every random number used.
        starts: Starts of the search for modes.
        progress: Called with a stage (``modes`` or ``particles``) and the number of steps done.
    """
    generator = torch.Generator().manual_seed(seed)
    modes = find_modes(target, initial_vectors(target, starts, generator), lambda k: progress("modes", k))
    best = int(modes.log_posterior.argmax())
    whitener = torch.linalg.cholesky(modes.precision[best])
    x = _spread(modes, whitener, particles, generator)
    centre = modes.theta[best]
    trace_p, trace_m, means = [], [], []

    def density(z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        theta = centre + torch.linalg.solve_triangular(whitener.T, z.T, upper=True).T
        e = target.evaluate(theta)
        trace_p.append(e.log_posterior.cpu().numpy())
        squares = (target.residual(e.prediction)[..., target.groups == 0] ** 2).sum((-1, -2, -3))
        trace_m.append((squares / target.per_group[0]).sqrt().cpu().numpy())
        return e.log_posterior, torch.linalg.solve_triangular(whitener, e.gradient.T, upper=False).T

    z = (x - centre) @ whitener
    for iteration in svgd(density, z, iterations=iterations, kernel="coordinate"):
        z = iteration.particles
        means.append(z.mean(0))
        progress("particles", 1)
    theta = centre + torch.linalg.solve_triangular(whitener.T, z.T, upper=True).T
    tail = torch.stack(means[-max(2, iterations // 10) :])
    return _posterior(
        target, theta, modes, np.array(trace_p), np.array(trace_m), float((tail[-1] - tail[0]).abs().max())
    )


def _spread(modes: Modes, whitener: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
    """Place particles about the modes in proportion to their posterior, a little wider than they will end."""
    share = torch.softmax(modes.log_posterior, 0)
    chosen = torch.multinomial(share.cpu(), count, replacement=True, generator=generator)
    z = torch.randn(count, whitener.shape[0], generator=generator, dtype=torch.float64).to(whitener.device) * 1.2
    return modes.theta[chosen] + torch.linalg.solve_triangular(whitener.T, z.T, upper=True).T


def _posterior(
    target: Target, theta: torch.Tensor, modes: Modes, trace_p: Array, trace_m: Array, drift: float
) -> Posterior:
    u, _, noise = target.split(theta)
    sigma = noise.exp() if target.num_noise else target.log_noise0.exp().expand(len(theta), -1)
    best = modes.log_posterior.max()
    return Posterior(
        names=tuple(p.name for p in target.plant.parameters),
        units=tuple(p.unit for p in target.plant.parameters),
        particles=u.exp().cpu().numpy(),
        theta=theta,
        noise=sigma[:, target.groups].cpu().numpy(),
        log_posterior=trace_p[-1],
        trace_log_posterior=trace_p,
        trace_misfit=trace_m,
        agreement=float((modes.log_posterior > best - 3.0).double().mean()),
        drift=drift,
    )
