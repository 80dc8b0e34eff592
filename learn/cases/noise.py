"""Noise of every measured channel, estimated from the data before any model is fitted.

Three estimates, each of which can only be too large where its assumption fails:

- quiet: scatter in windows where the true value is known not to change (open gripper, branch not yet touched);
- replicates: half the variance of the difference of two recordings of the same experiment (pure error);
- differences: the m-th difference of white noise has variance binomial(2m, m) sigma^2, and a smooth signal leaves less
  in it the higher m is, as long as it is sampled more than six times a period. Median absolute deviations keep the few
  samples around a release out. Of rounded samples the median is that of grouped data, with Sheppard's correction: the
  differences are whole counts, and their plain median a whole count too, up to a third beside the deviation.

Since a failure only adds variance, the pooled value uses the smallest estimate and all that agree with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from ...sim.base.types import Array
from .case import BRANCH_COLUMNS, DERIVATIVE_NOISE, BranchCase, JointCase
from .columns import resolution

ORDERS = tuple(range(2, 11))
AGREE = 2.0
"""Estimates that differ by less than this many of their standard errors are pooled."""
#: Steps, relative to the differences' median, that round nothing.
FINE = 1e-3
_MAD = 1.4826
_QUIET_MIN = 4


@dataclass(frozen=True)
class NoiseEstimate:
    """Standard deviation of the white noise on C channels, in the channels' SI units.

    Attributes:
        channel: Names of the channels, length C: the columns of the case's CSV without the clock and the input.
        sigma: Pooled estimate, shape [C].
        by_method: Estimate of each method that applies, shape [C], NaN where it does not.
    """

    channel: tuple[str, ...]
    sigma: Array
    by_method: dict[str, Array]

    def of(self, *channels: str) -> Array:
        """Sigma of some channels, in the order given."""
        return self.sigma[[self.channel.index(name) for name in channels]]

    @property
    def force(self) -> Array:
        """Sigma of a branch case's force [N], shape [3]."""
        return self.of(*BRANCH_COLUMNS[1:4])

    @property
    def displacement(self) -> Array:
        """Sigma of a branch case's displacement [m], shape [3]."""
        return self.of(*BRANCH_COLUMNS[4:7])

    @property
    def velocity(self) -> Array:
        """Sigma of a branch case's velocity [m/s], shape [3]."""
        return self.of(*BRANCH_COLUMNS[7:10])


def estimate_noise(case: BranchCase | JointCase) -> NoiseEstimate:
    """Estimate the noise of every channel of a case.

    A channel that a method cannot judge (no replicates, no quiet window) is NaN in that method. No estimate is below
    the channel's rounding, resolution / sqrt(12). On slowly sampled fast motion (fewer than six samples a period) the
    differences are too large; quiet windows and replicates then decide.
    """
    channel, signals, quiet = _channels(case)
    pairs = [(i, t.replicate_of) for i, t in enumerate(case.trajectories) if t.replicate_of is not None]
    rounding = _rounding(case, signals) / np.sqrt(12)
    methods = {
        "quiet": [quiet_sigma([s[:, c] for s in signals], [q[:, c] for q in quiet]) for c in range(len(channel))],
        "replicates": [replicate_sigma([(signals[i][:, c], signals[j][:, c]) for i, j in pairs])
                       for c in range(len(channel))],
        "differences": [difference_sigma([s[:, c] for s in signals]) for c in range(len(channel))],
    }  # fmt: skip
    sigma = [pool([methods[name][c] for name in methods]) for c in range(len(channel))]
    by_method = {name: np.array([value for value, _ in rows]) for name, rows in methods.items()}
    sigma = np.maximum(sigma, rounding)
    if isinstance(case, BranchCase) and not case.velocity_measured:
        # a derivative's noise is that of the displacement, and its differences would show less than there is
        for values in (sigma, *by_method.values()):
            values[6:9] = DERIVATIVE_NOISE / case.dt * values[3:6]
    return NoiseEstimate(channel, sigma, by_method)


def quiet_sigma(signals: list[Array], masks: list[Array]) -> tuple[float, float]:
    """Scatter about the mean of each run of samples in ``masks``: (sigma, its standard error), NaN if there is none."""
    squares, freedom = 0.0, 0
    for x, mask in zip(signals, masks, strict=True):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
        for start, stop in edges.reshape(-1, 2):
            if stop - start >= _QUIET_MIN:
                squares += float(np.sum((x[start:stop] - x[start:stop].mean()) ** 2))
                freedom += stop - start - 1
    return _with_error(squares, freedom)


def replicate_sigma(pairs: list[tuple[Array, Array]]) -> tuple[float, float]:
    """Pure error from pairs of recordings of one experiment: (sigma, its standard error), NaN without pairs."""
    differences = [a[: len(b)] - b[: len(a)] for a, b in pairs]
    return _with_error(sum(float(d @ d) for d in differences) / 2, sum(len(d) for d in differences))


def difference_sigma(signals: list[Array], orders: tuple[int, ...] = ORDERS) -> tuple[float, float]:
    """Noise from m-th differences: (sigma, its standard error).

    Takes the lowest order whose estimate no higher order undercuts by more than the higher one's standard error
    (Lepski's rule): a higher order removes more signal but knows the noise less well.
    """
    step = resolution(signals)
    estimates = [_one_order(signals, m, step) for m in orders if max(len(x) for x in signals) > 2 * m]
    for i, (sigma, error) in enumerate(estimates):
        if all(sigma <= higher + spread for higher, spread in estimates[i + 1 :]):
            return sigma, error
    return np.nan, np.nan


def _one_order(signals: list[Array], order: int, step: float) -> tuple[float, float]:
    """Robust sigma from one order of differences of samples that are rounded to ``step``, and its standard error.

    Neighbouring differences share samples: their correlation at lag j is binomial(2m, m + j) / binomial(2m, m) with
    alternating sign, so that n of them are worth n / sum of its squares. The median absolute deviation has 37 % of the
    efficiency of the standard deviation.
    """
    differences = np.concatenate([np.diff(x, order) for x in signals if len(x) > order])
    scale = np.sqrt(comb(2 * order, order))
    correlation = np.array([comb(2 * order, order + j) / comb(2 * order, order) for j in range(1, order + 1)])
    worth = len(differences) / (1 + 2 * np.sum(correlation**2))
    sigma = _spread(np.abs(differences), step) / scale
    return sigma, sigma / np.sqrt(2 * 0.37 * worth)


def _spread(sizes: Array, step: float) -> float:
    """Return the robust deviation of values with these sizes, multiples of ``step``.

    Each value is spread evenly over its rounding, which adds step^2 / 12 to the variance.
    """
    plain = float(np.median(sizes))
    if step <= FINE * plain or step == 0.0:
        return _MAD * plain
    group, count = np.unique(np.round(sizes / step), return_counts=True)
    total = np.cumsum(count)
    k = int(np.searchsorted(total, 0.5 * len(sizes)))
    low, high = max(group[k] - 0.5, 0.0), group[k] + 0.5
    median = step * (low + (high - low) * (0.5 * len(sizes) - total[k] + count[k]) / count[k])
    return float(np.sqrt(max((_MAD * median) ** 2 - step**2 / 12, 0.0)))


def pool(estimates: list[tuple[float, float]]) -> float:
    """Combine the smallest estimate with all that agree with it, variances weighted by what each is worth.

    ``estimates`` are pairs (sigma, its standard error); NaN ones are left out, NaN is returned if none is left.
    """
    known = sorted((e for e in estimates if np.isfinite(e[0])), key=lambda e: e[0])
    if not known:
        return np.nan
    low, spread = known[0]
    agree = np.array([e for e in known if e[0] - low <= AGREE * np.hypot(spread, e[1])])
    if (agree[:, 1] <= 0).any():
        return float(low)
    weight = (agree[:, 0] / agree[:, 1]) ** 2  # proportional to the degrees of freedom
    return float(np.sqrt(np.sum(weight * agree[:, 0] ** 2) / np.sum(weight)))


def _with_error(squares: float, freedom: int) -> tuple[float, float]:
    if freedom == 0:
        return np.nan, np.nan
    sigma = float(np.sqrt(squares / freedom))
    return sigma, sigma / np.sqrt(2 * freedom)


def _rounding(case: BranchCase | JointCase, signals: list[Array]) -> Array:
    """Return what every channel is rounded to, shape [C]: on another grid than the file's by what the file was."""
    own = np.array([resolution([s[:, c] for s in signals]) for c in range(signals[0].shape[1])])
    if isinstance(case, BranchCase):
        return own
    return np.maximum(own, np.min([t.step for t in case.trajectories], axis=0))


def _channels(case: BranchCase | JointCase) -> tuple[tuple[str, ...], list[Array], list[Array]]:
    """Channel names, signals [T, C] and quiet masks [T, C] of every trajectory."""
    if isinstance(case, JointCase):
        signals = [t.output for t in case.trajectories]
        return tuple(o.column for o in case.outputs), signals, [np.zeros(s.shape, dtype=bool) for s in signals]
    signals = [np.concatenate([t.force, t.displacement, t.velocity], axis=1) for t in case.trajectories]
    masks = []
    for t in case.trajectories:
        untouched = np.logical_and.accumulate(t.no_contact)
        masks.append(np.repeat(np.stack([t.no_contact, untouched, untouched], axis=1), 3, axis=1))
    return BRANCH_COLUMNS[1:], signals, masks
