"""A serial arm of revolute joints under velocity control: placed in lanes, solved world by world.

All spatial quantities are about the world's origin, in world axes. With S_j = (z_j, s_j), s_j = p_j x z_j, for a joint
at p_j with axis z_j, the joint-space inertia is (composite rigid bodies; Featherstone, Rigid Body Dynamics Algorithms,
2008, section 6.2)

    M_ij = S_i . I_j^c S_j   (i <= j),   I^c the inertia of the links from j outward

and a step of length h is implicit in the servo, the joints' friction and the stops:

    A v' = (M + R) v + h (tau_0 - b - g + sum J^T f),   A = M + R + h D = L L^T
    tau = (1 - e) g + D (v* - v')   within +-tau_max

R the reflected rotor inertia, b the velocity products, g the torque that carries the weight (the servo knows it, but
for a share e), v* the target speed of so many substeps ago. A joint whose torque would leave its limit gives the limit,
and its D does not count. f are the contacts' forces, which are found together with those of the branches (`space`).
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.algebra import (
    about_axis,
    add,
    add_cross,
    add_scaled,
    cross,
    dot,
    mul,
    renormalised,
    rotate,
    spread,
    sub,
    types_of,
)
from ..lanes.real import real, round_

__all__ = ["Arm", "ArmState", "arm_lanes", "arm_types"]

#: Stiffness [N m/rad] and damping [N m s/rad] of the joints' stops.
STOP = wp.constant(2.0e4)
STOP_DAMPING = wp.constant(200.0)
#: Joint speed below which friction acts as a damper [rad/s].
CREEP = wp.constant(1.0e-3)
#: Times its speed limit that a joint may be thrown at.
GUARD = wp.constant(5.0)
#: 1 / (2 pi)
WHOLE_TURN = wp.constant(wp.float64(0.15915494309189535))
#: Corrections of the set of joints at their torque limit.
TRIES = wp.constant(8)


@wp.struct
class Arm:
    """What the arms of all worlds share, [dof] or [capsules]."""

    position: wp.array(dtype=wp.vec3)
    rotation: wp.array(dtype=wp.quat)
    axis: wp.array(dtype=wp.vec3)
    mass: wp.array(dtype=wp.float32)
    com: wp.array(dtype=wp.vec3)
    inertia: wp.array(dtype=wp.mat33)
    armature: wp.array(dtype=wp.float32)
    damping: wp.array(dtype=wp.float32)
    gain: wp.array(dtype=wp.float32)
    friction: wp.array(dtype=wp.float32)
    weight_error: wp.array(dtype=wp.float32)
    late: wp.array(dtype=int)
    torque_limit: wp.array(dtype=wp.float32)
    speed_limit: wp.array(dtype=wp.float32)
    lower: wp.array(dtype=wp.float32)
    upper: wp.array(dtype=wp.float32)
    reach: wp.array(dtype=wp.float32)
    end_link: int
    end_position: wp.vec3
    end_rotation: wp.quat
    shape_link: wp.array(dtype=int)
    shape_start: wp.array(dtype=wp.vec3)
    shape_end: wp.array(dtype=wp.vec3)
    shape_radius: wp.array(dtype=wp.float32)
    pair: wp.array2d(dtype=int)
    gravity: wp.vec3


@wp.struct
class ArmState:
    """What a user reads and writes, [worlds, dof] or [worlds].

    ``waiting`` [slots, worlds, dof] holds the last targets, ``beat`` is the next slot, ``obeyed`` the target in force.
    """

    q: wp.array2d(dtype=wp.float32)
    qd: wp.array2d(dtype=wp.float32)
    torque: wp.array2d(dtype=wp.float32)
    target: wp.array2d(dtype=wp.float32)
    obeyed: wp.array2d(dtype=wp.float32)
    waiting: wp.array3d(dtype=wp.float32)
    beat: wp.array(dtype=int)
    force: wp.array2d(dtype=wp.vec3)
    end_position: wp.array(dtype=wp.vec3)
    end_rotation: wp.array(dtype=wp.vec4)
    lost: wp.array(dtype=int)


@cache
def arm_types(dof: int) -> SimpleNamespace:
    """Return `Arm`, `ArmState` and ``ArmWork``, which a step of an arm with ``dof`` joints works in, [worlds].

    With them the vector ``Row`` [dof] and the matrices ``Square`` [dof, dof] and ``Tall`` [dof, 3].
    """
    Row = wp.types.vector(dof, wp.float32)
    Square = wp.types.matrix((dof, dof), wp.float32)
    Tall = wp.types.matrix((dof, 3), wp.float32)

    @wp.struct
    class ArmWork:
        """Working memory of one world's arm."""

        origin: wp.array2d(dtype=wp.vec3)
        axis: wp.array2d(dtype=wp.vec3)
        inertia: wp.array(dtype=Square)
        factor: wp.array(dtype=Square)
        bias: wp.array(dtype=Row)
        weight: wp.array(dtype=Row)
        velocity: wp.array(dtype=Row)
        held: wp.array(dtype=Row)
        changed: wp.array(dtype=int)

    return SimpleNamespace(Arm=Arm, ArmState=ArmState, ArmWork=ArmWork, Row=Row, Square=Square, Tall=Tall)


@cache
def arm_lanes(width: int) -> Any:
    """Return ``ArmLanes``, where a thread places the arms of its group's worlds: a real a world, [rows, dof].

    ``start`` and ``end`` are the capsules' ends [rows, capsules], ``inertia`` [rows, dof x dof]; ``tensor`` and
    ``first`` a link's inertia about the world's origin and its mass times centre, ``moment`` and ``push`` what its
    velocity products need.
    """
    t = types_of(width, 32)
    Real, Vec, Quat, Sym = t.Real, t.Vec, t.Quat, t.Sym

    @wp.struct
    class ArmLanes:
        """Poses and inertia of the arms of a group, in lanes."""

        q: wp.array2d(dtype=Real)
        qd: wp.array2d(dtype=Real)
        pose: wp.array2d(dtype=Quat)
        origin: wp.array2d(dtype=Vec)
        axis: wp.array2d(dtype=Vec)
        slide: wp.array2d(dtype=Vec)
        start: wp.array2d(dtype=Vec)
        end: wp.array2d(dtype=Vec)
        first: wp.array2d(dtype=Vec)
        tensor: wp.array2d(dtype=Sym)
        push: wp.array2d(dtype=Vec)
        moment: wp.array2d(dtype=Vec)
        inertia: wp.array2d(dtype=Real)
        bias: wp.array2d(dtype=Real)
        weight: wp.array2d(dtype=Real)
        q_entry: wp.array4d(dtype=wp.float32)
        qd_entry: wp.array4d(dtype=wp.float32)
        pose_entry: wp.array4d(dtype=wp.float32)
        origin_entry: wp.array4d(dtype=wp.float32)
        axis_entry: wp.array4d(dtype=wp.float32)
        start_entry: wp.array4d(dtype=wp.float32)
        end_entry: wp.array4d(dtype=wp.float32)
        inertia_entry: wp.array4d(dtype=wp.float32)
        bias_entry: wp.array4d(dtype=wp.float32)
        weight_entry: wp.array4d(dtype=wp.float32)

    return ArmLanes


@wp.func(inline=True)
def entry_vec(entry_in: wp.array4d(dtype=wp.float32), row: int, i: int, lane_: int):
    """A vector of one world of the group."""
    return wp.vec3(entry_in[row, i, 0, lane_], entry_in[row, i, 1, lane_], entry_in[row, i, 2, lane_])


@wp.func(inline=True)
def joint_turn(axis: Any, angle: Any, like: Any):
    """Unit quaternion of a joint's turn, continuous in the angle: who reads poses must see no change of sign."""
    turns = round_(angle * real(WHOLE_TURN, angle))
    odd = turns - round_(turns * 0.5) * 2.0
    return about_axis(axis, angle, like) * (real(1.0, angle) - odd * odd * 2.0)


@wp.func(inline=True)
def place_arms(row: int, a: Any, g: Any):
    """Place every link: p_j = p_{j-1} + R_{j-1} o_j,  R_j = R_{j-1} T_j exp(axis q_j); and the ends of its capsules."""
    like = g.q[row, 0]
    o = real(0.0, like)
    origin = type(g.origin[row, 0])(o, o, o)
    pose = type(g.pose[row, 0])(real(1.0, o), o, o, o)
    for j in range(a.mass.shape[0]):
        origin = origin + rotate(pose, spread(a.position[j], origin))
        turn = a.rotation[j]
        axis = spread(a.axis[j], origin)
        pose = pose * type(pose)(real(turn[3], o), real(turn[0], o), real(turn[1], o), real(turn[2], o))
        pose = renormalised(pose * joint_turn(axis, g.q[row, j], pose))
        axis = rotate(pose, axis)
        g.origin[row, j] = origin
        g.pose[row, j] = pose
        g.axis[row, j] = axis
        g.slide[row, j] = cross(origin, axis)
    for c in range(a.shape_link.shape[0]):
        j = a.shape_link[c]
        start = spread(a.shape_start[c], origin)
        end = spread(a.shape_end[c], origin)
        if j >= 0:
            start = g.origin[row, j] + rotate(g.pose[row, j], start)
            end = g.origin[row, j] + rotate(g.pose[row, j], end)
        g.start[row, c] = start
        g.end[row, c] = end


@wp.func(inline=True)
def inertia_about_origin(pose: Any, about_com: wp.mat33, mass: Any, c: Any, like: Any):
    """R I R^T + m (|c|^2 1 - c c^T)"""
    o = real(0.0, mass)
    one = real(1.0, mass)
    ex = rotate(pose, type(c)(one, o, o))
    ey = rotate(pose, type(c)(o, one, o))
    ez = cross(ex, ey)
    tx = ex * about_com[0, 0] + ey * about_com[0, 1] + ez * about_com[0, 2]
    ty = ex * about_com[0, 1] + ey * about_com[1, 1] + ez * about_com[1, 2]
    tz = ex * about_com[0, 2] + ey * about_com[1, 2] + ez * about_com[2, 2]
    mc = c * mass
    far = dot(mc, c)
    return type(like)(
        tx.x * ex.x + ty.x * ey.x + tz.x * ez.x + (far - mc.x * c.x),
        tx.x * ex.y + ty.x * ey.y + tz.x * ez.y - mc.x * c.y,
        tx.x * ex.z + ty.x * ey.z + tz.x * ez.z - mc.x * c.z,
        tx.y * ex.y + ty.y * ey.y + tz.y * ez.y + (far - mc.y * c.y),
        tx.y * ex.z + ty.y * ey.z + tz.y * ez.z - mc.y * c.z,
        tx.z * ex.z + ty.z * ey.z + tz.z * ez.z + (far - mc.z * c.z),
    )


@wp.func(inline=True)
def velocity_forces(row: int, a: Any, g: Any):
    """Every link's inertia about the origin, and the forces that velocity products need of it.

    f = m ao + aw x mc + w x P,  n = I aw + mc x ao + w x H + vo x P
    """
    o = real(0.0, g.q[row, 0])
    spin = type(g.origin[row, 0])(o, o, o)
    slide = type(spin)(o, o, o)
    turning = type(spin)(o, o, o)
    sliding = type(spin)(o, o, o)
    for j in range(a.mass.shape[0]):
        z = g.axis[row, j]
        s = g.slide[row, j]
        rate = g.qd[row, j]
        turning = add_scaled(turning, cross(spin, z), rate)
        sliding = add_scaled(sliding, add_cross(cross(spin, s), slide, z), rate)
        spin = add_scaled(spin, z, rate)
        slide = add_scaled(slide, s, rate)
        m = real(a.mass[j], o)
        pose = g.pose[row, j]
        c = g.origin[row, j] + rotate(pose, spread(a.com[j], spin))
        tensor = inertia_about_origin(pose, a.inertia[j], m, c, g.tensor[row, j])
        first = c * m
        P = add_cross(slide * m, spin, first)
        H = add_cross(tensor * spin, first, slide)
        g.first[row, j] = first
        g.tensor[row, j] = tensor
        g.push[row, j] = add_cross(add_cross(sliding * m, turning, first), spin, P)
        g.moment[row, j] = add_cross(add_cross(add_cross(tensor * turning, first, sliding), spin, H), slide, P)


@wp.func(inline=True)
def arm_dynamics(row: int, a: Any, g: Any):
    """Joint-space inertia M, velocity products b and the torques that carry the weight, from the last joint inward."""
    velocity_forces(row, a, g)
    n = a.mass.shape[0]
    last = n - 1
    o = real(0.0, g.q[row, 0])
    mass = o
    first = g.first[row, last]
    tensor = g.tensor[row, last]
    push = g.push[row, last]
    moment = g.moment[row, last]
    gravity = spread(a.gravity, first)
    for step in range(n):
        j = last - step
        mass = mass + real(a.mass[j], o)
        if step > 0:
            first = first + g.first[row, j]
            tensor = tensor + g.tensor[row, j]
            push = push + g.push[row, j]
            moment = moment + g.moment[row, j]
        z = g.axis[row, j]
        s = g.slide[row, j]
        P = add_cross(s * mass, z, first)
        H = add_cross(tensor * z, first, s)
        g.bias[row, j] = dot(z, moment) + dot(s, push)
        g.weight[row, j] = o - dot(z, cross(first, gravity)) - mass * dot(s, gravity)
        for i in range(j + 1):
            entry = dot(g.axis[row, i], H) + dot(g.slide[row, i], P)
            if i == j:
                entry = entry + real(a.armature[j], o)
            g.inertia[row, i * n + j] = entry
            g.inertia[row, j * n + i] = entry


@wp.func(inline=True)
def place_group(e: int, row: int, width: int, slot_world: wp.array(dtype=int), a: Any, x: Any, g: Any):
    """Place the arms of a group's worlds."""
    for lane_ in range(width):
        w = slot_world[e * width + lane_]
        if w >= 0:
            for j in range(a.mass.shape[0]):
                g.q_entry[row, j, 0, lane_] = x.q[w, j]
                g.qd_entry[row, j, 0, lane_] = x.qd[w, j]
    place_arms(row, a, g)


@wp.func(inline=True)
def take_arm(w: int, row: int, lane_: int, k: Any, g: Any):
    """Copy what was found for one world out of its lane."""
    M = k.inertia[w]
    b = k.bias[w]
    weight = k.weight[w]
    n = k.origin.shape[1]
    for j in range(n):
        k.origin[w, j] = entry_vec(g.origin_entry, row, j, lane_)
        k.axis[w, j] = entry_vec(g.axis_entry, row, j, lane_)
        b[j] = g.bias_entry[row, j, 0, lane_]
        weight[j] = g.weight_entry[row, j, 0, lane_]
        for i in range(n):
            M[i, j] = g.inertia_entry[row, i * n + j, 0, lane_]
    k.inertia[w] = M
    k.bias[w] = b
    k.weight[w] = weight


@wp.func(inline=True)
def lever(w: int, k: Any, j: int, point: wp.vec3):
    """Velocity of a point per unit rate of joint j: z_j x (p - p_j)."""
    return wp.cross(k.axis[w, j], point - k.origin[w, j])


# ---- one world: matrices and rows of the arm's size ------------------------------------------------------------------


@wp.func(inline=True)
def cholesky(A: Any):
    """L with A = L L^T; its diagonal holds the reciprocals."""
    L = type(A)()
    for i in range(len(A)):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = 1.0 / wp.sqrt(wp.max(total, 1.0e-9))
            else:
                L[i, j] = total * L[j, j]
    return L


@wp.func(inline=True)
def transposed_solved(L: Any, z: Any):
    """L^-T z"""
    y = type(z)()
    for step in range(len(z)):
        i = len(z) - 1 - step
        total = z[i]
        for k in range(i + 1, len(z)):
            total -= L[k, i] * y[k]
        y[i] = total * L[i, i]
    return y


@wp.func(inline=True)
def solved(L: Any, b: Any):
    """A^-1 b = L^-T L^-1 b"""
    y = type(b)()
    for i in range(len(b)):
        total = b[i]
        for k in range(i):
            total -= L[i, k] * y[k]
        y[i] = total * L[i, i]
    return transposed_solved(L, y)


@wp.func(inline=True)
def response(w: int, k: Any, link: int, other: int, point: wp.vec3, sign: float, frame: wp.mat33, tall: Any):
    """J^T and L^-1 J^T of a link's point against another's (or what does not move, -1), in a contact's frame.

    Both are of the type of ``tall``, [dof, 3].
    """
    J = type(tall)()
    Y = type(tall)()
    L = k.factor[w]
    for j in range(len(tall)):
        y = wp.vec3(0.0, 0.0, 0.0)
        if j <= link:
            if j > other:
                y = frame * (lever(w, k, j, point) * sign)
        J[j] = y
        for m in range(j):
            y = y - Y[m] * L[j, m]
        Y[j] = y * L[j, j]
    return J, Y


# ---- one world: servos and the step ----------------------------------------------------------------------------------


@wp.func(inline=True)
def beyond(q: float, lower: float, upper: float):
    """How far a joint is beyond its stops [rad], signed."""
    return wp.max(q - upper, 0.0) + wp.min(q - lower, 0.0)


@wp.func(inline=True)
def obey(w: int, a: Any, x: Any):
    """Note the targets of this substep, and take up those of as many substeps ago as each joint is late."""
    slots = x.waiting.shape[0]
    now = x.beat[w]
    for j in range(x.target.shape[1]):
        x.waiting[now % slots, w, j] = x.target[w, j]
        x.obeyed[w, j] = x.waiting[(now + slots - a.late[j]) % slots, w, j]
    x.beat[w] = (now + 1) % slots


@wp.func(inline=True)
def command(w: int, a: Any, x: Any, j: int, h: float):
    """Velocity target within the speed limit, and slowing so that a joint comes to rest at its stop, not beyond."""
    limit = a.speed_limit[j]
    v = wp.clamp(x.obeyed[w, j], 0.0 - limit, limit)
    reach = 8.0 * h
    return wp.clamp(
        v, wp.min((a.lower[j] - x.q[w, j]) / reach, limit), wp.max((a.upper[j] - x.q[w, j]) / reach, 0.0 - limit)
    )


@wp.func(inline=True)
def servo(w: int, a: Any, x: Any, j: int, weight: float, speed: float, h: float):
    """Torque that a joint's servo asks for, before its limit: (1 - e) g + D (v* - v')."""
    return weight * (1.0 - a.weight_error[j]) + a.gain[j] * (command(w, a, x, j, h) - speed)


@wp.func(inline=True)
def free_arm(w: int, a: Any, x: Any, k: Any, h: float):
    """Velocities after the step without contact, for the present set of joints at their torque limit; and L.

    A v' = (M + R) v + h (tau_0 - b - g) with A = M + R + h D = L L^T; a stop adds h STOP + STOP_DAMPING to its D.
    """
    A = k.inertia[w]
    b = k.bias[w]
    g = k.weight[w]
    held = k.held[w]
    r = type(b)()
    for i in range(len(b)):
        total = 0.0 - h * b[i]
        for j in range(len(b)):
            total += A[i, j] * x.qd[w, j]
        r[i] = total
    for j in range(len(b)):
        rest = a.damping[j] + a.friction[j] / wp.max(wp.abs(x.qd[w, j]), CREEP)
        if held[j] == 0.0:
            rest = rest + a.gain[j]
            r[j] = r[j] + h * a.gain[j] * command(w, a, x, j, h)
            r[j] = r[j] - h * a.weight_error[j] * g[j]
        else:
            r[j] = r[j] + h * (held[j] * a.torque_limit[j] - g[j])
        over = beyond(x.q[w, j], a.lower[j], a.upper[j])
        if over != 0.0:
            rest = rest + h * STOP + STOP_DAMPING
            r[j] = r[j] - h * STOP * over
        A[j, j] = A[j, j] + h * rest
    L = cholesky(A)
    k.factor[w] = L
    k.velocity[w] = solved(L, r)


@wp.func(inline=True)
def push_arm(w: int, k: Any, z: Any, h: float):
    """v' += h A^-1 sum J^T f, with z = L^-1 sum J^T f."""
    k.velocity[w] = k.velocity[w] + transposed_solved(k.factor[w], z) * h


@wp.func(inline=True)
def judge_servos(w: int, a: Any, x: Any, k: Any, h: float):
    """Note the servos' torques and correct which joints are at their limit, and whether that changed anything."""
    g = k.weight[w]
    v = k.velocity[w]
    held = k.held[w]
    changed = int(0)
    for j in range(len(v)):
        wanted = servo(w, a, x, j, g[j], v[j], h)
        x.torque[w, j] = wp.clamp(wanted, 0.0 - a.torque_limit[j], a.torque_limit[j])
        limited = float(0.0)
        if wanted > a.torque_limit[j]:
            limited = 1.0
        if wanted < 0.0 - a.torque_limit[j]:
            limited = -1.0
        if limited != held[j]:
            # from one limit to the other by way of the servo: a light joint would be thrown to and fro
            held[j] = wp.where(limited * held[j] < 0.0, 0.0, limited)
            changed = 1
    k.held[w] = held
    k.changed[w] = changed


@wp.func(inline=True)
def finish_arm(w: int, a: Any, x: Any, k: Any, h: float):
    """Take the step: qd <- v', q <- q + h v'.

    Speeds beyond GUARD times a joint's limit are taken out of all joints by one factor, which takes energy out.
    A step that left the finite is not taken and marks the world as lost.
    """
    v = k.velocity[w]
    calm = float(1.0)
    sound = int(1)
    for j in range(len(v)):
        if not wp.isfinite(v[j]):
            sound = 0
        calm = wp.min(calm, GUARD * a.speed_limit[j] / wp.max(wp.abs(v[j]), 1.0e-6))
    if sound == 1:
        for j in range(len(v)):
            x.qd[w, j] = v[j] * calm
            x.q[w, j] = x.q[w, j] + h * x.qd[w, j]
    else:
        x.lost[w] = 1


@wp.func(inline=True)
def end_pose(w: int, row: int, lane_: int, a: Any, x: Any, g: Any):
    """Write the end-effector's pose of one world."""
    j = a.end_link
    pose = wp.quat(g.pose_entry[row, j, 1, lane_], g.pose_entry[row, j, 2, lane_], g.pose_entry[row, j, 3, lane_],
                   g.pose_entry[row, j, 0, lane_])  # fmt: skip
    x.end_position[w] = entry_vec(g.origin_entry, row, j, lane_) + wp.quat_rotate(pose, a.end_position)
    q = pose * a.end_rotation
    x.end_rotation[w] = wp.vec4(q[3], q[0], q[1], q[2])
