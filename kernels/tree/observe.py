"""Kernels that look at worlds without moving them: body poses, probe points, energy and momentum.

Outputs are plain arrays over worlds, in the worlds' own order; ``slot_world`` names the world of every slot, -1 where a
lane is empty.
"""

from functools import cache
from typing import Any

import warp as wp

from ..lanes.algebra import add, add_cross, dot, half_angle_log, mul, rotate, sub
from ..lanes.real import SOURCE, fma, lane, real
from .articulated import PRISMATIC, SPHERICAL, own_inertia, place_links, place_root
from .layout import layout_of

__all__ = ["energy_kernel", "pose_kernel", "probe_kernel"]


@wp.func(inline=True)
def locate_joints(e: int, row: int, m: Any, s: Any, at_out: Any, velocity_out: Any):
    """Sum the offsets of placed links outward: joint points in world axes, and v = v_p + w_p x r (+ slide)."""
    at_out[row, 0] = s.spin[row, 0]
    velocity_out[row, 0] = s.spin[row, 0]
    for i in range(1, m.count[e] + 1):
        p = m.parent[e, i]
        r = s.r[row, i]
        at_out[row, i] = at_out[row, p] + r
        v = add_cross(velocity_out[row, p], s.spin[row, p], r)
        if m.kind[e, i] == PRISMATIC:
            v = v + s.relative[row, i]
        velocity_out[row, i] = v


@wp.func
def locate_links(e: int, row: int, m: Any, x: Any, s: Any):
    """Place all links; joint points go into ``s.accel`` and their velocities into ``s.alpha``."""
    place_root(e, row, m, s)
    place_links(e, row, m, x, s)
    locate_joints(e, row, m, s, s.accel, s.alpha)


def _outputs(precision: int) -> tuple[Any, Any, Any]:
    """Types of numbers, 3-vectors and 4-vectors written out."""
    scalar = wp.float64 if precision == 64 else wp.float32
    return scalar, wp.types.vector(3, scalar), wp.types.vector(4, scalar)


@cache
def pose_kernel(width: int = 1, precision: int = 32) -> Any:
    """Return the kernel that writes body frames: Q_body = Q_link frame^-1, x_body = x_joint - Q_body anchor."""
    t = layout_of(width, precision)
    Model, State, Scratch, Vec, Quat, W = t.Model, t.State, t.Scratch, t.Vec, t.Quat, width
    _, Out3, Out4 = _outputs(precision)

    @wp.kernel(enable_backward=False, module="unique")
    def poses(
        m: Model, x_in: State, anchor: wp.array2d(dtype=Vec), frame: wp.array2d(dtype=Quat),
        slot_world: wp.array(dtype=int), slot_link: wp.array2d(dtype=int), s_out: Scratch, first: int, row: int,
        position_out: wp.array2d(dtype=Out3), rotation_out: wp.array2d(dtype=Out4),
    ):  # fmt: skip
        """Write the body frames of a group's worlds: positions [m], world axes, and quaternions w, x, y, z."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        locate_links(e, r, m, x_in, s_out)
        for i in range(1, m.count[e] + 1):
            q = s_out.pose[r, i] * frame[e, i]
            p = s_out.accel[r, i] - rotate(q, anchor[e, i])
            for k in range(W):
                world = slot_world[e * W + k]
                link = slot_link[e * W + k, i]
                if world >= 0 and link >= 0:
                    position_out[world, link] = Out3(lane(p.x, k), lane(p.y, k), lane(p.z, k))
                    rotation_out[world, link] = Out4(lane(q.w, k), lane(q.x, k), lane(q.y, k), lane(q.z, k))

    return poses


@cache
def probe_kernel(width: int = 1, precision: int = 32) -> Any:
    """Return the kernel that writes points fixed to links: x = x_joint + Q p, v = v_joint + w x Q p."""
    t = layout_of(width, precision)
    Model, State, Scratch, Vec, W = t.Model, t.State, t.Scratch, t.Vec, width
    _, Out3, _ = _outputs(precision)

    @wp.kernel(enable_backward=False, module="unique")
    def probes(
        m: Model, x_in: State, place: wp.array2d(dtype=int), point: wp.array2d(dtype=Vec),
        slot_world: wp.array(dtype=int), s_out: Scratch, first: int, row: int,
        position_out: wp.array2d(dtype=Out3), velocity_out: wp.array2d(dtype=Out3),
    ):  # fmt: skip
        """Write positions [m] and velocities [m/s] of the points of a group's worlds, world axes."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        locate_links(e, r, m, x_in, s_out)
        for j in range(place.shape[1]):
            i = place[e, j]
            arm = rotate(s_out.pose[r, i], point[e, j])
            p = s_out.accel[r, i] + arm
            v = add_cross(s_out.alpha[r, i], s_out.spin[r, i], arm)
            for k in range(W):
                world = slot_world[e * W + k]
                if world >= 0:
                    position_out[world, j] = Out3(lane(p.x, k), lane(p.y, k), lane(p.z, k))
                    velocity_out[world, j] = Out3(lane(v.x, k), lane(v.y, k), lane(v.z, k))

    return probes


@wp.func
def spring_energy(e: int, i: int, m: Any, x: Any):
    """K |phi|^2 / 2 - P.phi of a joint, phi its rotation vector or coordinate from rest, P its pre-load."""
    q = x.coordinate[e, i]
    P = m.preload[e, i]
    o = real(0.0, q.x)
    phi = type(P)(q.x, o, o)
    if m.kind[e, i] == SPHERICAL:
        phi = type(P)(q.x, q.y, q.z) * half_angle_log(q)
    return m.stiffness[e, i] * dot(phi, phi) * real(0.5, o) - dot(P, phi)


@wp.func(inline=True)
def sums(e: int, row: int, m: Any, x: Any, s: Any):
    """Kinetic energy, energy of the weight and of the springs, linear and angular momentum of located links.

    T = m v.v/2 + m v.(w x c) + w.I w/2 about each joint point, V = -m g.x, springs K |phi|^2/2 - P.phi.
    """
    lift = s.accel0[row, 0]
    o = real(0.0, lift.x)
    kinetic = o
    weight = o
    spring = o
    linear = type(lift)(o, o, o)
    angular = type(lift)(o, o, o)
    for i in range(1, m.count[e] + 1):
        mass = m.mass[e, i]
        mc = rotate(s.pose[row, i], m.com[e, i]) * mass
        v = s.alpha[row, i]
        w = s.spin[row, i]
        at = s.accel[row, i]
        p = add_cross(v * mass, w, mc)
        h = add_cross(own_inertia(e, row, i, m, s) * w, mc, v)
        kinetic = kinetic + (dot(p, v) + dot(h, w)) * real(0.5, o)
        weight = weight + dot(lift, at * mass + mc)
        spring = spring + spring_energy(e, i, m, x)
        linear = linear + p
        angular = angular + add_cross(h, at, p)
    return kinetic, weight, spring, linear, angular


@cache
def energy_kernel(width: int = 1, precision: int = 32) -> Any:
    """Return the kernel that sums energies (`sums`) and momenta of every world.

    Linear momentum, and angular momentum about the origin.
    """
    t = layout_of(width, precision)
    Model, State, Scratch, W = t.Model, t.State, t.Scratch, width
    Out, Out3, _ = _outputs(precision)

    @wp.kernel(enable_backward=False, module="unique")
    def energy(
        m: Model, x_in: State, slot_world: wp.array(dtype=int), s_out: Scratch, first: int, row: int,
        energy_out: wp.array2d(dtype=Out), momentum_out: wp.array2d(dtype=Out3),
    ):  # fmt: skip
        """Write kinetic, weight's and springs' energy [J], linear [N s] and angular [N m s] momentum of a group."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        locate_links(e, r, m, x_in, s_out)
        kinetic, weight, spring, linear, angular = sums(e, r, m, x_in, s_out)
        for k in range(W):
            world = slot_world[e * W + k]
            if world >= 0:
                energy_out[world, 0] = lane(kinetic, k)
                energy_out[world, 1] = lane(weight, k)
                energy_out[world, 2] = lane(spring, k)
                momentum_out[world, 0] = Out3(lane(linear.x, k), lane(linear.y, k), lane(linear.z, k))
                momentum_out[world, 1] = Out3(lane(angular.x, k), lane(angular.y, k), lane(angular.z, k))

    return energy
