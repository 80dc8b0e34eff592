"""The posterior of an earlier case as the prior of the next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from ...sim.base.archive import read_arrays
from ...sim.base.errors import InputError
from ..systems.system import Parameter, free_of
from .prior import Prior

#: What the posterior of an earlier case is, as errors say it.
EARLIER = "the posterior.npz that bough identify writes"


class EarlierPosterior(Prior):
    """Gaussian kernel density of particles over some of the coordinates of theta; the others get no density.

    The kernel's covariance is that of the particles times h^2, h = P^(-1 / (m + 4)) (Scott 1992, Multivariate Density
    Estimation). Kernels sit at the particles drawn towards their mean by sqrt(1 - h^2), so that the density has the
    particles' own mean and covariance (West 1993, J. R. Stat. Soc. B 55:409): in six dimensions 64 plain kernels would
    make it a fifth wider, and hollow, since particles of SVGD lie on a shell. The density is normalised.

    Args:
        index: Which m coordinates of theta, shape [m].
        particles: Their values, more than m and not in a plane, float64, shape [P, m].

    Raises:
        torch.linalg.LinAlgError: The particles' covariance is not positive definite.
    """

    index: torch.Tensor
    particles: torch.Tensor
    whitener: torch.Tensor

    def __init__(self, index: torch.Tensor, particles: torch.Tensor) -> None:
        super().__init__()
        count, m = particles.shape
        squared_width = count ** (-2.0 / (m + 4))
        factor = torch.linalg.cholesky(torch.cov(particles.T).reshape(m, m) * squared_width)
        centre = particles.mean(0)
        particles = centre + (1.0 - squared_width) ** 0.5 * (particles - centre)
        self.register_buffer("index", index)
        self.register_buffer("particles", particles)
        self.register_buffer("whitener", torch.linalg.inv(factor))
        self.constant = -float(factor.diagonal().log().sum()) - 0.5 * m * math.log(2.0 * math.pi) - math.log(count)

    def forward(self, theta: torch.Tensor) -> torch.Tensor:
        """Return the log density, shape [...]."""
        offset = (theta[..., None, self.index] - self.particles) @ self.whitener.T
        return torch.logsumexp(-0.5 * (offset**2).sum(-1), -1) + self.constant


def read_earlier(path: str | Path, parameters: Sequence[Parameter]) -> EarlierPosterior:
    """Return the posterior of an earlier case as a prior for the parameters of the same names.

    Args:
        path: A ``posterior.npz`` with names [n], units [n] and particles [P, n] in SI units; other arrays are passed
            over.
        parameters: Of the next case, in the order of theta.

    Raises:
        InputError: The file is missing, no such archive or lacks an array; shapes or types do not fit; no name is
            common, or one has another unit; a particle is not finite, or not positive where it must be; the particles
            are too few or too alike for a density.
    """
    file = Path(path)
    names, units, particles = read_particles(file)
    index = [i for i, p in enumerate(parameters) if p.name in names]
    if not index:
        found = f"no parameter of this case, only {', '.join(names)}"
        raise InputError(file, "names", found, f"at least one of {', '.join(p.name for p in parameters)}")
    common = [parameters[i] for i in index]
    columns = [names.index(p.name) for p in common]
    for p, column in zip(common, columns, strict=True):
        if units[column] != p.unit:
            raise InputError(file, f"units, {p.name}", repr(units[column]), repr(p.unit))
        _check_values(file, p, particles[:, column])
    free = free_of(common, torch.from_numpy(particles[:, columns]))
    _check_spread(file, free)
    return EarlierPosterior(torch.tensor(index), free)


def read_particles(file: Path) -> tuple[list[str], list[str], np.ndarray]:
    """Return names [n], units [n] and particles [P, n], float64, of a posterior; other arrays are passed over.

    Raises:
        InputError: The file is missing, no such archive or lacks an array; shapes or types do not fit.
    """
    keys = ("names", "units", "particles")
    found = read_arrays(file, EARLIER, keys)
    names, units, particles = (found[key] for key in keys)
    _check_arrays(file, names, units, particles)
    return names.tolist(), units.tolist(), particles.astype(np.float64)


def _check_arrays(file: Path, names: np.ndarray, units: np.ndarray, particles: np.ndarray) -> None:
    for key, array, kinds, allowed, dims in (
        ("names", names, "U", "text", 1),
        ("units", units, "U", "text", 1),
        ("particles", particles, "fiu", "numbers", 2),
    ):
        if array.dtype.kind not in kinds or array.ndim != dims:
            found = f"type {array.dtype}, shape {list(array.shape)}"
            raise InputError(file, key, found, f"{allowed} in {dims} dimension{'s'[: dims - 1]}")
    if not len(names) == len(units) == particles.shape[1]:
        found = f"{len(names)} names, {len(units)} units, {particles.shape[1]} columns of particles"
        raise InputError(file, "", found, "as many of each")
    twice = [name for name in names.tolist() if names.tolist().count(name) > 1]
    if twice:
        raise InputError(file, "names", f"{twice[0]} twice", "each name once")


def _check_values(file: Path, parameter: Parameter, values: np.ndarray) -> None:
    positive = parameter.scale == "log"
    wrong = np.flatnonzero(~np.isfinite(values) | (positive & (values <= 0.0)))
    if len(wrong):
        allowed = "finite numbers above 0" if positive else "finite numbers"
        raise InputError(file, f"particles, row {wrong[0]}, {parameter.name}", f"{values[wrong[0]]:g}", allowed)


def _check_spread(file: Path, free: torch.Tensor) -> None:
    """Raise `InputError` where a covariance would be singular to half the digits of a float64."""
    count, m = free.shape
    if count <= m:
        raise InputError(file, "particles", f"{count} particles of {m} parameters in common", f"at least {m + 1}")
    centred = free - free.mean(0)
    spread = centred.std(0)
    smallest = torch.linalg.svdvals(centred / spread)[-1] if bool((spread > 0.0).all()) else 0.0
    if smallest < 1e-6 * math.sqrt(count):
        raise InputError(file, "particles", "particles that all lie in a plane", "spread in every direction")
