"""What counts as motion in measured channels, whatever zero an encoder has."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ..cases.case import BranchCase, JointCase
from .equation_error import fits_torque
from .recording import Recording


def about_rest(case: BranchCase | JointCase, chosen: Sequence[Recording], measured: torch.Tensor) -> torch.Tensor:
    """Return measured channels [R, T, C] with joints' positions about their means over all recordings.

    The zero of an encoder means nothing; that of a displacement, rate, acceleration or effort is rest. Zero past a
    recording's end.
    """
    if not isinstance(case, JointCase) or fits_torque(case):
        return measured.clone()
    position = torch.tensor([o.quantity == "position" for o in case.outputs], device=measured.device)
    counts = torch.tensor([len(r.t) for r in chosen], device=measured.device)
    inside = (torch.arange(measured.shape[1], device=measured.device) < counts[:, None])[..., None]
    mean = measured.sum((0, 1)) / float(counts.sum())
    return torch.where(inside & position, measured - mean, measured)
