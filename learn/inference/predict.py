"""Posterior predictive distribution of recordings, and its scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
import torch

from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from ..replay.input_noise import input_colour
from ..replay.recording import Recording, beginning
from ..samplers.mixture import Mixture, scott_bandwidth
from ..systems.branch import Unknowns
from ..systems.system import free_of
from .fit import levenberg_marquardt
from .posterior import Posterior
from .target import Target

#: A start state that was not measured is fitted to this much of a held-out recording [s].
START_WINDOW = 0.3
#: Windows per recording in which RMSE is compared with amplitude.
WINDOWS = 12


@dataclass(frozen=True)
class Prediction:
    """Predicted channels of some recordings, lists over recordings of arrays [T, C].

    Attributes:
        median, low, high: Median and 95 % interval of the measurement, noise included.
        measured: The measurement.
        level: Predictive cumulative distribution at the measurement.
        nll: Negative log predictive density of the measurement.
        crps: Continuous ranked probability score, in the channels' unit.
        t: Times [s], arrays [T].
        main: Channels that are scored (displacement, or the outputs of the first kind).
    """

    median: list[Array]
    low: list[Array]
    high: list[Array]
    measured: list[Array]
    level: list[Array]
    nll: list[Array]
    crps: list[Array]
    t: list[Array]
    main: tuple[int, ...]

    @property
    def coverage(self) -> float:
        """Share of measured points inside the 95 % interval."""
        return self.coverage_at(0.95)

    def coverage_at(self, nominal: float) -> float:
        """Share of measured points inside the central interval of a nominal probability."""
        level = self._all("level")
        return float((np.abs(level - 0.5) <= 0.5 * nominal).mean())

    @property
    def width(self) -> float:
        """Mean width of the 95 % interval, in the channels' unit."""
        return float(np.mean(self._all("high") - self._all("low")))

    @property
    def rms(self) -> float:
        """Root mean square error: measured minus median."""
        return float(np.sqrt(np.mean((self._all("measured") - self._all("median")) ** 2)))

    @property
    def mean_nll(self) -> float:
        """Mean negative log predictive density per point; the density is per unit of the channel."""
        return float(self._all("nll").mean())

    @property
    def mean_crps(self) -> float:
        """Mean continuous ranked probability score, in the channels' unit."""
        return float(self._all("crps").mean())

    @property
    def residual(self) -> list[Array]:
        """Measured minus median."""
        return [m - p for m, p in zip(self.measured, self.median, strict=True)]

    def by_amplitude(self) -> tuple[Array, Array]:
        """Return the rms of the measurement (about its mean) and the RMSE in time windows, shapes [W], by amplitude.

        Every recording gives up to `WINDOWS` windows of equal length. Noise does not grow with the amplitude; errors of
        the model do.
        """
        pairs = []
        for y, m in zip(self.measured, self.median, strict=True):
            y, m = y[:, list(self.main)], m[:, list(self.main)]
            centred = y - y.mean(axis=0)
            for part in np.array_split(np.arange(len(y)), min(WINDOWS, max(1, len(y) // 10))):
                pairs.append([np.sqrt(np.mean(centred[part] ** 2)), np.sqrt(np.mean((y - m)[part] ** 2))])
        amplitude, misfit = np.array(sorted(pairs)).T
        return amplitude, misfit

    def _all(self, name: str) -> Array:
        return np.concatenate([a[:, list(self.main)].ravel() for a in getattr(self, name)])


def pooled(parts: Sequence[Prediction]) -> Prediction:
    """Return the predictions of several folds as one."""
    names = ("median", "low", "high", "measured", "level", "nll", "crps", "t")
    return Prediction(**{n: list(chain(*(getattr(p, n) for p in parts))) for n in names}, main=parts[0].main)


def predict(
    case: BranchCase | JointCase, posterior: Posterior, recordings: Sequence[Recording], sigma: torch.Tensor, *,
    unknowns: Unknowns | None = None, force_sigma: Array | None = None, device: object = None,
) -> Prediction:  # fmt: skip
    """Predict recordings from a posterior; start states not known beforehand come from their first 0.3 s.

    The predictive density is a Gaussian kernel density estimate over the particles' simulations at every time step
    (Scott's bandwidth), with the inferred noise of the channel and, where ``force_sigma`` [3] is given, the response
    to noise of the force.
    """
    target = Target(case, recordings, sigma, unknowns=unknowns, device=device)
    theta = _with_starts(case, posterior, recordings, sigma, target, unknowns, device)
    simulated = target.predict(theta)
    noise = torch.as_tensor(posterior.noise, device=target.place)[:, None] ** 2
    coloured = None
    if force_sigma is not None and float(np.max(force_sigma)) > 0.0:
        assert isinstance(case, BranchCase)
        centre = target.values(posterior.free.to(target.place).mean(0))
        coloured = input_colour(
            case, recordings, centre, force_sigma, sigma, unknowns=unknowns, device=device
        ).variance(simulated.shape[2:])  # type: ignore[arg-type] # fmt: skip
    estimated = sigma.to(target.place) ** 2
    found = [
        _scores(
            r,
            simulated[:, j, : len(r.t)],
            noise if coloured is None else noise + estimated * coloured[j, : len(r.t)],
        )
        for j, r in enumerate(recordings)
    ]
    columns = {name: [f[name] for f in found] for name in found[0]}
    return Prediction(
        **columns, measured=[r.output for r in recordings], t=[r.t for r in recordings], main=main_channels(case)
    )


def _scores(recording: Recording, clean: torch.Tensor, variance: torch.Tensor) -> dict[str, Array]:
    """Quantiles and scores of a recording from the particles' simulations [P, T, C] and the noise's variance."""
    y = torch.as_tensor(recording.output, device=clean.device)
    floor = 1e-12 + 1e-6 * y.abs().amax(0)  # a positive width for channels without noise or motion
    deviation = torch.sqrt(scott_bandwidth(clean) ** 2 + variance + floor**2)
    mixture = Mixture(clean, deviation.expand_as(clean))
    out = {
        "median": mixture.quantile(0.5), "low": mixture.quantile(0.025), "high": mixture.quantile(0.975),
        "level": mixture.cdf(y), "nll": -mixture.log_density(y), "crps": mixture.crps(y),
    }  # fmt: skip
    return {name: value.cpu().numpy() for name, value in out.items()}


def main_channels(case: BranchCase | JointCase) -> tuple[int, ...]:
    """Displacement of a branch; of joints, the channels of the first output's quantity."""
    if isinstance(case, BranchCase):
        return (0, 2) if case.planar else (0, 1, 2)
    return tuple(i for i, o in enumerate(case.channels) if o.quantity == case.channels[0].quantity)


def _with_starts(
    case: BranchCase | JointCase, posterior: Posterior, recordings: Sequence[Recording], sigma: torch.Tensor,
    target: Target, unknowns: Unknowns | None, device: object,
) -> torch.Tensor:  # fmt: skip
    """Return the target's vectors [P, D] with parameters from the posterior and start states fitted to the window."""
    shared = free_of(posterior.parameters, torch.as_tensor(posterior.particles, device=target.place))
    count = len(shared)
    rows = [shared, target.start0.flatten().expand(count, -1), target.log_noise0.expand(count, -1)]
    theta = torch.cat(rows, 1)
    if not target.num_starts:
        return theta
    cut = [first_moments(r, START_WINDOW) for r in recordings]
    window = Target(case, cut, sigma, unknowns=unknowns, device=device)
    return levenberg_marquardt(window, theta, iterations=12, frozen=target.num_parameters)


def first_moments(recording: Recording, seconds: float) -> Recording:
    """Return the first seconds of a recording."""
    n = max(4, int(np.searchsorted(recording.t, recording.t[0] + seconds)))
    return beginning(recording, n)
