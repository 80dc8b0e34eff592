"""What a posterior predicts of recordings it has not seen, and how well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ..sim.tree import Array
from .case import BranchCase, JointCase
from .fit import levenberg_marquardt
from .posterior import Posterior
from .rollout import Recording
from .target import Target

#: A start state that was not measured is taken from this much of a held-out recording [s].
START_WINDOW = 0.3
DRAWS = 64


@dataclass(frozen=True)
class Prediction:
    """Predicted channels of some recordings, lists over recordings of arrays [T, C].

    Attributes:
        median, low, high: Median and 95 % interval of what a sensor would read, noise included.
        measured: What it read.
        t: Times [s], arrays [T].
        main: Channels that the scores are about (displacement, or the outputs of the first kind).
    """

    median: list[Array]
    low: list[Array]
    high: list[Array]
    measured: list[Array]
    t: list[Array]
    main: tuple[int, ...]

    @property
    def coverage(self) -> float:
        """Share of measured points inside the interval."""
        inside = [
            (m >= a) & (m <= b)
            for m, a, b in zip(self._of(self.measured), self._of(self.low), self._of(self.high), strict=True)
        ]
        return float(np.concatenate([i.ravel() for i in inside]).mean())

    @property
    def width(self) -> float:
        """Mean width of the interval, in the channels' unit."""
        return float(
            np.concatenate(
                [(b - a).ravel() for a, b in zip(self._of(self.low), self._of(self.high), strict=True)]
            ).mean()
        )

    @property
    def rms(self) -> float:
        """Root mean square of measured minus median."""
        return float(np.sqrt(np.mean(np.concatenate([r.ravel() ** 2 for r in self._of(self.residual)]))))

    @property
    def residual(self) -> list[Array]:
        """Measured minus median."""
        return [m - p for m, p in zip(self.measured, self.median, strict=True)]

    def _of(self, arrays: Sequence[Array]) -> list[Array]:
        return [a[:, list(self.main)] for a in arrays]


def predict(
    case: BranchCase | JointCase, posterior: Posterior, recordings: Sequence[Recording], sigma: torch.Tensor, *,
    seed: int, device: object = None,
) -> Prediction:  # fmt: skip
    """Predict recordings from a posterior; start states not known beforehand come from their first 0.3 s.

    The interval is that of the particles' simulations with their inferred noise added.
    """
    target = Target(case, recordings, sigma, device=device)
    theta = _with_starts(case, posterior, recordings, sigma, target, device)
    simulated = target.predict(theta).cpu().numpy()
    rng = np.random.default_rng(seed)
    low, median, high, measured = [], [], [], []
    for j, recording in enumerate(recordings):
        clean = simulated[:, j, : len(recording.t)]
        noise = (
            rng.normal(size=(DRAWS, *clean.shape)) if clean.size * DRAWS < 5e7 else rng.normal(size=(8, *clean.shape))
        )
        read = (clean + noise * posterior.noise[:, None, :]).reshape(-1, *clean.shape[1:])
        a, b = np.quantile(read, [0.025, 0.975], axis=0)
        low.append(a)
        high.append(b)
        median.append(np.median(clean, axis=0))
        measured.append(recording.output)
    return Prediction(median, low, high, measured, [r.t for r in recordings], main_channels(case))


def main_channels(case: BranchCase | JointCase) -> tuple[int, ...]:
    """Displacement of a branch; of joints, the channels of the first output's quantity."""
    if isinstance(case, BranchCase):
        return (0, 2) if case.planar else (0, 1, 2)
    return tuple(i for i, o in enumerate(case.outputs) if o.quantity == case.outputs[0].quantity)


def _with_starts(
    case: BranchCase | JointCase, posterior: Posterior, recordings: Sequence[Recording], sigma: torch.Tensor,
    target: Target, device: object,
) -> torch.Tensor:  # fmt: skip
    """Return the target's vectors [P, D] with parameters from the posterior and start states fitted to the window."""
    shared = torch.as_tensor(np.log(posterior.particles), device=target.place)
    count = len(shared)
    rows = [shared, target.start0.flatten().expand(count, -1), target.log_noise0.expand(count, -1)]
    theta = torch.cat(rows, 1)
    if not target.num_starts:
        return theta
    cut = [_first(r, START_WINDOW) for r in recordings]
    window = Target(case, cut, sigma, device=device)
    return levenberg_marquardt(window, theta, iterations=12, frozen=target.num_parameters)


def _first(recording: Recording, seconds: float) -> Recording:
    n = max(4, int(np.searchsorted(recording.t, recording.t[0] + seconds)))
    return replace(recording, t=recording.t[:n], input=recording.input[:n], output=recording.output[:n])
