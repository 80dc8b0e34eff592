"""Kernels that replay recorded trajectories: many parameter sets against the same inputs, in one launch."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from .algebra import add, add_cross, rotate
from .articulated import advance_loaded
from .layout import layout_of
from .observe import locate_links
from .real import SOURCE, mul, real, sub

__all__ = ["rollout_kernels"]


@wp.func
def vec_of(v: wp.vec3d, like: Any):
    """A vector of constants, of the type of ``like``."""
    return type(like)(real(v[0], like.x), real(v[1], like.x), real(v[2], like.x))


@cache
def rollout_kernels(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return ``point`` (a point of a link pushed and watched) and ``joint`` (joints driven and watched).

    Every group replays one trajectory: ``trajectory`` [groups] names it, ``input_in`` [trajectories, samples] holds
    what acts at its samples, ``length`` [trajectories] its number of samples. Between samples the input is linear, and
    each of ``substeps`` steps takes its value in the middle; with ``hold`` zero it stays at the sample's value. Worlds
    start from the state they are given.
    """
    t = layout_of(width, precision)
    Model, State, Load, Scratch, Real = t.Model, t.State, t.Load, t.Scratch, t.Real

    @wp.func
    def between(a: wp.vec3d, b: wp.vec3d, step: int, substeps: int, hold: int) -> wp.vec3d:
        share = wp.float64(hold) * (wp.float64(step) + wp.float64(0.5)) / wp.float64(substeps)
        return a + (b - a) * share

    @wp.kernel(enable_backward=False, module="unique")
    def point(
        m: Model,
        x_in_out: State,
        u_out: Load,
        place: int,
        trajectory: wp.array(dtype=int),
        length: wp.array(dtype=int),
        input_in: wp.array2d(dtype=wp.vec3d),
        s_out: Scratch,
        first: int,
        row: int,
        substeps: int,
        h: wp.float64,
        bound: wp.float64,
        output_out: wp.array2d(dtype=Real),
    ):
        """Push link ``place`` at its load point as recorded; write the point's position and velocity, 6 a sample."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        j = trajectory[e]
        n = length[j]
        for k in range(n):
            locate_links(e, r, m, x_in_out, s_out)
            arm = rotate(s_out.pose[r, place], u_out.point[e, place])
            p = s_out.accel[r, place] + arm
            v = add_cross(s_out.alpha[r, place], s_out.spin[r, place], arm)
            output_out[e, 6 * k + 0] = p.x
            output_out[e, 6 * k + 1] = p.y
            output_out[e, 6 * k + 2] = p.z
            output_out[e, 6 * k + 3] = v.x
            output_out[e, 6 * k + 4] = v.y
            output_out[e, 6 * k + 5] = v.z
            if k < n - 1:
                for step in range(substeps):
                    force = between(input_in[j, k], input_in[j, k + 1], step, substeps, 1)
                    u_out.force[e, place] = vec_of(force, p)
                    advance_loaded(e, r, m, x_in_out, u_out, s_out, h, bound)

    @wp.kernel(enable_backward=False, module="unique")
    def joint(
        m: Model,
        x_in_out: State,
        u_out: Load,
        place: int,
        hold: int,
        watched: wp.array(dtype=int),
        trajectory: wp.array(dtype=int),
        length: wp.array(dtype=int),
        input_in: wp.array2d(dtype=wp.vec3d),
        s_out: Scratch,
        first: int,
        row: int,
        substeps: int,
        h: wp.float64,
        bound: wp.float64,
        output_out: wp.array2d(dtype=Real),
    ):
        """Drive joint ``place`` with the recorded effort; write coordinate, rate, acceleration of watched joints."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        j = trajectory[e]
        n = length[j]
        c = watched.shape[0]
        for k in range(n):
            after = wp.min(k + 1, n - 1)
            for w in range(c):
                output_out[e, 3 * (k * c + w) + 0] = x_in_out.coordinate[e, watched[w]].x
                output_out[e, 3 * (k * c + w) + 1] = x_in_out.velocity[e, watched[w]].x
            for step in range(substeps):
                effort = between(input_in[j, k], input_in[j, after], step, substeps, hold)
                u_out.effort[e, place] = vec_of(effort, u_out.effort[e, place])
                advance_loaded(e, r, m, x_in_out, u_out, s_out, h, bound)
                if step == 0:
                    for w in range(c):
                        before = output_out[e, 3 * (k * c + w) + 1]
                        gained = x_in_out.velocity[e, watched[w]].x - before
                        output_out[e, 3 * (k * c + w) + 2] = gained * real(wp.float64(1.0) / h, before)

    return SimpleNamespace(point=point, joint=joint)
