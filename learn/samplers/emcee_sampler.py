"""The affine-invariant ensemble sampler of Goodman and Weare (2010) through emcee, as an independent reference."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from .base import Density, Population


class Emcee(Population):
    """Stretch moves of emcee (Foreman-Mackey et al. 2013), an independent implementation.

    Runs on the host; asks for log densities alone, half of the chains at a time.

    Raises:
        InputError: There are fewer than 2 D particles, which would confine them to a subspace.
    """

    name = "emcee"
    kept = ("key", "place")

    def __init__(self, particles: torch.Tensor, *, iterations: int, seed: int) -> None:
        super().__init__(particles, iterations=iterations, seed=seed)
        count, dims = self.particles.shape
        if count < 2 * dims:
            raise InputError(self.name, "particles", str(count), f"{2 * dims} or more, twice the {dims} coordinates")
        self._keep(np.random.RandomState(seed).get_state(legacy=True))

    def step(self, density: Density) -> torch.Tensor:
        """Do one iteration and return the positions after it, shape [P, D]."""
        import emcee

        def log_density(x: Array) -> Array:
            """Return the log density of positions [P, D], shape [P], -inf where it is not finite."""
            value = density.log_density(torch.as_tensor(x).to(self.particles)).cpu().numpy()
            return np.where(np.isfinite(value), value, -np.inf)

        x = self.particles.cpu().numpy()
        if self.iteration == 0:
            self.log_density = torch.as_tensor(log_density(x)).to(self.particles)
        state = emcee.State(x, log_prob=self.log_density.cpu().numpy(), random_state=self._random_state())
        ensemble = emcee.EnsembleSampler(*x.shape, log_density, vectorize=True)
        # emcee logs a warning on the start positions' condition, which prior draws of odd units would raise
        moves = ensemble.sample(state, iterations=1, store=False, skip_initial_state_check=True)
        with np.errstate(invalid="ignore"):  # from -inf to -inf is a NaN ratio, which emcee refuses
            after = next(iter(moves))
        self.particles = torch.as_tensor(after.coords.copy()).to(self.particles)
        self.log_density = torch.as_tensor(after.log_prob.copy()).to(self.particles)
        self._keep(after.random_state)
        self.iteration += 1
        return self.particles

    def _keep(self, state: Any) -> None:
        """Keep a state of numpy's Mersenne twister as tensors: its 624 words, and (position, has, cached normal)."""
        _, key, position, has, cached = state
        self.key = torch.as_tensor(key.astype(np.int64))
        self.place = torch.tensor([position, has, cached], dtype=torch.float64)

    def _random_state(self) -> Any:
        position, has, cached = self.place.tolist()
        return ("MT19937", self.key.cpu().numpy().astype(np.uint32), int(position), int(has), cached)
