"""Checks whether a case's data can support a verdict; if not, why, and which probe is missing."""

from __future__ import annotations

import numpy as np

from ..cases.case import BranchCase, JointCase
from ..replay.equation_error import recordings_of

#: Largest noise relative to the rms of the motion.
MOST_NOISE = 0.7


def nothing_moves(case: BranchCase | JointCase) -> str | None:
    """Return that nothing acts or nothing moves, or None."""
    if isinstance(case, BranchCase) and not any(t.force.any() for t in case.trajectories):
        return "no trajectory has any force; push the branch"
    if not any(np.ptp(r.output, axis=0).any() for r in recordings_of(case)):
        return "nothing moves in any trajectory; push harder"
    return None


def too_few(case: BranchCase | JointCase) -> str | None:
    """Return that a branch has too few trajectories, or None."""
    if isinstance(case, BranchCase) and len(case.trajectories) < 2:
        return "one trajectory can be fitted by almost any effect; push in two more directions"
    return None


def too_noisy(motion: float) -> str | None:
    """Return what to do where noise hides the motion; ``motion`` is its rms in units of the noise."""
    if motion < 1.0 / MOST_NOISE:
        return "noise is as large as the motion; push harder, or average repeated pushes"
    return None
