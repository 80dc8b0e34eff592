"""Everything about the worlds that does not change while they move."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from ...kernels.tree.layout import layout_of
from ..base import rotation
from ..base.errors import InputError
from ..base.host import lane_width
from ..base.types import Array, IntArray
from ..trees.tree import Joint, Tree
from .arrays import LaneArray, integer_array
from .parameters import Links, link_parameters
from .topology import Layout, arrange

_FIELDS = {
    "offset": "Vec", "turn": "Quat", "axis": "Vec", "mass": "Real", "com": "Vec", "inertia": "Vec",
    "stiffness": "Real", "damping": "Real", "armature": "Real", "preload": "Vec",
}  # fmt: skip


class Model:
    """Constant arrays of a batch of worlds, one tree each.

    Attributes:
        trees: The description of every world.
        width: Worlds a thread (lanes), 1, 8 or 16.
        precision: 32 or 64 bit.
        groups: Kernel arrays are [groups, places + 1], a thread each.
        places: Links that kernel arrays have room for, beside place 0, the world.
        world_slot: Slot of every world, shape [worlds]; slot = group * width + lane.
        arrays: The fields of `kernels.tree.layout` Model as `LaneArray`, by name.
        kernel: The Warp struct that kernels take.
        links: The host parameters behind the arrays.
        freedom: How the trees of each group are held, 0, 1 or 2 as in `kernels.tree.momentum`, shape [groups].
        has_free_trees: Whether any tree is held by nothing, so that its momentum is kept (`kernels.tree.momentum`).
    """

    def __init__(
        self,
        trees: Tree | Sequence[Tree],
        *,
        gravity: Sequence[float] | Array = (0.0, 0.0, -9.81),
        device: Any = None,
        precision: int = 32,
        width: int | None = None,
    ) -> None:
        """Build the arrays.

        Args:
            trees: One tree a world; a single tree makes one world. Trees may all differ.
            gravity: Acceleration of free fall [m/s^2].
            device: Warp device; None takes Warp's default.
            precision: 32 or 64 bit.
            width: Worlds a thread; None takes what suits the device and the number of worlds.

        Raises:
            InputError: A tree cannot move (see `Tree.validate`), or a link has no inertia to move with.
        """
        self.trees = [trees] if isinstance(trees, Tree) else list(trees)
        if not self.trees:
            raise InputError("model", "trees", "none", "at least one tree")
        for tree in {id(t): t for t in self.trees}.values():
            tree.validate()
            check_movable(tree)
        self.device = wp.get_device(device)
        self.precision = precision
        self.width = lane_width(self.device, precision, len(self.trees)) if width is None else width
        self.gravity = np.asarray(gravity, np.float64)
        self._layout = arrange(self.trees, self.width)
        self.links = link_parameters(self.trees)
        self._index()
        self._allocate()

    @property
    def num_worlds(self) -> int:
        """Number of worlds."""
        return len(self.trees)

    @property
    def nbytes(self) -> int:
        """Bytes of all device arrays of the model."""
        return sum(a.nbytes for a in self.arrays.values()) + sum(a.size * 4 for a in self._integers.values())

    def link_name(self, world: int, place: int) -> str:
        """Return the name of the link at a place of a world's kernel arrays."""
        a, b = self.first_link[world : world + 2]
        return self.trees[world].link_name[int(np.flatnonzero(self.link_place[a:b] == place)[0])]

    def field(self, kind: str, places: int | None = None) -> LaneArray:
        """Return a zeroed array over this model's groups and places ("Real", "Vec", "Quat", "Sym", "Mat")."""
        n = self.places + 1 if places is None else places
        return LaneArray(kind, self.groups, n, width=self.width, precision=self.precision, device=self.device)

    def scatter(self, values: Array, fill: Sequence[float]) -> Array:
        """Return per-link values [N, C] as [slots, places + 1, C] with ``fill`` [C] where no link is."""
        out = np.empty((self.groups * self.width, self.places + 1, len(fill)))
        out[:] = fill
        out[self.link_slot, self.link_place] = np.reshape(values, (-1, len(fill)))
        return out

    def gather(self, values: Array) -> Array:
        """Return per-link values [N, C] from [slots, places + 1, C]."""
        return values[self.link_slot, self.link_place]

    def _index(self) -> None:
        layout: Layout = self._layout
        self.groups, self.places = len(layout.count), layout.parent.shape[1] - 1
        self.world_slot: IntArray = layout.world_slot
        self.freedom: IntArray = layout.free
        self.link_place: IntArray = np.concatenate(layout.place)
        self.link_slot: IntArray = layout.world_slot[self.links.world]
        counts = [t.num_links for t in self.trees]
        self.first_link: IntArray = np.cumsum([0, *counts])

    def _allocate(self) -> None:
        t = layout_of(self.width, self.precision)
        self.kernel = t.Model()
        self.has_free_trees = bool(self.freedom.any())
        self._integers = {name: self._int(getattr(self._layout, name)) for name in ("count", "free")}
        self._integers |= self._arrivals()
        for name in ("parent", "kind"):
            self._integers[name] = self._int(getattr(self._layout, name))
        self.arrays: dict[str, LaneArray] = {}
        fill = {"turn": [1.0, 0, 0, 0], "axis": [0, 0, 1.0], "armature": [1.0]}  # a masked link: mass 0, k = 1
        for name, kind in _FIELDS.items():
            array = self.field(kind)
            zero = [0.0] * array.components
            array.assign(self.scatter(getattr(self.links, name), fill.get(name, zero)))
            self.arrays[name] = array
            setattr(self.kernel, name, array.kernel)
        for name, integer in self._integers.items():
            setattr(self.kernel, name, integer)
        self.kernel.lift = wp.array(-self.gravity, dtype=wp.float64, device=self.device)

    def _arrivals(self) -> dict[str, wp.array]:
        """Mark the places that carry others, and each parent's child that arrives first going inward."""
        parent, count = self._layout.parent, self._layout.count
        inner, first = np.zeros_like(parent), np.zeros_like(parent)
        for i in range(parent.shape[1] - 1, 0, -1):
            rows = np.flatnonzero(i <= count)
            above = parent[rows, i]
            first[rows, i] = 1 - inner[rows, above]
            inner[rows, above] = 1
        return {"inner": self._int(inner), "first": self._int(first)}

    def _int(self, values: IntArray) -> wp.array:
        return integer_array(values, self.device)

    # ---- coordinates in MuJoCo's order ---------------------------------------------------------------------------

    def coordinates_from_qpos(self, qpos: Sequence[Array]) -> Array:
        """Return kernel coordinates [N, 4] of all links from one ``qpos`` (MuJoCo's order) a world.

        Raises:
            InputError: A ``qpos`` has the wrong length or a quaternion of length zero.
        """
        flat = np.concatenate([self._coordinates(w, np.asarray(q, np.float64)) for w, q in enumerate(qpos)])
        links: Links = self.links
        spherical = (links.kind == Joint.SPHERICAL)[:, None]
        # rest^-1 q, seen from the link frame
        turned = rotation.quat_multiply(rotation.quat_conjugate(np.where(spherical, links.rest, [1.0, 0, 0, 0])), flat)
        inverse = rotation.quat_conjugate(links.frame)
        turned = rotation.quat_multiply(rotation.quat_multiply(inverse, turned), links.frame)
        scalar = np.zeros_like(flat)
        scalar[:, 0] = 1.0
        scalar[:, 1] = np.where(links.kind == Joint.FIXED, 0.0, flat[:, 0] - links.rest[:, 0])
        return np.where(spherical, turned, scalar)

    def _coordinates(self, world: int, qpos: Array) -> Array:
        tree = self.trees[world]
        if qpos.shape != (tree.num_coordinates,):
            raise InputError(
                tree.name, "qpos", f"{qpos.size} numbers", f"{tree.num_coordinates} (w x y z a ball joint, 1 a hinge)"
            )
        out, k = np.zeros((tree.num_links, 4)), 0
        for i, joint in enumerate(tree.joint):
            n = Joint(joint).coordinates
            out[i, :n] = qpos[k : k + n]
            k += n
            length = np.linalg.norm(out[i])
            if n == 4 and not 1e-9 < length < np.inf:
                raise InputError(
                    tree.name, f"qpos[{k - 4}:{k}] (link {tree.link_name[i]})", f"{out[i]}", "a quaternion"
                )
            out[i] = out[i] / length if n == 4 else out[i]
        return out

    def qpos_from_coordinates(self, coordinates: Array) -> list[Array]:
        """Return one ``qpos`` a world from kernel coordinates [N, 4]; the inverse of `coordinates_from_qpos`."""
        links: Links = self.links
        spherical = (links.kind == Joint.SPHERICAL)[:, None]
        q = rotation.quat_multiply(
            rotation.quat_multiply(links.frame, coordinates), rotation.quat_conjugate(links.frame)
        )
        q = rotation.quat_multiply(np.where(spherical, links.rest, [1.0, 0, 0, 0]), q)
        scalar = np.zeros_like(q)
        scalar[:, 0] = coordinates[:, 1] + links.rest[:, 0]
        values = np.where(spherical, q, scalar)
        keep = [np.arange(4)[None, :] < np.array([Joint(j).coordinates for j in t.joint])[:, None] for t in self.trees]
        return [values[a:b][k] for a, b, k in zip(self.first_link, self.first_link[1:], keep, strict=False)]


def check_movable(tree: Tree) -> None:
    """Raise `InputError` for a joint that would have nothing to accelerate: no inertia beyond it and no damper."""
    carried = tree.mass + np.trace(tree.inertia, axis1=1, axis2=2)
    for i in range(tree.num_links - 1, -1, -1):
        if tree.parent[i] >= 0:
            carried[tree.parent[i]] += carried[i]
        if carried[i] <= 0 and tree.joint[i] != Joint.FIXED and tree.armature[i] <= 0:
            raise InputError(
                tree.name, f"link {tree.link_name[i]}", "a joint that carries no mass", "a mass above zero"
            )
