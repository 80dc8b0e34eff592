"""How far an arm's capsules are inside a box."""

from __future__ import annotations

import numpy as np

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.base.rotation import quat_rotate
from ...sim.base.types import Array


class Workspace:
    """A box that all links beyond the first stay in, by their capsules.

    The first link turns about its own axis on the base and stays where it is.
    """

    def __init__(self, arm: Arm, low: Array, high: Array) -> None:
        """Take an arm of D joints and the corners of the box in its base frame [m], [3] each."""
        self._arm, self._low, self._high = arm, low, high
        tree = arm.tree
        beyond = tree.shape_link > 0
        link = tree.shape_link[beyond]
        self._link = np.concatenate([link, link])
        self._point = np.concatenate([(x[beyond] - tree.anchor[link]) for x in (tree.shape_start, tree.shape_end)])
        self._radius = np.concatenate([tree.shape_radius[beyond].max(axis=1)] * 2)

    def clearance(self, q: Array) -> Array:
        """Return the least distance of any capsule from the box's faces [m], negative outside, [...].

        Args:
            q: Joint positions [rad], [..., D].
        """
        points, turn, _ = forward_kinematics(self._arm, q)
        at = points[..., self._link, :] + quat_rotate(turn[..., self._link, :], self._point)
        inside = np.minimum(at - self._low, self._high - at).min(axis=-1) - self._radius
        out: Array = inside.min(axis=-1)
        return out
