"""Leave one recording out: every recording is told by a classifier that has seen none of its rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...sim.base.errors import InputError
from .model import Kind, TouchModel, digest, train_model
from .recording import Recording
from .scores import Told

#: Groups that a threshold is found with: one recording at a time takes as many trainings as there are recordings.
FOLDS = 4


def left_out(
    recordings: Sequence[Recording], kind: Kind, seed: int, source: str, *, folds: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Told]:  # fmt: skip
    """Tell every recording by a model of the others; free motion is fitted anew without it, too.

    Args:
        recordings: Two or more.
        kind: Of the classifier.
        seed: Of the classifier.
        source: What the recordings are called in an error.
        folds: How many recordings' groups are left out in turn; None leaves out one at a time.
        progress: Called with 1 for every model.

    Raises:
        InputError: There are fewer than two recordings; those left lack contact or free motion.
    """
    if len(recordings) < 2:
        raise InputError(source, "", "one recording", "two or more, to leave one out")
    group = np.arange(len(recordings)) % (folds or len(recordings))
    out: list[Told | None] = [None] * len(recordings)
    for g in np.unique(group):
        rest = [r for r, k in zip(recordings, group, strict=True) if k != g]
        labels = np.concatenate([r.contact for r in rest])
        if not ((labels == 1).any() and (labels == 0).any()):
            found = "contact in one recording alone" if (labels == 0).any() else "no free motion in the others"
            raise InputError(source, "contact", found, "contact and free motion in two recordings or more")
        model = train_model(rest, kind, 0.5, seed, source)
        for k in np.nonzero(group == g)[0].tolist():
            out[k] = Told(recordings[k], model.probability(recordings[k]))
        progress(1)
    return [t for t in out if t is not None]


def unseen(model: TouchModel, recordings: Sequence[Recording], source: str) -> list[Told]:
    """Tell recordings by a model that was not trained on them; those that it was are left out.

    Raises:
        InputError: It was trained on all of them.
    """
    fresh = [r for r in recordings if digest(r) not in set(model.trained_on)]
    if not fresh:
        raise InputError(source, "", "only recordings that the model was trained on", "recordings that it has not seen")
    return [Told(r, model.probability(r)) for r in fresh]
