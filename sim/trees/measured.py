"""A branch measured segment by segment, turned into a `Tree`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..base.errors import InputError
from ..base.rotation import quat_multiply
from ..base.types import Array
from .stiffness import hold_rest_pose
from .tree import Joint, Tree


@dataclass(frozen=True)
class MeasuredBranch:
    """Geometry of a chain of R straight, tapered segments at rest under gravity; base first, z up.

    Attributes:
        name: Name of the branch.
        segment_name: Names of the segments, length R.
        length: Lengths [m], shape [R].
        radius: Radii at the lower and the upper end [m], shape [R, 2].
        elevation: Angle of each axis above the horizontal plane [rad], shape [R].
        azimuth: Angle of each axis about z from x [rad], shape [R].
        mass: Masses [kg], shape [R].
        base_position: Lower end of the first segment in the world [m], shape [3].
        gravity: Gravity, downwards positive [m/s^2].
        grasp_segment: Index of the segment that is held.
        grasp_distance: Distance of the grasp point from that segment's lower end [m].
    """

    name: str
    segment_name: tuple[str, ...]
    length: Array
    radius: Array
    elevation: Array
    azimuth: Array
    mass: Array
    base_position: Array
    gravity: float
    grasp_segment: int
    grasp_distance: float

    @property
    def num_segments(self) -> int:
        """Number of segments R."""
        return len(self.segment_name)

    @property
    def axis(self) -> Array:
        """Unit axis of every segment in the rest pose, world frame, shape [R, 3]."""
        across = np.cos(self.elevation)
        return np.stack([across * np.cos(self.azimuth), across * np.sin(self.azimuth), np.sin(self.elevation)], axis=-1)

    @property
    def lower_end(self) -> Array:
        """Lower end of every segment in the rest pose, world frame [m], shape [R, 3]."""
        along = self.axis * self.length[:, None]
        return self.base_position + np.cumsum(along, axis=0) - along

    @property
    def grasp(self) -> tuple[int, Array]:
        """Link that is held and the grasp point in its body frame [m], shape [3]."""
        return self.grasp_segment, np.array([0.0, 0.0, self.grasp_distance])


def measured_tree(
    branch: MeasuredBranch,
    stiffness: ArrayLike,
    damping: ArrayLike,
    joints: Literal["spherical", "revolute"] = "spherical",
) -> Tree:
    """Build the chain of a measured branch, held in its given pose against gravity by pre-loads.

    Each segment is a solid frustum on a joint at its lower end; its body frame sits there, z along the axis and y
    horizontal.

    Args:
        branch: Measured geometry of R segments.
        stiffness: Spring of each joint [N m/rad], shape [R].
        damping: Damper of each joint [N m s/rad], shape [R].
        joints: ``spherical``, or ``revolute`` about y, so that segments bend up and down only.

    Raises:
        InputError: ``stiffness`` or ``damping`` has another shape, is negative or not finite.
    """
    n = branch.num_segments
    given = {"stiffness": np.asarray(stiffness, dtype=np.float64), "damping": np.asarray(damping, dtype=np.float64)}
    for label, value in given.items():
        if value.shape != (n,):
            raise InputError(branch.name, label, f"shape {value.shape}", f"one number per segment, shape ({n},)")
    com, inertia = frustum_inertia(branch.mass, branch.radius, branch.length)
    world = axis_rotation(branch.elevation, branch.azimuth)
    tree = Tree(
        name=branch.name,
        link_name=list(branch.segment_name),
        parent=np.arange(-1, n - 1),
        joint=np.full(n, Joint.SPHERICAL if joints == "spherical" else Joint.REVOLUTE),
        axis=np.tile([0.0, 1.0, 0.0], (n, 1)),
        position=np.concatenate([branch.base_position[None], _up(branch.length[:-1])]),
        rotation=np.concatenate([world[:1], quat_multiply(world[:-1] * [1, -1, -1, -1], world[1:])]),
        mass=branch.mass,
        com=com,
        inertia=inertia,
        level=np.arange(n),
        shape_link=np.arange(n),
        shape_start=np.zeros((n, 3)),
        shape_end=_up(branch.length),
        shape_radius=branch.radius,
        **given,
    ).validate()
    return hold_rest_pose(tree, branch.gravity)


def axis_rotation(elevation: Array, azimuth: Array) -> Array:
    """Quaternion Rz(azimuth) Ry(pi/2 - elevation) that turns z onto an axis and keeps y horizontal, shape [..., 4]."""
    half_z, half_y = azimuth / 2, (np.pi / 2 - elevation) / 2
    cz, sz, cy, sy = np.cos(half_z), np.sin(half_z), np.cos(half_y), np.sin(half_y)
    return np.stack([cz * cy, -sz * sy, cz * sy, sz * cy], axis=-1)


def frustum_inertia(mass: Array, radius: Array, length: Array) -> tuple[Array, Array]:
    """Centre of mass and inertia of solid circular frusta, z along the axis from the lower end.

    From the moments of the disc of radius r(s) = a + (b - a) s at height s length: the mass element is proportional to
    r^2, its inertia about a diameter to r^4 / 4.

    Args:
        mass: Masses [kg], shape [R].
        radius: Radii a at the lower and b at the upper end [m], shape [R, 2].
        length: Lengths [m], shape [R].

    Returns:
        Centres of mass [m], shape [R, 3], and inertias about them [kg m^2], shape [R, 3, 3].
    """
    a, b = radius[:, 0], radius[:, 1]
    volume = a * a + a * b + b * b
    height = length * (a * a + 2 * a * b + 3 * b * b) / (4 * volume)
    height_squared = length**2 * (a * a + 3 * a * b + 6 * b * b) / (10 * volume)
    along = 0.3 * mass * (a**4 + a**3 * b + a * a * b * b + a * b**3 + b**4) / volume
    across = along / 2 + mass * (height_squared - height**2)
    inertia = np.zeros((len(mass), 3, 3))
    inertia[:, 0, 0] = inertia[:, 1, 1] = across
    inertia[:, 2, 2] = along
    return _up(height), inertia


def _up(height: Array) -> Array:
    """Points at some height on the z axis, shape [R, 3]."""
    return np.stack([np.zeros_like(height), np.zeros_like(height), height], axis=-1)
