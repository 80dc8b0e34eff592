"""Kernels between the lanes' arrays and plain tensors [worlds, links] or [worlds, columns] in MuJoCo's order.

With F the link frame in the body frame and R the spring's rest orientation, both of a link on a ball joint, a joint
orientation Q as MuJoCo's ``qpos`` has it and an angular velocity w as its ``qvel`` has it are, for the kernels,

    q = F^-1 R^-1 Q F,     v = F^-1 w

Scalar joints differ by the spring's rest coordinate alone. Fields are reached number by number through views
[group, place, component, lane], which suit every lane width and memory order; a thread serves one link of one row of
the tensor. Row r is world ``index[r]``, and is passed over where ``mask`` of that world is false.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.real import SOURCE
from .articulated import FIXED, SPHERICAL

__all__ = ["exchange_kernels", "exchange_types"]


@cache
def exchange_types(precision: int = 32) -> SimpleNamespace:
    """Return ``Scalar``, ``Vec``, ``Quat`` of a precision and the struct ``Slots``.

    ``Slots`` says where link l of world w is: its slot and place in the lanes' arrays (place 0: there is no such link),
    the kind of its joint, its first columns in ``qpos`` and ``qvel``, F, R (or the rest coordinate in its first
    number) as x, y, z, w, and the joint point in the body frame [m].
    """
    Scalar, Vec, Quat = (wp.float64, wp.vec3d, wp.quatd) if precision == 64 else (wp.float32, wp.vec3f, wp.quatf)

    @wp.struct
    class Slots:
        """Where the links of all worlds are, in both layouts."""

        slot: wp.array(dtype=int)
        place: wp.array2d(dtype=int)
        kind: wp.array2d(dtype=int)
        q_start: wp.array2d(dtype=int)
        v_start: wp.array2d(dtype=int)
        frame: wp.array2d(dtype=Quat)
        rest: wp.array2d(dtype=Quat)
        anchor: wp.array2d(dtype=Vec)

    return SimpleNamespace(Scalar=Scalar, Vec=Vec, Quat=Quat, Slots=Slots)


@wp.func
def world_of(r: int, index: wp.array(dtype=int), mask: wp.array(dtype=wp.bool)):
    """World of a row of a tensor, or -1 where it is masked or does not exist."""
    world = index[r]
    if world < 0 or world >= mask.shape[0]:
        return -1
    if not mask[world]:
        return -1
    return world


@wp.func
def vec_at(field: Any, g: int, i: int, k: int, like: Any):
    """Vector of a field, of the type of ``like``."""
    return type(like)(field[g, i, 0, k], field[g, i, 1, k], field[g, i, 2, k])


@wp.func
def put_vec(field: Any, g: int, i: int, k: int, v: Any):
    """Write a vector of a field."""
    for c in range(3):
        field[g, i, c, k] = v[c]


@wp.func
def row_at(values: Any, r: int, first: int, like: Any):
    """Three numbers of a row, of the type of ``like``."""
    return type(like)(values[r, first], values[r, first + 1], values[r, first + 2])


@wp.func
def unit(q: wp.quatf):
    """Return a quaternion at length one: to the bit where it has that, the identity where it has none."""
    n = wp.dot(q, q)
    if wp.abs(n - 1.0) <= 1.0e-6:
        return q
    if n <= 1.0e-30:
        return wp.quatf(0.0, 0.0, 0.0, 1.0)
    return q * (1.0 / wp.sqrt(n))


@wp.func
def unit(q: wp.quatd):
    """Return a quaternion at length one, in float64."""
    n = wp.dot(q, q)
    one = wp.float64(1.0)
    o = wp.float64(0.0)
    if wp.abs(n - one) <= wp.float64(1.0e-14):
        return q
    if n <= wp.float64(1.0e-30):
        return wp.quatd(o, o, o, one)
    return q * (one / wp.sqrt(n))


def _readers(t: SimpleNamespace) -> dict[str, Any]:
    """Kernels that write tensors."""
    Scalar, Quat, Slots = t.Scalar, t.Quat, t.Slots

    @wp.kernel(enable_backward=False, module="unique")
    def get_links(s: Slots, field_in: wp.array4d(dtype=Scalar), values_out: wp.array3d(dtype=Scalar)):
        """Every component as it is."""
        tag = SOURCE  # noqa: F841
        w, n = wp.tid()
        i = s.place[w, n]
        if i > 0:
            lanes = field_in.shape[3]
            for c in range(values_out.shape[2]):
                values_out[w, n, c] = field_in[s.slot[w] // lanes, i, c, s.slot[w] % lanes]

    @wp.kernel(enable_backward=False, module="unique")
    def get_points(s: Slots, field_in: wp.array4d(dtype=Scalar), values_out: wp.array3d(dtype=Scalar)):
        """Points of link frames in body frames."""
        tag = SOURCE  # noqa: F841
        w, n = wp.tid()
        i = s.place[w, n]
        if i > 0:
            lanes = field_in.shape[3]
            own = vec_at(field_in, s.slot[w] // lanes, i, s.slot[w] % lanes, s.anchor[w, n])
            point = s.anchor[w, n] + wp.quat_rotate(s.frame[w, n], own)
            for c in range(3):
                values_out[w, n, c] = point[c]

    @wp.kernel(enable_backward=False, module="unique")
    def get_dofs(s: Slots, field_in: wp.array4d(dtype=Scalar), values_out: wp.array2d(dtype=Scalar)):
        """Rates, efforts and the like, of ball joints in the body frame."""
        tag = SOURCE  # noqa: F841
        w, n = wp.tid()
        i = s.place[w, n]
        kind = s.kind[w, n]
        if i > 0 and kind != FIXED:
            lanes = field_in.shape[3]
            g, k, first = s.slot[w] // lanes, s.slot[w] % lanes, s.v_start[w, n]
            if kind == SPHERICAL:
                v = wp.quat_rotate(s.frame[w, n], vec_at(field_in, g, i, k, s.anchor[w, n]))
                for c in range(3):
                    values_out[w, first + c] = v[c]
            else:
                values_out[w, first] = field_in[g, i, 0, k]

    @wp.kernel(enable_backward=False, module="unique")
    def get_qpos(s: Slots, field_in: wp.array4d(dtype=Scalar), values_out: wp.array2d(dtype=Scalar)):
        """Coordinates in MuJoCo's order: Q = R F q F^-1."""
        tag = SOURCE  # noqa: F841
        w, n = wp.tid()
        i = s.place[w, n]
        kind = s.kind[w, n]
        if i > 0 and kind != FIXED:
            lanes = field_in.shape[3]
            g, k, first = s.slot[w] // lanes, s.slot[w] % lanes, s.q_start[w, n]
            rest = s.rest[w, n]
            if kind == SPHERICAL:
                q = Quat(field_in[g, i, 1, k], field_in[g, i, 2, k], field_in[g, i, 3, k], field_in[g, i, 0, k])
                turned = rest * (s.frame[w, n] * q * wp.quat_inverse(s.frame[w, n]))
                values_out[w, first] = turned[3]
                for c in range(3):
                    values_out[w, first + 1 + c] = turned[c]
            else:
                values_out[w, first] = field_in[g, i, 1, k] + rest[0]

    return {"get_links": get_links, "get_points": get_points, "get_dofs": get_dofs, "get_qpos": get_qpos}


def _writers(t: SimpleNamespace) -> dict[str, Any]:
    """Kernels that read tensors; they take worlds and mask before the values."""
    Scalar, Vec, Quat, Slots = t.Scalar, t.Vec, t.Quat, t.Slots

    @wp.kernel(enable_backward=False, module="unique")
    def set_links(
        s: Slots, index: wp.array(dtype=int), mask: wp.array(dtype=wp.bool), values: wp.array3d(dtype=Scalar),
        field_out: wp.array4d(dtype=Scalar),
    ):  # fmt: skip
        """Every component as it is."""
        tag = SOURCE  # noqa: F841
        r, n = wp.tid()
        w = world_of(r, index, mask)
        if w >= 0 and s.place[wp.max(w, 0), n] > 0:
            lanes = field_out.shape[3]
            for c in range(values.shape[2]):
                field_out[s.slot[w] // lanes, s.place[w, n], c, s.slot[w] % lanes] = values[r, n, c]

    @wp.kernel(enable_backward=False, module="unique")
    def set_points(
        s: Slots, index: wp.array(dtype=int), mask: wp.array(dtype=wp.bool), values: wp.array3d(dtype=Scalar),
        field_out: wp.array4d(dtype=Scalar),
    ):  # fmt: skip
        """Points of body frames in link frames."""
        tag = SOURCE  # noqa: F841
        r, n = wp.tid()
        w = world_of(r, index, mask)
        if w >= 0 and s.place[wp.max(w, 0), n] > 0:
            lanes = field_out.shape[3]
            point = Vec(values[r, n, 0], values[r, n, 1], values[r, n, 2]) - s.anchor[w, n]
            own = wp.quat_rotate_inv(s.frame[w, n], point)
            put_vec(field_out, s.slot[w] // lanes, s.place[w, n], s.slot[w] % lanes, own)

    @wp.kernel(enable_backward=False, module="unique")
    def set_dofs(
        s: Slots, index: wp.array(dtype=int), mask: wp.array(dtype=wp.bool), values: wp.array2d(dtype=Scalar),
        field_out: wp.array4d(dtype=Scalar),
    ):  # fmt: skip
        """Rates, efforts and the like, of ball joints in the body frame."""
        tag = SOURCE  # noqa: F841
        r, n = wp.tid()
        w = world_of(r, index, mask)
        if w >= 0 and s.place[wp.max(w, 0), n] > 0:
            lanes, kind, i = field_out.shape[3], s.kind[w, n], s.place[w, n]
            g, k, first = s.slot[w] // lanes, s.slot[w] % lanes, s.v_start[w, n]
            if kind == SPHERICAL:
                v = row_at(values, r, first, s.anchor[w, n])
                put_vec(field_out, g, i, k, wp.quat_rotate_inv(s.frame[w, n], v))
            elif kind != FIXED:
                field_out[g, i, 0, k] = values[r, first]

    @wp.kernel(enable_backward=False, module="unique")
    def set_qpos(
        s: Slots, index: wp.array(dtype=int), mask: wp.array(dtype=wp.bool), values: wp.array2d(dtype=Scalar),
        field_out: wp.array4d(dtype=Scalar),
    ):  # fmt: skip
        """Coordinates from MuJoCo's order: q = F^-1 R^-1 Q F."""
        tag = SOURCE  # noqa: F841
        r, n = wp.tid()
        w = world_of(r, index, mask)
        if w >= 0 and s.place[wp.max(w, 0), n] > 0:
            lanes, kind, i = field_out.shape[3], s.kind[w, n], s.place[w, n]
            g, k, first = s.slot[w] // lanes, s.slot[w] % lanes, s.q_start[w, n]
            rest = s.rest[w, n]
            if kind == SPHERICAL:
                xyz = row_at(values, r, first + 1, s.anchor[w, n])
                given = unit(Quat(xyz[0], xyz[1], xyz[2], values[r, first]))
                frame = s.frame[w, n]
                q = wp.quat_inverse(frame) * (wp.quat_inverse(rest) * given) * frame
                field_out[g, i, 0, k] = q[3]
                for c in range(3):
                    field_out[g, i, c + 1, k] = q[c]
            elif kind != FIXED:
                field_out[g, i, 1, k] = values[r, first] - rest[0]

    @wp.kernel(enable_backward=False, module="unique")
    def set_mass(
        s: Slots, index: wp.array(dtype=int), mask: wp.array(dtype=wp.bool), values: wp.array3d(dtype=Scalar),
        own_mass: wp.array2d(dtype=Scalar), own_inertia: wp.array2d(dtype=Vec), mass_out: wp.array4d(dtype=Scalar),
        inertia_out: wp.array4d(dtype=Scalar),
    ):  # fmt: skip
        """Masses, and inertias in proportion to what both were when the model was made."""
        tag = SOURCE  # noqa: F841
        r, n = wp.tid()
        w = world_of(r, index, mask)
        if w >= 0 and s.place[wp.max(w, 0), n] > 0 and own_mass[wp.max(w, 0), n] > Scalar(0.0):
            lanes, i = mass_out.shape[3], s.place[w, n]
            g, k = s.slot[w] // lanes, s.slot[w] % lanes
            mass_out[g, i, 0, k] = values[r, n, 0]
            put_vec(inertia_out, g, i, k, own_inertia[w, n] * (values[r, n, 0] / own_mass[w, n]))

    return {
        "set_links": set_links, "set_points": set_points, "set_dofs": set_dofs, "set_qpos": set_qpos,
        "set_mass": set_mass,
    }  # fmt: skip


@cache
def exchange_kernels(precision: int = 32) -> SimpleNamespace:
    """Return the kernels ``get_*`` and ``set_*`` for a precision."""
    t = exchange_types(precision)
    return SimpleNamespace(**_readers(t), **_writers(t))
