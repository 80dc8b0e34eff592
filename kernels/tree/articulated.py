"""Articulated-body algorithm for trees of fixed, revolute, spherical and prismatic joints.

Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 7, in world-aligned axes with the reference point of each
link at its joint. A first pass outward finds every pose and the *nominal* accelerations: those of joint accelerations
zero, velocity products and gravity included (the world accelerates upward). What remains is linear in the deviation
from them: a link's articulated inertia maps the deviation al of its angular acceleration and a of its joint point's
acceleration to the moment n about that point and the force f that it needs,

    n = A al + B a + n0        A  symmetric 3 x 3 [kg m^2],  B = m [c x] [kg m]
    f = B^T al + M a + f0      M  symmetric 3 x 3 [kg]

and the nominal motion enters n0, f0 alone, so that no velocity-product term crosses a joint.

Springs and dampers are implicit in the velocity (backward Euler on the damper, and on the share gamma of the spring
that `stability` asks for): with D' = D + gamma h K,

    (joint-space inertia + armature + h D') qdd = Q - K log(q) - D' qd - ...

so k = armature + h D' joins the inertia before it is inverted. A spherical joint has S = [1; 0]: it passes on
A - A (A + k)^-1 A, formed as k - k^2 (A + k)^-1, which keeps its digits in float32 where the difference does not.

Coordinates are measured from the spring's rest: a spherical joint's ``coordinate`` is the quaternion from rest, a
revolute or prismatic joint's is ``coordinate.x`` [rad or m]. ``velocity`` is the angular velocity in the link's own
frame, or the rate in ``velocity.x``. Link frames lie along the principal axes of inertia about the joint point.

Slot 0 of the arrays is the world; links are 1..count. Children come after their parents. The child that arrives first
at its parent stores, the others add, in the order of the tree's own list: sums do not depend on the batch.
"""

from typing import Any

import warp as wp

from ..lanes.algebra import (
    about_axis,
    add,
    add_cross,
    add_dot,
    add_mul,
    add_scaled,
    cross,
    div,
    dot,
    exponential,
    log_factors,
    mul,
    renormalised,
    rotate,
    shifted_inverse,
    sub,
    sub_dot,
    sub_mul,
    sub_outer,
    sub_scaled,
    transposed_mul,
    unrotate,
)
from ..lanes.real import any_neg, fma, lane_neg, real, sqrt_, where_neg

__all__ = ["FIXED", "PRISMATIC", "REVOLUTE", "SPHERICAL"]

FIXED = wp.constant(0)
REVOLUTE = wp.constant(1)
SPHERICAL = wp.constant(2)
PRISMATIC = wp.constant(3)


# ---- outward: poses, spins and nominal accelerations -------------------------------------------------------------


@wp.func(inline=True)
def place_root(e: int, row: int, m: Any, s: Any):
    """Put the world at rest, accelerating against gravity so that no link needs its weight as a force."""
    like = m.offset[e, 1]
    o = real(0.0, like.x)
    zero = type(like)(o, o, o)
    s.pose[row, 0] = type(m.turn[e, 1])(real(1.0, o), o, o, o)
    s.spin[row, 0] = zero
    s.alpha0[row, 0] = zero
    s.accel0[row, 0] = type(like)(real(m.lift[0], o), real(m.lift[1], o), real(m.lift[2], o))
    s.alpha[row, 0] = zero
    s.accel[row, 0] = zero
    s.calm[row, 0] = real(1.0, o)


@wp.func(inline=True)
def place_links(e: int, row: int, m: Any, x: Any, s: Any):
    """Place every link: pose, offset r from the parent's joint point, spin w, nominal accelerations.

    Spherical: w = w_p + R qd,  al0 = al0_p + w_p x R qd,  a0 = a0_p + al0_p x r + w_p x (w_p x r).
    """
    for i in range(1, m.count[e] + 1):
        p = m.parent[e, i]
        kind = m.kind[e, i]
        parent_pose = s.pose[row, p]
        rest_pose = parent_pose * m.turn[e, i]
        r = rotate(parent_pose, m.offset[e, i])
        if kind == SPHERICAL:
            pose = rest_pose * x.coordinate[e, i]
            relative = rotate(pose, x.velocity[e, i])
            spin = s.spin[row, p]
            alpha0 = s.alpha0[row, p]
            s.pose[row, i] = pose
            s.r[row, i] = r
            s.relative[row, i] = relative
            s.spin[row, i] = spin + relative
            s.alpha0[row, i] = add_cross(alpha0, spin, relative)
            s.accel0[row, i] = add_cross(add_cross(s.accel0[row, p], alpha0, r), spin, cross(spin, r))
        else:
            place_scalar(e, row, i, p, kind, m, x, s, rest_pose, r)


@wp.func
def place_scalar(e: int, row: int, i: int, p: int, kind: int, m: Any, x: Any, s: Any, rest_pose: Any, r: Any):
    """Place a link on a revolute (turns about s), prismatic (slides along s) or fixed joint.

    A slide adds s q to r, and the Coriolis acceleration 2 w_p x s qd. The rate is ``velocity.x`` and what a replay adds
    to it to have that in the middle of a step, ``velocity.y`` (`rollout.look_ahead`; zero elsewhere).
    """
    v = x.velocity[e, i]
    axis = rotate(rest_pose, m.axis[e, i])
    relative = axis * (v.x + v.y)
    spin = s.spin[row, p]
    alpha0 = s.alpha0[row, p]
    accel0 = s.accel0[row, p]
    if kind == PRISMATIC:
        s.pose[row, i] = rest_pose
        offset = add_scaled(r, axis, x.coordinate[e, i].x)
        s.r[row, i] = offset
        s.relative[row, i] = relative
        s.spin[row, i] = spin
        s.alpha0[row, i] = alpha0
        sliding = add_cross(accel0, spin, relative + relative)
        s.accel0[row, i] = add_cross(add_cross(sliding, alpha0, offset), spin, cross(spin, offset))
    else:
        s.r[row, i] = r
        s.accel0[row, i] = add_cross(add_cross(accel0, alpha0, r), spin, cross(spin, r))
        if kind == REVOLUTE:
            s.pose[row, i] = rest_pose * about_axis(m.axis[e, i], x.coordinate[e, i].x, rest_pose)
            s.spin[row, i] = spin + relative
            s.alpha0[row, i] = add_cross(alpha0, spin, relative)
        else:
            s.pose[row, i] = rest_pose
            s.spin[row, i] = spin
            s.alpha0[row, i] = alpha0


# ---- inward: articulated inertia ---------------------------------------------------------------------------------


@wp.func(inline=True)
def own_inertia(e: int, row: int, i: int, m: Any, s: Any):
    """Rotational inertia of a link about its joint point, in world axes, from its principal moments.

    I = I_y 1 + (I_x - I_y) e_x e_x^T + (I_z - I_y) e_z e_z^T with e_x, e_z columns of the rotation.
    """
    q = s.pose[row, i]
    one = real(1.0, q.w)
    two = real(2.0, q.w)
    like = s.r[row, i]
    ex = type(like)(one - two * fma(q.y, q.y, q.z * q.z), two * fma(q.w, q.z, q.x * q.y), two * (q.x * q.z - q.w * q.y))
    ez = type(like)(two * fma(q.w, q.y, q.x * q.z), two * (q.y * q.z - q.w * q.x), one - two * fma(q.x, q.x, q.y * q.y))
    principal = m.inertia[e, i]
    iy = principal.y
    ux = ex * (principal.x - iy)
    uz = ez * (principal.z - iy)
    return type(s.D[row, i])(
        fma(uz.x, ez.x, fma(ux.x, ex.x, iy)),
        fma(uz.x, ez.y, ux.x * ex.y),
        fma(uz.x, ez.z, ux.x * ex.z),
        fma(uz.y, ez.y, fma(ux.y, ex.y, iy)),
        fma(uz.y, ez.z, ux.y * ex.z),
        fma(uz.z, ez.z, fma(ux.z, ex.z, iy)),
    )


@wp.func(inline=True)
def own_force(row: int, i: int, s: Any, mass: Any, mc: Any):
    """Force of a link's nominal motion: f0 = m a0 + al0 x m c + w x (w x m c)."""
    spin = s.spin[row, i]
    return add_cross(add_cross(s.accel0[row, i] * mass, s.alpha0[row, i], mc), spin, cross(spin, mc))


@wp.func(inline=True)
def own_moment(row: int, i: int, s: Any, A: Any, mc: Any):
    """Moment of a link's nominal motion about its joint point: n0 = I al0 + m c x a0 + w x I w."""
    spin = s.spin[row, i]
    return add_cross(add_cross(A * s.alpha0[row, i], mc, s.accel0[row, i]), spin, A * spin)


@wp.func(inline=True)
def skew(v: Any, like: Any):
    """[v x] as columns, of the type of ``like``."""
    o = real(0.0, v.x)
    return type(like)(type(v)(o, v.z, o - v.y), type(v)(o - v.z, o, v.x), type(v)(v.y, o - v.x, o))


@wp.func(inline=True)
def held_of(P: Any, v: Any, f: Any, g: Any):
    """Torque of a ball joint's pre-load P at a turn (w, v), link's axes: the force of the energy -P.phi, phi = f v.

    J^-T P = P - f/2 v x P + g v x (v x P) of the right Jacobian of phi (`log_factors`): what a spring that is strained
    by P / K at rest adds to -K phi, but for the square of that strain. A torque that is constant in the link's axes is
    the force of no energy.
    """
    turned = cross(v, P)
    return add_scaled(sub_scaled(P, turned, real(0.5, f) * f), cross(v, turned), g)


@wp.func(inline=True)
def held_at(e: int, i: int, m: Any, x: Any, P: Any):
    """Effort of a pre-load P at a joint's present coordinate: `held_of` at a ball joint, else P as it is."""
    out = type(P)(P.x, P.y, P.z)
    if m.kind[e, i] == SPHERICAL:
        q = x.coordinate[e, i]
        f, g = log_factors(q)
        out = held_of(P, type(P)(q.x, q.y, q.z), f, g)
    return out


@wp.func(inline=True)
def implicit_inertia(e: int, i: int, m: Any, h: wp.float64):
    """k = armature + h D', what joins a joint's inertia."""
    damping = m.damping[e, i]
    return fma(damping, real(h, damping), m.armature[e, i])


@wp.func(inline=True)
def fold_links(e: int, row: int, m: Any, x: Any, s: Any, h: wp.float64):
    """Fold every link's articulated inertia into its parent's, from the tips inward."""
    n = m.count[e]
    for step in range(n):
        i = n - step
        A = own_inertia(e, row, i, m, s)
        mass = m.mass[e, i]
        o = real(0.0, mass)
        mc = rotate(s.pose[row, i], m.com[e, i]) * mass
        B = skew(mc, s.U[row, i])
        f = own_force(row, i, s, mass, mc)
        n0 = own_moment(row, i, s, A, mc)
        fold_link(e, row, i, m, x, s, h, A, B, mass, n0, f, type(f)(o, o, o))


@wp.func(inline=True)
def fold_links_loaded(e: int, row: int, m: Any, x: Any, u: Any, s: Any, h: wp.float64):
    """Fold as `fold_links` does, under forces at points of the links, torques on them and efforts at the joints."""
    n = m.count[e]
    for step in range(n):
        i = n - step
        A = own_inertia(e, row, i, m, s)
        mass = m.mass[e, i]
        pose = s.pose[row, i]
        mc = rotate(pose, m.com[e, i]) * mass
        B = skew(mc, s.U[row, i])
        force = u.force[e, i]
        f = own_force(row, i, s, mass, mc) - force
        n0 = add_cross(own_moment(row, i, s, A, mc) - u.torque[e, i], force, rotate(pose, u.point[e, i]))
        fold_link(e, row, i, m, x, s, h, A, B, mass, n0, f, u.effort[e, i])


@wp.func(inline=True)
def fold_link(
    e: int, row: int, i: int, m: Any, x: Any, s: Any, h: wp.float64, A: Any, B: Any, mass: Any, n0: Any, f0: Any,
    effort: Any,
):  # fmt: skip
    """Add what the children handed in to a link's own inertia and fold the sum across its joint."""
    o = real(0.0, mass)
    fold_inertia(e, row, i, m, x, s, h, A, B, type(A)(mass, o, o, mass, o, mass), n0, f0, effort)


@wp.func(inline=True)
def fold_inertia(
    e: int, row: int, i: int, m: Any, x: Any, s: Any, h: wp.float64, A: Any, B: Any, M: Any, n0: Any, f0: Any,
    effort: Any,
):  # fmt: skip
    """Fold as `fold_link` does a link whose inertia against a push may depend on the push's direction."""
    kind = m.kind[e, i]
    if kind == SPHERICAL:
        if m.inner[e, i] == 1:
            fold_spherical(e, row, i, m, x, s, h, A + s.A[row, i], B + s.B[row, i], M + s.M[row, i],
                           n0 + s.n[row, i], f0 + s.f[row, i], effort)  # fmt: skip
        else:
            fold_spherical(e, row, i, m, x, s, h, A, B, M, n0, f0, effort)
    else:
        if m.inner[e, i] == 1:
            fold_other(e, row, i, kind, m, x, s, h, A + s.A[row, i], B + s.B[row, i], M + s.M[row, i],
                       n0 + s.n[row, i], f0 + s.f[row, i], effort)  # fmt: skip
        else:
            fold_other(e, row, i, kind, m, x, s, h, A, B, M, n0, f0, effort)


@wp.func(inline=True)
def fold_spherical(
    e: int, row: int, i: int, m: Any, x: Any, s: Any, h: wp.float64, A: Any, B: Any, M: Any, n0: Any, f0: Any,
    effort: Any,
):  # fmt: skip
    """Fold across a spherical joint, S = [1; 0].

    With D = (A + k)^-1 and t = Q - K log q - D' w - n0:  A -> k - k^2 D,  B -> k D B,  M -> M - B^T D B,
    n0 -> n0 + t - k D t,  f0 -> f0 + B^T D t;  Q is the joint's effort, applied and of its pre-load, in world axes.
    """
    q = x.coordinate[e, i]
    damping = m.damping[e, i]
    k = implicit_inertia(e, i, m, h)
    c, g = log_factors(q)
    v = type(n0)(q.x, q.y, q.z)
    sprung = sub_scaled(effort + held_of(m.preload[e, i], v, c, g), v, c * m.stiffness[e, i])
    t = sub_scaled(rotate(s.pose[row, i], sprung), s.relative[row, i], damping) - n0
    D = shifted_inverse(A, k)
    U = D * B
    u = D * t
    s.D[row, i] = D
    s.U[row, i] = U
    s.u[row, i] = u
    p = m.parent[e, i]
    if p > 0:
        f = type(f0)(add_dot(f0.x, B.x, u), add_dot(f0.y, B.y, u), add_dot(f0.z, B.z, u))
        hand_in_spherical(e, row, i, p, m, s, D, B, U, M, k, n0 + sub_scaled(t, u, k), f)


@wp.func(inline=True)
def hand_in_spherical(
    e: int, row: int, i: int, p: int, m: Any, s: Any, D: Any, B: Any, U: Any, M: Any, k: Any, n: Any, f: Any
):
    """Hand in what is left of the inertia across a spherical joint: k - k^2 D, k D B and M - B^T D B, with U = D B."""
    minus = real(0.0, k) - k * k
    passed = type(D)(
        fma(D.xx, minus, k), D.xy * minus, D.xz * minus, fma(D.yy, minus, k), D.yz * minus, fma(D.zz, minus, k)
    )
    reduced = type(D)(
        sub_dot(M.xx, B.x, U.x), sub_dot(M.xy, B.x, U.y), sub_dot(M.xz, B.x, U.z),
        sub_dot(M.yy, B.y, U.y), sub_dot(M.yz, B.y, U.z), sub_dot(M.zz, B.z, U.z),
    )  # fmt: skip
    hand_in(e, row, i, p, m, s, passed, U * k, reduced, n, f)


@wp.func
def fold_other(
    e: int, row: int, i: int, kind: int, m: Any, x: Any, s: Any, h: wp.float64, A: Any, B: Any, M: Any, n: Any, f: Any,
    effort: Any,
):  # fmt: skip
    """Fold across a revolute (S = [s; 0]), prismatic (S = [0; s]) or fixed joint."""
    p = m.parent[e, i]
    if kind == FIXED:
        if p > 0:
            hand_in(e, row, i, p, m, s, A, B, M, n, f)
    else:
        axis = rotate(s.pose[row, i], m.axis[e, i])
        damping = m.damping[e, i]
        k = implicit_inertia(e, i, m, h)
        t = effort.x + m.preload[e, i].x - m.stiffness[e, i] * x.coordinate[e, i].x - damping * x.velocity[e, i].x
        if kind == REVOLUTE:
            un = A * axis
            fold_scalar(e, row, i, p, m, s, A, B, M, n, f, axis, un, transposed_mul(B, axis), k + dot(axis, un),
                        t - dot(axis, n))  # fmt: skip
        else:
            uf = M * axis
            fold_scalar(e, row, i, p, m, s, A, B, M, n, f, axis, B * axis, uf, k + dot(axis, uf), t - dot(axis, f))


@wp.func(inline=True)
def fold_scalar(
    e: int, row: int, i: int, p: int, m: Any, s: Any, A: Any, B: Any, M: Any, n: Any, f: Any, axis: Any, un: Any,
    uf: Any, d: Any, t: Any,
):  # fmt: skip
    """Fold across a joint of one axis: with U = I S, d = S^T U + k:  I -> I - U U^T / d,  p0 -> p0 + U t / d."""
    inverse = 1.0 / d
    s.U[row, i] = type(B)(un, uf, axis)
    s.u[row, i] = type(n)(t * inverse, inverse, inverse)
    if p > 0:
        hand_in_scalar(e, row, i, p, m, s, A, B, M, n, f, un, uf, inverse, t)


@wp.func
def hand_in_scalar(
    e: int, row: int, i: int, p: int, m: Any, s: Any, A: Any, B: Any, M: Any, n: Any, f: Any, un: Any, uf: Any,
    inverse: Any, t: Any,
):  # fmt: skip
    """Hand in what is left of the inertia across a joint of one axis: I - U U^T / d and p0 + U t / d."""
    vn = un * inverse
    vf = uf * inverse
    reduced = type(B)(sub_scaled(B.x, un, vf.x), sub_scaled(B.y, un, vf.y), sub_scaled(B.z, un, vf.z))
    hand_in(e, row, i, p, m, s, sub_outer(A, vn, un), reduced, sub_outer(M, vf, uf), add_scaled(n, vn, t),
            add_scaled(f, vf, t))  # fmt: skip


@wp.func(inline=True)
def hand_in(e: int, row: int, i: int, p: int, m: Any, s: Any, A: Any, B: Any, M: Any, n: Any, f: Any):
    """Move a link's inertia and bias from its joint point to its parent's (offset r) and hand them in there.

    n += r x f,  B -> B + X with X = [r] M,  A -> A + Y + Y^T with Y = [r] (B + X/2)^T.
    """
    r = s.r[row, i]
    X = type(B)(
        cross(r, type(r)(M.xx, M.xy, M.xz)), cross(r, type(r)(M.xy, M.yy, M.yz)), cross(r, type(r)(M.xz, M.yz, M.zz))
    )
    half = real(0.5, r.x)
    gx = add_scaled(B.x, X.x, half)
    gy = add_scaled(B.y, X.y, half)
    gz = add_scaled(B.z, X.z, half)
    Yx = cross(r, type(r)(gx.x, gy.x, gz.x))
    Yy = cross(r, type(r)(gx.y, gy.y, gz.y))
    Yz = cross(r, type(r)(gx.z, gy.z, gz.z))
    two = real(2.0, r.x)
    moved = type(A)(
        fma(two, Yx.x, A.xx), A.xy + (Yx.y + Yy.x), A.xz + (Yx.z + Yz.x),
        fma(two, Yy.y, A.yy), A.yz + (Yy.z + Yz.y), fma(two, Yz.z, A.zz),
    )  # fmt: skip
    moment = add_cross(n, r, f)
    if m.first[e, i] == 1:
        s.A[row, p] = moved
        s.B[row, p] = B + X
        s.M[row, p] = M
        s.n[row, p] = moment
        s.f[row, p] = f
    else:
        s.A[row, p] = s.A[row, p] + moved
        s.B[row, p] = s.B[row, p] + (B + X)
        s.M[row, p] = s.M[row, p] + M
        s.n[row, p] = s.n[row, p] + moment
        s.f[row, p] = s.f[row, p] + f


# ---- outward: accelerations and the step -------------------------------------------------------------------------


@wp.func(inline=True)
def spherical_acceleration(e: int, row: int, i: int, m: Any, s: Any, alpha: Any, accel: Any, h: wp.float64):
    """qdd = D t - D B a - (1 - k D) al, of the parent's deviations al and a at the joint's point."""
    k = implicit_inertia(e, i, m, h)
    return add_mul(sub_mul(s.u[row, i], s.U[row, i], accel), s.D[row, i], alpha * k) - alpha


@wp.func(inline=True)
def scalar_acceleration(row: int, i: int, s: Any, alpha: Any, accel: Any):
    """qdd = (t - U^T (al, a)) / d of a joint of one axis."""
    U = s.U[row, i]
    u = s.u[row, i]
    return u.x - add_dot(dot(U.x, alpha), U.y, accel) * u.y


@wp.func(inline=True)
def advance_links(e: int, row: int, m: Any, x: Any, s: Any, h: wp.float64, bound: wp.float64):
    """Solve every joint's acceleration outward and take the step: qd += h qdd, then q <- q exp(h qd).

    al and a are deviations from the nominal accelerations: a = a_p + al_p x r, and for a spherical joint
    qdd = D t - D B a - (1 - k D) al_p.
    """
    for i in range(1, m.count[e] + 1):
        p = m.parent[e, i]
        kind = m.kind[e, i]
        alpha = s.alpha[row, p]
        accel = add_cross(s.accel[row, p], alpha, s.r[row, i])
        v = x.velocity[e, i]
        if kind == SPHERICAL:
            dt = real(h, m.damping[e, i])
            qdd = spherical_acceleration(e, row, i, m, s, alpha, accel, h)
            s.alpha[row, i] = alpha + qdd
            s.accel[row, i] = accel
            new = add_scaled(v, unrotate(s.pose[row, i], qdd), dt)
            turn = dt * guarded(e, row, i, m, x, s, dot(new, new), bound)
            keep = x.alive[e]
            q = x.coordinate[e, i]
            commit_spherical(e, i, x, keep, q, renormalised(q * exponential(new * turn, q)), v, new)
        elif kind == FIXED:
            s.alpha[row, i] = alpha
            s.accel[row, i] = accel
        else:
            advance_scalar(e, row, i, kind, m, x, s, alpha, accel, v, h, bound)
    calm_down(e, row, m, x, s)


@wp.func
def advance_scalar(
    e: int, row: int, i: int, kind: int, m: Any, x: Any, s: Any, alpha: Any, accel: Any, v: Any, h: wp.float64,
    bound: wp.float64,
):  # fmt: skip
    """Advance a revolute or prismatic joint: qdd = (t - U^T (al, a)) / d."""
    U = s.U[row, i]
    u = s.u[row, i]
    dt = real(h, u.x)
    qdd = scalar_acceleration(row, i, s, alpha, accel)
    if kind == REVOLUTE:
        s.alpha[row, i] = add_scaled(alpha, U.z, qdd)
        s.accel[row, i] = accel
    else:
        s.alpha[row, i] = alpha
        s.accel[row, i] = add_scaled(accel, U.z, qdd)
    new = fma(qdd, dt, v.x)
    q = x.coordinate[e, i]
    turn = dt * guarded(e, row, i, m, x, s, new * new, bound)
    keep = x.alive[e]
    x.coordinate[e, i] = type(q)(q.w, where_neg(keep, q.x, fma(new, turn, q.x)), q.y, q.z)
    x.velocity[e, i] = type(v)(where_neg(keep, v.x, new), v.y, v.z)


@wp.func(inline=True)
def commit_spherical(e: int, i: int, x: Any, keep: Any, q: Any, new_q: Any, v: Any, new: Any):
    """Write the new state of the worlds that are alive; the others keep the old one."""
    x.coordinate[e, i] = type(q)(
        where_neg(keep, q.w, new_q.w),
        where_neg(keep, q.x, new_q.x),
        where_neg(keep, q.y, new_q.y),
        where_neg(keep, q.z, new_q.z),
    )
    x.velocity[e, i] = type(v)(where_neg(keep, v.x, new.x), where_neg(keep, v.y, new.y), where_neg(keep, v.z, new.z))


@wp.func(inline=True)
def guarded(e: int, row: int, i: int, m: Any, x: Any, s: Any, speed2: Any, bound: wp.float64):
    """Return the share of its turn that a joint takes this step: 1, unless its squared speed leaves the limit.

    In a world with implicit springs a joint may move faster than the step resolves. It then turns by ``limit`` only,
    and all velocities of the world are scaled down together (`calm_down`): kinetic energy is a quadratic form, so one
    factor for all takes energy out, and every equilibrium stays where it is. A world that leaves ``bound``, or the
    finite, is frozen.
    """
    one = real(1.0, speed2)
    minus = real(-1.0, speed2)
    limit = m.limit[e, i]
    # c < 0 where the joint is fine; so is a world frozen before, or it would take the slow path every step
    c = where_neg(x.alive[e], minus, speed2 - limit * limit)
    verdict = where_neg(c, one, minus)
    scale = one
    if any_neg(verdict):
        scale = slowed(e, i, x, speed2, limit, verdict, bound)
        calm = s.calm[row, 0]
        s.calm[row, 0] = where_neg(scale - calm, scale, calm)
    return scale


@wp.func
def calm_down(e: int, row: int, m: Any, x: Any, s: Any):
    """Scale all velocities of a world by the factor of its fastest joint, if any left its limit."""
    calm = s.calm[row, 0]
    if any_neg(calm - real(1.0, calm)):
        alive = x.alive[e]
        for i in range(1, m.count[e] + 1):
            v = x.velocity[e, i]
            w = v * calm
            x.velocity[e, i] = type(v)(
                where_neg(alive, v.x, w.x), where_neg(alive, v.y, w.y), where_neg(alive, v.z, w.z)
            )


#: A slowed joint may ask for any finite speed; squares beyond this leave float32.
FAST = wp.constant(wp.float64(1.0e15))


@wp.func
def slowed(e: int, i: int, x: Any, speed2: Any, limit: Any, verdict: Any, bound: wp.float64):
    """Freeze the worlds of a negative verdict that left the bound or the finite; return the factor for the others."""
    b = real(bound, speed2)
    b = where_neg(limit - b, real(FAST, b), b)
    c = where_neg(verdict, speed2 - b * b, verdict - real(2.0, b))
    lost = where_neg(c, real(1.0, b), real(-1.0, b))
    if any_neg(lost):
        freeze(e, i, x, lost)
    return where_neg(verdict, limit / sqrt_(speed2), real(1.0, b))


@wp.func
def freeze(e: int, i: int, x: Any, verdict: Any):
    """Mark the worlds with a negative verdict as frozen and note the joint and the tick."""
    for k in range(x.lanes):
        if lane_neg(verdict, k):
            x.fault_link[e * x.lanes + k] = i
            x.fault_tick[e * x.lanes + k] = x.tick[e]
    x.alive[e] = where_neg(verdict, verdict, x.alive[e])


@wp.func(inline=True)
def advance(e: int, row: int, m: Any, x: Any, s: Any, h: wp.float64, bound: wp.float64):
    """Take one semi-implicit step of length h [s] without applied forces."""
    place_root(e, row, m, s)
    place_links(e, row, m, x, s)
    fold_links(e, row, m, x, s, h)
    advance_links(e, row, m, x, s, h, bound)
    x.tick[e] = x.tick[e] + 1


@wp.func(inline=True)
def advance_loaded(e: int, row: int, m: Any, x: Any, u: Any, s: Any, h: wp.float64, bound: wp.float64):
    """Take one semi-implicit step of length h [s] under forces applied at points of the links."""
    place_root(e, row, m, s)
    place_links(e, row, m, x, s)
    fold_links_loaded(e, row, m, x, u, s, h)
    advance_links(e, row, m, x, s, h, bound)
    x.tick[e] = x.tick[e] + 1
