"""Device arrays of an arm and of what branches, arm, line and ground touch each other with."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from ...kernels.contact.arm import arm_lanes, arm_types
from ...kernels.contact.law import Contact, ContactRule, contact_types
from ..base import rotation
from ..base.types import Array, IntArray
from ..engine.arrays import LaneArray, integer_array
from ..engine.launcher import Launcher
from ..engine.model import Model
from ..trees.tree import Tree
from .arm import Arm, arm_capsules

#: Contacts that press for which Newton's method is used; where more do, there are only sweeps.
DIRECT = 10
#: Middle of a capsule that a world lacks [m].
FAR = 1.0e6


class ArmArrays:
    """An arm's constants, shared by all worlds, and its state in every world, in the worlds' own order.

    Attributes:
        q, qd: Joint positions [rad] and speeds [rad/s], torch views [worlds, dof].
        torque: What the servos did in the last step [N m], [worlds, dof].
        target: Speeds that the servos are asked for [rad/s], [worlds, dof].
        force: Net contact force on every link in the last step, world axes [N], [worlds, dof, 3].
        end_position, end_rotation: End-effector [m] and w, x, y, z, [worlds, 3] and [worlds, 4].
        lost: 1 where a step left the finite, [worlds].
    """

    def __init__(self, arm: Arm, worlds: int, gravity: Array, device: Any, substep: float) -> None:
        self.types, self.device = arm_types(arm.num_dofs), device
        self._keep: list[wp.array] = []
        late = np.rint(arm.delay / substep).astype(np.int32)
        self.constants = self._constants(arm, gravity, late)
        n = arm.num_dofs
        self._state, self._work = self.types.ArmState(), self.types.ArmWork()
        for name, kind in (("q", float), ("qd", float), ("torque", float), ("target", float), ("obeyed", float),
                           ("force", wp.vec3)):  # fmt: skip
            self._field(self._state, name, (worlds, n), kind)
        self._field(self._state, "waiting", (int(late.max()) + 1, worlds, n), float)
        self._field(self._state, "beat", worlds, int)
        self._field(self._state, "lost", worlds, int)
        self._field(self._state, "end_position", worlds, wp.vec3)
        self._field(self._state, "end_rotation", worlds, wp.vec4)
        for name in ("origin", "axis"):
            self._field(self._work, name, (worlds, n), wp.vec3)
        for name in ("inertia", "factor"):
            self._field(self._work, name, worlds, self.types.Square)
        for name in ("bias", "weight", "velocity", "held"):
            self._field(self._work, name, worlds, self.types.Row)
        self._field(self._work, "changed", worlds, int)
        views = {name: wp.to_torch(getattr(self._state, name)) for name in self._state._cls.vars}
        self.q, self.qd, self.torque, self.target = (views[k] for k in ("q", "qd", "torque", "target"))
        self.force, self.end_position, self.end_rotation = (views[k] for k in ("force", "end_position", "end_rotation"))
        self.lost = views["lost"]

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the arrays of ArmState; the worlds are the first dimension of each, of ``waiting`` the second."""
        return tuple(self._state._cls.vars)

    @property
    def kernel(self) -> tuple[Any, Any, Any]:
        """The Warp structs Arm, ArmState and ArmWork."""
        return self.constants, self._state, self._work

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        return sum(a.size * wp.types.type_size_in_bytes(a.dtype) for a in self._keep)

    def _field(self, struct: Any, name: str, shape: Any, kind: Any) -> None:
        array: wp.array = wp.zeros(shape, dtype=kind, device=self.device)
        self._keep.append(array)
        setattr(struct, name, array)

    def _constants(self, arm: Arm, gravity: Array, late: NDArray[np.int32]) -> Any:
        out, tree = self.types.Arm(), arm.tree
        turned = rotation.quat_rotate(tree.rotation, tree.anchor)
        before = np.concatenate([np.zeros((1, 3)), tree.anchor[:-1]])
        #: every link's frame is moved to its joint point
        vectors = {"position": tree.position + turned - before, "axis": tree.axis, "com": tree.com - tree.anchor}
        anchor = tree.anchor[tree.shape_link]
        vectors["shape_start"] = np.concatenate([arm.base_start, tree.shape_start - anchor])
        vectors["shape_end"] = np.concatenate([arm.base_end, tree.shape_end - anchor])
        numbers = {
            "mass": tree.mass, "armature": tree.armature, "damping": tree.damping, "gain": arm.gain,
            "friction": arm.friction, "weight_error": arm.weight_error,
            "torque_limit": arm.torque_limit, "speed_limit": arm.velocity_limit, "lower": arm.lower, "upper": arm.upper,
            "reach": _reach(vectors), "shape_radius": np.concatenate([arm.base_radius, tree.shape_radius.mean(axis=1)]),
        }  # fmt: skip
        for name, value in (numbers | vectors).items():
            kind = wp.vec3 if name in vectors else wp.float32
            self._constant(out, name, value.astype(np.float32), kind)
        self._constant(out, "rotation", _xyzw(tree.rotation), wp.quat)
        self._constant(out, "inertia", tree.inertia.astype(np.float32), wp.mat33)
        link = np.concatenate([np.full(len(arm.base_radius), -1), tree.shape_link])
        self._constant(out, "shape_link", link.astype(np.int32), int)
        self._constant(out, "late", late, int)
        self._constant(out, "pair", _pairs(arm, link), int)
        out.end_link = int(arm.end_link)
        out.end_position = wp.vec3(*(arm.end_position - tree.anchor[arm.end_link]))
        out.end_rotation = wp.quat(*_xyzw(arm.end_rotation))
        out.gravity = wp.vec3(*gravity)
        return out

    def _constant(self, struct: Any, name: str, value: Any, kind: Any) -> None:
        array: wp.array = wp.array(np.ascontiguousarray(value), dtype=kind, device=self.device)
        self._keep.append(array)
        setattr(struct, name, array)


def _xyzw(q: Array) -> Array:
    return np.roll(q, -1, axis=-1).astype(np.float32)


def _reach(vectors: dict[str, Array]) -> Array:
    """Greatest distance of any point of the arm from each joint [m]: the lengths of all links further out, summed."""
    steps = np.linalg.norm(vectors["position"], axis=1)
    ends = np.linalg.norm(np.concatenate([vectors["shape_start"], vectors["shape_end"]]), axis=1).max()
    return np.array([steps[j + 1 :].sum() + ends for j in range(len(steps))])


def _pairs(arm: Arm, link: IntArray) -> NDArray[np.int32]:
    """Capsules of links that may meet: neither of one link nor of neighbours, and apart in the home pose."""
    start, end = arm_capsules(arm, arm.home)
    radius = np.concatenate([arm.base_radius, arm.tree.shape_radius.mean(axis=1)])
    share = np.linspace(0.0, 1.0, 17)[:, None]
    points = [a + share * (b - a) for a, b in zip(start, end, strict=True)]
    far = []
    for i in range(len(link)):
        for j in range(i + 1, len(link)):
            gap = np.linalg.norm(points[i][:, None] - points[j][None], axis=-1).min() - radius[i] - radius[j]
            if link[i] >= 0 and link[j] - link[i] > 1 and gap > 0.0:
                far.append((i, j))
    return np.array(far, np.int32).reshape(-1, 2)


class TouchArrays:
    """Capsules of all branches, the rule of contact and the contacts themselves.

    Attributes:
        kernel: The Warp structs ContactRule, Shapes and Touch.
        friction: Coefficient of friction, torch view [worlds].
        line_start, line_end: Ends of the power line's axis [m], torch views [worlds, 3].
        line_mask: 1 where branches and line touch, int32 torch view [worlds].
        count, overflow: Contacts of the last step, and those that found no room since the last reset, [worlds].
        forgotten: Contacts that found no room before it, [worlds].
        depth: Deepest penetration of the last step [m], [worlds].
        branch_force: Net contact force on every capsule of the branches in the last step [N], [worlds, B, 3].
        arm_peak: Greatest force on every link of the arm since it was last set to zero [N], [worlds, dof].
        radius: Radii of all capsules, arm first, 0 where a world has none [m], Warp array [worlds, C].
        owner: Link of each capsule of each world, -1 where it has none, [worlds, B].
    """

    def __init__(self, model: Model, launcher: Launcher, arm: Arm, capacity: int) -> None:
        self._model, self._types = model, contact_types(model.width, 32)
        self.device = model.device
        self.num_arm = len(arm.base_radius) + arm.num_capsules
        self._rule = self._make_rule(arm, capacity)
        self._shapes = self._make_shapes()
        self._touch = self._make_touch(launcher)
        self._space_struct = self._make_space(launcher, arm.num_dofs, capacity)
        self._arms = self._make_lanes(launcher, arm)
        self.kernel = (self._rule, self._shapes, self._touch, self._space_struct, self._arms)

    # ---- rule and records --------------------------------------------------------------------------------------------

    def _make_rule(self, arm: Arm, capacity: int) -> Any:
        rule, worlds, dev = ContactRule(), self._model.num_worlds, self.device
        capsules = max(len(t.shape_link) for t in self._model.trees)
        made = {
            "friction": wp.zeros(worlds, dtype=float, device=dev),
            "line_start": wp.zeros(worlds, dtype=wp.vec3, device=dev),
            "line_end": wp.zeros(worlds, dtype=wp.vec3, device=dev),
            "line_mask": wp.zeros(worlds, dtype=int, device=dev),
            "record": wp.zeros((worlds, capacity), dtype=Contact, device=dev),
            "count": wp.zeros(worlds, dtype=int, device=dev),
            "overflow": wp.zeros(worlds, dtype=int, device=dev),
            "forgotten": wp.zeros(worlds, dtype=int, device=dev),
            "unsettled": wp.zeros(worlds, dtype=int, device=dev),
            "depth": wp.zeros(worlds, dtype=float, device=dev),
            "branch_force": wp.zeros((worlds, capsules), dtype=wp.vec3, device=dev),
            "arm_peak": wp.zeros((worlds, arm.num_dofs), dtype=float, device=dev),
            "arm_bound": self._arm_bounds(arm),
        }
        for name, array in made.items():
            setattr(rule, name, array)
        self.record = made["record"]
        self.warp = made
        for name in ("friction", "line_start", "line_end", "line_mask", "count", "overflow", "forgotten", "unsettled",
                     "depth", "branch_force", "arm_peak"):  # fmt: skip
            view: torch.Tensor = wp.to_torch(made[name])
            setattr(self, name, view)
        return rule

    friction: torch.Tensor
    line_start: torch.Tensor
    line_end: torch.Tensor
    line_mask: torch.Tensor
    count: torch.Tensor
    overflow: torch.Tensor
    forgotten: torch.Tensor
    unsettled: torch.Tensor
    depth: torch.Tensor
    branch_force: torch.Tensor
    arm_peak: torch.Tensor

    def _arm_bounds(self, arm: Arm) -> wp.array:
        start = np.concatenate([arm.base_start, arm.tree.shape_start])
        end = np.concatenate([arm.base_end, arm.tree.shape_end])
        radius = np.concatenate([arm.base_radius, arm.tree.shape_radius.mean(axis=1)])
        bound = np.linalg.norm(end - start, axis=1) / 2 + radius
        return wp.array(bound.astype(np.float32), dtype=float, device=self.device)

    # ---- capsules of the branches ------------------------------------------------------------------------------------

    def _make_shapes(self) -> Any:
        m = self._model
        numbers = [_numbered(t) for t in m.trees]
        places = [m.link_place[a:b] for a, b in pairwise(m.first_link)]
        slots = m.groups * m.width
        rows: list[dict[tuple[int, int], list[tuple[int, int, int]]]] = [{} for _ in range(m.groups)]
        for w, (tree, place) in enumerate(zip(m.trees, places, strict=True)):
            slot = int(m.world_slot[w])
            for c, link in enumerate(tree.shape_link):
                key = (int(place[link]), int(numbers[w][c]))
                rows[slot // m.width].setdefault(key, []).append((slot, w, c))
        most = max((len(r) for r in rows), default=0)
        return self._fill_shapes(rows, max(most, 1), slots)

    def _fill_shapes(self, rows: list[dict[tuple[int, int], list[tuple[int, int, int]]]], most: int, slots: int) -> Any:
        m, out = self._model, self._types.Shapes()
        link, count = np.zeros((m.groups, most), np.int64), np.array([len(r) for r in rows])
        capsule = np.full((slots, most), -1, np.int64)
        middle, half = np.zeros((slots, most, 3)), np.zeros((slots, most, 3))
        middle[:] = FAR
        radius, bound = np.zeros((slots, most, 1)), np.zeros((slots, most, 1))
        ends = [self._capsule_ends(w) for w in range(len(m.trees))]
        for g, row in enumerate(rows):
            for c, key in enumerate(sorted(row)):
                link[g, c] = key[0]
                for slot, w, own in row[key]:
                    a, b = ends[w][0][own], ends[w][1][own]
                    capsule[slot, c], radius[slot, c, 0] = own, m.trees[w].shape_radius[own].mean()
                    middle[slot, c], half[slot, c] = (a + b) / 2, (b - a) / 2
                    bound[slot, c, 0] = np.linalg.norm(b - a) / 2 + radius[slot, c, 0]
        self._lanes = {}
        for name, kind, values in (("middle", "Vec", middle), ("half", "Vec", half), ("radius", "Real", radius),
                                   ("bound", "Real", bound)):  # fmt: skip
            array = m.field(kind, places=most)
            array.assign(values)
            self._lanes[name] = array
            setattr(out, name, array.kernel)
        out.count, out.link = integer_array(count, m.device), integer_array(link, m.device)
        out.slot_capsule = integer_array(capsule, m.device)
        self._integers = [out.count, out.link, out.slot_capsule]
        self._lay_pairs(out, [np.zeros((0, 3), np.int64)] * m.groups)
        return out

    def _capsule_ends(self, world: int) -> tuple[Array, Array]:
        """Return the ends of a tree's capsules in their links' frames [m], [C, 3] each."""
        m, tree = self._model, self._model.trees[world]
        links = m.first_link[world] + tree.shape_link
        return m.links.in_link_frame(links, tree.shape_start), m.links.in_link_frame(links, tree.shape_end)

    def _lay_pairs(self, shapes: Any, found: list[IntArray]) -> None:
        count = np.array([len(f) for f in found])
        pair = np.zeros((len(found), max(int(count.max()), 1), 3), np.int32)
        for g, f in enumerate(found):
            pair[g, : len(f)] = f
        self._pair: wp.array = wp.array(pair, dtype=int, device=self.device)
        shapes.pairs, shapes.pair = integer_array(count, self.device), self._pair
        self._integers.append(shapes.pairs)

    def pair_branches(self, start: Array, end: Array, radius: Array) -> None:
        """Let branches touch each other: all capsules of a world that are apart where they stand now.

        Those that overlap, as a branch and the one it grows from, never touch. A group's worlds share one list of
        pairs, with a bit for every lane in which the pair may touch.

        Args:
            start: First ends of the branches' axes [m], [worlds, capsules, 3].
            end: Their other ends.
            radius: [m], [worlds, capsules].
        """
        m, found = self._model, []
        capsule = self._shapes.slot_capsule.numpy()
        world = np.full(m.groups * m.width, -1)
        world[np.asarray(m.world_slot)] = np.arange(m.num_worlds)
        for g, count in enumerate(self._shapes.count.numpy()):
            one, two = np.triu_indices(int(count), 1)
            lanes = np.zeros(len(one), np.int64)
            for lane in range(m.width):
                w, own = world[g * m.width + lane], capsule[g * m.width + lane]
                a, b = own[one], own[two]
                both = (a >= 0) & (b >= 0) & (w >= 0)
                lanes[both] |= _apart(start[w], end[w], radius[w], a[both], b[both]).astype(np.int64) << lane
            found.append(np.stack([one, two, lanes], axis=1)[lanes > 0])
        self._lay_pairs(self._shapes, found)

    def _make_touch(self, launcher: Launcher) -> Any:
        out = self._types.Touch()
        self._fields: dict[str, LaneArray] = {}
        kinds = {"at": "Vec", "velocity": "Vec", "n": "Vec", "f": "Vec"}
        for name, kind in kinds.items():
            self._fields[name] = launcher.field(kind)
        self._fields["near"] = launcher.field("Vec", places=3 * self.num_arm + 3)
        capsules = self._shapes.link.shape[1]
        self._fields["centre"] = launcher.field("Vec", places=capsules)
        self._fields["reach"] = launcher.field("Real", places=capsules)
        _set_fields(out, self._fields)
        self._fields["near"].torch.fill_(-FAR)  # lanes without a world: far from absent capsules
        self._path: wp.array = wp.zeros(self._fields["at"].kernel.shape, dtype=int, device=self.device)
        out.path = self._path
        return out

    def _make_lanes(self, launcher: Launcher, arm: Arm) -> Any:
        out, n = arm_lanes(self._model.width)(), arm.num_dofs
        sizes = dict.fromkeys(("q", "qd", "bias", "weight"), ("Real", n)) | {"inertia": ("Real", n * n)}
        sizes |= {"pose": ("Quat", n), "tensor": ("Sym", n)} | dict.fromkeys(("start", "end"), ("Vec", self.num_arm))
        sizes |= dict.fromkeys(("origin", "axis", "slide", "first", "push", "moment"), ("Vec", n))
        self._lane_fields = {name: launcher.field(kind, places=places) for name, (kind, places) in sizes.items()}
        _set_fields(out, self._lane_fields)
        return out

    def _make_space(self, launcher: Launcher, dof: int, capacity: int) -> Any:
        out = self._types.Space()
        rows, places = self._path.shape
        turns = -(-3 * capacity // self._model.width)
        kinds = {"D": "Sym", "U": "Mat", "k": "Real", "r": "Vec"}
        fields = {name: launcher.field(kind) for name, kind in kinds.items()}
        fields |= {name: launcher.field("Vec", team=launcher.team) for name in ("n", "f", "alpha", "accel")}
        sizes = {"branch": 3 * capacity * turns, "total": 3 * capacity * turns, "arm": dof * turns, "free": turns,
                 "velocity": turns}  # fmt: skip
        fields |= {name: launcher.field("Real", places=size, by_link=False) for name, size in sizes.items()}
        _set_fields(out, fields)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("number", "up", "kind"), (rows, places))
        shapes |= {"gate": (rows, 2), "size": (rows,)}
        shapes |= dict.fromkeys(("frame", "still", "force", "spring", "resist", "give"), (rows, capacity))
        shapes |= {"pressing": (rows, DIRECT), "matrix": (rows, 3 * DIRECT, 3 * DIRECT), "right": (rows, 3 * DIRECT)}
        self._space_fields, self._space = fields, {}
        for name, shape in shapes.items():
            self._space[name] = wp.zeros(shape, dtype=out._cls.vars[name].type.dtype, device=self.device)
            setattr(out, name, self._space[name])
        return out

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        arrays = (*self.warp.values(), *self._space.values(), self._path)
        made = sum(a.size * wp.types.type_size_in_bytes(a.dtype) for a in arrays)
        return int(made) + sum(
            f.nbytes
            for f in (
                *self._fields.values(),
                *self._space_fields.values(),
                *self._lane_fields.values(),
                *self._lanes.values(),
            )
        )


def _apart(start: Array, end: Array, radius: Array, a: IntArray, b: IntArray) -> Array:
    """Return whether pairs of capsules do not overlap, judged at nine points along each axis."""
    share = np.linspace(0.0, 1.0, 9)[:, None, None]
    points = (start + share * (end - start)).transpose(1, 0, 2)
    gap = np.linalg.norm(points[a][:, :, None] - points[b][:, None, :], axis=3).min(axis=(1, 2))
    clear: Array = gap > radius[a] + radius[b]
    return clear


def _set_fields(struct: Any, fields: dict[str, LaneArray]) -> None:
    """Set the fields of a struct, and the views of their entries where it has some."""
    for name, field in fields.items():
        setattr(struct, name, field.kernel)
        if f"{name}_entry" in struct._cls.vars:
            setattr(struct, f"{name}_entry", field.entries())


def _numbered(tree: Tree) -> IntArray:
    """Return every capsule's number among those of its link."""
    seen: dict[int, int] = {}
    out = []
    for link in tree.shape_link.tolist():
        out.append(seen.get(link, 0))
        seen[link] = out[-1] + 1
    return np.array(out, np.int64)
