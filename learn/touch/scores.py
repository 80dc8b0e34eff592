"""How well contact is told: ROC, shares at a threshold, delay of detection, with intervals over recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...sim.base.types import Array, IntArray
from .recording import Recording

#: Resamples of the recordings for an interval.
RESAMPLES = 500


@dataclass(frozen=True)
class Told:
    """What a classifier said of a recording that it had not seen.

    Attributes:
        recording: The recording, T rows.
        probability: Of contact, [T].
    """

    recording: Recording
    probability: Array

    def rows(self, certain: bool) -> tuple[Array, IntArray]:
        """Return probability and label of the rows whose label is known, or certain (`Recording.certain`)."""
        use = self.recording.certain if certain else self.recording.contact >= 0
        return self.probability[use], self.recording.contact[use]


@dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval; NaN where nothing can be said."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3f} ({self.low:.3f} to {self.high:.3f})"


def pooled(told: Sequence[Told], certain: bool) -> tuple[Array, IntArray]:
    """Return probabilities and labels of all recordings, one after the other."""
    rows = [t.rows(certain) for t in told]
    return np.concatenate([p for p, _ in rows]), np.concatenate([y for _, y in rows])


def auc(probability: Array, contact: IntArray) -> float:
    """Return the area under the ROC: how often a row with contact scores above one without, ties counted half."""
    ones = int(contact.sum())
    if ones in (0, len(contact)):
        return float("nan")
    _, inverse, count = np.unique(probability, return_inverse=True, return_counts=True)
    rank = (np.cumsum(count) - (count - 1) / 2)[inverse]
    return float((rank[contact == 1].sum() - ones * (ones + 1) / 2) / (ones * (len(contact) - ones)))


def roc(probability: Array, contact: IntArray) -> tuple[Array, Array, Array]:
    """Return false positive rates, recalls and thresholds from strict to loose; contact is said above a threshold."""
    order = np.argsort(-probability, kind="stable")
    p, y = probability[order], contact[order]
    last = np.append(np.diff(p) != 0, True)
    recall, wrong = np.cumsum(y)[last] / max(y.sum(), 1), np.cumsum(1 - y)[last] / max((1 - y).sum(), 1)
    below = np.append(p[last][1:], -np.inf)
    threshold = np.where(np.isfinite(below), (p[last] + below) / 2, 0.0)
    return np.append(0.0, wrong), np.append(0.0, recall), np.append(1.0, threshold)


def specificity_at(probability: Array, contact: IntArray, recall: float) -> float:
    """Return the specificity at the strictest threshold with at least that recall."""
    if not contact.any() or contact.all():
        return float("nan")
    wrong, found, _ = roc(probability, contact)
    return float(1.0 - wrong[int(np.argmax(found >= recall))])


def threshold_for(told: Sequence[Told], specificity: float) -> float:
    """Return the lowest threshold at which a share of the certain rows without contact is told so."""
    wrong, _, threshold = roc(*pooled(told, certain=True))
    return float(threshold[int(np.nonzero(wrong <= 1.0 - specificity)[0][-1])])


def share(hit: Any) -> float:
    """Return the share of ones, NaN of nothing."""
    return float(np.mean(hit)) if len(hit) else float("nan")


def over_recordings(
    told: Sequence[Told], measures: Sequence[Callable[[Array, IntArray], float]], certain: bool, seed: int = 0
) -> list[Interval]:  # fmt: skip
    """Return measures of the pooled rows, with the intervals that recordings drawn again with repeats give them.

    Args:
        told: What was told of every recording.
        measures: Of probabilities and labels; NaN where nothing can be said.
        certain: As `Told.rows` takes it.
        seed: Of the draws (percentile bootstrap, `RESAMPLES` of them).
    """
    rng, rows = np.random.default_rng(seed), [t.rows(certain) for t in told]
    again = np.empty((RESAMPLES, len(measures)))
    for n in range(RESAMPLES):
        some = [rows[k] for k in rng.integers(0, len(rows), len(rows))]
        probability, contact = np.concatenate([p for p, _ in some]), np.concatenate([y for _, y in some])
        again[n] = [measure(probability, contact) for measure in measures]
    probability, contact = pooled(told, certain)
    out = []
    for values, measure in zip(again.T, measures, strict=True):
        kept = values[np.isfinite(values)]
        low, high = np.quantile(kept, [0.025, 0.975]) if len(kept) else (np.nan, np.nan)
        out.append(Interval(measure(probability, contact), float(low), float(high)))
    return out


@dataclass(frozen=True)
class Detection:
    """One stretch of contact: where, and how long it took to be said [s]; None if it was not."""

    name: str
    link: str
    direction: str
    delay: float | None


def detections(told: Sequence[Told], threshold: float) -> list[Detection]:
    """Return every stretch of contact that a recording shows from its start, and when it was first told."""
    out = []
    for t in told:
        r, said = t.recording, t.probability > threshold
        edges = np.diff(np.concatenate([[0], (r.contact == 1).astype(int), [0]]))
        for a, b in zip(np.nonzero(edges == 1)[0], np.nonzero(edges == -1)[0], strict=True):
            hits = np.nonzero(said[a:b])[0]
            delay = float(r.time[a + hits[0]] - r.time[a]) if len(hits) else None
            out.append(Detection(r.name, r.link, r.direction, delay))
    return out
