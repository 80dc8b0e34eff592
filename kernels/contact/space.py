"""What all contacts of one world yield to each other's forces: the space that `solve` finds the forces in.

The branches' articulated inertia is folded once, without contacts (`articulated`). A force on a link then changes the
accelerations of the links by what the folded inertias say: inward along the path, at a spherical joint,

    n' = k D n,   f' = f - U^T n,   n_parent = n' + r x f',   f_parent = f'              (D, U, k of `fold_spherical`)

and outward  al = k D al_parent - U a + D n,  a = a_parent - r x al_parent. Three unit forces at every contact give the
blocks C_ij = J_i M^-1 J_j^T of the branches (Featherstone, Rigid Body Dynamics Algorithms, 2008, section 11.5); the arm
adds Y_i^T Y_j with Y = L^-1 J^T and L L^T its own inertia with servos (`arm`). With v0 the velocities that the step
brings without contact,

    v_i = v0_i + h sum_j C_ij f_j

Everything is in the contacts' frames (n, t1, t2).
"""

from typing import Any

import warp as wp

from ..lanes.algebra import (
    add,
    add_cross,
    add_mul,
    add_scaled,
    cross,
    dot,
    mul,
    spread,
    sub,
    sub_mul,
    sub_scaled,
    transposed_mul,
    vec3_of,
)
from ..lanes.real import lane, real
from ..tree.articulated import (
    FIXED,
    PRISMATIC,
    SPHERICAL,
    implicit_inertia,
    scalar_acceleration,
    spherical_acceleration,
)
from .law import ContactRule, frame_of, resistance

__all__ = ["find_yields", "mark_paths", "press_links", "respond", "set_out_contacts"]


# ---- lanes: the group's links ----------------------------------------------------------------------------------------


@wp.func(inline=True)
def mark_paths(
    e: int, row: int, width: int, slot_world: wp.array(dtype=int), m: Any, rule: ContactRule, touch: Any
) -> int:
    """Mark the links that a contact may touch, and all between them and the root; return whether anything touches."""
    o = real(0.0, touch.n[row, 0].x)
    for i in range(m.count[e] + 1):
        touch.path[row, i] = 0
    todo = int(0)
    for k in range(width):
        w = slot_world[e * width + k]
        if w >= 0:
            for n in range(rule.count[w]):
                touch.path[row, rule.record[w, n].link] = 1
                touch.path[row, rule.record[w, n].second_link] = 1
                todo = 1
    for step in range(m.count[e]):
        i = m.count[e] - step
        if touch.path[row, i] == 1:
            touch.path[row, m.parent[e, i]] = 1
            touch.n[row, i] = type(touch.n[row, i])(o, o, o)
            touch.f[row, i] = type(touch.f[row, i])(o, o, o)
    touch.path[row, 0] = 0
    return todo


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


@wp.func(inline=True)
def cross_joint(kind: int, D: Any, U: Any, k: Any, n: Any, f: Any):
    """What a moment n and a force f on a link make its joint do (one axis: in ``x``), and what they pass on.

    ``k`` is armature + h D' of a spherical joint, 1 / d of one of one axis (`articulated.fold_scalar`).
    """
    answer = n
    moment = n
    force = f
    if kind == SPHERICAL:
        answer = D * n
        moment = answer * k
        force = f - transposed_mul(U, n)
    else:
        t = dot(U.z, n)
        if kind == PRISMATIC:
            t = dot(U.z, f)
        rate = t * k
        answer = type(n)(rate, rate, rate)
        moment = sub_scaled(n, U.x, rate)
        force = sub_scaled(f, U.y, rate)
    return answer, moment, force


@wp.func(inline=True)
def press_links(e: int, row: int, m: Any, s: Any, touch: Any, h: wp.float64):
    """Add the contacts' moments ``touch.n`` and forces ``touch.f`` to what the joints' accelerations are made from."""
    for step in range(m.count[e]):
        i = m.count[e] - step
        if touch.path[row, i] == 1:
            n = touch.n[row, i]
            f = touch.f[row, i]
            kind = m.kind[e, i]
            if kind != FIXED:
                u = s.u[row, i]
                k = u.y
                if kind == SPHERICAL:
                    k = implicit_inertia(e, i, m, h)
                answer, n, f = cross_joint(kind, s.D[row, i], s.U[row, i], k, n, f)
                if kind == SPHERICAL:
                    s.u[row, i] = u + answer
                else:
                    s.u[row, i] = type(u)(u.x + answer.x, u.y, u.z)
            p = m.parent[e, i]
            if p > 0:
                touch.n[row, p] = add_cross(touch.n[row, p] + n, s.r[row, i], f)
                touch.f[row, p] = touch.f[row, p] + f


@wp.func(inline=True)
def load_link(row: int, k: int, i: int, lever: wp.vec3, force: wp.vec3, x: Any):
    """Add a force at a point of a link to its moments ``x.n`` and forces ``x.f``, in one lane."""
    moment = wp.cross(lever, force)
    for axis in range(3):
        x.n_entry[row, i, axis, k] = x.n_entry[row, i, axis, k] + moment[axis]
        x.f_entry[row, i, axis, k] = x.f_entry[row, i, axis, k] + force[axis]


# ---- one world: its paths --------------------------------------------------------------------------------------------


@wp.func(inline=True)
def everywhere(v: Any, k: int):
    """A vector of world k in all lanes."""
    return type(v)(real(lane(v.x, k), v.x), real(lane(v.y, k), v.x), real(lane(v.z, k), v.x))


@wp.func(inline=True)
def mark_up(e: int, row: int, link: int, m: Any, p: Any):
    """Mark a link and all between it and the root."""
    i = int(link)
    while p.number[row, i] == -1:
        p.number[row, i] = -2
        i = m.parent[e, i]


@wp.func(inline=True)
def copy_link(e: int, row: int, lane_: int, i: int, at: int, m: Any, s: Any, p: Any, h: wp.float64):
    """Copy what a unit response needs of a link, in one world, into all lanes."""
    kind = m.kind[e, i]
    p.kind[row, at] = kind
    p.up[row, at] = p.number[row, m.parent[e, i]]
    p.r[row, at] = everywhere(s.r[row, i], lane_)
    if kind != FIXED:
        U = s.U[row, i]
        p.U[row, at] = type(U)(everywhere(U.x, lane_), everywhere(U.y, lane_), everywhere(U.z, lane_))
    if kind == SPHERICAL:
        D = s.D[row, i]
        o = D.xx
        p.D[row, at] = type(D)(
            real(lane(D.xx, lane_), o), real(lane(D.xy, lane_), o), real(lane(D.xz, lane_), o),
            real(lane(D.yy, lane_), o), real(lane(D.yz, lane_), o), real(lane(D.zz, lane_), o),
        )  # fmt: skip
        p.k[row, at] = real(lane(implicit_inertia(e, i, m, h), lane_), o)
    elif kind != FIXED:
        inverse = s.u[row, i].y
        p.k[row, at] = real(lane(inverse, lane_), inverse)


@wp.func(inline=True)
def list_paths(e: int, row: int, lane_: int, w: int, m: Any, s: Any, rule: ContactRule, p: Any, h: wp.float64):
    """Number the links between this world's contacts and the root from 1; ``p.size`` is the last number."""
    p.number[row, 0] = 0
    for i in range(1, m.count[e] + 1):
        p.number[row, i] = -1
    for n in range(rule.count[w]):
        mark_up(e, row, rule.record[w, n].link, m, p)
        mark_up(e, row, rule.record[w, n].second_link, m, p)
    size = int(0)
    for i in range(1, m.count[e] + 1):
        if p.number[row, i] == -2:
            size = size + 1
            p.number[row, i] = size
            copy_link(e, row, lane_, i, size, m, s, p, h)
    p.size[row] = size


# ---- one world: unit responses, a direction a lane -------------------------------------------------------------------


@wp.func(inline=True)
def turns_of(count: int, width: int):
    """How many reals hold the three directions of ``count`` contacts."""
    return (3 * count + width - 1) // width


@wp.func(inline=True)
def carry_inward(row: int, own: int, at: int, p: Any):
    """Hand a link's moments and forces to its parent; its joint's own answer stays in ``alpha``, or ``alpha.x``."""
    n = p.n[own, at]
    f = p.f[own, at]
    kind = p.kind[row, at]
    if kind != FIXED:
        answer, n, f = cross_joint(kind, p.D[row, at], p.U[row, at], p.k[row, at], n, f)
        p.alpha[own, at] = answer
    up = p.up[row, at]
    p.n[own, up] = add_cross(p.n[own, up] + n, p.r[row, at], f)
    p.f[own, up] = p.f[own, up] + f


@wp.func(inline=True)
def answer_outward(row: int, own: int, at: int, p: Any):
    """A link's angular acceleration and its joint point's, from its parent's."""
    kind = p.kind[row, at]
    up = p.up[row, at]
    turned = p.alpha[own, up]
    accel = add_cross(p.accel[own, up], turned, p.r[row, at])
    if kind == SPHERICAL:
        turned = add_mul(sub_mul(p.alpha[own, at], p.U[row, at], accel), p.D[row, at], turned * p.k[row, at])
    elif kind != FIXED:
        U = p.U[row, at]
        rate = p.alpha[own, at].x - (dot(U.x, turned) + dot(U.y, accel)) * p.k[row, at]
        if kind == PRISMATIC:
            accel = add_scaled(accel, U.z, rate)
        else:
            turned = add_scaled(turned, U.z, rate)
    p.alpha[own, at] = turned
    p.accel[own, at] = accel


@wp.func(inline=True)
def give_units(row: int, own: int, w: int, first: int, width: int, size: int, rule: ContactRule, p: Any):
    """Put one unit force of a contact into every lane: directions ``first``, ``first`` + 1, ..., three a contact."""
    o = real(0.0, p.k[row, 0])
    like = p.n[own, 0]
    for at in range(size + 1):
        p.n[own, at] = type(like)(o, o, o)
        p.f[own, at] = type(like)(o, o, o)
    for lane_ in range(width):
        n = (first + lane_) // 3
        if n < rule.count[w]:
            link = rule.record[w, n].link
            if link > 0:
                frame = p.frame[row, n]
                force = frame[(first + lane_) % 3]
                load_link(own, lane_, p.number[row, link], rule.record[w, n].lever, force, p)
                second = rule.record[w, n].second_link
                if second > 0:
                    back = wp.vec3(0.0, 0.0, 0.0) - force
                    load_link(own, lane_, p.number[row, second], rule.record[w, n].second_lever, back, p)


@wp.func(inline=True)
def read_yields(row: int, own: int, w: int, turn: int, turns: int, rule: ContactRule, p: Any):
    """Write what every contact yields, in its frame, to the unit forces in the lanes: rows of sum J M^-1 J^T."""
    o = real(0.0, p.k[row, 0])
    for j in range(rule.count[w]):
        link = rule.record[w, j].link
        if link > 0:
            at = p.number[row, link]
            accel = p.accel[own, at]
            a = add_cross(accel, p.alpha[own, at], spread(rule.record[w, j].lever, accel))
            second = rule.record[w, j].second_link
            if second > 0:
                at = p.number[row, second]
                lever = spread(rule.record[w, j].second_lever, accel)
                a = a - add_cross(p.accel[own, at], p.alpha[own, at], lever)
            frame = p.frame[row, j]
            for axis in range(3):
                p.branch[row, (3 * j + axis) * turns + turn] = dot(a, spread(frame[axis], accel))
        else:
            for axis in range(3):
                p.branch[row, (3 * j + axis) * turns + turn] = o


@wp.func(inline=True)
def find_yields(row: int, thread: int, threads: int, w: int, width: int, rule: ContactRule, p: Any):
    """Find what all contacts of a world yield to each other's unit forces through the branches.

    A team's threads take directions in turn; each writes them through the tree in a row ``own`` of its own.
    """
    own = row * threads + thread
    o = real(0.0, p.k[row, 0])
    like = p.n[own, 0]
    p.alpha[own, 0] = type(like)(o, o, o)
    p.accel[own, 0] = type(like)(o, o, o)
    size = p.size[row]
    turns = turns_of(rule.count[w], width)
    for turn in range(thread, turns, threads):
        give_units(row, own, w, turn * width, width, size, rule, p)
        for step in range(size):
            carry_inward(row, own, size - step, p)
        for step in range(size):
            answer_outward(row, own, step + 1, p)
        read_yields(row, own, w, turn, turns, rule, p)


@wp.func(inline=True)
def set_out_contacts(
    e: int, row: int, lane_: int, w: int, m: Any, s: Any, rule: ContactRule, p: Any, h: float, dt: wp.float64
):  # fmt: skip
    """Set out a world's contacts, and the links that they act on, for `find_yields`."""
    for n in range(rule.count[w]):
        c = rule.record[w, n]
        p.frame[row, n] = frame_of(c.normal)
        p.spring[row, n] = 0.0 - rule.stiffness * c.gap
        p.resist[row, n] = resistance(c.gap, rule, h)
        p.force[row, n] = wp.vec3(0.0, 0.0, 0.0)
        p.give[row, n] = 0.0
        v = c.branch
        if c.link > 0:
            turned = vec3_of(s.alpha[row, c.link], lane_)
            v = v + h * (vec3_of(s.accel[row, c.link], lane_) + wp.cross(turned, c.lever))
        if c.second_link > 0:
            turned = vec3_of(s.alpha[row, c.second_link], lane_)
            v = v - h * (vec3_of(s.accel[row, c.second_link], lane_) + wp.cross(turned, c.second_lever))
        p.still[row, n] = v
    list_paths(e, row, lane_, w, m, s, rule, p, dt)
