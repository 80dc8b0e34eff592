"""Two clocks: how far they are apart, from two signals of the same event (cross-correlation), and one on the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_lsq_spline

from ...sim.base.types import Array
from ..cases.clock import interpolated

#: Share of the shorter signal that has to lie on the other one.
OVERLAP = 0.5
#: Least samples for each step of a grid from which on a force is fitted instead of read off.
FINER = 1.5


@dataclass(frozen=True)
class Offset:
    """How far a second clock is ahead of a first.

    Attributes:
        seconds: What to take from the times of the second signal [s].
        correlation: Pearson's correlation of the signals there, in size.
        before: That of the signals as they are.
    """

    seconds: float
    correlation: float
    before: float


def clock_offset(first: tuple[Array, Array], second: tuple[Array, Array], most: float) -> Offset:
    """Return the offset at which two signals are most alike.

    Both are put on a grid of the finer of their steps; Pearson's correlation over what overlaps is taken at each lag of
    whole steps, and a parabola through the best and its neighbours gives what lies between.

    Args:
        first: Times [s], shape [T], and a signal, shape [T].
        second: The same of the other clock, shape [S].
        most: Largest offset that is looked at [s].
    """
    step = min(float(np.median(np.diff(t))) for t, _ in (first, second))
    a, b = (_on_grid(t, x, step) for t, x in (first, second))
    begin = (second[0][0] - first[0][0]) / step  # of b on a's grid
    reach = round(most / step)
    lags = np.arange(-reach, reach + 1)
    values = np.array([_correlation(a, b, round(begin) - int(lag)) for lag in lags])
    best = int(np.argmax(values))
    at = float(lags[best])
    if 0 < best < len(lags) - 1 and values[best - 1 : best + 2].min() > 0:
        low, mid, high = values[best - 1 : best + 2]
        curve = low - 2 * mid + high
        at += 0.5 * (low - high) / curve if curve < 0 else 0.0
    return Offset(step * (at + begin - round(begin)), float(values[best]), float(values[reach]))


def _on_grid(t: Array, x: Array, step: float) -> Array:
    grid = np.arange(t[0], t[-1] + 1e-9, step)
    out: Array = np.interp(grid, t, x)
    return out


def _correlation(a: Array, b: Array, shift: int) -> float:
    """Return the size of the correlation of a[i + shift] and b[i] where both are; 0 where too little is."""
    low, high = max(0, -shift), min(len(b), len(a) - shift)
    if high - low < max(3, OVERLAP * min(len(a), len(b))):
        return 0.0
    x, y = a[low + shift : high + shift], b[low:high]
    x, y = x - x.mean(), y - y.mean()
    size = float(np.sqrt((x @ x) * (y @ y)))
    return abs(float(x @ y)) / size if size > 0 else 0.0


def force_on_grid(t: Array, rows: Array, grid: Array) -> Array:
    """Return forces on a grid, shape [T, C], whose linear interpolation comes closest to all samples.

    A simulation takes the force linear between the grid's points. Read off at these points alone a release loses what
    happened in between, half a step of its impulse at worst, and a sweep some of its size; the linear spline of least
    squares (de Boor, A Practical Guide to Splines (1978), chapter XIV) keeps the sum over all samples. Where these
    are not finer than the grid it is their linear interpolation.

    Args:
        t: Times of the samples [s], shape [N], increasing, around the grid's.
        rows: Samples, shape [N, C].
        grid: Times of a uniform grid [s], shape [T].
    """
    inside = (t >= grid[0]) & (t <= grid[-1])
    counts = np.histogram(t[inside], grid)[0]
    if not len(counts) or counts.min() < 1 or counts.mean() < FINER:
        return interpolated(t, rows, grid)
    knots = np.concatenate([grid[:1], grid, grid[-1:]])
    out: Array = make_lsq_spline(t[inside], rows[inside], knots, k=1).c
    return out
