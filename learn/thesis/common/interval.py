"""A mean over trainings that differ in their seed, and how far it may be off."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from scipy import stats


@dataclass(frozen=True)
class Interval:
    """A mean over seeds and its 95 % interval, whose ends are NaN where there are fewer than two values.

    Attributes:
        mean: The mean, NaN of none.
        low, high: Ends of the interval.
        count: Number of values.
    """

    mean: float
    low: float
    high: float
    count: int

    def apart(self, other: Interval) -> bool:
        """Return whether both are of three values or more and do not overlap."""
        enough = min(self.count, other.count) >= LEAST_SEEDS
        return enough and (self.low > other.high or self.high < other.low)


LEAST_SEEDS = 3
"""Trainings that a verdict takes at least."""


def interval(values: Sequence[float]) -> Interval:
    """Return mean and 95 % interval of Student's t of the values that are known."""
    known = [v for v in values if not math.isnan(v)]
    mean = sum(known) / len(known) if known else math.nan
    if len(known) < 2:
        return Interval(mean, math.nan, math.nan, len(known))
    half = float(stats.t.ppf(0.975, len(known) - 1)) * statistics.stdev(known) / math.sqrt(len(known))
    return Interval(mean, mean - half, mean + half, len(known))
