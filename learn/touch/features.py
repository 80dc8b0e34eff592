"""The same features as `kernels.touch.features` in plain NumPy: of whole recordings, and of one robot's stream."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ...kernels.touch.features import EPS, FEATURES, RING, K, M
from ...sim.base.types import Array
from .free_motion import FreeMotion

#: Names of a joint's features, in their order.
NAMES = (
    "torque",
    *(f"{kind} {name}" for kind in ("raw", "smooth") for name in ("min", "max", "mean", "var", "skew", "kurt")),
    "commanded velocity",
    "executed velocity",
)


def statistics(x: Array) -> Array:
    """Return minimum, maximum, mean, variance, skewness, excess kurtosis over the last axis, [..., 6].

    NaN stands for what is not there yet; the newest value, at the end, is always there.
    """
    d = x - x[..., -1:]
    mu = np.nanmean(d, axis=-1, keepdims=True)
    second, third, fourth = (np.nanmean((d - mu) ** power, axis=-1) for power in (2, 3, 4))
    spread = second + EPS
    parts = [np.nanmin(x, -1), np.nanmax(x, -1), x[..., -1] + mu[..., 0], second,
             third / spread**1.5, fourth / spread**2 - 3.0]  # fmt: skip
    return np.stack(parts, axis=-1)


def torque_features(history: Array) -> Array:
    """Return the thirteen features of torques, from the last `RING` standardised ones.

    Args:
        history: Oldest first, NaN where there was none yet, [..., RING].

    Returns:
        [..., 13].
    """
    raw = history[..., -M:]
    return np.concatenate([history[..., -1:], statistics(raw), statistics(_smoothed(history))], axis=-1)


def _smoothed(history: Array) -> Array:
    """Means of up to K values, NaN where none is there, [..., M]."""
    windows = sliding_window_view(history, K, axis=-1)[..., -M:, :]
    count = (~np.isnan(windows)).sum(-1)
    total = np.nansum(windows, axis=-1)
    mean = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    # a mean belongs to its newest value: without that one there is none
    return np.where(np.isnan(windows[..., -1]), np.nan, mean)


def features_of(free: FreeMotion, torque: Array, expected: Array, command: Array, velocity: Array) -> Array:
    """Return the features of a whole recording, row by row as they would have been streamed.

    Args:
        free: What the joints need in free motion.
        torque: As `Recording` has them, like the rest, [T, D].
        expected: What the robot's own model expects of the torques.
        command: Commanded joint speeds.
        velocity: Executed ones.

    Returns:
        [T, 15 D], joint by joint in the order of `NAMES`.
    """
    z = free.standardised(torque, expected, velocity)
    padded = np.concatenate([np.full((RING - 1, z.shape[1]), np.nan), z])
    history = sliding_window_view(padded, RING, axis=0)
    out = np.concatenate([torque_features(history), command[..., None], velocity[..., None]], axis=-1)
    return out.reshape(len(z), FEATURES * z.shape[1])


class TouchStream:
    """Features of one robot, sample by sample.

    Attributes:
        free: What the joints need in free motion.
    """

    def __init__(self, free: FreeMotion) -> None:
        self.free = free
        self.restart()

    def restart(self) -> None:
        """Forget all samples."""
        self._history = np.full((self.free.num_dofs, RING), np.nan)

    def push(self, torque: Array, command: Array, velocity: Array, expected: Array | None = None) -> Array:
        """Take a sample, [D] each, in the units of the recordings; return the features, [15 D].

        Raises:
            ValueError: A shape is not [D].
        """
        rows = [torque, np.zeros(self.free.num_dofs) if expected is None else expected, velocity, command]
        if any(np.shape(row) != (self.free.num_dofs,) for row in rows):
            raise ValueError(f"samples of shape [{self.free.num_dofs}] are needed")
        z = self.free.standardised(*(np.asarray(row, np.float64) for row in rows[:3]))
        self._history = np.concatenate([self._history[:, 1:], z[:, None]], axis=1)
        out = np.concatenate([torque_features(self._history), np.stack([command, velocity], 1)], axis=1)
        return out.ravel()
