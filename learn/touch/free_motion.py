"""What a joint's torque is while nothing touches the arm, and how far it scatters: a friction model, fitted.

    tau = c0 + c1 s + c2 v + c3 m + c4 s |m| + noise,   s = tanh(v / V0)

Offset, dry and viscous friction, and friction that grows with the load m, which is what the robot's own model expects
(such as a UR's target current; zero where a recording has none). The noise has one standard deviation for each joint,
that of free motion: divided by one that grows with speed, a Jaco 2's torques told contact worse (docs/touch.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...kernels.touch.features import V0
from ...sim.base.errors import InputError
from ...sim.base.types import Array
from .recording import Recording

#: Rows without contact that a fit needs.
LEAST_ROWS = 30
_RIDGE = 1.0e-3


@dataclass(frozen=True)
class FreeMotion:
    """The model of a robot's free motion.

    Attributes:
        mean: c0 to c4 of every joint, in the recordings' unit of torque, [D, 5].
        noise: Standard deviation of every joint's torque about it, [D].
    """

    mean: Array
    noise: Array

    @property
    def num_dofs(self) -> int:
        """Number of joints D."""
        return len(self.mean)

    def needed(self, expected: Array, velocity: Array) -> Array:
        """Return the torque of free motion for what the robot expects and its joint speeds, [..., D] each."""
        return np.einsum("...jk,jk->...j", _terms(expected, velocity), self.mean)

    def standardised(self, torque: Array, expected: Array, velocity: Array) -> Array:
        """Return how far torques are from free motion, in standard deviations of its noise, [..., D]."""
        out: Array = (torque - self.needed(expected, velocity)) / self.noise
        return out


def _terms(expected: Array, velocity: Array) -> Array:
    """Return what c0 to c4 multiply, [..., D, 5]."""
    s = np.tanh(velocity / V0)
    return np.stack([np.ones_like(s), s, velocity, expected, s * np.abs(expected)], axis=-1)


def fit_free_motion(recordings: Sequence[Recording], source: str) -> FreeMotion:
    """Fit the model to all rows that are known to be without contact.

    Args:
        recordings: Of one robot.
        source: What the recordings are called in an error.

    Raises:
        InputError: There are fewer than `LEAST_ROWS` such rows.
    """
    rows = [r.contact == 0 for r in recordings]
    if sum(int(k.sum()) for k in rows) < LEAST_ROWS:
        found = f"{sum(int(k.sum()) for k in rows)} rows that are known to be without contact"
        raise InputError(source, "contact", found, f"{LEAST_ROWS} or more, to know the arm's free motion by")
    torque, expected, velocity = (
        np.concatenate([getattr(r, name)[k] for r, k in zip(recordings, rows, strict=True)])
        for name in ("torque", "expected", "velocity")
    )
    terms = _terms(expected, velocity)
    fits = np.array([_fit_joint(terms[:, j], torque[:, j]) for j in range(torque.shape[1])])
    left = torque - np.einsum("njk,jk->nj", terms, fits)
    return FreeMotion(fits, np.maximum(left.std(0), 1.0e-6))


def _fit_joint(terms: Array, torque: Array) -> Array:
    """Least squares with a little ridge on what is not the offset."""
    scale = np.maximum(np.sqrt(np.mean(terms**2, axis=0)), 1.0e-9)
    a = terms / scale
    ridge = _RIDGE * len(a) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0])
    c = np.linalg.solve(a.T @ a + ridge, a.T @ torque) / scale
    c[np.sqrt(np.mean(terms**2, axis=0)) < 1.0e-9] = 0.0  # what never acted is not known
    return np.asarray(c)
