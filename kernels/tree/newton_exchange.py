"""Kernels between Newton's flat joint arrays and bough's arrays of groups, without a copy on the host.

Newton (1.8) keeps a ball joint's coordinate q_N as x, y, z, w in the joint's own frames and its velocity w_N in the
joint's frame on the parent. With F the link frame in the body, T the joint's frame in the body and R the spring's rest
orientation, both in the body frame, the link's coordinate and velocity are

    q = (F^-1 R^-1 T) q_N (T^-1 F) = left q_N right,     w = (q_N right)^-1 w_N

Scalar joints differ by the spring's rest coordinate alone. Reals are reached one by one through four-dimensional views
[group, place, component, lane], which suit every lane width and memory order.
"""

import warp as wp

from .articulated import FIXED, PRISMATIC, REVOLUTE, SPHERICAL

__all__ = ["Slots", "read_load", "read_state", "write_state"]


@wp.struct
class Slots:
    """Where each of N links sits in both layouts; links of a world follow each other, parents first.

    ``group``, ``place``, ``lane``: bough's; ``kind`` of joint; ``q_start``, ``qd_start``, ``body``: Newton's;
    ``parent``: index of the parent link or -1; ``left``, ``right``: see above; ``rest``: spring's rest coordinate of
    scalar joints; ``frame``: F; ``axis``: joint axis in the link frame.
    """

    group: wp.array(dtype=int)
    place: wp.array(dtype=int)
    lane: wp.array(dtype=int)
    kind: wp.array(dtype=int)
    q_start: wp.array(dtype=int)
    qd_start: wp.array(dtype=int)
    body: wp.array(dtype=int)
    parent: wp.array(dtype=int)
    left: wp.array(dtype=wp.quat)
    right: wp.array(dtype=wp.quat)
    rest: wp.array(dtype=float)
    frame: wp.array(dtype=wp.quat)
    axis: wp.array(dtype=wp.vec3)


@wp.func
def unit(q: wp.quat):
    """Return a quaternion at length one. A quaternion of length zero gives NaN, which the guard sees."""
    return q / wp.length(q)


@wp.func
def quat_at(a: wp.array(dtype=float), i: int):
    """Return the unit quaternion x, y, z, w in entries i to i + 3."""
    return unit(wp.quat(a[i], a[i + 1], a[i + 2], a[i + 3]))


@wp.func
def vec_at(a: wp.array(dtype=float), i: int):
    """Return the vector in entries i to i + 2."""
    return wp.vec3(a[i], a[i + 1], a[i + 2])


@wp.func
def put_vec(s: Slots, n: int, v: wp.vec3, field_out: wp.array4d(dtype=float)):
    """Write the vector of link n."""
    for c in range(3):
        field_out[s.group[n], s.place[n], c, s.lane[n]] = v[c]


@wp.kernel(enable_backward=False)
def read_state(
    s: Slots,
    joint_q: wp.array(dtype=float),
    joint_qd: wp.array(dtype=float),
    coordinate_out: wp.array4d(dtype=float),
    velocity_out: wp.array4d(dtype=float),
):
    """Take one link's coordinate and velocity from Newton's arrays."""
    n = wp.tid()
    g, i, k, kind = s.group[n], s.place[n], s.lane[n], s.kind[n]
    if kind == SPHERICAL:
        turned = quat_at(joint_q, s.q_start[n]) * s.right[n]
        q = s.left[n] * turned
        coordinate_out[g, i, 0, k] = q[3]
        for c in range(3):
            coordinate_out[g, i, c + 1, k] = q[c]
        put_vec(s, n, wp.quat_rotate_inv(turned, vec_at(joint_qd, s.qd_start[n])), velocity_out)
    elif kind != FIXED:
        coordinate_out[g, i, 1, k] = joint_q[s.q_start[n]] - s.rest[n]
        velocity_out[g, i, 0, k] = joint_qd[s.qd_start[n]]


@wp.kernel(enable_backward=False)
def write_state(
    s: Slots,
    coordinate_in: wp.array4d(dtype=float),
    velocity_in: wp.array4d(dtype=float),
    joint_q_out: wp.array(dtype=float),
    joint_qd_out: wp.array(dtype=float),
):
    """Give one link's coordinate and velocity to Newton's arrays; the inverse of `read_state`."""
    n = wp.tid()
    g, i, k, kind = s.group[n], s.place[n], s.lane[n], s.kind[n]
    if kind == SPHERICAL:
        q = wp.quat(
            coordinate_in[g, i, 1, k], coordinate_in[g, i, 2, k], coordinate_in[g, i, 3, k], coordinate_in[g, i, 0, k]
        )
        turned = wp.quat_inverse(s.left[n]) * q
        v = wp.vec3(velocity_in[g, i, 0, k], velocity_in[g, i, 1, k], velocity_in[g, i, 2, k])
        w = wp.quat_rotate(turned, v)
        own = unit(turned * wp.quat_inverse(s.right[n]))
        for c in range(4):
            joint_q_out[s.q_start[n] + c] = own[c]
        for c in range(3):
            joint_qd_out[s.qd_start[n] + c] = w[c]
    elif kind != FIXED:
        joint_q_out[s.q_start[n]] = coordinate_in[g, i, 1, k] + s.rest[n]
        joint_qd_out[s.qd_start[n]] = velocity_in[g, i, 0, k]


@wp.kernel(enable_backward=False)
def read_load(
    s: Slots,
    first: wp.array(dtype=int),
    rotation: wp.array2d(dtype=wp.vec4),
    joint_q: wp.array(dtype=float),
    joint_f: wp.array(dtype=float),
    body_f: wp.array(dtype=wp.spatial_vector),
    carried: wp.array(dtype=wp.vec3),
    force_out: wp.array4d(dtype=float),
    effort_out: wp.array4d(dtype=float),
):
    """Turn one world's body wrenches and joint forces into forces on its links and efforts at its joints.

    Forces act at the centres of mass as they are. A torque on a body is, at every joint that carries it, the effort
    S^T t: torques are summed from the tips inward (``carried``) and seen from each joint. ``rotation`` [worlds, links]
    holds the bodies' orientations w, x, y, z; ``first`` [worlds + 1] each world's first link.
    """
    world = wp.tid()
    begin = first[world]
    for n in range(begin, first[world + 1]):
        carried[n] = wp.spatial_bottom(body_f[s.body[n]])
        put_vec(s, n, wp.spatial_top(body_f[s.body[n]]), force_out)
    for step in range(first[world + 1] - begin):
        n = first[world + 1] - 1 - step
        kind = s.kind[n]
        if s.parent[n] >= 0:
            carried[s.parent[n]] = carried[s.parent[n]] + carried[n]
        o = rotation[world, n - begin]
        torque = wp.quat_rotate_inv(wp.quat(o[1], o[2], o[3], o[0]) * s.frame[n], carried[n])
        if kind == SPHERICAL:
            turned = quat_at(joint_q, s.q_start[n]) * s.right[n]
            put_vec(s, n, torque + wp.quat_rotate_inv(turned, vec_at(joint_f, s.qd_start[n])), effort_out)
        elif kind == REVOLUTE:
            effort_out[s.group[n], s.place[n], 0, s.lane[n]] = wp.dot(torque, s.axis[n]) + joint_f[s.qd_start[n]]
        elif kind == PRISMATIC:
            effort_out[s.group[n], s.place[n], 0, s.lane[n]] = joint_f[s.qd_start[n]]
