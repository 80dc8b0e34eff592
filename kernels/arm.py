"""A serial arm of revolute joints under velocity control, one scalar solve a world.

All spatial quantities are about the world's origin, in world axes. With S_j = (z_j, s_j), s_j = p_j x z_j, for a joint
at p_j with axis z_j, the joint-space inertia is (composite rigid bodies; Featherstone, Rigid Body Dynamics Algorithms,
2008, section 6.2)

    M_ij = S_i . I_j^c S_j   (i <= j),   I^c the inertia of the links from j outward

and a step of length h is implicit in the servo, the joints' friction, the stops and contacts with what does not move:

    (M + R + h D + h sum J^T W J) v' = (M + R) v + h (tau_0 - b - g + Q + sum J^T F)
    tau = g + D (v* - v')   within +-tau_max

R the reflected rotor inertia, b the velocity products, g the torque that carries the weight (the servo knows it). A
joint whose torque would leave its limit gives the limit, and its D does not count. Q are the forces of the branches,
known from their own solve (`contact`).
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

__all__ = ["arm_functions", "arm_types"]

#: Stiffness [N m/rad] and damping [N m s/rad] of the joints' stops.
STOP = wp.constant(2.0e4)
STOP_DAMPING = wp.constant(200.0)
#: Joint speed below which friction acts as a damper [rad/s].
CREEP = wp.constant(1.0e-3)
#: Times its speed limit that a joint may be thrown at.
GUARD = wp.constant(5.0)
#: Corrections of the set of joints at their torque limit.
TRIES = wp.constant(8)


@cache
def arm_types(dof: int) -> SimpleNamespace:
    """Return the structs of an arm with ``dof`` joints.

    ``Arm`` holds what all worlds share, [dof] or [capsules]; ``ArmState`` what a user reads and writes, [worlds, dof];
    ``ArmWork`` what a step works in.
    """
    Row = wp.types.vector(dof, wp.float32)
    Square = wp.types.matrix((dof, dof), wp.float32)

    @wp.struct
    class Arm:
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
        q: wp.array2d(dtype=wp.float32)
        qd: wp.array2d(dtype=wp.float32)
        torque: wp.array2d(dtype=wp.float32)
        target: wp.array2d(dtype=wp.float32)
        force: wp.array2d(dtype=wp.vec3)
        end_position: wp.array(dtype=wp.vec3)
        end_rotation: wp.array(dtype=wp.vec4)
        lost: wp.array(dtype=int)

    @wp.struct
    class ArmWork:
        pose: wp.array2d(dtype=wp.quat)
        origin: wp.array2d(dtype=wp.vec3)
        axis: wp.array2d(dtype=wp.vec3)
        moment: wp.array2d(dtype=wp.vec3)
        push: wp.array2d(dtype=wp.vec3)
        first: wp.array2d(dtype=wp.vec3)
        tensor: wp.array2d(dtype=wp.mat33)
        start: wp.array2d(dtype=wp.vec3)
        end: wp.array2d(dtype=wp.vec3)
        inertia: wp.array(dtype=Square)
        factor: wp.array(dtype=Square)
        bias: wp.array(dtype=Row)
        weight: wp.array(dtype=Row)
        load: wp.array(dtype=Row)
        velocity: wp.array(dtype=Row)
        held: wp.array(dtype=Row)
        loose: wp.array(dtype=int)
        settled: wp.array(dtype=int)

    return SimpleNamespace(Arm=Arm, ArmState=ArmState, ArmWork=ArmWork, Row=Row, Square=Square)


@wp.func(inline=True)
def place_arm(w: int, a: Any, q_in: Any, k: Any):
    """Place every link: p_j = p_{j-1} + R_{j-1} o_j,  R_j = R_{j-1} T_j exp(axis q_j); and the ends of its capsules."""
    origin = wp.vec3(0.0, 0.0, 0.0)
    pose = wp.quat(0.0, 0.0, 0.0, 1.0)
    for j in range(a.mass.shape[0]):
        origin = origin + wp.quat_rotate(pose, a.position[j])
        pose = wp.normalize(pose * a.rotation[j] * wp.quat_from_axis_angle(a.axis[j], q_in[w, j]))
        k.origin[w, j] = origin
        k.pose[w, j] = pose
        k.axis[w, j] = wp.quat_rotate(pose, a.axis[j])
    for c in range(a.shape_link.shape[0]):
        j = a.shape_link[c]
        if j < 0:
            k.start[w, c] = a.shape_start[c]
            k.end[w, c] = a.shape_end[c]
        else:
            k.start[w, c] = k.origin[w, j] + wp.quat_rotate(k.pose[w, j], a.shape_start[c])
            k.end[w, c] = k.origin[w, j] + wp.quat_rotate(k.pose[w, j], a.shape_end[c])


@wp.func(inline=True)
def inertia_about_origin(mass: float, c: wp.vec3, about_com: wp.mat33):
    """I + m (|c|^2 1 - c c^T)"""
    return about_com + mass * (wp.dot(c, c) * wp.identity(n=3, dtype=wp.float32) - wp.outer(c, c))


@wp.func(inline=True)
def velocity_forces(w: int, a: Any, x: Any, k: Any):
    """Every link's inertia about the origin, and the forces that velocity products need of it.

    f = m ao + aw x mc + w x P,  n = I aw + mc x ao + w x H + vo x P
    """
    spin = wp.vec3(0.0, 0.0, 0.0)
    slide = wp.vec3(0.0, 0.0, 0.0)
    turning = wp.vec3(0.0, 0.0, 0.0)
    sliding = wp.vec3(0.0, 0.0, 0.0)
    for j in range(a.mass.shape[0]):
        z = k.axis[w, j]
        s = wp.cross(k.origin[w, j], z)
        rate = x.qd[w, j]
        turning = turning + wp.cross(spin, z) * rate
        sliding = sliding + (wp.cross(spin, s) + wp.cross(slide, z)) * rate
        spin = spin + z * rate
        slide = slide + s * rate
        m = a.mass[j]
        R = wp.quat_to_matrix(k.pose[w, j])
        c = k.origin[w, j] + R * a.com[j]
        tensor = inertia_about_origin(m, c, R * a.inertia[j] * wp.transpose(R))
        first = m * c
        k.first[w, j] = first
        k.tensor[w, j] = tensor
        P = m * slide + wp.cross(spin, first)
        H = tensor * spin + wp.cross(first, slide)
        k.push[w, j] = m * sliding + wp.cross(turning, first) + wp.cross(spin, P)
        k.moment[w, j] = tensor * turning + wp.cross(first, sliding) + wp.cross(spin, H) + wp.cross(slide, P)


@wp.func(inline=True)
def arm_dynamics(w: int, a: Any, x: Any, k: Any):
    """Joint-space inertia M, velocity products b and the torques that carry the weight, from the last joint inward."""
    velocity_forces(w, a, x, k)
    mass = float(0.0)
    first = wp.vec3(0.0, 0.0, 0.0)
    tensor = wp.mat33()
    push = wp.vec3(0.0, 0.0, 0.0)
    moment = wp.vec3(0.0, 0.0, 0.0)
    M = k.inertia[w]
    b = k.bias[w]
    g = k.weight[w]
    n = a.mass.shape[0]
    for step in range(n):
        j = n - 1 - step
        mass += a.mass[j]
        first += k.first[w, j]
        tensor += k.tensor[w, j]
        push += k.push[w, j]
        moment += k.moment[w, j]
        z = k.axis[w, j]
        s = wp.cross(k.origin[w, j], z)
        P = mass * s + wp.cross(z, first)
        H = tensor * z + wp.cross(first, s)
        b[j] = wp.dot(z, moment) + wp.dot(s, push)
        g[j] = 0.0 - wp.dot(z, wp.cross(first, a.gravity)) - mass * wp.dot(s, a.gravity)
        for i in range(j + 1):
            zi = k.axis[w, i]
            entry = wp.dot(zi, H) + wp.dot(wp.cross(k.origin[w, i], zi), P)
            M[i, j] = entry
            M[j, i] = entry
        M[j, j] = M[j, j] + a.armature[j]
    k.inertia[w] = M
    k.bias[w] = b
    k.weight[w] = g


@wp.func(inline=True)
def lever(w: int, k: Any, j: int, point: wp.vec3):
    """Velocity of a point per unit rate of joint j: z_j x (p - p_j)."""
    return wp.cross(k.axis[w, j], point - k.origin[w, j])


@wp.func(inline=True)
def point_velocity(w: int, k: Any, link: int, point: wp.vec3, v: Any):
    """J v of a point of a link."""
    out = wp.vec3(0.0, 0.0, 0.0)
    for j in range(link + 1):
        out += lever(w, k, j, point) * v[j]
    return out


@wp.func(inline=True)
def add_point_force(w: int, k: Any, link: int, point: wp.vec3, force: wp.vec3):
    """Q += J^T f of a force at a point of a link."""
    Q = k.load[w]
    for j in range(link + 1):
        Q[j] = Q[j] + wp.dot(lever(w, k, j, point), force)
    k.load[w] = Q


@cache
def arm_functions(dof: int) -> SimpleNamespace:
    """Return device functions whose matrices have the arm's size: ``solve_arm``, ``compliance`` and ``finish_arm``."""
    types = arm_types(dof)
    Row, Square = types.Row, types.Square
    Tall = wp.types.matrix((dof, 3), wp.float32)

    @wp.func(inline=True)
    def cholesky(A: Square) -> Square:
        """L with A = L L^T; its diagonal holds the reciprocals."""
        L = Square()
        for i in range(dof):
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
    def solved(L: Square, b: Row) -> Row:
        """A^-1 b"""
        y = Row()
        for i in range(dof):
            total = b[i]
            for k in range(i):
                total -= L[i, k] * y[k]
            y[i] = total * L[i, i]
        for step in range(dof):
            i = dof - 1 - step
            total = y[i]
            for k in range(i + 1, dof):
                total -= L[k, i] * y[k]
            y[i] = total * L[i, i]
        return y

    @wp.func(inline=True)
    def jacobian(w: int, k: Any, link: int, other: int, point: wp.vec3) -> Tall:
        """Velocity of a link's point against that of another link (or of what does not move, -1), a row a joint."""
        J = Tall()
        for j in range(dof):
            c = wp.vec3(0.0, 0.0, 0.0)
            if j <= link:
                if j > other:
                    c = lever(w, k, j, point)
            J[j, 0] = c[0]
            J[j, 1] = c[1]
            J[j, 2] = c[2]
        return J

    @wp.func
    def compliance(w: int, k: Any, link: int, point: wp.vec3) -> wp.mat33:
        """J A^-1 J^T of a point of a link: what it yields to an impulse [1/kg]."""
        J = jacobian(w, k, link, -1, point)
        L = k.factor[w]
        Y = Tall()
        C = wp.mat33()
        for i in range(dof):
            y = wp.vec3(J[i, 0], J[i, 1], J[i, 2])
            for m in range(i):
                y = y - wp.vec3(Y[m, 0], Y[m, 1], Y[m, 2]) * L[i, m]
            y = y * L[i, i]
            Y[i, 0] = y[0]
            Y[i, 1] = y[1]
            Y[i, 2] = y[2]
            C = C + wp.outer(y, y)
        return C

    @wp.func(inline=True)
    def push_back(J: Tall, W: wp.mat33, A: Square, h: float) -> Square:
        """A + h J^T W J of a contact with something that does not move, or with another link of the arm."""
        for i in range(dof):
            WJ = W * wp.vec3(J[i, 0], J[i, 1], J[i, 2])
            for j in range(dof):
                A[i, j] = A[i, j] + h * wp.dot(wp.vec3(J[j, 0], J[j, 1], J[j, 2]), WJ)
        return A

    @wp.func(inline=True)
    def solve_arm(w: int, a: Any, x: Any, k: Any, contact_in: Any, count: int, h: float):
        """Velocities after the step under the present contact forces; the joints at their torque limit are found."""
        M = k.inertia[w]
        b = k.bias[w]
        Q = k.load[w]
        base = M
        right = Row()
        for i in range(dof):
            total = h * (Q[i] - b[i])
            for j in range(dof):
                total += M[i, j] * x.qd[w, j]
            right[i] = total
        for n in range(count):
            c = contact_in[w, n]
            if c.link == 0:
                if c.active == 1:
                    J = jacobian(w, k, c.body, c.other, c.point)
                    base = push_back(J, c.impedance, base, h)
                    for i in range(dof):
                        right[i] = right[i] + h * wp.dot(wp.vec3(J[i, 0], J[i, 1], J[i, 2]), c.drive)
        for j in range(dof):
            resisting = a.damping[j] + a.friction[j] / wp.max(wp.abs(x.qd[w, j]), CREEP)
            base[j, j] = base[j, j] + h * resisting
        g = k.weight[w]
        held = k.held[w]
        v = Row()
        L = Square()
        changed = int(1)
        for attempt in range(TRIES):
            if changed == 1:
                A = base
                r = right
                for j in range(dof):
                    if held[j] == 0.0:
                        A[j, j] = A[j, j] + h * a.gain[j]
                        r[j] = r[j] + h * a.gain[j] * command(w, a, x, j, h)
                    else:
                        r[j] = r[j] + h * (held[j] * a.torque_limit[j] - g[j])
                    over = beyond(x.q[w, j], a.lower[j], a.upper[j])
                    if over != 0.0:
                        A[j, j] = A[j, j] + h * (h * STOP + STOP_DAMPING)
                        r[j] = r[j] - h * STOP * over
                L = cholesky(A)
                v = solved(L, r)
                changed = int(0)
                for j in range(dof):
                    wanted = servo(w, a, x, j, g[j], v[j], h)
                    limited = float(0.0)
                    if wanted > a.torque_limit[j]:
                        limited = 1.0
                    if wanted < 0.0 - a.torque_limit[j]:
                        limited = -1.0
                    if limited != held[j]:
                        # from one limit to the other by way of the servo: a light joint would be thrown to and fro
                        held[j] = wp.where(limited * held[j] < 0.0, 0.0, limited)
                        if attempt < TRIES - 1:
                            changed = 1
        k.held[w] = held
        k.velocity[w] = v
        # A joint at its limit yields far more than one under its servo. Once one was there in this step, contacts
        # count on an arm that no servo holds: that much it never yields, so that their exchange converges.
        for j in range(dof):
            if held[j] != 0.0:
                k.loose[w] = 1
        if k.loose[w] == 1:
            L = cholesky(base)
        k.factor[w] = L

    @wp.func(inline=True)
    def finish_arm(w: int, a: Any, x: Any, k: Any, h: float):
        """Take the step: qd <- v', q <- q + h v'; and note the servos' torques.

        Speeds beyond GUARD times a joint's limit are taken out of all joints by one factor, which takes energy out.
        A step that left the finite is not taken and marks the world as lost.
        """
        v = k.velocity[w]
        g = k.weight[w]
        calm = float(1.0)
        sound = int(1)
        for j in range(dof):
            wanted = servo(w, a, x, j, g[j], v[j], h)
            x.torque[w, j] = wp.clamp(wanted, 0.0 - a.torque_limit[j], a.torque_limit[j])
            if not wp.isfinite(v[j]):
                sound = 0
            calm = wp.min(calm, GUARD * a.speed_limit[j] / wp.max(wp.abs(v[j]), 1.0e-6))
        if sound == 1:
            for j in range(dof):
                x.qd[w, j] = v[j] * calm
                x.q[w, j] = x.q[w, j] + h * x.qd[w, j]
        else:
            x.lost[w] = 1

    return SimpleNamespace(solve_arm=solve_arm, compliance=compliance, finish_arm=finish_arm)


@wp.func(inline=True)
def beyond(q: float, lower: float, upper: float):
    """How far a joint is beyond its stops [rad], signed."""
    return wp.max(q - upper, 0.0) + wp.min(q - lower, 0.0)


@wp.func(inline=True)
def command(w: int, a: Any, x: Any, j: int, h: float):
    """Velocity target within the speed limit, and slowing so that a joint comes to rest at its stop, not beyond."""
    limit = a.speed_limit[j]
    v = wp.clamp(x.target[w, j], 0.0 - limit, limit)
    reach = 8.0 * h
    return wp.clamp(
        v, wp.min((a.lower[j] - x.q[w, j]) / reach, limit), wp.max((a.upper[j] - x.q[w, j]) / reach, 0.0 - limit)
    )


@wp.func(inline=True)
def servo(w: int, a: Any, x: Any, j: int, weight: float, speed: float, h: float):
    """Torque that a joint's servo asks for, before its limit: g + D (v* - v')."""
    return weight + a.gain[j] * (command(w, a, x, j, h) - speed)


@wp.func
def end_pose(w: int, a: Any, x: Any, k: Any):
    """Write the end-effector's pose."""
    j = a.end_link
    x.end_position[w] = k.origin[w, j] + wp.quat_rotate(k.pose[w, j], a.end_position)
    q = k.pose[w, j] * a.end_rotation
    x.end_rotation[w] = wp.vec4(q[3], q[0], q[1], q[2])
