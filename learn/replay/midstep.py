"""What a replay of joints takes in the middle of its steps, so that their error is of second order.

A step of length h takes coordinates, efforts and velocity products in its middle. A damper d is implicit,

    (m + a + h d) (v' - v) / h = Q - d v,

which is d (v + v') / 2 on an inertia that is larger by h d / 2. With the armature a - h d / 2 in the place of a it is
the trapezoidal rule: no error of first order, and stable for every d, since a - h d / 2 + h d is never below a.

Efforts are known at samples and taken to be linear between them, which leaves sinc^2(f dt) of a tone f: 1 % less at
eighteen samples a period. Samples raised by a twelfth of their second difference give it back to fourth order. That is
done where the second difference is that of a smooth input: of noise and of steps it is not, and would add to them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from .recording import Recording

#: Largest fourth difference of a smooth input relative to its second: nine samples a period; noise has 3.4, a step 3.2.
RESOLVED = 0.5


class Armature:
    """Armatures of a model's worlds that make up for implicit dampers.

    Args:
        armature, damping: The model's arrays, of one shape.
        half: Half of a step [s]; zero changes nothing.
    """

    def __init__(self, armature: torch.Tensor, damping: torch.Tensor, half: float) -> None:
        self._armature, self._damping, self._half = armature, damping, half
        self._own = armature.clone()

    def restore(self) -> None:
        """Write the armatures that the model was built with, before parameters are written."""
        self._armature.copy_(self._own)

    def centre(self) -> None:
        """Take half a step of each damper off the armature, after parameters are written."""
        self._armature.sub_(self._damping, alpha=self._half)


def driving(case: BranchCase | JointCase, chosen: Sequence[Recording]) -> list[Array]:
    """Return the inputs [T, I] that, linear between samples, act as the recorded ones of joints do.

    Inputs that are held or rough, and a branch's force, are returned as they are.
    """
    inputs = [np.asarray(r.input, dtype=np.float64) for r in chosen]
    if isinstance(case, BranchCase) or any(item.hold == "zero_order" for item in case.inputs):
        return inputs
    whole = [t.effort for t in case.trajectories if len(t.t) > 4]  # the same for beginnings and parts of it
    if not whole:
        return inputs
    smooth = _rms(whole, 4) < RESOLVED * _rms(whole, 2)
    return [_raised(x, smooth) for x in inputs]


def _rms(inputs: Sequence[Array], order: int) -> Array:
    """Return the rms of the differences of an order of inputs [T, I] over all recordings, shape [I]."""
    return np.asarray(np.sqrt(np.mean(np.concatenate([np.diff(x, order, axis=0) for x in inputs]) ** 2, axis=0)))


def _raised(x: Array, smooth: NDArray[np.bool_]) -> Array:
    """Return samples [T, I], the smooth columns less a twelfth of their second difference but for first and last."""
    out = x.copy()
    out[1:-1] -= np.where(smooth, np.diff(x, 2, axis=0) / 12.0, 0.0)
    return out
