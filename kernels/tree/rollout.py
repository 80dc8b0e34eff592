"""Kernels that replay recorded trajectories: many parameter sets against the same inputs, in one launch.

Inputs are known at samples. A step takes the value in its middle: between samples a and b, step s of n,

    a + (b - a) (s + 1/2) / n      or a, where inputs are held
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.algebra import add, add_cross, rotate
from ..lanes.inlined import inlined
from ..lanes.real import SOURCE, mul, real, sub
from .articulated import SPHERICAL, advance_links, advance_loaded, fold_links_loaded, place_links, place_root
from .midway import damper_midway, look_again, look_forward, midway_types, set_out_from, to_sample, to_step
from .observe import locate_links

__all__ = [
    "Moment",
    "between",
    "look_ahead",
    "rollout_kernels",
    "share_of",
    "write_gains",
    "write_joints",
    "write_point",
]


@wp.struct
class Moment:
    """The middle of a step between a recording's ``sample`` and the one ``after`` it; ``hold`` is 0 for held inputs."""

    recording: int
    sample: int
    after: int
    step: int
    substeps: int
    hold: int


@wp.func
def share_of(now: Moment):
    """Share of the way to the next sample."""
    return (wp.float64(now.step) + wp.float64(0.5)) / wp.float64(now.substeps)


@wp.func
def between(input_in: wp.array3d(dtype=wp.float64), now: Moment, c: int):
    """Recorded value of column c in the middle of a step."""
    a = input_in[now.recording, now.sample, c]
    return a + (input_in[now.recording, now.after, c] - a) * (wp.float64(now.hold) * share_of(now))


# ---- a point of a link, pushed and watched ---------------------------------------------------------------------------


@wp.func(inline=True)
def write_point(e: int, k: int, p: Any, v: Any, output_out: Any):
    """Write a point's displacement and velocity as sample k."""
    output_out[e, 6 * k + 0] = p.x
    output_out[e, 6 * k + 1] = p.y
    output_out[e, 6 * k + 2] = p.z
    output_out[e, 6 * k + 3] = v.x
    output_out[e, 6 * k + 4] = v.y
    output_out[e, 6 * k + 5] = v.z


@wp.func(inline=True)
def force_in(input_in: wp.array3d(dtype=wp.float64), now: Moment, like: Any):
    """Recorded force in the middle of a step, of the type of ``like``."""
    return type(like)(
        real(between(input_in, now, 0), like.x),
        real(between(input_in, now, 1), like.x),
        real(between(input_in, now, 2), like.x),
    )


@wp.func(inline=True)
def advance_midway(e: int, row: int, m: Any, x: Any, u: Any, s: Any, mid: Any, h: wp.float64, bound: wp.float64):
    """Take a step as `articulated.advance_loaded` does, of second order (`midway`); efforts at joints are its own."""
    place_root(e, row, m, s)
    look_forward(e, m, x, mid)
    place_links(e, row, m, x, s)
    look_again(e, m, x, mid)
    for i in range(1, m.count[e] + 1):
        damping = m.damping[e, i]
        u.effort[e, i] = damper_midway(e, i, m, mid, damping, damping, m.stiffness[e, i], h)
    fold_links_loaded(e, row, m, x, u, s, h)
    advance_links(e, row, m, x, s, h, bound)
    x.tick[e] = x.tick[e] + 1


@wp.func(inline=True)
def replay_point(
    e: int, row: int, j: int, place: int, samples: int, m: Any, x: Any, u: Any, mid: Any,
    input_in: wp.array3d(dtype=wp.float64), s: Any, substeps: int, h: wp.float64, bound: wp.float64, output_out: Any,
):  # fmt: skip
    """Push a link at its load point p as recording j says; write x + R p since the first sample, and v + w x R p."""
    locate_links(e, row, m, x, s)
    start = s.accel[row, place] + rotate(s.pose[row, place], u.point[e, place])
    set_out_from(e, m, x, mid)
    for k in range(samples):
        to_sample(e, m, x, mid, h, k > 0)
        locate_links(e, row, m, x, s)
        arm = rotate(s.pose[row, place], u.point[e, place])
        p = s.accel[row, place] + arm - start
        write_point(e, k, p, add_cross(s.alpha[row, place], s.spin[row, place], arm), output_out)
        to_step(e, m, x, mid)
        if k < samples - 1:
            for step in range(substeps):
                u.force[e, place] = force_in(input_in, Moment(j, k, k + 1, step, substeps, 1), p)
                advance_midway(e, row, m, x, u, s, mid, h, bound)


# ---- joints, driven and watched --------------------------------------------------------------------------------------


@wp.func(inline=True)
def write_joints(e: int, k: int, watched: wp.array(dtype=int), x: Any, output_out: Any):
    """Write coordinate and rate of the watched joints as sample k."""
    c = watched.shape[0]
    for w in range(c):
        output_out[e, 3 * (k * c + w) + 0] = x.coordinate[e, watched[w]].x
        output_out[e, 3 * (k * c + w) + 1] = x.velocity[e, watched[w]].x


@wp.func(inline=True)
def write_gains(e: int, k: int, watched: wp.array(dtype=int), x: Any, h: wp.float64, output_out: Any):
    """Write the acceleration (v' - v) / h of the watched joints in the first step after sample k."""
    c = watched.shape[0]
    for w in range(c):
        before = output_out[e, 3 * (k * c + w) + 1]
        gained = x.velocity[e, watched[w]].x - before
        output_out[e, 3 * (k * c + w) + 2] = gained * real(wp.float64(1.0) / h, before)


@wp.func(inline=True)
def look_ahead(e: int, m: Any, x: Any):
    """Write by how much each rate will have changed in the middle of the next step: half of its change in the last one.

    A step has coordinates and efforts in its middle. With velocity products there too it is of second order. Of joints
    of one axis ``velocity`` holds the rate, this change, and the rate before the last step.
    """
    for i in range(1, m.count[e] + 1):
        if m.kind[e, i] != SPHERICAL:
            v = x.velocity[e, i]
            x.velocity[e, i] = type(v)(v.x, (v.x - v.z) * real(0.5, v.x), v.x)


@wp.func(inline=True)
def replay_joints(
    e: int, row: int, j: int, samples: int, m: Any, x: Any, u: Any, driven: wp.array(dtype=int), hold: int,
    watched: wp.array(dtype=int), input_in: wp.array3d(dtype=wp.float64), s: Any, substeps: int, h: wp.float64,
    bound: wp.float64, output_out: Any,
):  # fmt: skip
    """Drive joints with the efforts of recording j; write coordinate, rate and acceleration of the watched ones."""
    for k in range(samples):
        write_joints(e, k, watched, x, output_out)
        for step in range(substeps):
            now = Moment(j, k, wp.min(k + 1, samples - 1), step, substeps, hold)
            for d in range(driven.shape[0]):
                effort = u.effort[e, driven[d]]
                effort.x = real(between(input_in, now, d), effort.x)
                u.effort[e, driven[d]] = effort
            look_ahead(e, m, x)
            advance_loaded(e, row, m, x, u, s, h, bound)
            if step == 0:
                write_gains(e, k, watched, x, h, output_out)


@cache
def rollout_kernels(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return ``point`` (a point of a link pushed and watched) and ``joint`` (joints driven and watched).

    Every group replays one trajectory: ``trajectory`` [groups] names it, ``input_in`` [trajectories, samples, inputs]
    holds what acts at its samples, ``length`` [trajectories] its number of samples, ``grasped`` [trajectories] the link
    that is pushed. Each sample is followed by ``substeps`` steps. Worlds start from the state they are given.
    """
    t = midway_types(width, precision)
    Model, State, Load, Midway, Scratch, Real = t.Model, t.State, t.Load, t.Midway, t.Scratch, t.Real

    @wp.kernel(enable_backward=False, module="unique", module_options=inlined())
    def point(
        m: Model, x_in_out: State, u_out: Load, mid_out: Midway, grasped: wp.array(dtype=int),
        trajectory: wp.array(dtype=int), length: wp.array(dtype=int), input_in: wp.array3d(dtype=wp.float64),
        s_out: Scratch, first: int, row: int, substeps: int, h: wp.float64, bound: wp.float64,
        output_out: wp.array2d(dtype=Real),
    ):  # fmt: skip
        """Push a link as the trajectory of a group says, and write how its load point moves."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        j = trajectory[e]
        replay_point(e, r, j, grasped[j], length[j], m, x_in_out, u_out, mid_out, input_in, s_out, substeps, h, bound,
                     output_out)  # fmt: skip

    @wp.kernel(enable_backward=False, module="unique", module_options=inlined())
    def joint(
        m: Model, x_in_out: State, u_out: Load, driven: wp.array(dtype=int), hold: int, watched: wp.array(dtype=int),
        trajectory: wp.array(dtype=int), length: wp.array(dtype=int), input_in: wp.array3d(dtype=wp.float64),
        s_out: Scratch, first: int, row: int, substeps: int, h: wp.float64, bound: wp.float64,
        output_out: wp.array2d(dtype=Real),
    ):  # fmt: skip
        """Drive joints as the trajectory of a group says, and write how the watched ones move."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        j = trajectory[e]
        replay_joints(e, r, j, length[j], m, x_in_out, u_out, driven, hold, watched, input_in, s_out, substeps, h,
                      bound, output_out)  # fmt: skip

    return SimpleNamespace(point=point, joint=joint)
