"""Mass properties of pieces of matter: seen from another frame, and put together."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..base.rotation import quat_matrix
from ..base.types import Array

#: Position [m] [3] and orientation (quaternion w, x, y, z) [4] of a frame in another.
Pose = tuple[Array, Array]
_SMALL = 1e-15  # less mass [kg] counts as none


@dataclass
class MassProperties:
    """Mass [kg], centre of mass [m] [3] and inertia about it [kg m^2] [3, 3] in some frame."""

    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def placed(self, pose: Pose) -> MassProperties:
        """Return the same matter seen from the frame in which its own frame has this pose."""
        R = quat_matrix(pose[1])
        return MassProperties(self.mass, pose[0] + R @ self.com, R @ self.inertia @ R.T)


def combined(parts: list[MassProperties]) -> MassProperties:
    """Mass properties of several pieces of matter given in one frame (parallel-axis theorem)."""
    mass = sum(p.mass for p in parts)
    if mass < _SMALL:
        return MassProperties()
    com = sum((p.mass * p.com for p in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for p in parts:
        d = p.com - com
        inertia += p.inertia + p.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return MassProperties(float(mass), com, inertia)
