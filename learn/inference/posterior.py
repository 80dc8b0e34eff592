"""Sampling a target: modes first, then a sampler in coordinates whitened at the best mode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..cases.case import BranchCase
from ..replay.input_noise import input_colour
from ..runs.checkpoint import Checkpoint
from ..samplers.choose import make_sampler
from ..samplers.diagnostics import Convergence, converged
from ..samplers.registry import SAMPLERS
from ..systems.branch import BranchSystem
from ..systems.system import Parameter, free_of
from .correlated import correlation, score_covariance, widening
from .fit import Modes, find_modes, jacobian_rows, refine, representatives
from .inside import Inside, coordinates_of, values_at
from .target import Target

Progress = Callable[[str, int], None]
#: How often the response to noise of the force is linearised again at the best mode: the first mode, found without it,
#: may be several standard deviations off where that noise dominates.
COLOURINGS = 2
#: Central-difference step in a free coordinate for the slope of the response's power.
COLOUR_STEP = 0.05
#: Largest deviation of a coordinate w by which particles are spread beyond their density.
WIDEST = 4.0


@dataclass(frozen=True)
class Posterior:
    """Particles of a target.

    Attributes:
        parameters: The n unknowns.
        particles: Their values in SI units, shape [P, n].
        theta: The target's vectors, shape [P, D].
        noise: Inferred noise of every channel, shape [P, C].
        log_posterior: Up to a constant, shape [P].
        trace_log_posterior: Of every particle (or chain) at every iteration, shape [I, P].
        trace_mean: Mean of the particles at every iteration, in posterior standard deviations about the mode, [I, D].
        agreement: Share of starts that ended within 3 of the best log posterior.
        convergence: Whether the sampler converged, with its diagnostics.
        geometry: What a branch's springs refer to: ``segment_name``, ``segment_length_m``, ``segment_radius_m``.
        widened: Largest factor by which standard deviations grew because residuals are correlated (`correlated`) or
            recordings differ by more than noise; one where neither is. ``log_posterior`` is that of the particles
            before.
    """

    parameters: tuple[Parameter, ...]
    particles: Array
    theta: torch.Tensor
    noise: Array
    log_posterior: Array
    trace_log_posterior: Array
    trace_mean: Array
    agreement: float
    convergence: Convergence
    geometry: dict[str, Array]
    widened: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return tuple(p.name for p in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """SI units of the unknowns."""
        return tuple(p.unit for p in self.parameters)

    @property
    def free(self) -> torch.Tensor:
        """Free coordinates of the particles, shape [P, n]."""
        return free_of(self.parameters, torch.as_tensor(self.particles))

    def interval(self) -> tuple[Array, Array, Array]:
        """Return median and ends of every parameter's 95 % interval, by a normal fit to its sampling coordinate.

        In that coordinate (`inside`) no end lies outside the box of a parameter that has one.
        """
        w = coordinates_of(self.parameters, torch.as_tensor(self.particles))
        mean, spread = w.mean(0), w.std(0)
        ends = (mean, mean - 1.96 * spread, mean + 1.96 * spread)
        return tuple(values_at(self.parameters, x).cpu().numpy() for x in ends)  # type: ignore[return-value]

    def save(self, path: Path) -> None:
        """Write ``posterior.npz``: names, units, particles [P, n], noise [P, C], log_posterior [P] and the geometry."""
        np.savez(path, names=np.array(self.names), units=np.array(self.units), particles=self.particles,
                 noise=self.noise, log_posterior=self.log_posterior, **self.geometry)  # type: ignore[arg-type] # fmt: skip


def initial_vectors(target: Target, count: int, generator: torch.Generator) -> torch.Tensor:
    """Return start vectors [S, D]: the parameters' typical values, scattered, and the recordings' guessed starts."""
    n = target.num_parameters
    typical = torch.tensor([p.start for p in target.system.parameters], dtype=torch.float64)
    low, high = (end.cpu() for end in target.box)
    scatter = torch.randn(count, n, generator=generator, dtype=torch.float64) * ((high - low) / 8.0).clamp(max=2.0)
    # half of the starts scale all parameters by one factor: the overall scale is the least known
    together = torch.randn(count, 1, generator=generator, dtype=torch.float64) * ((high - low) / 8.0).clamp(max=1.5)
    scatter = torch.where(torch.arange(count)[:, None] % 2 == 0, together, scatter)
    scatter[0] = 0.0
    logs = torch.maximum(torch.minimum(typical + scatter, high), low).to(target.place)
    rows = [logs, target.start0.flatten().expand(count, -1)]
    if target.num_noise:
        rows.append(target.log_noise0.expand(count, -1))
    return torch.cat(rows, 1)


class Whitened:
    """A target's density in coordinates z = L^T (w - centre), L L^T the precision of w at the centre.

    w are the coordinates of `inside`, in which no particle leaves its box. A `samplers.choose.Density`, NaN where a
    simulation is not finite. Gradients combine residuals at z with derivatives of the simulation that are recomputed
    only where a particle has moved by `STALE` standard deviations: within that distance they change by about two
    percent, and each costs two worlds per parameter.

    Args:
        target: The density.
        centre: Coordinates w, shape [D].
        precision: Of w, shape [D, D].

    Attributes:
        inside: Turns w into the target's vectors.
        factor: L, shape [D, D].
        taken_at: Where the derivatives were taken, shape [P, D], or None.
    """

    STALE = 0.5

    def __init__(self, target: Target, centre: torch.Tensor, precision: torch.Tensor) -> None:
        self.target, self.centre = target, centre
        self.inside = inside_of(target)
        self.factor = torch.linalg.cholesky(precision)
        self.taken_at: torch.Tensor | None = None
        self._derivative: torch.Tensor | None = None

    def w(self, z: torch.Tensor) -> torch.Tensor:
        """Return coordinates w [..., D] of z."""
        return self.centre + torch.linalg.solve_triangular(
            self.factor.T, z.reshape(-1, z.shape[-1]).T, upper=True
        ).T.reshape(z.shape)

    def theta(self, z: torch.Tensor) -> torch.Tensor:
        """Return the target's vectors [..., D] of z."""
        return self.inside.theta(self.w(z))

    def z(self, w: torch.Tensor) -> torch.Tensor:
        """Return z [..., D] of coordinates w."""
        return (w - self.centre) @ self.factor

    def evaluate(self, z: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return log density [P] and gradient [P, D]."""
        self._refresh(z)
        w = self.w(z)
        e = self.target.evaluate(self.inside.theta(w), self._derivative)
        gradient = self.inside.gradient(w, e.gradient)
        value = e.log_posterior + self.inside.log_volume(w)
        return value, torch.linalg.solve_triangular(self.factor, gradient.T, upper=False).T

    def take(self, z: torch.Tensor) -> None:
        """Take the derivatives at z [P, D]."""
        self.taken_at, self._derivative = z.clone(), self.target.linearise(self.theta(z))[1]

    def _refresh(self, z: torch.Tensor) -> None:
        """Take the derivatives anew of the particles z [P, D] that moved farthest, all that are stale among them.

        They are a quarter of the particles, or two or three, so that batches of four sizes are built at most.
        """
        if self.taken_at is None or self._derivative is None:
            self.take(z)
            return
        moved = torch.nan_to_num((z - self.taken_at).abs().amax(1), nan=torch.inf)
        stale, quarter = int((moved > self.STALE).sum()), -(-len(z) // 4)
        if stale:
            far = moved.argsort(descending=True, stable=True)[: -(-stale // quarter) * quarter]
            self.taken_at[far], self._derivative[far] = z[far], self.target.linearise(self.theta(z[far]))[1]

    def log_density(self, z: torch.Tensor) -> torch.Tensor:
        """Return the log density [P]."""
        w = self.w(z)
        return self.target.log_density(self.inside.theta(w)) + self.inside.log_volume(w)


def inside_of(target: Target) -> Inside:
    """Return the transform of a target's vectors into the coordinates in which they are sampled."""
    return Inside(target.system.parameters, target.num_dims, target.place)


def widening_at(density: Whitened) -> torch.Tensor | None:
    """Return the matrix [D, D] that widens deviations in z for correlated residuals; None where they are white.

    The residuals are those at the centre, at the noise inferred there. Noise keeps its own spread.
    """
    target, centre = density.target, density.centre[None]
    theta = density.inside.theta(centre)
    prediction, derivative = target.linearise(theta)
    noise = target.split(theta)[2]
    z = target.whiten(target.residual(prediction), noise)[0]
    free = target.num_parameters + target.num_starts
    seen = correlation(z, [len(r.t) for r in target.recordings], free)
    if seen.white:
        return None
    weighed = jacobian_rows(target, derivative) * target.weight[..., None]
    rows = target.whiten(weighed.permute(0, 4, 1, 2, 3), noise)[0] * density.inside.slope(centre)[0, :free].view(
        -1, 1, 1, 1
    )
    curvature, scores = (torch.zeros_like(density.factor) for _ in range(2))
    curvature[:free, :free] = rows.flatten(1) @ rows.flatten(1).T
    scores[:free, :free] = score_covariance(seen, rows)
    return widening(density.factor, curvature, scores)


def infer(
    target: Target,
    *,
    method: str = "svgd",
    particles: int,
    iterations: int,
    seed: int,
    starts: int = 16,
    force_sigma: Array | None = None,
    checkpoint: Checkpoint | None = None,
    name: str = "posterior",
    progress: Progress = lambda stage, done: None,
) -> Posterior:
    """Infer a target's posterior.

    Args:
        target: What to infer.
        method: Sampler, see `samplers.choose.make_sampler`.
        particles: Number of particles, or of chains.
        iterations: Updates of the sampler.
        seed: Seed of all random numbers.
        starts: Starts of the search for modes.
        force_sigma: Noise of a branch's force [N], shape [3], propagated through the model; None takes it as exact.
        checkpoint: Where intermediate states are kept.
        name: Name of this inference in the checkpoint.
        progress: Called with a stage (``modes`` or ``particles``) and the number of steps done.

    Raises:
        InputError: There are too few particles for the unknowns.
    """
    if particles < 2 * target.num_dims:
        found, allowed = (
            str(particles),
            f"{2 * target.num_dims} or more: two for each of the {target.num_dims} unknowns",
        )
        raise InputError("identify", "--particles", found, f"{allowed}, noise and start states counted")
    keep = checkpoint or Checkpoint()
    modes = _modes(target, seed, starts, force_sigma, keep, name, progress)
    return sample(
        target, modes, method=method, particles=particles, iterations=iterations, seed=seed, checkpoint=keep, name=name,
        progress=progress,
    )  # fmt: skip


def sample(
    target: Target, modes: Modes, *, method: str = "svgd", particles: int, iterations: int, seed: int,
    checkpoint: Checkpoint | None = None, name: str = "posterior", progress: Progress = lambda stage, done: None,
    beyond: torch.Tensor | None = None,
) -> Posterior:  # fmt: skip
    """Sample a target's posterior about its modes; arguments as of `infer`.

    ``beyond`` holds standard deviations of the parameters' free coordinates [n] that the density does not know, such as
    by a model that is not quite right. The particles spread by them too.
    """
    keep = checkpoint or Checkpoint()
    found = inside_of(target).modes(modes)
    best = int(found.log_posterior.argmax())
    density = Whitened(target, found.theta[best], found.precision[best])
    generator = torch.Generator().manual_seed(seed + 1)
    first = density.z(spread(found, particles, generator))
    sampler = make_sampler(method, first, iterations=iterations, seed=seed)
    trace_z, trace_p = _restored(sampler, density, keep.load(f"{name}.sampler"))
    progress("particles", len(trace_z))
    for _ in range(len(trace_z), iterations):
        with SAMPLERS.running(method):
            trace_z.append(sampler.step(density).clone())
        trace_p.append(sampler.log_density.clone())
        progress("particles", 1)
        if keep.due(f"{name}.sampler"):
            state = {
                "sampler": sampler.state(), "z": torch.stack(trace_z), "p": torch.stack(trace_p),
                "taken_at": density.taken_at,
            }  # fmt: skip
            keep.save(f"{name}.sampler", state)
    wider = _opened(density, widening_at(density) if target.loss == "gaussian" else None, beyond)
    return _posterior(target, density, sampler, modes, torch.stack(trace_z), torch.stack(trace_p), particles, wider)


def _opened(density: Whitened, wider: torch.Tensor | None, beyond: torch.Tensor | None) -> torch.Tensor | None:
    """Return the matrix [D, D] that widens deviations in z as ``wider`` does and by deviations ``beyond`` [n].

    Covariances add: in z a deviation of w is multiplied by L^T, and that of a bounded parameter is its own over the
    slope there, up to `WIDEST`, which fills the box.
    """
    if beyond is None or not bool((beyond > 0.0).any()):
        return wider
    apart = torch.zeros_like(density.centre)
    apart[: len(beyond)] = (beyond / density.inside.slope(density.centre)[: len(beyond)]).clamp(max=WIDEST)
    more = density.factor.T * apart
    square = torch.eye(len(apart)).to(more) if wider is None else wider @ wider
    value, vector = torch.linalg.eigh(square + more @ more.T)
    return (vector * value.sqrt()) @ vector.T


def _modes(
    target: Target, seed: int, starts: int, force_sigma: Array | None, keep: Checkpoint, name: str, progress: Progress
) -> Modes:
    """Find the modes, then again with noise of the force propagated through the model at the best of them."""
    done = keep.load(f"{name}.modes")
    if done is None:
        generator = torch.Generator().manual_seed(seed)
        modes = find_modes(target, initial_vectors(target, starts, generator), lambda k: progress("modes", k))
        keep.save(f"{name}.modes", {f.name: getattr(modes, f.name) for f in fields(Modes)})
    else:
        modes = Modes(**{f.name: done[f.name] for f in fields(Modes)})
    noisy = isinstance(target.case, BranchCase) and force_sigma is not None and float(np.max(force_sigma)) > 0.0
    if not noisy or target.loss != "gaussian":
        return modes
    for _ in range(COLOURINGS):
        _colour(target, modes.theta[int(modes.log_posterior.argmax())], force_sigma)
        modes = refine(target, modes)
    return modes


def _colour(target: Target, centre: torch.Tensor, force_sigma: Array | None) -> None:
    """Set the noise of a branch's force in its target, propagated through the model at ``centre`` [D]."""
    assert isinstance(target.case, BranchCase) and force_sigma is not None
    u = target.split(centre[None])[0]
    steps = COLOUR_STEP * torch.eye(u.shape[1], dtype=u.dtype, device=u.device)
    sigma = torch.where(target.weight.amax((0, 1)) > 0, target.sigma0, 0.0)
    target.colour = input_colour(
        target.case, target.recordings, target.values(u)[0], force_sigma, sigma,
        nearby=target.values(torch.cat([u + steps, u - steps])), unknowns=target.unknowns, device=target.device,
    )  # fmt: skip
    more, less = target.colour.power.chunk(2)
    target.lean = ((more - less) / (2.0 * COLOUR_STEP), u[0])


def spread(modes: Modes, count: int, generator: torch.Generator) -> torch.Tensor:
    """Draw initial particles [P, D] about the modes in proportion to their Laplace evidence, 1.2 times too wide.

    Modes and particles are in the same coordinates. Starts at the same mode (within three standard deviations) count
    once.
    """
    of = representatives(modes)
    distinct = [i for i in range(len(of)) if of[i] == i and bool(torch.isfinite(modes.log_posterior[i]))]
    evidence = modes.log_posterior[distinct] - 0.5 * torch.logdet(modes.precision[distinct])
    chosen = torch.multinomial(torch.softmax(evidence, 0).cpu(), count, replacement=True, generator=generator)
    factor = torch.linalg.cholesky(modes.precision[distinct])[chosen]
    z = torch.randn(count, factor.shape[-1], generator=generator, dtype=torch.float64).to(factor.device) * 1.2
    off = torch.linalg.solve_triangular(factor.transpose(1, 2), z[..., None], upper=True)[..., 0]
    return modes.theta[torch.tensor(distinct)[chosen]] + off


def _restored(
    sampler: Any, density: Whitened, state: dict[str, Any] | None
) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """Restore a sampler and its density from a checkpoint; return the traces so far."""
    if state is None:
        return [], []
    sampler.load(state["sampler"])
    if state["taken_at"] is not None:
        density.take(state["taken_at"])
    return list(state["z"]), list(state["p"])


def _posterior(
    target: Target, density: Whitened, sampler: Any, modes: Modes, z: torch.Tensor, p: torch.Tensor, particles: int,
    wider: torch.Tensor | None,
) -> Posterior:  # fmt: skip
    last = z[-1]
    verdict = converged(z, chain=sampler.chain, gradient=sampler.gradient)
    drawn, log_p = (last, p[-1]) if not sampler.chain else _thinned(z, p, 4 * particles)
    if wider is not None:
        drawn = drawn.mean(0) + (drawn - drawn.mean(0)) @ wider
    theta = density.theta(drawn)
    u, _, noise = target.split(theta)
    sigma = noise.exp() if target.num_noise else target.log_noise0.exp().expand(len(theta), -1)
    best = modes.log_posterior.max()
    system = target.system
    return Posterior(
        parameters=tuple(system.parameters),
        particles=target.values(u).cpu().numpy(),
        theta=theta,
        noise=(sigma[:, target.groups] * (target.weight.amax((0, 1)) > 0)).cpu().numpy(),
        log_posterior=log_p.cpu().numpy(),
        trace_log_posterior=p.cpu().numpy(),
        trace_mean=z.mean(1).cpu().numpy(),
        agreement=float((modes.log_posterior > best - 3.0).double().mean()),
        convergence=verdict,
        geometry=_geometry(system.branch) if isinstance(system, BranchSystem) else {},
        widened=1.0 if wider is None else float(torch.linalg.eigvalsh(wider).max()),
    )


def _thinned(z: torch.Tensor, p: torch.Tensor, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return at most ``count`` draws, evenly spaced over the second half of all chains."""
    half = len(z) // 2
    flat, log_p = z[half:].flatten(0, 1), p[half:].flatten()
    picked = torch.linspace(0, len(flat) - 1, min(count, len(flat)), device=z.device).round().long()
    return flat[picked], log_p[picked]


def _geometry(branch: Any) -> dict[str, Array]:
    return {
        "segment_name": np.array(branch.segment_name),
        "segment_length_m": np.asarray(branch.length),
        "segment_radius_m": np.asarray(branch.radius),
    }
