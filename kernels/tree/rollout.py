"""Kernels that replay recorded trajectories: many parameter sets against the same inputs, in one launch."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.algebra import add, add_cross, rotate
from ..lanes.real import SOURCE, mul, real, sub
from .articulated import advance_loaded
from .layout import layout_of
from .observe import locate_links

__all__ = ["rollout_kernels"]


@cache
def rollout_kernels(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return ``point`` (a point of a link pushed and watched) and ``joint`` (joints driven and watched).

    Every group replays one trajectory: ``trajectory`` [groups] names it, ``input_in`` [trajectories, samples, inputs]
    holds what acts at its samples, ``length`` [trajectories] its number of samples. Between samples the input is
    linear, and each of ``substeps`` steps takes its value in the middle; with ``hold`` zero it stays at the sample's
    value. Worlds start from the state they are given.
    """
    t = layout_of(width, precision)
    Model, State, Load, Scratch, Real, Vec = t.Model, t.State, t.Load, t.Scratch, t.Real, t.Vec

    @wp.func
    def between(
        input_in: wp.array3d(dtype=wp.float64), j: int, k: int, after: int, c: int, step: int, substeps: int, hold: int
    ) -> wp.float64:
        a = input_in[j, k, c]
        share = wp.float64(hold) * (wp.float64(step) + wp.float64(0.5)) / wp.float64(substeps)
        return a + (input_in[j, after, c] - a) * share

    @wp.kernel(enable_backward=False, module="unique")
    def point(
        m: Model,
        x_in_out: State,
        u_out: Load,
        grasped: wp.array(dtype=int),
        trajectory: wp.array(dtype=int),
        length: wp.array(dtype=int),
        input_in: wp.array3d(dtype=wp.float64),
        s_out: Scratch,
        first: int,
        row: int,
        substeps: int,
        h: wp.float64,
        bound: wp.float64,
        output_out: wp.array2d(dtype=Real),
    ):
        """Push link ``grasped`` [trajectories] at its load point as recorded.

        Writes six numbers a sample: displacement of the point since the first sample, and its velocity.
        """
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        j = trajectory[e]
        n = length[j]
        place = grasped[j]
        locate_links(e, r, m, x_in_out, s_out)
        start = s_out.accel[r, place] + rotate(s_out.pose[r, place], u_out.point[e, place])
        for k in range(n):
            locate_links(e, r, m, x_in_out, s_out)
            arm = rotate(s_out.pose[r, place], u_out.point[e, place])
            p = s_out.accel[r, place] + arm - start
            v = add_cross(s_out.alpha[r, place], s_out.spin[r, place], arm)
            output_out[e, 6 * k + 0] = p.x
            output_out[e, 6 * k + 1] = p.y
            output_out[e, 6 * k + 2] = p.z
            output_out[e, 6 * k + 3] = v.x
            output_out[e, 6 * k + 4] = v.y
            output_out[e, 6 * k + 5] = v.z
            if k < n - 1:
                for step in range(substeps):
                    u_out.force[e, place] = Vec(
                        real(between(input_in, j, k, k + 1, 0, step, substeps, 1), p.x),
                        real(between(input_in, j, k, k + 1, 1, step, substeps, 1), p.x),
                        real(between(input_in, j, k, k + 1, 2, step, substeps, 1), p.x),
                    )
                    advance_loaded(e, r, m, x_in_out, u_out, s_out, h, bound)

    @wp.kernel(enable_backward=False, module="unique")
    def joint(
        m: Model,
        x_in_out: State,
        u_out: Load,
        driven: wp.array(dtype=int),
        hold: int,
        watched: wp.array(dtype=int),
        trajectory: wp.array(dtype=int),
        length: wp.array(dtype=int),
        input_in: wp.array3d(dtype=wp.float64),
        s_out: Scratch,
        first: int,
        row: int,
        substeps: int,
        h: wp.float64,
        bound: wp.float64,
        output_out: wp.array2d(dtype=Real),
    ):
        """Drive joints with their recorded efforts; write coordinate, rate and acceleration of the watched ones."""
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
                for d in range(driven.shape[0]):
                    effort = u_out.effort[e, driven[d]]
                    effort.x = real(between(input_in, j, k, after, d, step, substeps, hold), effort.x)
                    u_out.effort[e, driven[d]] = effort
                advance_loaded(e, r, m, x_in_out, u_out, s_out, h, bound)
                if step == 0:
                    for w in range(c):
                        before = output_out[e, 3 * (k * c + w) + 1]
                        gained = x_in_out.velocity[e, watched[w]].x - before
                        output_out[e, 3 * (k * c + w) + 2] = gained * real(wp.float64(1.0) / h, before)

    return SimpleNamespace(point=point, joint=joint)
