"""Whether a branch sways while nothing touches it, and whether what a model misses differs from repeat to repeat.

A law of the branch or of a sensor misses the same whenever the same push is repeated, and nothing before the first
push. Gusts do both otherwise: they are there before the gripper closes, and never twice the same.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.stats import chi2

from ...replay.recording import Recording
from ..models.contest import Contest
from ..models.left_out import profiles

#: Probability by chance of a sway that is told, and least mean square of it in units of the noise. Of 79 branches
#: without gusts the largest was 1.4, of 15 with gusts the smallest 3.2 (`docs/decisions/gap.md`).
CHANCE, LEAST = 1e-6, 1.8
#: Fewest recordings that begin untouched.
FEWEST = 3
#: Least share of what is missed that differs between repeats of one push.
DIFFERS = 0.3


def untouched(recording: Recording) -> int:
    """Return at how many samples from the first on the gripper is open."""
    return int(np.logical_and.accumulate(~recording.contact).sum())


def sways(contest: Contest) -> bool:
    """Return whether a branch moves before it is touched: by its velocities, which a displaced rest does not have."""
    sigma = contest.data_sigma[3:]  # what a search takes for noise may be the sway
    own = [r.output[: untouched(r), 3:][:, sigma > 0.0] / sigma[sigma > 0.0] for r in contest.recordings]
    known = [x.ravel() for x in own if x.size]
    if len(known) < FEWEST:
        return False
    squares = np.concatenate(known) ** 2
    return bool(chi2.sf(squares.sum(), len(squares)) < CHANCE and squares.mean() > LEAST)


def differs(contest: Contest, residual: torch.Tensor) -> bool:
    """Return whether whitened residuals [R, T, C] differ between repeats of one push; True where nothing is repeated.

    Half of the mean squared difference of two, and the mean square of each, are both more by one for noise, where there
    is noise: channels out of a planar case's plane have none, nor has what is past a recording's end.
    """
    groups = [g for g in profiles(contest) if len(g) > 1]
    apart = [0.5 * (residual[i] - residual[j]) ** 2 for g in groups for i in g for j in g if i < j]
    if not apart:
        return True
    missed = torch.stack([residual[j] ** 2 for g in groups for j in g]).mean()
    noise = contest.num_samples / residual.numel()
    return float(torch.stack(apart).mean() - noise) > DIFFERS * float(missed - noise)
