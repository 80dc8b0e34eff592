"""Policies in the same worlds: differences with a paired bootstrap, and what an ensemble of policies can reach."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...sim.base.archive import read_arrays
from ...sim.base.errors import InputError
from ...sim.base.types import Array, IntArray
from ..tasks.parts import Column

#: Resamples of a bootstrap: ends of a 95 % interval then scatter by a fiftieth of its width.
RESAMPLES = 10_000
SUCCESS = "success"


@dataclass(frozen=True)
class Episodes:
    """One episode in every world of some test sets, N in all.

    Attributes:
        measures: What was said of each, float64 [N] by name.
        target: What each was about, int64 [N]: episodes of the same are resampled together.
        kinds: Which are of a kind of worlds, bool [N] by name.
    """

    measures: Mapping[str, Array]
    target: IntArray
    kinds: Mapping[str, Array]

    def of(self, mask: Array) -> Episodes:
        """Return the episodes of a mask [N]."""
        measures = {name: values[mask] for name, values in self.measures.items()}
        return Episodes(measures, self.target[mask], {name: kind[mask] for name, kind in self.kinds.items()})


@dataclass(frozen=True)
class Difference:
    """A column of one policy less that of another.

    Attributes:
        value: The difference, NaN where an episode of either does not count.
        low, high: Its 95 % interval.
    """

    value: float
    low: float
    high: float

    @property
    def sure(self) -> bool:
        """Whether the interval leaves out zero."""
        return self.low > 0.0 or self.high < 0.0


def join(sets: Sequence[Episodes]) -> Episodes:
    """Return the episodes of several test sets as one."""
    first = sets[0]
    measures = {name: np.concatenate([s.measures[name] for s in sets]) for name in first.measures}
    kinds = {name: np.concatenate([s.kinds[name] for s in sets]) for name in first.kinds}
    return Episodes(measures, np.concatenate([s.target for s in sets]), kinds)


def difference(one: Episodes, other: Episodes, column: Column, seed: int = 0) -> Difference:
    """Return by how much a column of one policy is above another's, in the same worlds.

    A paired bootstrap (Efron and Tibshirani 1993, chapter 16): targets are drawn with replacement, each with all its
    episodes of both policies, `RESAMPLES` times; the interval lies between the 2.5 and the 97.5 percentile.

    Raises:
        ValueError: The policies were not in the same worlds.
    """
    if not np.array_equal(one.target, other.target):
        raise ValueError("episodes about other targets")
    if any(column.measure not in e.measures for e in (one, other)):
        return Difference(math.nan, math.nan, math.nan)
    _, place = np.unique(one.target, return_inverse=True)
    sums = [_sums(e, column, place) for e in (one, other)]
    count = int(place.max()) + 1 if len(place) else 0
    if count == 0 or any(total.sum() == 0.0 for _, total in sums):
        return Difference(math.nan, math.nan, math.nan)
    drawn = np.random.default_rng(seed).multinomial(count, np.full(count, 1.0 / count), RESAMPLES)
    with np.errstate(invalid="ignore"):
        means = [(drawn @ value) / (drawn @ total) for value, total in sums]
    low, high = np.nanpercentile(means[0] - means[1], (2.5, 97.5))
    value = sums[0][0].sum() / sums[0][1].sum() - sums[1][0].sum() / sums[1][1].sum()
    return Difference(column.scale * float(value), column.scale * float(low), column.scale * float(high))


def mean(episodes: Episodes, column: Column) -> float:
    """Return a column of a table: the mean over the episodes that count, NaN where none does."""
    if column.measure not in episodes.measures:
        return math.nan
    value, count = _sums(episodes, column, np.zeros(len(episodes.target), np.int64))
    return column.scale * float(value.sum() / count.sum()) if count.sum() > 0.0 else math.nan


def _sums(episodes: Episodes, column: Column, place: IntArray) -> tuple[Array, Array]:
    """Return by target the sum of a measure over the episodes that count, and how many those are."""
    counts = np.ones(len(place)) if not column.of_successes else (episodes.measures[SUCCESS] > 0.0).astype(float)
    values = np.where(counts > 0.0, episodes.measures[column.measure], 0.0)
    out = [np.bincount(place, rows).astype(np.float64) for rows in (values, counts)]
    return out[0], out[1]


def feasible(ensemble: Sequence[Episodes]) -> Array:
    """Return in which worlds any policy of an ensemble succeeds, bool [N]: what is taken as possible (thesis, B.3).

    Raises:
        ValueError: The policies were not in the same worlds.
    """
    first = ensemble[0]
    if not all(np.array_equal(first.target, e.target) for e in ensemble):
        raise ValueError("episodes about other targets")
    out: Array = np.any([e.measures[SUCCESS] > 0.0 for e in ensemble], axis=0)
    return out


def relative_success(episodes: Episodes, possible: Array) -> tuple[float, int]:
    """Return the share of the possible worlds that a policy succeeds in, NaN of none, and how many are possible."""
    count = int(possible.sum())
    return (float(np.mean(episodes.measures[SUCCESS][possible] > 0.0)) if count else math.nan), count


def by_kind(episodes: Episodes) -> dict[str, Array]:
    """Return which episodes are of all worlds, and of each kind that there is, bool [N]."""
    everywhere = np.ones(len(episodes.target), bool)
    return {"all": everywhere} | {name: mask for name, mask in episodes.kinds.items() if mask.any()}


def write_episodes(path: Path, found: Mapping[str, Episodes]) -> None:
    """Write the episodes of policies by name, all in the same worlds, as .npz without pickle."""
    first = next(iter(found.values()))
    arrays = {f"measure/{policy}/{name}": v for policy, e in found.items() for name, v in e.measures.items()}
    arrays |= {f"kind/{name}": mask for name, mask in first.kinds.items()}
    np.savez_compressed(path, target=first.target, **arrays)  # type: ignore[arg-type]


def read_episodes(path: Path, policy: str = "trained") -> Episodes:
    """Read the episodes of one policy.

    Raises:
        InputError: The file is missing or no such file, or the policy is not in it.
    """
    allowed = "a file that bough evaluate wrote"
    held = read_arrays(path, allowed)
    start = f"measure/{policy}/"
    measures = {name[len(start) :]: values for name, values in held.items() if name.startswith(start)}
    if "target" not in held or SUCCESS not in measures:
        raise InputError(path, policy, "no episodes", allowed)
    kinds = {name[5:]: mask for name, mask in held.items() if name.startswith("kind/")}
    return Episodes(measures, held["target"], kinds)
