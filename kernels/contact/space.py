"""All contacts of one world, solved together in the space of their forces.

The branches' articulated inertia is folded once, without contacts (`articulated`). A force on a link then changes the
accelerations of the links by what the folded inertias say: inward along the path, at a spherical joint,

    n' = k D n,   f' = f - U^T n,   n_parent = n' + r x f',   f_parent = f'              (D, U, k of `fold_spherical`)

and outward  al = k D al_parent - U a + D n,  a = a_parent - r x al_parent. Three unit forces at every contact give the
blocks C_ij = J_i M^-1 J_j^T of the branches (Featherstone, Rigid Body Dynamics Algorithms, 2008, section 11.5); the arm
adds Y_i^T Y_j with Y = L^-1 J^T and L L^T its own inertia with servos (`arm`). With v0 the velocities that the step
brings without contact,

    v_i = v0_i + h sum_j C_ij f_j

and `law.grip` solves one contact exactly for given forces of the others. Sweeps over the contacts (block
Gauss-Seidel) converge, slowly where contacts push each other through stiff parts; a step of Newton's method for those
that press goes before each sweep until it has failed twice to bring the forces nearer (as projected Gauss-Seidel with
subspace minimisation: Silcowitz, Niebe, Erleben, 2010). Of 3414 problems from fast sweeps 90 % are solved in 4 sweeps,
99 % in 13, all in 40; sweeps alone take 14 for 90 %, Newton alone leaves 9 % unsolved. A sweep is always last, so that
every force pushes and lies in its cone. Everything is in the contacts' frames (n, t1, t2).
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
from ..lanes.real import REAL_OF_WIDTH, fma, lane, real
from ..tree.articulated import (
    FIXED,
    PRISMATIC,
    SPHERICAL,
    implicit_inertia,
    scalar_acceleration,
    spherical_acceleration,
)
from .law import ContactRule, frame_of, grip, resistance, within_cone

__all__ = ["mark_paths", "note_response", "press_links", "respond", "set_out_contacts", "solve_contacts", "summed"]

#: Share of the greatest force, and force [N], by which a sweep may still change one when the contacts count as solved.
SETTLED = wp.constant(5.0e-3)
FEEBLE = wp.constant(5.0e-3)
#: Newton steps that may fail to bring the forces nearer before there are only sweeps.
FAILURES = wp.constant(2)


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
def list_paths(e: int, row: int, lane_: int, w: int, m: Any, s: Any, rule: ContactRule, p: Any, h: wp.float64) -> int:
    """Number the links between this world's contacts and the root from 1; return the last number."""
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
    return size


# ---- one world: unit responses, a direction a lane -------------------------------------------------------------------


@wp.func(inline=True)
def turns_of(count: int, width: int):
    """How many reals hold the three directions of ``count`` contacts."""
    return (3 * count + width - 1) // width


@wp.func(inline=True)
def carry_inward(row: int, at: int, p: Any):
    """Hand a link's moments and forces to its parent; its joint's own answer stays in ``alpha``, or ``alpha.x``."""
    n = p.n[row, at]
    f = p.f[row, at]
    kind = p.kind[row, at]
    if kind != FIXED:
        answer, n, f = cross_joint(kind, p.D[row, at], p.U[row, at], p.k[row, at], n, f)
        p.alpha[row, at] = answer
    up = p.up[row, at]
    p.n[row, up] = add_cross(p.n[row, up] + n, p.r[row, at], f)
    p.f[row, up] = p.f[row, up] + f


@wp.func(inline=True)
def answer_outward(row: int, at: int, p: Any):
    """A link's angular acceleration and its joint point's, from its parent's."""
    kind = p.kind[row, at]
    up = p.up[row, at]
    turned = p.alpha[row, up]
    accel = add_cross(p.accel[row, up], turned, p.r[row, at])
    if kind == SPHERICAL:
        turned = add_mul(sub_mul(p.alpha[row, at], p.U[row, at], accel), p.D[row, at], turned * p.k[row, at])
    elif kind != FIXED:
        U = p.U[row, at]
        rate = p.alpha[row, at].x - (dot(U.x, turned) + dot(U.y, accel)) * p.k[row, at]
        if kind == PRISMATIC:
            accel = add_scaled(accel, U.z, rate)
        else:
            turned = add_scaled(turned, U.z, rate)
    p.alpha[row, at] = turned
    p.accel[row, at] = accel


@wp.func(inline=True)
def give_units(row: int, w: int, first: int, width: int, size: int, rule: ContactRule, p: Any):
    """Put one unit force of a contact into every lane: directions ``first``, ``first`` + 1, ..., three a contact."""
    o = real(0.0, p.k[row, 0])
    like = p.n[row, 0]
    for at in range(size + 1):
        p.n[row, at] = type(like)(o, o, o)
        p.f[row, at] = type(like)(o, o, o)
    for lane_ in range(width):
        n = (first + lane_) // 3
        if n < rule.count[w]:
            link = rule.record[w, n].link
            if link > 0:
                frame = p.frame[row, n]
                force = frame[(first + lane_) % 3]
                load_link(row, lane_, p.number[row, link], rule.record[w, n].lever, force, p)
                second = rule.record[w, n].second_link
                if second > 0:
                    back = wp.vec3(0.0, 0.0, 0.0) - force
                    load_link(row, lane_, p.number[row, second], rule.record[w, n].second_lever, back, p)


@wp.func(inline=True)
def read_yields(row: int, w: int, turn: int, turns: int, rule: ContactRule, p: Any):
    """Write what every contact yields, in its frame, to the unit forces in the lanes: rows of sum J M^-1 J^T."""
    o = real(0.0, p.k[row, 0])
    for j in range(rule.count[w]):
        link = rule.record[w, j].link
        if link > 0:
            at = p.number[row, link]
            accel = p.accel[row, at]
            a = add_cross(accel, p.alpha[row, at], spread(rule.record[w, j].lever, accel))
            second = rule.record[w, j].second_link
            if second > 0:
                at = p.number[row, second]
                lever = spread(rule.record[w, j].second_lever, accel)
                a = a - add_cross(p.accel[row, at], p.alpha[row, at], lever)
            frame = p.frame[row, j]
            for axis in range(3):
                p.branch[row, (3 * j + axis) * turns + turn] = dot(a, spread(frame[axis], accel))
        else:
            for axis in range(3):
                p.branch[row, (3 * j + axis) * turns + turn] = o


@wp.func(inline=True)
def find_yields(row: int, w: int, width: int, size: int, rule: ContactRule, p: Any):
    """Find what all contacts of a world yield to each other's unit forces through the branches."""
    o = real(0.0, p.k[row, 0])
    like = p.n[row, 0]
    p.alpha[row, 0] = type(like)(o, o, o)
    p.accel[row, 0] = type(like)(o, o, o)
    turns = turns_of(rule.count[w], width)
    for turn in range(turns):
        give_units(row, w, turn * width, width, size, rule, p)
        for step in range(size):
            carry_inward(row, size - step, p)
        for step in range(size):
            answer_outward(row, step + 1, p)
        read_yields(row, w, turn, turns, rule, p)


@wp.func(inline=True)
def set_out_contacts(
    e: int, row: int, lane_: int, w: int, width: int, m: Any, s: Any, rule: ContactRule, p: Any, h: float,
    dt: wp.float64,
):  # fmt: skip
    """Everything about a world's contacts that does not depend on the arm."""
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
    size = list_paths(e, row, lane_, w, m, s, rule, p, dt)
    find_yields(row, w, width, size, rule, p)


# ---- one world: the solve --------------------------------------------------------------------------------------------
#
# Sizes come from types, not from arguments: they are constants then before anything is inlined. With arguments the step
# of one world a thread took 9 % longer.


@wp.func(inline=True)
def lanes_of(x: wp.float32):
    return 1


for _W in (8, 16):
    Lanes = REAL_OF_WIDTH[_W]

    @wp.func(inline=True)
    def lanes_of(x: Lanes):
        """How many worlds a real holds."""
        return len(x.v)


del Lanes


@wp.func(inline=True)
def note_response(row: int, n: int, turns: int, J: Any, Y: Any, v: Any, p: Any):
    """Write down what the arm yields at contact n, and how fast the contact is without any force: v0 + J v."""
    width = lanes_of(p.velocity[row, 0])
    free = p.frame[row, n] * p.still[row, n]
    for axis in range(3):
        d = 3 * n + axis
        total = free[axis]
        for j in range(len(v)):
            p.arm_entry[row, j * turns + d // width, 0, d % width] = Y[j, axis]
            total = total + J[j, axis] * v[j]
        p.free_entry[row, d // width, 0, d % width] = total


@wp.func(inline=True)
def summed(row: int, count: int, turns: int, p: Any, like: Any):
    """sum_j Y_j f_j, of the type of ``like``."""
    width = lanes_of(p.velocity[row, 0])
    z = type(like)()
    for n in range(count):
        f = p.force[row, n]
        for axis in range(3):
            d = 3 * n + axis
            for j in range(len(z)):
                z[j] = z[j] + p.arm_entry[row, j * turns + d // width, 0, d % width] * f[axis]
    return z


@wp.func(inline=True)
def add_arm(row: int, count: int, turns: int, p: Any, like: Any, h: float):
    """h (C_branches + Y^T Y), and v of the present forces; ``like`` is a row of the arm's size."""
    width = lanes_of(p.velocity[row, 0])
    for q in range(turns):
        p.velocity[row, q] = p.free[row, q]
    for n in range(count):
        f = p.force[row, n]
        for axis in range(3):
            d = 3 * n + axis
            for q in range(turns):
                y = p.branch[row, d * turns + q]
                for j in range(len(like)):
                    one = real(p.arm_entry[row, j * turns + d // width, 0, d % width], y)
                    y = fma(p.arm[row, j * turns + q], one, y)
                y = y * real(h, y)
                p.total[row, d * turns + q] = y
                p.velocity[row, q] = fma(y, real(f[axis], y), p.velocity[row, q])


@wp.func(inline=True)
def change_force(row: int, i: int, turns: int, new: wp.vec3, p: Any):
    """Set the force of contact i, and v of all contacts."""
    change = new - p.force[row, i]
    p.force[row, i] = new
    for q in range(turns):
        v = p.velocity[row, q]
        for axis in range(3):
            v = fma(p.total[row, (3 * i + axis) * turns + q], real(change[axis], v), v)
        p.velocity[row, q] = v


@wp.func(inline=True)
def velocity_of(row: int, i: int, p: Any) -> wp.vec3:
    """Velocity of contact i under the present forces."""
    width = lanes_of(p.velocity[row, 0])
    v = wp.vec3(0.0, 0.0, 0.0)
    for axis in range(3):
        v[axis] = p.velocity_entry[row, (3 * i + axis) // width, 0, (3 * i + axis) % width]
    return v


@wp.func(inline=True)
def total_of(row: int, i: int, j: int, turns: int, p: Any) -> wp.mat33:
    """What contact i yields to the force of contact j."""
    width = lanes_of(p.velocity[row, 0])
    C = wp.mat33()
    for b in range(3):
        d = 3 * j + b
        for a in range(3):
            C[a, b] = p.total_entry[row, (3 * i + a) * turns + d // width, 0, d % width]
    return C


@wp.func(inline=True)
def sweep(row: int, count: int, turns: int, mu: float, creep: float, p: Any):
    """Solve the contacts one after the other; return the greatest change of a force and the greatest force."""
    moved = float(0.0)
    most = float(0.0)
    for i in range(count):
        old = p.force[row, i]
        v = velocity_of(row, i, p)
        if old[0] > 0.0 or p.spring[row, i] > p.resist[row, i] * v[0]:
            own = total_of(row, i, i, turns, p)
            new, give = grip(v - own * old, own, p.spring[row, i], p.resist[row, i], mu, creep, p.give[row, i])
            p.give[row, i] = give
            change_force(row, i, turns, new, p)
            moved = wp.max(moved, wp.length(new - old))
            most = wp.max(most, wp.length(new))
    return moved, most


@wp.func(inline=True)
def assemble(row: int, size: int, turns: int, mu: float, creep: float, p: Any):
    """(1 - F' h C) df = F(v) - f of the contacts that press, F the law and F' its derivative."""
    for a in range(size):
        i = p.pressing[row, a]
        v = velocity_of(row, i, p)
        f = p.force[row, i]
        K = p.resist[row, i]
        normal = p.spring[row, i] - K * v[0]
        speed = wp.sqrt(v[1] * v[1] + v[2] * v[2])
        pace = wp.max(speed, creep)
        t1 = v[1] / pace
        t2 = v[2] / pace
        slip = wp.where(speed > creep, 1.0, 0.0)
        d = 0.0 - mu * f[0] / pace
        F1 = wp.mat33(0.0 - K, 0.0, 0.0, mu * K * t1, d * (1.0 - slip * t1 * t1), 0.0 - d * slip * t1 * t2,
                      mu * K * t2, 0.0 - d * slip * t1 * t2, d * (1.0 - slip * t2 * t2))  # fmt: skip
        g = wp.vec3(normal, 0.0 - mu * normal * t1, 0.0 - mu * normal * t2) - f
        for b in range(size):
            A = wp.mat33() - F1 * total_of(row, i, p.pressing[row, b], turns, p)
            if a == b:
                A = A + wp.identity(n=3, dtype=wp.float32)
            for r in range(3):
                for q in range(3):
                    p.matrix[row, 3 * a + r, 3 * b + q] = A[r, q]
        for r in range(3):
            p.right[row, 3 * a + r] = g[r]


@wp.func(inline=True)
def eliminate(row: int, size: int, p: Any):
    """Gauss in place, without a change of order: the diagonal is 1 and more; the solution is in ``right``."""
    for k in range(size):
        pivot = p.matrix[row, k, k]
        inverse = 1.0 / wp.where(wp.abs(pivot) < 1.0e-6, 1.0e-6, pivot)
        p.matrix[row, k, k] = inverse
        for i in range(k + 1, size):
            share = p.matrix[row, i, k] * inverse
            for j in range(k + 1, size):
                p.matrix[row, i, j] = p.matrix[row, i, j] - share * p.matrix[row, k, j]
            p.right[row, i] = p.right[row, i] - share * p.right[row, k]
    for step in range(size):
        k = size - 1 - step
        total = p.right[row, k]
        for j in range(k + 1, size):
            total -= p.matrix[row, k, j] * p.right[row, j]
        p.right[row, k] = total * p.matrix[row, k, k]


@wp.func(inline=True)
def newton(row: int, count: int, turns: int, mu: float, creep: float, p: Any):
    """One step of Newton's method for the contacts that press, cut to their cones."""
    size = int(0)
    most = p.pressing.shape[1]
    for i in range(count):
        if p.force[row, i][0] > 0.0:
            if size < most:
                p.pressing[row, size] = i
            size = size + 1
    if size > 1 and size <= most:
        assemble(row, size, turns, mu, creep, p)
        eliminate(row, 3 * size, p)
        for a in range(size):
            i = p.pressing[row, a]
            f = p.force[row, i] + wp.vec3(p.right[row, 3 * a], p.right[row, 3 * a + 1], p.right[row, 3 * a + 2])
            change_force(row, i, turns, within_cone(f[0], f[1], f[2], mu), p)


@wp.func(inline=True)
def solve_contacts(
    row: int, count: int, turns: int, mu: float, rule: ContactRule, p: Any, like: Any, h: float
) -> int:  # fmt: skip
    """Find the forces of all contacts of a world; return whether they were still changing at the end."""
    add_arm(row, count, turns, p, like, h)
    changed = int(1)
    least = float(1.0e30)
    failed = int(0)
    for turn in range(rule.repeats):
        if changed == 1:
            leap = wp.where(turn > 0 and failed < FAILURES, 1, 0)
            if leap == 1:
                newton(row, count, turns, mu, rule.creep, p)
            moved, most = sweep(row, count, turns, mu, rule.creep, p)
            if count == 1 or moved <= SETTLED * most + FEEBLE:
                changed = 0
            if leap == 1 and moved > 0.7 * least:
                failed = failed + 1
            least = wp.min(least, moved)
    return changed
