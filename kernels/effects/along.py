"""A law asked along prescribed motions, outside of any simulation: what `bough check-law` looks at."""

from __future__ import annotations

from functools import cache
from typing import Any

import warp as wp

from ..lanes.real import SOURCE, lane, real
from ..tree.layout import layout_of
from .structs import law_types

__all__ = ["joint_law_kernel", "link_law_kernel"]

#: Where a law at a link is asked, from the joint along the link's own z [m].
ARM = wp.constant(wp.float64(0.25))


@cache
def joint_law_kernel(law: Any, memory: int) -> Any:
    """Return the kernel that asks a law at a joint at every sample of a motion, in 64 bit, one thread a motion.

    Angles and rates [M, T] are those of the joint's frame. The memory starts empty and follows the samples, ``step``
    [s] apart. Torque, stiffness and damping [M, T] are what the law answers.
    """
    t, own = layout_of(1, 64), law_types(1, 64)
    Real, Vec, Parameters, JointState = t.Real, t.Vec, own.Parameters, own.JointState
    Response, LongResponse = own.Response, own.LongResponse

    @wp.kernel(enable_backward=False, module="unique")
    def along(
        angle_in: wp.array2d(dtype=wp.vec3d), rate_in: wp.array2d(dtype=wp.vec3d), value_in: wp.array(dtype=wp.float64),
        spring: wp.float64, step: wp.float64, torque_out: wp.array2d(dtype=wp.vec3d),
        stiffness_out: wp.array2d(dtype=wp.float64), damping_out: wp.array2d(dtype=wp.float64),
    ):  # fmt: skip
        """Ask the law along motion m, its memory carried from sample to sample, and write what it answers."""
        tag = SOURCE  # noqa: F841
        m = wp.tid()
        o = Real(wp.float64(0.0))
        zero = Vec(o, o, o)
        first = zero
        second = zero
        p = Parameters(
            real(value_in[0], o), real(value_in[1], o), real(value_in[2], o), real(value_in[3], o),
            real(value_in[4], o), real(value_in[5], o), real(value_in[6], o), real(value_in[7], o),
            real(value_in[8], o), real(value_in[9], o),
        )  # fmt: skip
        for k in range(angle_in.shape[1]):
            q = angle_in[m, k]
            w = rate_in[m, k]
            v = Vec(real(w[0], o), real(w[1], o), real(w[2], o))
            j = JointState(
                Vec(real(q[0], o), real(q[1], o), real(q[2], o)), v, zero, zero, real(spring, o),
                real(wp.float64(k) * step, o), real(step, o), v,
            )  # fmt: skip
            if wp.static(memory == 2):
                long = law(j, p, LongResponse(zero, first, second, o, o))
                first = long.memory
                second = long.second
                r = Response(long.torque, long.memory, long.stiffness, long.damping)
            else:
                r = law(j, p, Response(zero, first, o, o))
                first = r.memory
            torque_out[m, k] = wp.vec3d(lane(r.torque.x, 0), lane(r.torque.y, 0), lane(r.torque.z, 0))
            stiffness_out[m, k] = lane(r.stiffness, 0)
            damping_out[m, k] = lane(r.damping, 0)

    return along


@cache
def link_law_kernel(law: Any) -> Any:
    """Return the kernel that asks a law at a link that is not turned, at every velocity [M, T] of its point."""
    t, own = layout_of(1, 64), law_types(1, 64)
    Real, Vec, Quat, Parameters, LinkState = t.Real, t.Vec, t.Quat, own.Parameters, own.LinkState

    @wp.kernel(enable_backward=False, module="unique")
    def along(
        velocity_in: wp.array2d(dtype=wp.vec3d), value_in: wp.array(dtype=wp.float64), area: wp.float64,
        step: wp.float64, force_out: wp.array2d(dtype=wp.vec3d),
    ):  # fmt: skip
        """Ask the law along motion m of a point `ARM` [m] above an upright link's joint, and write its force [N]."""
        tag = SOURCE  # noqa: F841
        m = wp.tid()
        o = Real(wp.float64(0.0))
        p = Parameters(
            real(value_in[0], o), real(value_in[1], o), real(value_in[2], o), real(value_in[3], o),
            real(value_in[4], o), real(value_in[5], o), real(value_in[6], o), real(value_in[7], o),
            real(value_in[8], o), real(value_in[9], o),
        )  # fmt: skip
        upright = Quat(real(wp.float64(1.0), o), o, o, o)
        for k in range(velocity_in.shape[1]):
            v = velocity_in[m, k]
            b = LinkState(
                Vec(real(v[0], o), real(v[1], o), real(v[2], o)), Vec(o, o, real(ARM, o)), upright, real(area, o),
                real(area, o), real(wp.float64(k) * step, o), Vec(o, o, o),
            )  # fmt: skip
            f = law(b, p)
            force_out[m, k] = wp.vec3d(lane(f.x, 0), lane(f.y, 0), lane(f.z, 0))

    return along
