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

from functools import lru_cache
from typing import Any

import warp as wp

from .algebra import add, add_cross, add_dot, add_mul, add_scaled, cross, div, dot, mul, rotate, shifted_inverse, sub
from .algebra import sub_dot, sub_mul, sub_outer, sub_scaled, transposed_mul
from .articulated import FIXED, REVOLUTE, SPHERICAL, hand_in, own_inertia, place_links, place_root, skew
from .layout import layout_of
from .real import SOURCE, any_neg, fma, fnma, real, sqrt_, where_neg

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
def pivot_stiffness(stiffness: Any, damping: Any, effective: Any, h: wp.float64):
    """C / 4 = (2 h D' - h^2 K) / 4 with D' = D + gamma h K the damping in effect."""
    dt = real(h, stiffness)
    return fnma(stiffness * dt, dt, effective * dt * 2.0) * real(0.25, dt)


@lru_cache(maxsize=None)
def damping_kernel(width: int = 1, precision: int = 32) -> Any:
    """Return the kernel that writes D + gamma h K of every joint at the pose of ``x_in``.

    An entry is only ever raised, so that several poses can be taken into account by as many launches; fill the output
    with the physical damping first.
    """
    t = layout_of(width, precision)
    Model, State, Scratch, Real = t.Model, t.State, t.Scratch, t.Real

    @wp.func
    def raise_to(damping_out: wp.array2d(dtype=Real), e: int, i: int, value: Real):
        """Raise a joint's damping to a value it has not reached."""
        old = damping_out[e, i]
        damping_out[e, i] = where_neg(old - value, value, old)

    @wp.kernel(enable_backward=False, module="unique")
    def implicit_damping(
        m: Model, x_in: State, s_out: Scratch, first: int, row: int, h: wp.float64, margin: wp.float64,
        damping_out: wp.array2d(dtype=Real), limit_out: wp.array2d(dtype=Real),
    ):  # fmt: skip
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        place_root(e, r, m, s_out)
        place_links(e, r, m, x_in, s_out)
        implicit = real(0.0, m.mass[e, 1])
        n = m.count[e]
        for step in range(n):
            i = n - step
            mass = m.mass[e, i]
            o = real(0.0, mass)
            A = own_inertia(e, r, i, m, s_out)
            mc = rotate(s_out.pose[r, i], m.com[e, i]) * mass
            B = skew(mc, s_out.U[r, i])
            M = type(A)(mass, o, o, mass, o, mass)
            if m.inner[e, i] == 1:
                A = A + s_out.A[r, i]
                B = B + s_out.B[r, i]
                M = M + s_out.M[r, i]
            kind = m.kind[e, i]
            stiffness = m.stiffness[e, i]
            damping = m.damping[e, i]
            armature = m.armature[e, i]
            zero = type(mc)(o, o, o)
            p = m.parent[e, i]
            if kind == SPHERICAL:
                inertia = least_eigenvalue(A, armature)
                share = implicit_share(stiffness, damping, inertia, h, margin)
                raise_to(damping_out, e, i, damping + share)
                implicit = implicit + share
                k = armature + pivot_stiffness(stiffness, damping, damping_out[e, i], h)
                D = shifted_inverse(A, k)
                U = D * B
                if p > 0:
                    minus = o - k * k
                    passed = type(A)(
                        fma(D.xx, minus, k), D.xy * minus, D.xz * minus,
                        fma(D.yy, minus, k), D.yz * minus, fma(D.zz, minus, k),
                    )  # fmt: skip
                    reduced = type(A)(
                        sub_dot(M.xx, B.x, U.x), sub_dot(M.xy, B.x, U.y), sub_dot(M.xz, B.x, U.z),
                        sub_dot(M.yy, B.y, U.y), sub_dot(M.yz, B.y, U.z), sub_dot(M.zz, B.z, U.z),
                    )  # fmt: skip
                    hand_in(e, r, i, p, m, s_out, passed, U * k, reduced, zero, zero)
            elif kind == FIXED:
                if p > 0:
                    hand_in(e, r, i, p, m, s_out, A, B, M, zero, zero)
            else:
                axis = rotate(s_out.pose[r, i], m.axis[e, i])
                un = B * axis
                uf = M * axis
                d = dot(axis, uf)
                if kind == REVOLUTE:
                    un = A * axis
                    uf = transposed_mul(B, axis)
                    d = dot(axis, un)
                inertia = d + armature
                share = implicit_share(stiffness, damping, inertia, h, margin)
                raise_to(damping_out, e, i, damping + share)
                implicit = implicit + share
                d = inertia + pivot_stiffness(stiffness, damping, damping_out[e, i], h)
                inverse = 1.0 / d
                if p > 0:
                    vn = un * inverse
                    vf = uf * inverse
                    rest = type(B)(sub_scaled(B.x, un, vf.x), sub_scaled(B.y, un, vf.y), sub_scaled(B.z, un, vf.z))
                    hand_in(e, r, i, p, m, s_out, sub_outer(A, vn, un), rest, sub_outer(M, vf, uf), zero, zero)

        limit = real(LIMITED_TURN / h, implicit)
        half = real(0.5, implicit) * real(h, implicit)
        for i in range(1, n + 1):
            # springs of a world that has an implicit one are all implicit by half: what the step cannot resolve in one
            # joint drives the others
            value = fma(m.stiffness[e, i], half, m.damping[e, i])
            old = damping_out[e, i]
            value = where_neg(old - value, value, old)
            none = implicit * -1.0
            damping_out[e, i] = where_neg(none, value, old)
            limit_out[e, i] = where_neg(none, limit, limit_out[e, i])

    return implicit_damping
