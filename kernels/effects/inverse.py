"""Efforts that effects at joints take or give along recorded motions, beside those of inverse dynamics (`inverse`)."""

from functools import cache
from typing import Any

import warp as wp

from ..lanes.algebra import add, mul, sub
from ..lanes.real import SOURCE, real
from .terms import Term, memory_row, step_of

__all__ = ["effect_efforts_kernel"]


@cache
def effect_efforts_kernel(width: int, precision: int, terms: tuple[Term, ...]) -> Any:
    """Return the kernel that takes off the efforts written by `inverse_kernels`' ``replay`` what joints' laws give.

    An actuator supplies what no law does: effort - (torque of the laws - their damping x rate). Memories start empty in
    every recording and follow its samples, ``step`` [s] apart. Joints are revolute or prismatic.
    """
    parts = step_of(width, precision, terms)
    t, law = parts.types, parts.joint
    Model, Scratch, Real, Vec = t.Model, t.Scratch, t.Real, t.Vec
    Effects, JointState, Response = t.Effects, t.JointState, t.Response
    num_rows = memory_row(terms, len(terms))

    @wp.kernel(enable_backward=False, module="unique")
    def efforts(
        m: Model, fx: Effects, moved: wp.array(dtype=int), watched: wp.array(dtype=int),
        trajectory: wp.array(dtype=int), length: wp.array(dtype=int), begins: wp.array(dtype=wp.float64),
        motion_in: wp.array2d(dtype=wp.vec3d), s_out: Scratch, first: int, row: int, step: wp.float64,
        effort_in_out: wp.array2d(dtype=Real),
    ):  # fmt: skip
        """Take torque - damping x rate of the joints' laws off the efforts of a recording, sample by sample."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        j = trajectory[e]
        o = real(0.0, m.mass[e, 1])
        zero = Vec(o, o, o)
        for k in range(num_rows * fx.stride):
            fx.memory[e, k] = zero
        count = watched.shape[0]
        for k in range(length[j]):
            for w in range(moved.shape[0]):
                now = motion_in[j, k * moved.shape[0] + w]
                i = moved[w]
                time = begins[j] + wp.float64(k) * step
                rate = real(now[1], o)
                effort = o
                for c in range(count):
                    if watched[c] == i:
                        effort = effort_in_out[e, k * count + c]
                v = Vec(rate, o, o)
                state = JointState(
                    Vec(real(now[0], o), o, o), v, m.preload[e, i], Vec(effort, o, o), m.stiffness[e, i],
                    real(time, o), real(step, o), v,
                )  # fmt: skip
                r = law(e, i, fx, state, Response(zero, zero, o, o))
                for c in range(count):
                    if watched[c] == i:
                        given = r.torque.x - r.damping * rate
                        effort_in_out[e, k * count + c] = effort_in_out[e, k * count + c] - given

    return efforts
