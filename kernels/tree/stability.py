"""How much of each joint's spring must be implicit for a step to be stable.

Semi-implicit Euler with implicit dampers and a share gamma of the springs implicit is stable, for small motions about
a pose, when

    4 M + C >= 0,   C = diag(2 h D + (2 gamma - 1) h^2 K)

with M the joint-space inertia (the z = -1 root of the step's characteristic polynomial). Eliminating from the tips
inward, as the articulated-body algorithm does, the matrix is positive when every pivot A_i + C_i / 4 is, A_i being
the articulated inertia of the pivots before it. gamma_i is the smallest share that keeps each pivot above
(1 - margin) of A_i; where explicit springs are stable with that margin it is zero everywhere and the step is MuJoCo's
``implicitfast``.
"""

from functools import cache
from typing import Any

import warp as wp

from ..lanes.algebra import add, div, dot, mul, rotate, shifted_inverse, sub, transposed_mul
from ..lanes.real import SOURCE, fma, fnma, real, sqrt_, where_neg
from .articulated import (
    FIXED,
    REVOLUTE,
    SPHERICAL,
    hand_in,
    hand_in_scalar,
    hand_in_spherical,
    own_inertia,
    place_links,
    place_root,
    skew,
)
from .layout import layout_of

__all__ = ["damping_kernel"]


#: Largest turn [rad] (or slide [m]) a step of a joint whose spring is implicit.
LIMITED_TURN = wp.constant(wp.float64(0.25))


@wp.func
def least_eigenvalue(a: Any, k: Any):
    """Lower bound of the least eigenvalue of a + k.

    1 / tr((a + k)^-1) where the matrix is positive, else mean - sqrt(2/3) |deviator|: what links further out hand in
    may be negative, since their springs have used up more than their own inertia.
    """
    inverse = shifted_inverse(a, k)
    trace = inverse.xx + inverse.yy + inverse.zz
    one = real(1.0, k)
    # positive definite: the inverse has a positive trace, diagonal and leading minor
    minor = fnma(a.xy, a.xy, (a.xx + k) * (a.yy + k))
    bad = where_neg(inverse.xx, real(-1.0, k), where_neg(inverse.yy, real(-1.0, k), minor))
    third = real(1.0 / 3.0, k)
    mean = (a.xx + a.yy + a.zz) * third
    x = a.xx - mean
    y = a.yy - mean
    z = a.zz - mean
    off = fma(a.yz, a.yz, fma(a.xz, a.xz, a.xy * a.xy))
    deviator2 = fma(off, real(2.0, k), fma(z, z, fma(y, y, x * x)))
    lower = mean + k - sqrt_(deviator2 * (third + third))
    return where_neg(where_neg(bad, bad, trace), where_neg(lower, lower, real(0.0, k)), one / trace)


@wp.func
def implicit_share(stiffness: Any, damping: Any, inertia: Any, h: wp.float64, margin: wp.float64):
    """gamma h K of one joint, the damping that its implicit share amounts to.

    gamma = 0 where 1/2 - (2 margin I + h D) / (h^2 K) < 0; else that value plus 1/2, since at the bare threshold a
    mode that the step cannot resolve flips its sign every step and never decays. A negative inertia is made up for
    twice.
    """
    dt = real(h, stiffness)
    half = real(0.5, dt) * stiffness * dt
    room = where_neg(inertia, inertia * 4.0, inertia * real(margin, dt) * 2.0)
    need = half - damping - room / dt
    return where_neg(need, real(0.0, dt), need + half)


@wp.func
def pivot_stiffness(stiffness: Any, effective: Any, h: wp.float64):
    """C / 4 = (2 h D' - h^2 K) / 4 with D' = D + gamma h K the damping in effect."""
    dt = real(h, stiffness)
    return fnma(stiffness * dt, dt, effective * dt * 2.0) * real(0.25, dt)


@wp.func
def raise_to(damping_out: Any, e: int, i: int, value: Any):
    """Raise a joint's damping to a value that it has not reached."""
    old = damping_out[e, i]
    damping_out[e, i] = where_neg(old - value, value, old)


@wp.func
def judge_spherical(
    e: int, row: int, i: int, m: Any, s: Any, A: Any, B: Any, M: Any, h: wp.float64, margin: wp.float64,
    damping_out: Any,
):  # fmt: skip
    """Eliminate a spherical joint; return the damping that its implicit share amounts to."""
    stiffness = m.stiffness[e, i]
    damping = m.damping[e, i]
    armature = m.armature[e, i]
    share = implicit_share(stiffness, damping, least_eigenvalue(A, armature), h, margin)
    raise_to(damping_out, e, i, damping + share)
    k = armature + pivot_stiffness(stiffness, damping_out[e, i], h)
    p = m.parent[e, i]
    if p > 0:
        D = shifted_inverse(A, k)
        o = real(0.0, k)
        zero = type(B.x)(o, o, o)
        hand_in_spherical(e, row, i, p, m, s, D, B, D * B, M, k, zero, zero)
    return share


@wp.func
def judge_scalar(
    e: int, row: int, i: int, kind: int, m: Any, s: Any, A: Any, B: Any, M: Any, h: wp.float64, margin: wp.float64,
    damping_out: Any,
):  # fmt: skip
    """Eliminate a revolute or prismatic joint; return the damping that its implicit share amounts to."""
    axis = rotate(s.pose[row, i], m.axis[e, i])
    un = B * axis
    uf = M * axis
    d = dot(axis, uf)
    if kind == REVOLUTE:
        un = A * axis
        uf = transposed_mul(B, axis)
        d = dot(axis, un)
    stiffness = m.stiffness[e, i]
    damping = m.damping[e, i]
    inertia = d + m.armature[e, i]
    share = implicit_share(stiffness, damping, inertia, h, margin)
    raise_to(damping_out, e, i, damping + share)
    p = m.parent[e, i]
    if p > 0:
        o = real(0.0, d)
        zero = type(B.x)(o, o, o)
        inverse = 1.0 / (inertia + pivot_stiffness(stiffness, damping_out[e, i], h))
        hand_in_scalar(e, row, i, p, m, s, A, B, M, zero, zero, un, uf, inverse, o)
    return share


@wp.func
def judge_link(e: int, row: int, i: int, m: Any, s: Any, h: wp.float64, margin: wp.float64, damping_out: Any):
    """Eliminate a link's joint after those beyond it; return the damping that its implicit share amounts to."""
    mass = m.mass[e, i]
    o = real(0.0, mass)
    A = own_inertia(e, row, i, m, s)
    B = skew(rotate(s.pose[row, i], m.com[e, i]) * mass, s.U[row, i])
    M = type(A)(mass, o, o, mass, o, mass)
    if m.inner[e, i] == 1:
        A = A + s.A[row, i]
        B = B + s.B[row, i]
        M = M + s.M[row, i]
    kind = m.kind[e, i]
    share = o
    if kind == SPHERICAL:
        share = judge_spherical(e, row, i, m, s, A, B, M, h, margin, damping_out)
    elif kind == FIXED:
        p = m.parent[e, i]
        zero = type(B.x)(o, o, o)
        if p > 0:
            hand_in(e, row, i, p, m, s, A, B, M, zero, zero)
    else:
        share = judge_scalar(e, row, i, kind, m, s, A, B, M, h, margin, damping_out)
    return share


@wp.func
def hold_world(e: int, m: Any, implicit: Any, h: wp.float64, damping_out: Any, limit_out: Any):
    """Where any spring of a world is implicit, make all of them implicit by half and limit every joint's speed.

    What the step cannot resolve in one joint drives the others.
    """
    limit = real(LIMITED_TURN / h, implicit)
    half = real(0.5, implicit) * real(h, implicit)
    none = implicit * -1.0
    for i in range(1, m.count[e] + 1):
        value = fma(m.stiffness[e, i], half, m.damping[e, i])
        old = damping_out[e, i]
        value = where_neg(old - value, value, old)
        damping_out[e, i] = where_neg(none, value, old)
        limit_out[e, i] = where_neg(none, limit, limit_out[e, i])


@cache
def damping_kernel(width: int = 1, precision: int = 32) -> Any:
    """Return the kernel that writes D + gamma h K and the speed limit of every joint at the pose of ``x_in``.

    Damping is only ever raised, so that several poses can be taken into account by as many launches; fill the outputs
    with the physical damping and the guard's bound first.
    """
    t = layout_of(width, precision)
    Model, State, Scratch, Real = t.Model, t.State, t.Scratch, t.Real

    @wp.kernel(enable_backward=False, module="unique")
    def implicit_damping(
        m: Model, x_in: State, s_out: Scratch, first: int, row: int, h: wp.float64, margin: wp.float64,
        damping_out: wp.array2d(dtype=Real), limit_out: wp.array2d(dtype=Real),
    ):  # fmt: skip
        """Judge a group's links from the tips to the root, then write dampings and speed limits."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        place_root(e, r, m, s_out)
        place_links(e, r, m, x_in, s_out)
        implicit = real(0.0, m.mass[e, 1])
        n = m.count[e]
        for step in range(n):
            implicit = implicit + judge_link(e, r, n - step, m, s_out, h, margin, damping_out)
        hold_world(e, m, implicit, h, damping_out, limit_out)

    return implicit_damping
