"""Kernels that replay recorded trajectories with effects (`terms`): `rollout` with laws in the step.

A group replays the recordings ``first[group]`` to ``last[group]``, one after the other, each from rest: damage that one
leaves is there in the next. Without a term that persists it replays one.

A point of a link is pushed by the force F that the sensor's laws make of what it recorded, where the gripper holds,

    x = x_link + R (p + c z u) - x_start,   v = v_link + w x R (p + c z u) + c z' R u

p the grasp point, u the segment's direction, z how far the grip has slid, c the share of that which the tracker sees. A
law's time is the recording's own. Where a recording has a course of gusts, their pressure over its rms at every sample
from ``lead`` before the first, laws at links see that, linear between samples.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.algebra import add, add_cross, add_scaled, cross, div, dot, growth, mul, norm, rotate, sub, unrotate
from ..lanes.inlined import inlined
from ..lanes.real import SOURCE, fma, fnma, real, sqrt_, where_neg
from ..tree.midway import set_out_from, to_sample, to_step
from ..tree.observe import locate_links
from ..tree.rollout import Moment, look_ahead, write_gains, write_joints, write_point
from .held import holder_of
from .kept import BETWEEN, EVERYTHING, fader_of, forget, kept_rows
from .sensor import NEVER, acting, drawn, opening
from .structs import PARAMETERS
from .terms import (
    CALM,
    GROUPS,
    MOVING,
    STILL,
    Term,
    is_on,
    mass_at,
    memory_row,
    slot_of,
    step_of,
)

__all__ = ["SETTLING", "effect_rollout_kernels"]

#: Columns of ``grip``: grasp point and direction of the segment in the link's frame, how far the grip may slide down
#: (negative) and up, the point in the world in the given pose [m], the recording's largest force [N], how far off
#: its calm place the point stands before [m], what the sensor reads of an open gripper [N], and the level unit vector
#: that the gripper faces.
GRASP = wp.constant(0)
ALONG = wp.constant(3)
DOWN = wp.constant(6)
UP = wp.constant(7)
GIVEN = wp.constant(8)
PEAK = wp.constant(11)
OFF = wp.constant(12)
OPENED = wp.constant(15)
HEADING = wp.constant(18)

#: Which parameters of a slip are the share that the tracker sees, from when on it slides, and the share of what it slid
#: in earlier recordings that displacement is not counted from.
SEEN = wp.constant(5)
BEGINS = wp.constant(8)
ZEROED = wp.constant(9)

#: Least time constant of a tracker, in samples, so that powers of a sample over it stay finite.
LEAST_LAG = wp.constant(wp.float64(1.0e-3))

#: Steps that seek rest under a load, each Newton's with 5/4 of the joints' stiffness, and their length [s].
SETTLING = 24
SETTLING_STEP = wp.constant(wp.float64(1.0))
#: Of these steps those that find rest before what laws remember goes on; the share of the time between two recordings
#: by which it does in the next one; how much longer each after it is; and the least such time [s]: laws divide by it.
FIRST = 8
LONGER = wp.constant(wp.float64(1.25))
LAPSE = wp.constant(wp.float64(0.25 / (1.25 ** (SETTLING - FIRST) - 1.0)))
LEAST_LAPSE = wp.constant(wp.float64(1.0e-6))


@wp.struct
class Slots:
    """Slots of what the replay itself carries out, -1 for what a kernel is built without, and places in ``active``.

    ``slip_row`` and ``delay_row`` are the first rows of the grip's and the tracker's memory. All are constants of a
    kernel.
    """

    tip: int
    slip: int
    slip_row: int
    delay: int
    delay_row: int
    lasting: int
    holding: int
    resting: int
    preceding: int


# ---- the grip --------------------------------------------------------------------------------------------------------


@wp.func
def grip_of(grip: wp.array2d(dtype=wp.float64), j: int, c: int, like: Any):
    """Three columns of recording j's grip, of the type of ``like``."""
    return type(like)(real(grip[j, c], like.x), real(grip[j, c + 1], like.x), real(grip[j, c + 2], like.x))


@wp.func
def between_ends(x: Any, bottom: Any, top: Any):
    """x inside an interval."""
    y = where_neg(x - bottom, bottom, x)
    return where_neg(top - y, top, y)


@wp.func
def slid(
    e: int, at: Slots, fx: Any, force: Any, axis: Any, grip: wp.array2d(dtype=wp.float64), j: int, time: wp.float64,
    h: Any,
):  # fmt: skip
    """Advance how far the grip has slid [m]: rate = a (n x + (1 - n) 1 N) sgn p towards the tip, inside the segment.

    The pull is p = (1 - s) |F| + s F_axis: the whole force's size, always towards one end, or its part along the
    segment. It slides while the excess x = |p| - b - c F_peak is positive, F_peak the recording's largest force, from
    a moment on the clock on, and no farther than the grip lets it, z in [-m, m].
    """
    first = at.slip * PARAMETERS * fx.stride
    a = fx.parameter[e, first]
    share = fx.parameter[e, first + 3 * fx.stride]
    z = fx.memory[e, at.slip_row * fx.stride]
    o = real(0.0, a)
    one = real(1.0, o)
    bear = fma(fx.parameter[e, first + 2 * fx.stride], real(grip[j, PEAK], o), fx.parameter[e, first + fx.stride])
    size = norm(force)
    pull = fma(fx.parameter[e, first + 4 * fx.stride], dot(force, axis) - size, size)
    excess = where_neg(pull, o - pull, pull) - bear
    early = real(time, o) - fx.parameter[e, first + BEGINS * fx.stride]
    excess = where_neg(early, o - one, excess)
    rate = where_neg(excess, o, a * fma(share, excess, one - share))
    rate = where_neg(pull, o - rate, rate)
    new = fma(rate, h, z.x)
    most = fx.parameter[e, first + 6 * fx.stride]
    new = between_ends(new, real(grip[j, DOWN], o), real(grip[j, UP], o))
    new = between_ends(new, o - most, most)
    fx.memory[e, at.slip_row * fx.stride] = type(z)(new, (new - z.x) / h, z.z)
    return new


@wp.func
def counted_from(e: int, at: Slots, fx: Any, start: Any, calm: Any, along: Any):
    """Where displacement counts from: the marked point at rest, or as far as it is zeroed where the grip slid to."""
    if is_on(e, at.slip, fx):
        z = fx.memory[e, at.slip_row * fx.stride]
        first = at.slip * PARAMETERS
        share = fx.parameter[e, (first + SEEN) * fx.stride] * fx.parameter[e, (first + ZEROED) * fx.stride]
        start = add_scaled(start, rotate(calm, along), share * z.x)
    return start


@wp.func
def followed(e: int, row: int, is_first: bool, fx: Any, x: Any, slow: Any, dt: Any):
    """Return what a tracker of first order reads of x: T y' = x - y, y = x at first, x linear between samples.

    Where T is not above zero that is x, else
    y = x - (1 - a) T x' + a (y - x at the last sample), a = exp(-u), u = dt / T, to 0.012 (`growth`).
    A ramp is late by T whatever a is.
    """
    k = row * fx.stride
    o = real(0.0, slow)
    one = real(1.0, o)
    least = real(LEAST_LAG, o) * dt
    t = where_neg(slow - least, least, slow)
    u = dt / t
    a = one / fma(u, growth(u), one)
    gone = x - fx.memory[e, k]
    late = fx.memory[e, k + 1] - fx.memory[e, k]
    y = x - gone * ((one - a) * t / dt) + late * a
    y = type(x)(where_neg(o - slow, y.x, x.x), where_neg(o - slow, y.y, x.y), where_neg(o - slow, y.z, x.z))
    if is_first:
        y = x
    fx.memory[e, k] = x
    fx.memory[e, k + 1] = y
    return y


@wp.func
def look(e: int, row: int, place: int, k: int, is_first: bool, at: Slots, s: Any, fx: Any, nominal: Any, along: Any,
         start: Any, dt: Any, output_out: Any):  # fmt: skip
    """Write the displacement and velocity of the grasp point, as the tracker reads them, as sample k."""
    o = real(0.0, nominal.x)
    arm = rotate(s.pose[row, place], nominal)
    slip = type(nominal)(o, o, o)
    if is_on(e, at.slip, fx):
        z = fx.memory[e, at.slip_row * fx.stride]
        axis = rotate(s.pose[row, place], along) * fx.parameter[e, (at.slip * PARAMETERS + SEEN) * fx.stride]
        arm = add_scaled(arm, axis, z.x)
        slip = axis * z.y
    p = s.accel[row, place] + arm - start
    v = add_cross(s.alpha[row, place], s.spin[row, place], arm) + slip
    if is_on(e, at.delay, fx):
        slow = fx.parameter[e, (at.delay * PARAMETERS + 1) * fx.stride]
        p = followed(e, at.delay_row, is_first, fx, p, slow, dt)
        v = followed(e, at.delay_row + 1, is_first, fx, v, slow, dt)
    write_point(e, k, p, v, output_out)


# ---- where a recording begins ----------------------------------------------------------------------------------------


@wp.func
def rest(e: int, m: Any, x: Any):
    """Put every joint at its spring's rest, at rest."""
    for i in range(1, m.count[e] + 1):
        q = x.coordinate[e, i]
        v = x.velocity[e, i]
        o = real(0.0, q.x)
        x.coordinate[e, i] = type(q)(real(1.0, o), o, o, o)
        x.velocity[e, i] = type(v)(o, o, o)


@wp.func
def hold_tip(e: int, row: int, slot: int, m: Any, fx: Any, s: Any):
    """Torques that hold the mass at the tip in the pose that the links have: the given one is in equilibrium."""
    i = fx.tip
    mass = fx.parameter[e, slot * PARAMETERS * fx.stride]
    o = real(0.0, mass)
    arm = mass_at(e, i, 0, slot, fx, s.r[row, i])
    place = s.accel[row, i] + rotate(s.pose[row, i], arm)
    lift = s.accel0[row, 0] * mass
    for k in range(1, m.count[e] + 1):
        fx.hold[e, k] = type(arm)(o, o, o)
    while i > 0:
        fx.hold[e, i] = unrotate(s.pose[row, i], cross(place - s.accel[row, i], lift))
        i = m.parent[e, i]


@wp.func
def settle(
    e: int, row: int, m: Any, x: Any, u: Any, fx: Any, s: Any, time: wp.float64, bound: wp.float64, still: int,
    rested: wp.float64, advance: wp.Function,
):  # fmt: skip
    """Let the worlds marked in ``settle`` come to rest under what acts; the others go to their springs' rest.

    What laws remember goes on by the time ``rested`` [s] once they rest, by ever longer steps: fast memories are empty
    by then.
    """
    due = wp.max(rested * LAPSE, LEAST_LAPSE)
    lapse = wp.min(LEAST_LAPSE, due)
    for n in range(SETTLING):
        if n >= FIRST:
            lapse = due
            due = due * LONGER
        for i in range(1, m.count[e] + 1):
            v = x.velocity[e, i]
            o = real(0.0, v.x)
            x.velocity[e, i] = type(v)(o, o, o)
        advance(e, row, m, x, u, fx, s, SETTLING_STEP, time, bound, still, lapse)
    mark = fx.settle[e]
    for i in range(1, m.count[e] + 1):
        v = x.velocity[e, i]
        q = x.coordinate[e, i]
        o = real(0.0, q.x)
        x.velocity[e, i] = type(v)(o, o, o)
        x.coordinate[e, i] = type(q)(
            where_neg(o - mark, q.w, real(1.0, o)),
            where_neg(o - mark, q.x, o), where_neg(o - mark, q.y, o), where_neg(o - mark, q.z, o),
        )  # fmt: skip


@wp.func
def way_to(off: Any, gone: Any):
    """Displacement ``off`` at which a recording finds a branch, less ``gone``, where memory left it; 0 if it is 0."""
    o = off.x - off.x
    told = dot(off, off)
    way = off - gone
    return type(off)(
        where_neg(o - told, way.x, o), where_neg(o - told, way.y, o), where_neg(o - told, way.z, o)
    )  # fmt: skip


@wp.func
def set_out(
    e: int, row: int, j: int, place: int, is_first: bool, at: Slots, m: Any, x: Any, u: Any, fx: Any, s: Any,
    grip: wp.array2d(dtype=wp.float64), nominal: Any, time: wp.float64, rested: wp.float64, bound: wp.float64,
    advance: wp.Function, hold: wp.Function,
):  # fmt: skip
    """Bring the worlds to where recording j begins; return the point that displacement counts from, and the calm pose.

    Worlds that are blown come to rest under the wind; displacement is counted from the calm pose all the same, that of
    the whole branch where a memory lasts, which went on for the time ``rested`` [s] since the recording before. Other
    worlds begin where laws hold them (`held`): at the place `OFF` from there, where the recording tells one, else where
    the memory leaves them.
    """
    o = real(0.0, nominal.x)
    lasting = fx.active[e, at.lasting]
    if is_first or lasting == 0:
        rest(e, m, x)
    for i in range(1, m.count[e] + 1):
        u.force[e, i] = type(nominal)(o, o, o)
    u.point[e, place] = nominal
    locate_links(e, row, m, x, s)
    if at.tip >= 0:
        if is_first:
            hold_tip(e, row, at.tip, m, fx, s)
    if lasting == 1:  # find the calm pose after the damage so far
        settle(e, row, m, x, u, fx, s, time, bound, CALM, rested, advance)
        locate_links(e, row, m, x, s)
    here = s.accel[row, place] + rotate(s.pose[row, place], nominal)
    start = type(here)(here.x, here.y, here.z)
    if lasting == 1:
        start = grip_of(grip, j, GIVEN, nominal)
    calm = s.pose[row, place]
    if fx.active[e, at.resting] == 1:
        settle(e, row, m, x, u, fx, s, time, bound, STILL, LEAST_LAPSE, advance)
        locate_links(e, row, m, x, s)
    if fx.active[e, at.holding] == 1:
        hold(e, row, place, here, way_to(grip_of(grip, j, OFF, nominal), here - start), m, x, fx, s)
    return start, calm


# ---- replay ----------------------------------------------------------------------------------------------------------


@wp.func
def blow_on(
    e: int, j: int, k: int, step: int, substeps: int, fx: Any, course_in: wp.array3d(dtype=wp.float64), like: Any
):  # fmt: skip
    """Take over the course of recording j's gusts in the middle of a step after its entry k, if it has one."""
    if k + 1 < course_in.shape[1]:
        share = (wp.float64(step) + wp.float64(0.5)) / wp.float64(substeps)
        x = course_in[j, k, 0] + share * (course_in[j, k + 1, 0] - course_in[j, k, 0])
        y = course_in[j, k, 1] + share * (course_in[j, k + 1, 1] - course_in[j, k, 1])
        fx.course[e, 0] = type(like)(real(x, like.x), real(y, like.x), real(0.0, like.x))


@wp.func
def replay_samples(
    e: int, row: int, j: int, place: int, n: int, written: int, at: Slots, m: Any, x: Any, u: Any, fx: Any, s: Any,
    grip: wp.array2d(dtype=wp.float64), input_in: wp.array3d(dtype=wp.float64),
    course_in: wp.array3d(dtype=wp.float64), lead: int, begin: wp.float64, substeps: int, h: wp.float64,
    bound: wp.float64, start: Any, like: Any, track: int, output_out: Any, coordinate_out: Any,
    advance: wp.Function, law: wp.Function,
):  # fmt: skip
    """Push a link as recording j says, from where it begins; ``like`` is the `ForceState` there.

    Where a law acts by the clock the link is left alone for ``lead`` samples first.
    """
    nominal = grip_of(grip, j, GRASP, start)
    along = grip_of(grip, j, ALONG, start)
    rate = wp.float64(1.0) / (h * wp.float64(substeps))
    before = wp.where(fx.active[e, at.preceding] == 1, lead, 0)
    set_out_from(e, m, x, fx)
    for i in range(before + n):
        k = i - before
        to_sample(e, m, x, fx, h, i > 0)
        locate_links(e, row, m, x, s)
        if written >= 0 and k >= 0:
            dt = real(h * wp.float64(substeps), start.x)
            look(e, row, place, written + k, k == 0, at, s, fx, nominal, along, start, dt, output_out)
            if track == 1:
                for link in range(m.count[e] + 1):
                    coordinate_out[e, (written + k) * fx.stride + link] = x.coordinate[e, link]
        to_step(e, m, x, fx)
        if k < n - 1:
            ends = wp.int32(NEVER)
            if is_on(e, at.delay, fx) and k >= 0:
                ends = opening(input_in, j, k, n)
            for step in range(substeps):
                time = begin + (wp.float64(k * substeps + step) + wp.float64(0.5)) * h
                if k >= 0:
                    now = Moment(j, k, k + 1, step, substeps, 1)
                    force = acting(e, fx, at.delay, input_in, now, n, ends, rate, s.pose[row, place], like, law)
                    u.force[e, place] = force
                    if is_on(e, at.slip, fx):
                        axis = rotate(s.pose[row, place], along)
                        far = slid(e, at, fx, force, axis, grip, j, time, real(h, nominal.x))
                        u.point[e, place] = add_scaled(nominal, along, far)
                blow_on(e, j, k + lead, step, substeps, fx, course_in, start)
                advance(e, row, m, x, u, fx, s, h, time, bound, MOVING, h)


@wp.func
def drive(
    e: int, row: int, delay: int, u: Any, fx: Any, s: Any, driven: wp.array(dtype=int),
    input_in: wp.array3d(dtype=wp.float64), now: Moment, n: int, rate: wp.float64, like: Any, law: wp.Function,
):  # fmt: skip
    """Set the efforts of the driven joints in the middle of a step; ``like`` is a `ForceState` of zeros."""
    o = like.contact
    for d in range(driven.shape[0]):
        i = driven[d]
        recorded = drawn(e, fx, delay, input_in, now, n, d, d, NEVER, rate, o)
        pose = s.pose[row, i]
        felt = type(like)(
            type(like.force)(recorded, o, o), real(1.0, o), pose, pose, like.gravity, like.opened, like.heading,
            like.time,
        )  # fmt: skip
        effort = u.effort[e, i]
        effort.x = law(e, i, fx, felt).x
        u.effort[e, i] = effort


@wp.func
def replay_joints(
    e: int, row: int, j: int, n: int, delay: int, m: Any, x: Any, u: Any, fx: Any, s: Any,
    driven: wp.array(dtype=int), hold: int, watched: wp.array(dtype=int), input_in: wp.array3d(dtype=wp.float64),
    begin: wp.float64, substeps: int, h: wp.float64, bound: wp.float64, like: Any, output_out: Any,
    advance: wp.Function, law: wp.Function,
):  # fmt: skip
    """Drive joints with the efforts of recording j; write coordinate, rate and acceleration of the watched ones."""
    rate = wp.float64(1.0) / (h * wp.float64(substeps))
    for k in range(n):
        write_joints(e, k, watched, x, output_out)
        for step in range(substeps):
            now = Moment(j, k, wp.min(k + 1, n - 1), step, substeps, hold)
            drive(e, row, delay, u, fx, s, driven, input_in, now, n, rate, like, law)
            since = wp.float64(k * substeps + step) * h
            look_ahead(e, m, x)
            advance(e, row, m, x, u, fx, s, h, begin + since, bound, MOVING, h)
            if step == 0:
                write_gains(e, k, watched, x, h, output_out)


@cache
def effect_rollout_kernels(width: int, precision: int, terms: tuple[Term, ...]) -> SimpleNamespace:
    """Return ``point`` and ``joint`` as `rollout.rollout_kernels` does, with the given terms in the step.

    Beside the laws, the replay itself carries out ``time_delay`` (lag and, of a branch's tracker, time constant [s],
    see `shifted` and `followed`), ``grasp_slip`` (see `slid`) and
    ``tip_mass`` (mass [kg]); parameters stand at their term's slot.
    """
    return SimpleNamespace(point=_point_kernel(width, precision, terms), joint=_joint_kernel(width, precision, terms))


def _point_kernel(width: int, precision: int, terms: tuple[Term, ...]) -> Any:
    """Kernel that pushes links at their load points as recorded.

    Inputs are the force x, y, z, whether the gripper holds (1 or 0), and what the sensor felt of each. ``grip``
    [recordings, 18] is laid out as `GRASP`, `ALONG`, ... say. With ``track`` 1 the joints' coordinates are written
    too. A recording is written at sample ``offset``, or not where that is negative; laws that act by the clock act for
    ``lead`` samples before it.
    """
    parts, kept = step_of(width, precision, terms), kept_rows(terms)
    t, advance, law, hold = parts.types, parts.advance, parts.force, holder_of(terms, parts.types, parts.key)
    fade = fader_of(terms, parts.key)
    Model, State, Load, Scratch, Real, Quat = t.Model, t.State, t.Load, t.Scratch, t.Real, t.Quat
    Effects, ForceState = t.Effects, t.ForceState
    tip, slip, delay = (slot_of(terms, kind) for kind in ("tip_mass", "grasp_slip", "time_delay"))
    marked = ("lasting", "holding", "preceding", "resting")
    lasting, holding, preceding, resting = (len(terms) + GROUPS.index(k) for k in marked)
    slip_row, delay_row = (memory_row(terms, max(0, slot)) for slot in (slip, delay))

    @wp.kernel(enable_backward=False, module="unique", module_options=inlined())
    def point(
        m: Model, x_in_out: State, u_out: Load, fx: Effects, grasped: wp.array(dtype=int),
        grip: wp.array2d(dtype=wp.float64), first_of: wp.array(dtype=int), last_of: wp.array(dtype=int),
        length: wp.array(dtype=int), begins: wp.array(dtype=wp.float64), offset: wp.array(dtype=int),
        lead: wp.array(dtype=int),
        input_in: wp.array3d(dtype=wp.float64), course_in: wp.array3d(dtype=wp.float64), s_out: Scratch, first: int,
        row: int, substeps: int, h: wp.float64, bound: wp.float64, output_out: wp.array2d(dtype=Real), track: int,
        coordinate_out: wp.array2d(dtype=Quat),
    ):  # fmt: skip
        """Replay a group's recordings ``first_of`` to ``last_of`` - 1 in turn: push the link, write its motion."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        at = Slots(tip, slip, slip_row, delay, delay_row, lasting, holding, resting, preceding)
        forget(e, kept, EVERYTHING, m, fx)
        for j in range(first_of[e], last_of[e]):
            place = grasped[j]
            forget(e, kept, BETWEEN, m, fx)
            fade(e, m, fx)
            nominal = grip_of(grip, j, GRASP, m.offset[e, 1])
            rested = wp.float64(0.0)
            if j > first_of[e]:
                rested = begins[j] - begins[j - 1] - h * wp.float64((length[j - 1] - 1) * substeps)
            blow_on(e, j, 0, 0, 1, fx, course_in, nominal)
            start, calm = set_out(e, r, j, place, j == first_of[e], at, m, x_in_out, u_out, fx, s_out, grip, nominal,
                                  begins[j], rested, bound, advance, hold)  # fmt: skip
            start = counted_from(e, at, fx, start, calm, grip_of(grip, j, ALONG, nominal))
            zero = nominal - nominal
            opened = grip_of(grip, j, OPENED, nominal)
            heading = grip_of(grip, j, HEADING, nominal)
            like = ForceState(zero, zero.x, calm, calm, zero - s_out.accel0[r, 0], opened, heading,
                              real(begins[j], zero.x))  # fmt: skip
            replay_samples(e, r, j, place, length[j], offset[j], at, m, x_in_out, u_out, fx, s_out, grip, input_in,
                           course_in, lead[j], begins[j], substeps, h, bound, start, like, track, output_out,
                           coordinate_out, advance, law)  # fmt: skip

    return point


def _joint_kernel(width: int, precision: int, terms: tuple[Term, ...]) -> Any:
    """Kernel that drives joints with their recorded efforts, and writes what the watched ones do."""
    parts, kept = step_of(width, precision, terms), kept_rows(terms)
    t, advance, law, delay = parts.types, parts.advance, parts.force, slot_of(terms, "time_delay")
    Model, State, Load, Scratch, Real, Vec = t.Model, t.State, t.Load, t.Scratch, t.Real, t.Vec
    Effects, ForceState = t.Effects, t.ForceState

    @wp.kernel(enable_backward=False, module="unique", module_options=inlined())
    def joint(
        m: Model, x_in_out: State, u_out: Load, fx: Effects, driven: wp.array(dtype=int), hold: int,
        watched: wp.array(dtype=int), trajectory: wp.array(dtype=int), length: wp.array(dtype=int),
        begins: wp.array(dtype=wp.float64), input_in: wp.array3d(dtype=wp.float64), s_out: Scratch, first: int,
        row: int, substeps: int, h: wp.float64, bound: wp.float64, output_out: wp.array2d(dtype=Real),
    ):  # fmt: skip
        """Replay the recording of a group under its efforts; write what the watched joints do."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        j = trajectory[e]
        forget(e, kept, EVERYTHING, m, fx)
        o = real(0.0, m.mass[e, 1])
        zero = Vec(o, o, o)
        pose = m.turn[e, 1]
        like = ForceState(zero, o, pose, pose, zero, zero, zero, o)
        replay_joints(e, r, j, length[j], delay, m, x_in_out, u_out, fx, s_out, driven, hold, watched, input_in,
                      begins[j], substeps, h, bound, like, output_out, advance, law)  # fmt: skip

    return joint
