"""Contact of branches with an arm, a power line and the ground: compliant, two-way, with Coulomb friction.

With the gap g along the normal n (towards the branch), its rate g' = n . (v_b - v_a) after the step, and v_t the
tangential part of v_b - v_a, the force on the branch is

    f = n [-k (g + h g') - c g'] - d v_t,     d = mu f_n / max(|v_t|, creep),     c = 0 while g > 0

where f_n > 0, else nothing: the spring acts on the gap at the end of the step, so that a contact is felt before it is
passed (from h g' away) and no stiffness makes it unstable. Both sides answer within the step. The branch's side joins
the articulated inertia before it is folded: with W = (W_v^-1 + h C)^-1, W_v = (c + h k) n n^T + d (1 - n n^T) and the
arm's compliance C = J A^-1 J^T (`arm`),

    f = F - W (v_b' - v_a),   A += [r] h W [r]^T,   B += [r] h W,   M += h W    at r from the link's joint

v_a being the arm's velocity without this contact. Where several contacts share the arm, each takes C that many times
(mass splitting: Tonge, Benevolenski, Voroshilov, Mass splitting for jitter-free parallel rigid body simulation, 2012),
which makes their exchange converge. The solve is repeated until no contact pulls, every friction force is in its cone
and on its edge when it slips, and the arm moves as the contacts assumed. The force that comes out is applied to both
sides as it is: action equals reaction to round-off whether or not the last repetition changed anything.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from .algebra import add, add_cross, add_scaled, mul, rotate, sub
from .articulated import (
    FIXED,
    PRISMATIC,
    SPHERICAL,
    fold_inertia,
    own_force,
    own_inertia,
    own_moment,
    scalar_acceleration,
    skew,
    spherical_acceleration,
)
from .layout import layout_of
from .real import fma, lane, real

__all__ = ["BASE", "GROUND", "LINE", "Contact", "ContactRule", "contact_types"]

#: What touches a branch where it is no link of the arm.
LINE = wp.constant(-1)
GROUND = wp.constant(-2)
BASE = wp.constant(-3)
#: Share by which friction may miss its cone before the solve is repeated.
SLACK = wp.constant(0.015)
#: Share of a force by which the arm may move otherwise than the contact assumed.
MISS = wp.constant(0.03)
#: Speed at which deep overlaps come apart [m/s]: damping grows with the depth, so that worlds that start with overlaps
#: do not burst, while the force of what is held grows on and no arm is strong enough to push through.
EXIT = wp.constant(2.0)
#: Share by which the damper of what sticks may miss before the solve is repeated.
STUCK = wp.constant(0.25)
#: Forces below this are not worth a repetition [N].
FEEBLE = wp.constant(0.02)


@wp.struct
class Contact:
    """One contact. ``link`` is the branch's place in the kernel arrays, 0 where the arm touches something else.

    ``body`` is the arm's link, or LINE, GROUND or BASE; ``other`` a second link of the arm, or -1. The normal points to
    the branch, or to the arm's link where no branch is involved. ``damper``, ``tried`` and ``gave`` belong to `hasten`.
    """

    link: int
    capsule: int
    body: int
    other: int
    active: int
    rounds: int
    gap: float
    damper: float
    tried: float
    gave: float
    point: wp.vec3
    normal: wp.vec3
    lever: wp.vec3
    branch: wp.vec3
    still: wp.vec3
    drive: wp.vec3
    nominal: wp.vec3
    force: wp.vec3
    branch_now: wp.vec3
    acted: wp.vec3
    share: float
    impedance: wp.mat33
    compliance: wp.mat33


@wp.struct
class ContactRule:
    """What all contacts obey, and where they are kept: [worlds, capacity] and [worlds]."""

    stiffness: float
    damping: float
    creep: float
    ground: float
    has_ground: int
    arm_branch: int
    arm_line: int
    arm_arm: int
    line_radius: float
    repeats: int
    friction: wp.array(dtype=wp.float32)
    line_start: wp.array(dtype=wp.vec3)
    line_end: wp.array(dtype=wp.vec3)
    line_mask: wp.array(dtype=int)
    record: wp.array2d(dtype=Contact)
    count: wp.array(dtype=int)
    overflow: wp.array(dtype=int)
    depth: wp.array(dtype=wp.float32)
    branch_force: wp.array2d(dtype=wp.vec3)
    arm_peak: wp.array2d(dtype=wp.float32)
    arm_bound: wp.array(dtype=wp.float32)


@cache
def contact_types(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return the structs of `layout.layout_of` with ``Shapes`` (the branches' capsules) and ``Touch`` (working memory).

    Capsules are [groups, capsules] in the frames of their links; an absent one lies far away. ``slot_capsule`` [slots,
    capsules] is a capsule's number in its world, -1 where it has none.
    """
    t = layout_of(width, precision)
    Real, Vec, Sym, Mat = t.Real, t.Vec, t.Sym, t.Mat

    @wp.struct
    class Shapes:
        count: wp.array(dtype=int)
        link: wp.array2d(dtype=int)
        middle: wp.array2d(dtype=Vec)
        half: wp.array2d(dtype=Vec)
        radius: wp.array2d(dtype=Real)
        bound: wp.array2d(dtype=Real)
        slot_capsule: wp.array2d(dtype=int)

    @wp.struct
    class Touch:
        at: wp.array2d(dtype=Vec)
        velocity: wp.array2d(dtype=Vec)
        touched: wp.array2d(dtype=int)
        path: wp.array2d(dtype=int)
        A: wp.array2d(dtype=Sym)
        B: wp.array2d(dtype=Mat)
        M: wp.array2d(dtype=Sym)
        n: wp.array2d(dtype=Vec)
        f: wp.array2d(dtype=Vec)
        A_entry: wp.array4d(dtype=wp.float32)
        B_entry: wp.array4d(dtype=wp.float32)
        M_entry: wp.array4d(dtype=wp.float32)
        n_entry: wp.array4d(dtype=wp.float32)
        f_entry: wp.array4d(dtype=wp.float32)
        near: wp.array2d(dtype=Vec)
        near_entry: wp.array4d(dtype=wp.float32)

    return SimpleNamespace(**vars(t), Shapes=Shapes, Touch=Touch)


# ---- one contact, scalar -----------------------------------------------------------------------------------------


@wp.func(inline=True)
def lane_vec(v: Any, k: int):
    """A vector of world k of the group."""
    return wp.vec3(lane(v.x, k), lane(v.y, k), lane(v.z, k))


@wp.func
def add_contact(w: int, rule: ContactRule, c: Contact):
    """Keep a contact; one too many is counted."""
    n = rule.count[w]
    rule.depth[w] = wp.max(rule.depth[w], 0.0 - c.gap)
    if n < rule.record.shape[1]:
        rule.record[w, n] = c
        rule.count[w] = n + 1
    else:
        rule.overflow[w] = rule.overflow[w] + 1


@wp.func
def damper_of(gap: float, rule: ContactRule, h: float):
    """c [N s/m]: none before touch; in deep overlaps as much as brings the force to zero at EXIT."""
    return wp.where(gap < 0.0, wp.max(rule.damping, (0.0 - gap / EXIT - h) * rule.stiffness), 0.0)


@wp.func
def meet(c: Contact, rule: ContactRule, w: int, approach: wp.vec3, h: float):
    """Set out with what the present velocities say: whether it will touch, and how hard friction may pull."""
    rate = wp.dot(c.normal, approach)
    c.active = wp.where(c.gap + h * rate < 0.0, 1, 0)
    push = wp.max(0.0 - rule.stiffness * (c.gap + h * rate) - damper_of(c.gap, rule, h) * rate, 0.0)
    slide = wp.length(approach - rate * c.normal)
    c.damper = rule.friction[w] * push / wp.max(slide, rule.creep)
    return c


@wp.func(inline=True)
def impedance(c: Contact, rule: ContactRule, h: float):
    """W_v = (c + h k) n n^T + d (1 - n n^T)"""
    normal = damper_of(c.gap, rule, h) + h * rule.stiffness
    return c.damper * wp.identity(n=3, dtype=wp.float32) + (normal - c.damper) * wp.outer(c.normal, c.normal)


@wp.func(inline=True)
def spring(c: Contact, rule: ContactRule):
    """-k g n"""
    return c.normal * (0.0 - rule.stiffness * c.gap)


@wp.func
def stiffen(c: Contact, rule: ContactRule, v_a: wp.vec3, share: float, h: float):
    """Bring a branch's contact up to date: W = (1 + h W_v C)^-1 W_v and its force at the branch's nominal velocity.

    v_a without this contact is the arm's velocity plus h C f; ``share`` contacts on one arm each take C that often.
    """
    Wv = impedance(c, rule, h)
    C = c.compliance * share
    c.share = share
    c.still = v_a + h * (C * c.force)
    yielding = wp.inverse(wp.identity(n=3, dtype=wp.float32) + h * (Wv * C))
    W = yielding * Wv
    c.impedance = 0.5 * (W + wp.transpose(W))
    c.drive = yielding * spring(c, rule)
    c.nominal = c.drive - c.impedance * (c.branch - c.still)
    return c


@wp.func
def hasten(c: Contact, wanted: float):
    """Set the next damper: a secant step of its logarithm from the last two (Aitken), plain repetition at first.

    Where friction nearly holds, what is wanted follows what was tried almost one to one, or overshoots it.
    """
    tried = wp.log(wp.max(c.damper, 1.0e-3))
    gave = wp.log(wp.max(wanted, 1.0e-3))
    slope = float(0.0)
    most = float(3.0)
    if c.damper == 0.0:
        most = 30.0
    elif c.rounds > 0:
        moved = tried - c.tried
        if wp.abs(moved) > 1.0e-4:
            slope = wp.clamp((gave - c.gave) / moved, -2.0, 0.9)
    c.rounds = c.rounds + 1
    c.tried = tried
    c.gave = gave
    c.damper = wp.exp(tried + wp.clamp((gave - tried) / (1.0 - slope), 0.0 - most, most))
    return c


@wp.func
def judge(c: Contact, rule: ContactRule, mu: float, relative: wp.vec3, h: float):
    """Correct whether a contact acts and how friction damps from the force and the velocity that came out.

    Returns the contact and whether anything changed that matters.
    """
    changed = int(0)
    rate = wp.dot(c.normal, relative)
    push = wp.dot(c.normal, c.force)
    slip = wp.length(relative - rate * c.normal)
    if c.active == 1:
        if push < 0.0:
            # should it act again, it does so without friction first: too strong a damper may be what pulled
            c.active = 0
            c.damper = 0.0
            c.rounds = 0
            c.force = wp.vec3(0.0, 0.0, 0.0)
            changed = 1
        else:
            drag = wp.length(c.force - push * c.normal)
            edge = mu * push
            if drag > edge * (1.0 + SLACK) + FEEBLE * 0.1:
                changed = 1
            if slip > 2.0 * rule.creep and drag < edge * (1.0 - SLACK) - FEEBLE:
                changed = 1
            wanted = edge / wp.max(slip, rule.creep)
            if slip <= rule.creep and drag > FEEBLE:
                if wp.abs(c.damper - wanted) > STUCK * wanted:
                    changed = 1
            c = hasten(c, wanted)
    elif c.gap + h * rate < -1.0e-6:
        c.active = 1
        changed = 1
    return c, changed


# ---- a group's links ---------------------------------------------------------------------------------------------


@wp.func
def clear_link(row: int, i: int, touch: Any):
    """Take a link's contacts away in all worlds of the group."""
    o = real(0.0, touch.A[row, i].xx)
    zero = type(touch.n[row, i])(o, o, o)
    nothing = type(touch.A[row, i])(o, o, o, o, o, o)
    touch.A[row, i] = nothing
    touch.M[row, i] = nothing
    touch.B[row, i] = type(touch.B[row, i])(zero, zero, zero)
    touch.n[row, i] = zero
    touch.f[row, i] = zero


@wp.func
def add_to_link(row: int, k: int, c: Contact, touch: Any, h: float):
    """A += [r] hW [r]^T,  B += [r] hW,  M += hW,  n -= r x f,  f -= f  of one world of the group."""
    i = c.link
    W = c.impedance * h
    r = c.lever
    cross_r = wp.skew(r)
    B = cross_r * W
    A = B * wp.transpose(cross_r)
    n = wp.cross(r, c.nominal)
    add_symmetric(touch.A_entry, row, i, k, A)
    add_symmetric(touch.M_entry, row, i, k, W)
    for column in range(3):
        for component in range(3):
            at = 3 * column + component
            touch.B_entry[row, i, at, k] = touch.B_entry[row, i, at, k] + B[component, column]
        touch.n_entry[row, i, column, k] = touch.n_entry[row, i, column, k] - n[column]
        touch.f_entry[row, i, column, k] = touch.f_entry[row, i, column, k] - c.nominal[column]


@wp.func
def add_symmetric(entry_out: wp.array4d(dtype=wp.float32), row: int, i: int, k: int, S: wp.mat33):
    """Add a symmetric matrix to one world's."""
    entry_out[row, i, 0, k] = entry_out[row, i, 0, k] + S[0, 0]
    entry_out[row, i, 1, k] = entry_out[row, i, 1, k] + 0.5 * (S[0, 1] + S[1, 0])
    entry_out[row, i, 2, k] = entry_out[row, i, 2, k] + 0.5 * (S[0, 2] + S[2, 0])
    entry_out[row, i, 3, k] = entry_out[row, i, 3, k] + S[1, 1]
    entry_out[row, i, 4, k] = entry_out[row, i, 4, k] + 0.5 * (S[1, 2] + S[2, 1])
    entry_out[row, i, 5, k] = entry_out[row, i, 5, k] + S[2, 2]


@wp.func(inline=True)
def mark_paths(
    e: int, row: int, width: int, slot_world: wp.array(dtype=int), m: Any, rule: ContactRule, touch: Any
) -> int:
    """Mark the links that a contact may touch, and all between them and the root; return whether anything touches.

    What the others hand in stays as it is while the contacts' solve is repeated.
    """
    for i in range(m.count[e] + 1):
        touch.path[row, i] = 0
    todo = int(0)
    for k in range(width):
        w = slot_world[e * width + k]
        if w >= 0:
            for n in range(rule.count[w]):
                touch.path[row, rule.record[w, n].link] = 1
                todo = 1
    for step in range(m.count[e]):
        i = m.count[e] - step
        if touch.path[row, i] == 1:
            touch.path[row, m.parent[e, i]] = 1
    touch.path[row, 0] = 0
    return todo


@wp.func(inline=True)
def fold_touched(e: int, row: int, m: Any, x: Any, s: Any, touch: Any, again: int, h: wp.float64):
    """Fold as `articulated.fold_links` does, with what the contacts add.

    ``again``, only what a contact changed: the links on marked paths, and their children, which hand in anew.
    """
    n = m.count[e]
    for step in range(n):
        i = n - step
        if again == 0 or touch.path[row, i] == 1 or touch.path[row, m.parent[e, i]] == 1:
            A = own_inertia(e, row, i, m, s)
            mass = m.mass[e, i]
            mc = rotate(s.pose[row, i], m.com[e, i]) * mass
            B = skew(mc, s.U[row, i])
            f = own_force(row, i, s, mass, mc)
            n0 = own_moment(row, i, s, A, mc)
            o = real(0.0, mass)
            M = type(A)(mass, o, o, mass, o, mass)
            if touch.touched[row, i] == 1:
                fold_inertia(e, row, i, m, x, s, h, A + touch.A[row, i], B + touch.B[row, i], M + touch.M[row, i],
                             n0 + touch.n[row, i], f + touch.f[row, i], m.preload[e, i])  # fmt: skip
            else:
                fold_inertia(e, row, i, m, x, s, h, A, B, M, n0, f, m.preload[e, i])


@wp.func(inline=True)
def respond(e: int, row: int, m: Any, s: Any, touch: Any, h: wp.float64):
    """Deviations of the accelerations on marked paths, as `articulated.advance_links` finds them."""
    for i in range(1, m.count[e] + 1):
        if touch.path[row, i] == 1:
            p = m.parent[e, i]
            kind = m.kind[e, i]
            alpha = s.alpha[row, p]
            accel = add_cross(s.accel[row, p], alpha, s.r[row, i])
            if kind == SPHERICAL:
                alpha = alpha + spherical_acceleration(e, row, i, m, s, alpha, accel, h)
            elif kind == PRISMATIC:
                accel = add_scaled(accel, s.U[row, i].z, scalar_acceleration(row, i, s, alpha, accel))
            elif kind != FIXED:
                alpha = add_scaled(alpha, s.U[row, i].z, scalar_acceleration(row, i, s, alpha, accel))
            s.alpha[row, i] = alpha
            s.accel[row, i] = accel
