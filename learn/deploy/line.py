"""The line that points on it lie on: a straight piece, fitted to all that was seen of it."""

from __future__ import annotations

import numpy as np

from ...sim.base.types import Array

_KEPT = 1024  # points that are remembered
_EACH = 128  # points of one picture, spread over it
_ROUNDS = 4
_FAR = 3.0  # deviations from the axis beyond which a point counts no more
_LEAST = 1e-5  # m: spread below which all points count


class LineFit:
    """A straight piece of a line, from points on its surface, some of which may lie elsewhere.

    The line stands still, so that what was hidden by a branch in one picture may be seen in another: points of all
    pictures count alike, the newest where there are too many.

    Attributes:
        ends: Its two ends [m], [2, 3]; both at the origin before anything was seen.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Forget what was seen."""
        self._points = np.zeros((0, 3))
        self.ends: Array = np.zeros((2, 3))

    @property
    def known(self) -> bool:
        """Whether there is a line."""
        return bool((self.ends[0] != self.ends[1]).any())

    def add(self, points: Array) -> None:
        """Take points that were seen [m], [N, 3], and fit again."""
        finite = np.asarray(points, np.float64)
        finite = finite[np.isfinite(finite).all(axis=1)]
        if len(finite) == 0:
            return
        spread = np.unique(np.linspace(0, len(finite) - 1, _EACH).round().astype(int))
        self._points = np.concatenate([self._points, finite[spread]])[-_KEPT:]
        if len(self._points) >= 2:
            self.ends = fitted(self._points)


def fitted(points: Array) -> Array:
    """Return the ends of the straight piece that points lie along [m], [2, 3].

    The axis is the first principal one of points within three deviations of it, found in rounds that begin with
    all; the ends are the outermost of those points along it, in the order of the first and the last.

    Args:
        points: [N, 3], two at least.
    """
    counts = np.ones(len(points), bool)
    for _ in range(_ROUNDS):
        middle = points[counts].mean(axis=0)
        apart = points[counts] - middle
        axis = np.linalg.eigh(apart.T @ apart)[1][:, -1]
        along = (points - middle) @ axis
        off = np.linalg.norm(points - middle - along[:, None] * axis, axis=1)
        spread = 1.4826 * float(np.median(off)) + _LEAST
        counts = off <= _FAR * spread
        if counts.sum() < 2:
            break
    if axis @ (points[-1] - points[0]) < 0.0:
        axis, along = -axis, -along
    ends: Array = middle + np.array([along[counts].min(), along[counts].max()])[:, None] * axis
    return ends
