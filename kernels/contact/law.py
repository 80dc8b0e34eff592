"""Contact of branches with an arm, a power line, the ground and each other: compliant, two-way, with Coulomb friction.

With the gap g along the normal n, its rate g' = n . v after the step, v the velocity of one side against the other, and
v_t the tangential part of v, the force on the side that n points to is

    f = n f_n - d v_t,   f_n = max(-k (g + h g') - c g', 0),   d = mu f_n / max(|v_t|, creep),   c = 0 while g > 0

The spring acts on the gap at the end of the step, so that a contact is felt before it is passed (from h g' away) and no
stiffness makes it unstable. Both sides answer within the step: `space` finds what all contacts of a world yield
to each other's forces, and solves them together. Every force that comes out pushes and lies in Coulomb's cone, and is
applied to both sides as it is: action equals reaction to round-off.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..tree.layout import layout_of

__all__ = ["BASE", "GROUND", "LINE", "Contact", "ContactRule", "contact_types", "grip"]

#: What touches a branch where it is no link of the arm. NONE: another branch.
LINE = wp.constant(-1)
GROUND = wp.constant(-2)
BASE = wp.constant(-3)
NONE = wp.constant(-4)
#: Speed at which deep overlaps come apart [m/s]: damping grows with the depth, so that worlds that start with overlaps
#: do not burst, while the force of what is held grows on and no arm is strong enough to push through.
EXIT = wp.constant(2.0)
#: Corrections of a contact's friction, and the share of it below which there is no further one.
ROUNDS = wp.constant(12)
EXACT = wp.constant(1.0e-3)


@wp.struct
class Contact:
    """One contact. ``link`` is the branch's place in the kernel arrays, 0 where the arm touches something else.

    ``second_link`` is the other branch's, 0 where there is none. ``body`` is the arm's link, or LINE, GROUND, BASE or
    NONE; ``other`` a second link of the arm, or -1. The normal points to the branch ``link``, or to the arm's link
    where no branch is involved. ``branch`` is the branch's velocity after the step, against the second's, if no joint
    accelerated.
    """

    link: int
    capsule: int
    second_link: int
    second_capsule: int
    body: int
    other: int
    gap: float
    point: wp.vec3
    normal: wp.vec3
    lever: wp.vec3
    second_lever: wp.vec3
    branch: wp.vec3
    force: wp.vec3


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
    branch_branch: int
    line_radius: float
    repeats: int
    friction: wp.array(dtype=wp.float32)
    line_start: wp.array(dtype=wp.vec3)
    line_end: wp.array(dtype=wp.vec3)
    line_mask: wp.array(dtype=int)
    record: wp.array2d(dtype=Contact)
    count: wp.array(dtype=int)
    overflow: wp.array(dtype=int)
    forgotten: wp.array(dtype=int)
    unsettled: wp.array(dtype=int)
    depth: wp.array(dtype=wp.float32)
    branch_force: wp.array2d(dtype=wp.vec3)
    arm_peak: wp.array2d(dtype=wp.float32)
    arm_bound: wp.array(dtype=wp.float32)


def _space_struct(t: SimpleNamespace) -> Any:
    """A thread's memory for the contacts of one world.

    The links on their paths [rows, links], numbered from 1 (``number`` of a place in the kernel arrays, ``up`` the
    parent's), with one world's D, U, r, k in all lanes; what direction d = 3 contact + axis yields to the unit forces
    of all directions, ``width`` a real: [rows, 3 contacts x turns], turns = ceil(3 contacts / width) of that world; the
    arm's share [rows, dof x turns]; [rows, contacts]; and the matrix of Newton's method. What a unit force does, ``n``,
    ``f``, ``alpha``, ``accel``, has a row for each thread of a team that solves a world, and ``gate`` is where they
    wait for each other (`team.meet`).
    """
    Real, Vec, Sym, Mat = t.Real, t.Vec, t.Sym, t.Mat

    @wp.struct
    class Space:
        """Memory of the problem in the contacts' forces."""

        gate: wp.array2d(dtype=int)
        size: wp.array(dtype=int)
        number: wp.array2d(dtype=int)
        up: wp.array2d(dtype=int)
        kind: wp.array2d(dtype=int)
        D: wp.array2d(dtype=Sym)
        U: wp.array2d(dtype=Mat)
        r: wp.array2d(dtype=Vec)
        k: wp.array2d(dtype=Real)
        n: wp.array2d(dtype=Vec)
        f: wp.array2d(dtype=Vec)
        alpha: wp.array2d(dtype=Vec)
        accel: wp.array2d(dtype=Vec)
        n_entry: wp.array4d(dtype=wp.float32)
        f_entry: wp.array4d(dtype=wp.float32)
        branch: wp.array2d(dtype=Real)
        total: wp.array2d(dtype=Real)
        arm: wp.array2d(dtype=Real)
        free: wp.array2d(dtype=Real)
        velocity: wp.array2d(dtype=Real)
        total_entry: wp.array4d(dtype=wp.float32)
        arm_entry: wp.array4d(dtype=wp.float32)
        free_entry: wp.array4d(dtype=wp.float32)
        velocity_entry: wp.array4d(dtype=wp.float32)
        frame: wp.array2d(dtype=wp.mat33)
        still: wp.array2d(dtype=wp.vec3)
        force: wp.array2d(dtype=wp.vec3)
        spring: wp.array2d(dtype=wp.float32)
        resist: wp.array2d(dtype=wp.float32)
        give: wp.array2d(dtype=wp.float32)
        pressing: wp.array2d(dtype=int)
        matrix: wp.array3d(dtype=wp.float32)
        right: wp.array2d(dtype=wp.float32)

    return Space


@cache
def contact_types(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return the structs of `layout.layout_of` with ``Shapes`` (branches' capsules), ``Touch`` and ``Space`` (scratch).

    Capsules are [groups, capsules] in the frames of their links; an absent one lies far away. ``slot_capsule`` [slots,
    capsules] is a capsule's number in its world, -1 where it has none. ``pair`` [groups, pairs, 3] are the capsules of
    branches that may touch each other, with a bit for each lane in which they may, ``pairs`` their number.
    """
    t = layout_of(width, precision)
    Real, Vec = t.Real, t.Vec

    @wp.struct
    class Shapes:
        """Capsules of branches and arm, the line."""

        count: wp.array(dtype=int)
        link: wp.array2d(dtype=int)
        middle: wp.array2d(dtype=Vec)
        half: wp.array2d(dtype=Vec)
        radius: wp.array2d(dtype=Real)
        bound: wp.array2d(dtype=Real)
        slot_capsule: wp.array2d(dtype=int)
        pairs: wp.array(dtype=int)
        pair: wp.array3d(dtype=int)

    @wp.struct
    class Touch:
        """Where contacts are noted."""

        at: wp.array2d(dtype=Vec)
        velocity: wp.array2d(dtype=Vec)
        path: wp.array2d(dtype=int)
        n: wp.array2d(dtype=Vec)
        f: wp.array2d(dtype=Vec)
        n_entry: wp.array4d(dtype=wp.float32)
        f_entry: wp.array4d(dtype=wp.float32)
        near: wp.array2d(dtype=Vec)
        near_entry: wp.array4d(dtype=wp.float32)
        centre: wp.array2d(dtype=Vec)
        reach: wp.array2d(dtype=Real)

    return SimpleNamespace(**vars(t), Shapes=Shapes, Touch=Touch, Space=_space_struct(t))


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
def resistance(gap: float, rule: ContactRule, h: float):
    """c + h k [N s/m]; c is none before touch, and in deep overlaps as much as brings the force to zero at EXIT."""
    c = wp.where(gap < 0.0, wp.max(rule.damping, (0.0 - gap / EXIT - h) * rule.stiffness), 0.0)
    return c + h * rule.stiffness


@wp.func
def frame_of(n: wp.vec3):
    """Rows n, t1, t2 of a contact's frame."""
    axis = wp.where(wp.abs(n[0]) < 0.6, wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0))
    t1 = wp.normalize(wp.cross(n, axis))
    return wp.matrix_from_rows(n, t1, wp.cross(n, t1))


@wp.func
def within_cone(fn: float, f1: float, f2: float, mu: float):
    """The force (n, t1, t2), none where it pulls, its friction cut to mu f_n."""
    normal = wp.max(fn, 0.0)
    keep = wp.min(1.0, mu * normal / wp.max(wp.sqrt(f1 * f1 + f2 * f2), 1.0e-12))
    return wp.vec3(normal, f1 * keep, f2 * keep)


@wp.func
def grip(v: wp.vec3, C: wp.mat33, spring: float, resist: float, mu: float, creep: float, guess: float):
    """Solve one contact that yields C [s/kg] to its own force: the force in its frame (n, t1, t2), and 1/d.

    v is its velocity without that force. With p = (1/d + C_tt)^-1 the law reads, for a given d,

        f_t = -p (v_t + C_tn f_n),   f_n (1 + K (C_nn - C_nt p C_tn)) = s - K (v_n - C_nt p v_t)

    and 1/d = max(|v_t'|, creep) / (mu f_n) is found as More and Sorensen (Computing a trust region step, 1983) find the
    multiplier of a trust region: |f_t| nearly goes as 1/(1/d + constant). ``guess`` is 1/d to begin with, 0 for none.
    """
    force = wp.vec3(0.0, 0.0, 0.0)
    x = float(guess)
    pressed = spring - resist * v[0]
    if pressed > 0.0:
        b1 = C[0, 1]
        b2 = C[0, 2]
        fn = pressed / (1.0 + resist * C[0, 0])
        if x == 0.0:
            x = creep / wp.max(mu * fn, 1.0e-9)
        f1 = float(0.0)
        f2 = float(0.0)
        busy = int(1)
        for _r in range(ROUNDS):
            if busy == 1:
                t11 = x + C[1, 1]
                t22 = x + C[2, 2]
                t12 = C[1, 2]
                scale = 1.0 / (t11 * t22 - t12 * t12)
                # p b and b p v
                q1 = (t22 * b1 - t12 * b2) * scale
                q2 = (t11 * b2 - t12 * b1) * scale
                left = 1.0 + resist * (C[0, 0] - b1 * q1 - b2 * q2)
                fn = (pressed + resist * (q1 * v[1] + q2 * v[2])) / left
                if fn <= 0.0:
                    # so strong a damper would pull it off
                    x = 4.0 * x
                else:
                    w1 = v[1] + b1 * fn
                    w2 = v[2] + b2 * fn
                    f1 = (t12 * w2 - t22 * w1) * scale
                    f2 = (t12 * w1 - t11 * w2) * scale
                    edge = wp.max(mu * fn, 1.0e-9)
                    drag = wp.max(wp.sqrt(f1 * f1 + f2 * f2), 1.0e-12)
                    free = wp.sqrt(w1 * w1 + w2 * w2)
                    new = wp.max(creep / edge, x + free * (1.0 / edge - 1.0 / drag))
                    if wp.abs(new - x) <= EXACT * x:
                        busy = 0
                    x = new
        force = within_cone(fn, f1, f2, mu)
    return force, x
