"""Inverse dynamics: the recursive Newton-Euler algorithm for every tree that the simulator steps.

Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 5, in the axes and at the reference points of
`articulated`: world axes, each link at its joint point. Outward, joint accelerations qdd add to the nominal
accelerations that velocities and gravity alone cause; inward, every link's force and moment are summed,

    f = m a + al x m c + w x (w x m c) - f_ext + sum of children's f
    n = I al + m c x a + w x I w - p x f_ext + sum of children's (n + r x f)

and the joint's actuator supplies what spring, damper, pre-load and armature do not:

    effort = S^T (n, f) + armature qdd + K log(q) + D qd - preload

Accelerations and efforts are laid out as velocities are: three components in the link frame for a spherical joint, the
first for a revolute or prismatic one, zero for a fixed one.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.algebra import add, add_cross, add_scaled, dot, log_factors, mul, rotate, sub, unrotate
from ..lanes.real import SOURCE, real
from .articulated import (
    FIXED,
    PRISMATIC,
    REVOLUTE,
    SPHERICAL,
    held_of,
    own_force,
    own_inertia,
    own_moment,
    place_links,
    place_root,
)
from .layout import layout_of

__all__ = ["inverse_kernels"]


@wp.func(inline=True)
def accelerate_links(e: int, row: int, m: Any, qdd: Any, s: Any):
    """Add what joint accelerations ``qdd`` bring to the nominal accelerations, from the root outward.

    al = al_p + S qdd and a = a_p + al_p x r (+ s qdd on a slide), in deviations from the nominal ones.
    """
    for i in range(1, m.count[e] + 1):
        p = m.parent[e, i]
        kind = m.kind[e, i]
        alpha = s.alpha[row, p]
        accel = add_cross(s.accel[row, p], alpha, s.r[row, i])
        if kind == SPHERICAL:
            alpha = alpha + rotate(s.pose[row, i], qdd[e, i])
        if kind == REVOLUTE:
            alpha = add_scaled(alpha, rotate(s.pose[row, i], m.axis[e, i]), qdd[e, i].x)
        if kind == PRISMATIC:
            accel = add_scaled(accel, rotate(s.pose[row, i], m.axis[e, i]), qdd[e, i].x)
        s.alpha[row, i] = alpha
        s.accel[row, i] = accel
        s.alpha0[row, i] = s.alpha0[row, i] + alpha
        s.accel0[row, i] = s.accel0[row, i] + accel


@wp.func(inline=True)
def sum_forces(e: int, row: int, m: Any, x: Any, u: Any, qdd: Any, s: Any, effort_out: Any):
    """Sum the links' forces and moments from the tips inward and project them on the joints."""
    n = m.count[e]
    for i in range(1, n + 1):
        pose = s.pose[row, i]
        mass = m.mass[e, i]
        mc = rotate(pose, m.com[e, i]) * mass
        force = u.force[e, i]
        s.f[row, i] = own_force(row, i, s, mass, mc) - force
        moment = own_moment(row, i, s, own_inertia(e, row, i, m, s), mc) - u.torque[e, i]
        s.n[row, i] = add_cross(moment, force, rotate(pose, u.point[e, i]))
    for step in range(n):
        i = n - step
        f = s.f[row, i]
        moment = s.n[row, i]
        effort_out[e, i] = joint_effort(e, row, i, m, x, s, qdd[e, i], moment, f)
        p = m.parent[e, i]
        if p > 0:
            s.f[row, p] = s.f[row, p] + f
            s.n[row, p] = add_cross(s.n[row, p] + moment, s.r[row, i], f)


@wp.func
def joint_effort(e: int, row: int, i: int, m: Any, x: Any, s: Any, qdd: Any, moment: Any, force: Any):
    """Effort of a joint's actuator: S^T (n, f) + armature qdd + K log(q) + D qd - preload."""
    kind = m.kind[e, i]
    q = x.coordinate[e, i]
    v = x.velocity[e, i]
    stiffness = m.stiffness[e, i]
    o = real(0.0, q.x)
    effort = type(moment)(o, o, o)
    if kind == SPHERICAL:
        turn = type(moment)(q.x, q.y, q.z)
        f, g = log_factors(q)
        sprung = add_scaled(unrotate(s.pose[row, i], moment), turn, f * stiffness) - held_of(
            m.preload[e, i], turn, f, g
        )
        effort = add_scaled(add_scaled(sprung, v, m.damping[e, i]), qdd, m.armature[e, i])
    elif kind != FIXED:
        axis = rotate(s.pose[row, i], m.axis[e, i])
        carried = dot(axis, moment)
        if kind == PRISMATIC:
            carried = dot(axis, force)
        passive = stiffness * q.x + m.damping[e, i] * v.x - m.preload[e, i].x
        effort = type(moment)(carried + m.armature[e, i] * qdd.x + passive, o, o)
    return effort


@wp.func
def balance(e: int, row: int, m: Any, x: Any, u: Any, qdd: Any, s: Any, effort_out: Any):
    """Write the efforts that give the joints of a group the accelerations ``qdd`` in the present state."""
    place_root(e, row, m, s)
    place_links(e, row, m, x, s)
    accelerate_links(e, row, m, qdd, s)
    sum_forces(e, row, m, x, u, qdd, s, effort_out)


@wp.func
def follow(
    e: int, j: int, k: int, moved: wp.array(dtype=int), motion_in: wp.array2d(dtype=wp.vec3d), x: Any, qdd: Any
):  # fmt: skip
    """Give the moved joints the coordinate, rate and acceleration of sample k of recording j."""
    for w in range(moved.shape[0]):
        i = moved[w]
        now = motion_in[j, k * moved.shape[0] + w]
        q = x.coordinate[e, i]
        v = x.velocity[e, i]
        x.coordinate[e, i] = type(q)(q.w, real(now[0], q.x), q.y, q.z)
        x.velocity[e, i] = type(v)(real(now[1], v.x), v.y, v.z)
        qdd[e, i] = type(v)(real(now[2], v.x), v.y, v.z)


@cache
def inverse_kernels(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return ``inverse`` (efforts in the present state) and ``replay`` (efforts along recorded motions).

    In ``replay`` every group follows one recording: ``trajectory`` [groups] names it, ``length`` [trajectories] is its
    number of samples and ``motion_in`` [trajectories, samples * joints] holds coordinate, rate and acceleration of the
    joints at the J places ``moved``; efforts of the places ``watched`` are written sample by sample.
    """
    t = layout_of(width, precision)
    Model, State, Load, Scratch, Real, Vec = t.Model, t.State, t.Load, t.Scratch, t.Real, t.Vec

    @wp.kernel(enable_backward=False, module="unique")
    def inverse(
        m: Model, x_in: State, u_in: Load, acceleration_in: wp.array2d(dtype=Vec), s_out: Scratch, first: int, row: int,
        effort_out: wp.array2d(dtype=Vec),
    ):  # fmt: skip
        """Write the efforts that give a group's joints ``acceleration_in`` in the present state, under its load."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        balance(e, r, m, x_in, u_in, acceleration_in, s_out, effort_out)

    @wp.kernel(enable_backward=False, module="unique")
    def replay(
        m: Model, x_out: State, u_in: Load, acceleration_out: wp.array2d(dtype=Vec), moved: wp.array(dtype=int),
        watched: wp.array(dtype=int), trajectory: wp.array(dtype=int), length: wp.array(dtype=int),
        motion_in: wp.array2d(dtype=wp.vec3d), s_out: Scratch, first: int, row: int, all_out: wp.array2d(dtype=Vec),
        effort_out: wp.array2d(dtype=Real),
    ):  # fmt: skip
        """Write the efforts that move the watched joints as the recording of a group says, sample by sample."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        j = trajectory[e]
        for k in range(length[j]):
            follow(e, j, k, moved, motion_in, x_out, acceleration_out)
            balance(e, r, m, x_out, u_in, acceleration_out, s_out, all_out)
            for w in range(watched.shape[0]):
                effort_out[e, k * watched.shape[0] + w] = all_out[e, watched[w]].x

    return SimpleNamespace(inverse=inverse, replay=replay)
