"""Base and repaired model fitted to the training recordings: the fits that are written, claimed and shown."""

from __future__ import annotations

from collections.abc import Sequence

from .decide import Decision
from .models.contest import Batch, Contest
from .models.refit import Fits, fit

#: Steps of a refit to the training recordings.
TRAIN = 10


def refitted(contest: Contest, decision: Decision, train: Sequence[int]) -> Fits:
    """Refit base and repaired model to the training recordings, a batch of two.

    Segments are rigid here, as in the model file and in every simulation of it. Springs and dampers fitted beside
    bending wood would have a larger RMSE in such a simulation, the base model more than the repaired one.
    """
    batch = Batch.joined([decision.base.fit.batch, decision.final.fit.batch])
    batch.weight[:] = 0.0
    batch.weight[:, list(train)] = 1.0
    return fit(contest.rigid(), batch, TRAIN)
