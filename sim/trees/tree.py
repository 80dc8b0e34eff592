"""The description of one tree: links in a tree of joints, in plain arrays.

A `Tree` is what every source (L-system, measured geometry, MJCF, URDF, a Newton model) is turned into and what a
`Model` is built from. Body frames, anchors and axes are as in MJCF: a body sits at `position`, `rotation` in its
parent's frame when its joint is at zero, and the joint turns it about `anchor`, given in its own frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.types import Array, IntArray

#: Largest number that a tree may hold, in SI units: products of three of them are still numbers of single precision.
LARGEST = 1.0e12
_LATER: Any = None  # replaced by an array of the right length in Tree.__post_init__


class Joint(IntEnum):
    """How a link moves against its parent (or the world)."""

    FIXED = 0
    REVOLUTE = 1
    SPHERICAL = 2
    PRISMATIC = 3

    @property
    def dofs(self) -> int:
        """Degrees of freedom: 0, 1, 3, 1."""
        return (0, 1, 3, 1)[self]

    @property
    def coordinates(self) -> int:
        """Position coordinates in MuJoCo's ``qpos`` order: 0, 1, 4 (w, x, y, z), 1."""
        return (0, 1, 4, 1)[self]


@dataclass
class Tree:
    """One tree of L links and S capsules. All arrays are host NumPy, float64, SI units.

    Parents precede their children: ``parent[i] < i``; -1 is the world.

    Attributes:
        name: Name of the tree.
        link_name: Names of the links, unique, length L.
        parent: Index of each link's parent, shape [L].
        joint: Kind of each link's joint to its parent (`Joint`), shape [L].
        position: Body frame origin in the parent's body frame at joint zero [m], shape [L, 3].
        rotation: Body frame orientation in the parent's, unit quaternion w, x, y, z, shape [L, 4].
        anchor: Point the joint turns about, in the link's own body frame [m], shape [L, 3].
        axis: Unit axis of revolute and prismatic joints in the link's own body frame, shape [L, 3].
        mass: Mass [kg], shape [L]; zero only for links that carry further links.
        com: Centre of mass in the body frame [m], shape [L, 3].
        inertia: Rotational inertia about the centre of mass, body axes [kg m^2], shape [L, 3, 3].
        stiffness: Joint spring [N m/rad or N/m], shape [L].
        damping: Joint damper [N m s/rad or N s/m], shape [L].
        armature: Inertia added to each joint axis [kg m^2 or kg], shape [L].
        rest: Orientation (quaternion w, x, y, z) or coordinate (first entry) where the spring is relaxed, shape [L, 4].
        preload: Joint force P at the spring's rest, of the energy -P.phi [N m or N], shape [L, 3]: three components in
            the body frame for spherical joints, phi their rotation vector from there; a constant first one for others.
        level: Branching order, 0 for the trunk, shape [L].
        shape_link: Link that each capsule belongs to, shape [S].
        shape_start: Where each capsule's axis begins, in the body frame [m], shape [S, 3].
        shape_end: Where it ends [m], shape [S, 3].
        shape_radius: Radius at start and end [m], shape [S, 2].
    """

    name: str
    link_name: list[str]
    parent: IntArray
    joint: IntArray
    position: Array
    rotation: Array
    mass: Array
    com: Array
    inertia: Array
    stiffness: Array
    damping: Array
    anchor: Array = _LATER
    axis: Array = _LATER
    armature: Array = _LATER
    rest: Array = _LATER
    preload: Array = _LATER
    level: IntArray = _LATER
    shape_link: IntArray = _LATER
    shape_start: Array = _LATER
    shape_end: Array = _LATER
    shape_radius: Array = _LATER

    def __post_init__(self) -> None:
        n = len(self.link_name)
        joints = np.asarray(self.joint, dtype=np.int64).reshape(n)
        defaults = {
            "anchor": np.zeros((n, 3)), "axis": np.tile([0.0, 0.0, 1.0], (n, 1)), "armature": np.zeros(n),
            "rest": _neutral(joints), "preload": np.zeros((n, 3)), "level": np.zeros(n, np.int64),
            "shape_link": np.zeros(0, np.int64), "shape_start": np.zeros((0, 3)), "shape_end": np.zeros((0, 3)),
            "shape_radius": np.zeros((0, 2)),
        }  # fmt: skip
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name in ("name", "link_name"):
                continue
            value = defaults[item.name] if value is None else value
            integer = item.name in ("parent", "joint", "level", "shape_link")
            setattr(self, item.name, np.array(value, dtype=np.int64 if integer else np.float64))

    @property
    def num_links(self) -> int:
        """Number of links L."""
        return len(self.link_name)

    @property
    def num_dofs(self) -> int:
        """Number of degrees of freedom."""
        return int(sum(Joint(j).dofs for j in self.joint))

    @property
    def num_coordinates(self) -> int:
        """Length of ``qpos`` in MuJoCo's order (one per scalar joint, four per spherical joint)."""
        return int(sum(Joint(j).coordinates for j in self.joint))

    def children(self) -> list[list[int]]:
        """Children of every link, in index order."""
        out: list[list[int]] = [[] for _ in self.link_name]
        for i, p in enumerate(self.parent):
            if p >= 0:
                out[p].append(i)
        return out

    def validate(self, source: str = "") -> Tree:
        """Return self if it describes a mechanism that can move; raise `InputError` naming the link otherwise."""
        src = source or self.name
        if self.num_links == 0:
            raise InputError(src, "", "no links", "at least one link")
        if len(set(self.link_name)) != self.num_links:
            twice = sorted(n for n in set(self.link_name) if self.link_name.count(n) > 1)
            raise InputError(src, f"link {twice[0]}", "the name twice", "unique link names")
        for sound, found, allowed, values in self._checks():
            if not sound.all():
                i = int(np.argmin(sound))
                raise InputError(src, f"link {self.link_name[i]}", f"{found} {values[i]}", allowed)
        for name in ("shape_start", "shape_end", "shape_radius"):
            value = getattr(self, name)
            for i in np.flatnonzero(~(np.abs(value) <= LARGEST).all(axis=tuple(range(1, value.ndim))))[:1]:
                place = f"link {self.link_name[self.shape_link[i]]}"
                raise InputError(src, place, f"{name} {value[i]}", f"finite numbers up to {LARGEST:g}")
        return self

    def _checks(self) -> Iterator[tuple[NDArray[np.bool_], str, str, NDArray[Any]]]:
        """Yield what must hold of every link: whether it does [L], what is found where not, what is allowed, values."""
        n = self.num_links
        before = np.logical_and(self.parent >= -1, self.parent < np.arange(n))
        yield before, "parent index", "-1 (world) or a link before it", self.parent
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray) and value.dtype == np.float64 and not item.name.startswith("shape_"):
                most = np.abs(value.reshape(n, -1)).max(axis=1)  # NaN where one is
                yield np.isfinite(most), item.name, "finite numbers", value
                yield most <= LARGEST, item.name, f"numbers up to {LARGEST:g}", value
        for name in ("mass", "stiffness", "damping", "armature"):
            value = getattr(self, name)
            yield value >= 0, name, "zero or more", value
        eig = np.linalg.eigvalsh(self.inertia)
        least = -1e-9 * np.maximum(eig[:, 2], 1e-12)
        yield eig[:, 0] >= least, "principal inertias [kg m^2]", "zero or more", eig
        length = np.linalg.norm(self.rotation, axis=1)
        yield np.abs(length - 1) < 1e-6, "a quaternion of length", "unit length", length
        scalar = np.isin(self.joint, [Joint.REVOLUTE, Joint.PRISMATIC])
        unit = np.abs(np.linalg.norm(self.axis, axis=1) - 1) < 1e-6
        yield np.where(scalar, unit, True), "axis", "a unit vector", self.axis

    def with_(self, **changes: Any) -> Tree:
        """Return a copy with some fields exchanged."""
        return replace(self, **changes)


def _neutral(joints: IntArray) -> Array:
    """Rest coordinates at joint zero: identity quaternion for spherical joints, 0 for the others, shape [L, 4]."""
    rest = np.zeros((len(joints), 4))
    rest[joints == Joint.SPHERICAL, 0] = 1.0
    return rest


def capsule_inertia(mass: float, radius: float, length: float) -> tuple[float, float]:
    """Inertia of a solid capsule about its centre: (across, along) its axis [kg m^2].

    ``length`` is that of the cylindrical part [m]; the two half-spheres share the mass by volume.
    """
    cylinder, ball = np.pi * radius**2 * length, 4.0 / 3.0 * np.pi * radius**3
    mc, mb = mass * cylinder / (cylinder + ball), mass * ball / (cylinder + ball)
    along = mc * radius**2 / 2 + mb * 2 * radius**2 / 5
    across = mc * (length**2 / 12 + radius**2 / 4) + mb * (2 * radius**2 / 5 + length**2 / 4 + 3 * length * radius / 8)
    return across, along
