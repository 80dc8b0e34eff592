"""Momentum of trees that nothing holds, kept to round-off.

Joint accelerations conserve momentum, joint velocities after a step of finite length do not: the same joint rates at
the new pose are another momentum, off by O(h^2) a step. For a tree on an unsprung spherical root (*pivoted*: its
angular momentum about the root), or on three unsprung slides and a spherical joint (*floating*: all of its momentum),
the step ends by correcting the root's velocity so that momentum has changed by the impulse of gravity and applied
forces alone:

    about the centre of mass:  dw = I_c^-1 (dL - c x dP),  dv_c = dP / m        (floating)
    about the root:            dw = I_r^-1 dL_r                                  (pivoted)

Joint rates beyond the root stay as they are, since both corrections move the tree as one rigid body.
"""

from typing import Any

import warp as wp

from ..lanes.algebra import add, add_cross, add_scaled, cross, div, dot, mul, rotate, shifted_inverse, sub, unrotate
from ..lanes.real import fma, real, where_neg
from .articulated import own_inertia
from .observe import locate_links

__all__ = ["FLOATING", "HELD", "PIVOTED"]

HELD = wp.constant(0)
PIVOTED = wp.constant(1)
FLOATING = wp.constant(2)


@wp.func
def steiner(mass: Any, a: Any, b: Any, like: Any):
    """mass (a.b 1 - (a b^T + b a^T) / 2) as a symmetric matrix."""
    half = real(-0.5, mass) * mass
    d = mass * dot(a, b)
    return type(like)(
        fma(half, a.x * b.x + b.x * a.x, d), half * (a.x * b.y + b.x * a.y), half * (a.x * b.z + b.x * a.z),
        fma(half, a.y * b.y + b.y * a.y, d), half * (a.y * b.z + b.y * a.z), fma(half, a.z * b.z + b.z * a.z, d),
    )  # fmt: skip


@wp.func
def sum_momentum(e: int, row: int, m: Any, x: Any, s: Any):
    """Sum momenta into ``s.f``, ``s.n`` (about the origin) and composite inertia into ``s.A``, ``s.u`` at the world.

    ``s.u[0]`` holds the first moment of mass, ``s.M[0].xx`` the mass.
    """
    locate_links(e, row, m, x, s)
    o = real(0.0, m.mass[e, 1])
    one = real(1.0, o)
    zero = type(s.r[row, 1])(o, o, o)
    linear = zero
    angular = zero
    first = zero
    mass = o
    inertia = type(s.A[row, 0])(o, o, o, o, o, o)
    for i in range(1, m.count[e] + 1):
        own = m.mass[e, i]
        mc = rotate(s.pose[row, i], m.com[e, i]) * own
        v = s.alpha[row, i]
        w = s.spin[row, i]
        p = s.accel[row, i]
        A = own_inertia(e, row, i, m, s)
        momentum = add_cross(v * own, w, mc)
        linear = linear + momentum
        angular = angular + add_cross(add_cross(A * w, mc, v), p, momentum)
        first = first + add_scaled(mc, p, own)
        mass = mass + own
        inertia = inertia + (A + (steiner(own, p, p, A) + steiner(one + one, p, mc, A)))
    s.f[row, 0] = linear
    s.n[row, 0] = angular
    s.u[row, 0] = first
    s.A[row, 0] = inertia
    s.M[row, 0] = type(inertia)(mass, o, o, o, o, o)


@wp.func
def add_gravity(row: int, s: Any, h: wp.float64):
    """Add gravity's impulse h (m g, C x g) to the momenta summed before a step."""
    lift = s.accel0[row, 0]
    fall = lift * (real(h, lift.x) * -1.0)
    s.f[row, 0] = add_scaled(s.f[row, 0], fall, s.M[row, 0].xx)
    s.n[row, 0] = add_cross(s.n[row, 0], s.u[row, 0], fall)


@wp.func
def add_impulses(e: int, row: int, m: Any, u: Any, s: Any, h: wp.float64):
    """Add the impulses of applied forces and torques, h (F, x x F + t), and of the root's efforts to the momenta."""
    for i in range(1, m.count[e] + 1):
        force = u.force[e, i]
        impulse = force * real(h, force.x)
        point = s.accel[row, i] + rotate(s.pose[row, i], u.point[e, i])
        s.f[row, 0] = s.f[row, 0] + impulse
        turned = add_scaled(s.n[row, 0], u.torque[e, i], real(h, force.x))
        s.n[row, 0] = add_cross(turned, point, impulse)
    root = wp.where(m.free[e] == FLOATING, 4, 1)
    torque = rotate(s.pose[row, root], u.effort[e, root])
    s.n[row, 0] = add_scaled(s.n[row, 0], torque, real(h, torque.x))
    for i in range(1, root):
        push = rotate(s.pose[row, i], m.axis[e, i]) * (u.effort[e, i].x * real(h, torque.x))
        s.f[row, 0] = s.f[row, 0] + push
        s.n[row, 0] = add_cross(s.n[row, 0], s.accel[row, root], push)


@wp.func
def restore_momentum(e: int, row: int, m: Any, x: Any, s: Any):
    """Correct the root's velocity so that momentum is what was summed before the step."""
    linear = s.f[row, 0]
    angular = s.n[row, 0]
    sum_momentum(e, row, m, x, s)
    first = s.u[row, 0]
    mass = s.M[row, 0].xx
    dP = linear - s.f[row, 0]
    dL = angular - s.n[row, 0]
    o = real(0.0, mass)
    if m.free[e] == FLOATING:
        centre = first * (1.0 / mass)
        about_centre = s.A[row, 0] - steiner(mass, centre, centre, s.A[row, 0])
        dw = shifted_inverse(about_centre, o) * (dL - cross(centre, dP))
        root = s.accel[row, 4]
        dv = add_cross(dP * (1.0 / mass), dw, root - centre)
        for i in range(1, 4):
            axis = rotate(s.pose[row, i], m.axis[e, i])
            v = x.velocity[e, i]
            correct(e, i, m, x, v, type(v)(v.x + dot(axis, dv), v.y, v.z))
        correct(e, 4, m, x, x.velocity[e, 4], x.velocity[e, 4] + unrotate(s.pose[row, 4], dw))
    else:
        root = s.accel[row, 1]
        one = real(1.0, o)
        moved = steiner(mass, root, root, s.A[row, 0]) - steiner(one + one, root, first, s.A[row, 0])
        about_root = s.A[row, 0] + moved
        dw = shifted_inverse(about_root, o) * (dL - cross(root, dP))
        correct(e, 1, m, x, x.velocity[e, 1], x.velocity[e, 1] + unrotate(s.pose[row, 1], dw))


@wp.func
def correct(e: int, i: int, m: Any, x: Any, old: Any, new: Any):
    """Write a joint's velocity in the worlds that are alive and in which nothing holds the joint."""
    held = m.stiffness[e, i] + m.damping[e, i] + m.armature[e, i] + dot(m.preload[e, i], m.preload[e, i])
    keep = where_neg(x.alive[e], real(-1.0, held), held * -1.0)
    x.velocity[e, i] = type(old)(
        where_neg(keep, old.x, new.x), where_neg(keep, old.y, new.y), where_neg(keep, old.z, new.z)
    )
