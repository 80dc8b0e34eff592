"""Kernels that replay recorded trajectories with effects (`terms`): `rollout` with laws in the step.

A group replays the recordings ``first[group]`` to ``last[group]``, one after the other, each from rest: damage that one
leaves is there in the next. Without a term that persists it replays one.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.algebra import add, add_cross, add_scaled, cross, div, dot, mul, norm, rotate, sub, unrotate
from ..lanes.real import SOURCE, fma, fnma, real, sqrt_, where_neg
from ..tree.observe import locate_links
from .terms import CALM, GROUPS, MOVING, PARAMETERS, STILL, Term, memory_row, step_of

__all__ = ["DELAY", "SETTLING", "effect_rollout_kernels"]

#: Most samples that a force may lag or lead.
DELAY = 5
#: Samples until a gripper opens that no shift reaches.
NEVER = wp.constant(3 * DELAY)
#: Column of a branch's input that is 1 where the gripper may hold, else 0.
CLOSED = wp.constant(3)

#: Steps that seek rest under a load, each Newton's with 5/4 of the joints' stiffness, and their length [s].
SETTLING = 16
SETTLING_STEP = wp.constant(wp.float64(1.0))


@wp.func
def sample(input_in: wp.array3d(dtype=wp.float64), j: int, k: int, n: int, c: int):
    """Recorded value at a sample; the first and last one beyond the ends."""
    return input_in[j, wp.clamp(k, 0, n - 1), c]


@wp.func
def hat(x: Any):
    """1 - |x| where that is positive, else 0."""
    o = real(0.0, x)
    y = real(1.0, x) - where_neg(x, o - x, x)
    return where_neg(y, o, y)


@wp.func
def opening(input_in: wp.array3d(dtype=wp.float64), j: int, k: int, n: int):
    """Samples from k until the gripper next opens; `NEVER` where no shift reaches it."""
    for d in range(1, 2 * DELAY + 2):
        if sample(input_in, j, k + d, n, CLOSED) == wp.float64(0.0):
            if sample(input_in, j, k + d - 1, n, CLOSED) > wp.float64(0.0):
                return int(d)
    return int(NEVER)


@wp.func
def shifted(
    input_in: wp.array3d(dtype=wp.float64), j: int, k: int, n: int, c: int, ends: int, share: wp.float64, lag: Any
):
    """What a shift of the recording by ``lag`` samples adds to its value ``share`` of a sample after sample k.

    The gripper opens ``ends`` samples after k, and the force falls to zero within the last of them. A recorded value
    that lies f of a sample inside this fall is 1 - f of the force, so f of the one before is added; one after it is not
    used. What is linear between the samples after a shift is no more what it was, and a release is the largest change.
    """
    o = real(0.0, lag)
    one = real(1.0, lag)
    here = real(share, lag)
    most = real(float(DELAY), lag)
    late = where_neg(most - lag, most, lag)
    late = where_neg(late + most, o - most, late)
    falling = wp.where(ends == 1, 1, 0)
    looked = here * real(float(1 - falling), lag) + late
    moved = o
    left = o
    last = real(sample(input_in, j, k - DELAY, n, c), lag)
    for step in range(2 * DELAY + 2):
        d = step - DELAY
        value = real(sample(input_in, j, k + d, n, c), lag)
        inside = real(float(d + 1 - ends), lag) - late
        inside = where_neg(inside, o, inside)
        part = where_neg(inside - one, inside, one)
        last = fma(part, last, where_neg(inside - one, value, o))
        moved = fma(last, hat(looked - real(float(d), lag)), moved)
        left = fma(value, hat(here - real(float(d), lag)), left)
    return moved * (one - here * real(float(falling), lag)) - left


@wp.func
def slid(fx: Any, e: int, k: int, force: Any, p: Any, peak: Any, low: wp.float64, high: wp.float64, h: Any):
    """Advance how far the grip has slid [m]: rate = a (n x + (1 - n) 1 N) towards the tip, inside the segment.

    It slides while the excess x = |F| - b - c F_peak is positive; F_peak is the largest force of the recording.
    """
    z = fx.memory[e, k]
    o = real(0.0, p.a)
    one = real(1.0, o)
    excess = norm(force) - fma(p.c, peak, p.b)
    rate = where_neg(excess, o, p.a * fma(p.d, excess, one - p.d))
    new = fma(rate, h, z.x)
    bottom = real(low, o)
    top = real(high, o)
    new = where_neg(new - bottom, bottom, new)
    new = where_neg(top - new, top, new)
    fx.memory[e, k] = type(z)(new, (new - z.x) / h, z.z)
    return new


@cache
def effect_rollout_kernels(width: int, precision: int, terms: tuple[Term, ...]) -> SimpleNamespace:
    """Return ``point`` and ``joint`` as `rollout.rollout_kernels` does, with the given terms in the step.

    Beside the laws, the replay itself carries out ``time_delay`` (lag [s]), ``grasp_slip`` (see `slid`) and
    ``tip_mass`` (mass [kg]); parameters stand at their term's slot.
    """
    parts = step_of(width, precision, terms)
    t, key, advance, force_law = parts.types, parts.key, parts.advance, parts.force
    Model, State, Load, Scratch, Real, Vec, Quat = t.Model, t.State, t.Load, t.Scratch, t.Real, t.Vec, t.Quat
    Effects, ForceState, Parameters = t.Effects, t.ForceState, t.Parameters
    slots = {term.kind: term.slot for term in terms}
    has_tip, tip_slot = parts.has_tip, parts.tip_slot
    has_slip, slip_slot = int("grasp_slip" in slots), slots.get("grasp_slip", 0)
    has_delay, delay_slot = int("time_delay" in slots), slots.get("time_delay", 0) * PARAMETERS
    lasts = int(any(x.persistent for x in terms))
    num_slots, num_rows = len(terms), memory_row(terms, len(terms))
    slip_row = memory_row(terms, slip_slot)
    has_lasting, has_resting = (num_slots + GROUPS.index(k) for k in ("lasting", "resting"))
    delay_term = slots.get("time_delay", 0)
    marks = [int(x.persistent) for x in terms for _ in range(x.memory)]
    kept = wp.constant(wp.types.vector(max(1, num_rows), wp.int32)(*(marks or [0])))

    def forget(e: int, m: Any, fx: Any, everything: int):
        """Clear the memories of a group: those that a recording's end clears, or all."""
        for row in range(num_rows):
            if everything == 1 or kept[row] == 0:
                for i in range(m.count[e] + 1):
                    z = fx.memory[e, row * fx.stride + i]
                    o = real(0.0, z.x)  # no difference of the memory itself: what is not a number would stay so
                    fx.memory[e, row * fx.stride + i] = type(z)(o, o, o)

    forget = wp.func(forget, name=f"forget_{key}")

    def rest(e: int, m: Any, x: Any):
        """Put every joint at its spring's rest, at rest."""
        for i in range(1, m.count[e] + 1):
            q = x.coordinate[e, i]
            v = x.velocity[e, i]
            o = real(0.0, q.x)
            x.coordinate[e, i] = type(q)(real(1.0, o), o, o, o)
            x.velocity[e, i] = type(v)(o, o, o)

    rest = wp.func(rest, name=f"rest_{key}")

    def hold_tip(e: int, row: int, m: Any, fx: Any, s: Any):
        """Torques that hold the mass at the tip in the pose that the links have: the given one is in equilibrium."""
        i = fx.tip
        mass = fx.parameter[e, tip_slot * fx.stride]
        o = real(0.0, mass)
        arm = type(s.r[row, i])(real(fx.tip_point[0], o), real(fx.tip_point[1], o), real(fx.tip_point[2], o))
        place = s.accel[row, i] + rotate(s.pose[row, i], arm)
        lift = s.accel0[row, 0] * mass
        for k in range(1, m.count[e] + 1):
            fx.hold[e, k] = type(arm)(o, o, o)
        while i > 0:
            fx.hold[e, i] = unrotate(s.pose[row, i], cross(place - s.accel[row, i], lift))
            i = m.parent[e, i]

    hold_tip = wp.func(hold_tip, name=f"hold_tip_{key}")

    def settle(
        e: int, row: int, m: Any, x: Any, u: Any, fx: Any, s: Any, time: wp.float64, bound: wp.float64, still: int
    ):  # fmt: skip
        """Let the worlds marked in ``settle`` come to rest under what acts; the others go to their springs' rest."""
        for _ in range(SETTLING):
            for i in range(1, m.count[e] + 1):
                v = x.velocity[e, i]
                o = real(0.0, v.x)
                x.velocity[e, i] = type(v)(o, o, o)
            advance(e, row, m, x, u, fx, s, SETTLING_STEP, time, bound, still)
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

    settle = wp.func(settle, name=f"settle_{key}")

    def drawn(
        input_in: wp.array3d(dtype=wp.float64), e: int, fx: Any, j: int, k: int, after: int, n: int, c: int, step: int,
        substeps: int, hold: int, rate: wp.float64, sensed: int, ends: int, like: Any,
    ):  # fmt: skip
        """Recorded value in the middle of a step; `shifted` by the lag of the sensor, it is in column ``sensed``."""
        a = input_in[j, k, c]
        share = (wp.float64(step) + wp.float64(0.5)) / wp.float64(substeps)
        value = real(a + (input_in[j, after, c] - a) * (wp.float64(hold) * share), like)
        if wp.static(has_delay):
            if fx.active[e, delay_term] == 1:
                lag = fx.parameter[e, delay_slot * fx.stride] * real(rate, like)
                a = input_in[j, k, sensed]
                value = real(a + (input_in[j, after, sensed] - a) * (wp.float64(hold) * share), like)
                value = value + shifted(input_in, j, k, n, sensed, ends, share, lag)
        return value

    drawn = wp.func(drawn, name=f"drawn_{key}")

    @wp.kernel(enable_backward=False, module="unique")
    def point(
        m: Model,
        x_in_out: State,
        u_out: Load,
        fx: Effects,
        grasped: wp.array(dtype=int),
        grip: wp.array2d(dtype=wp.float64),
        first_of: wp.array(dtype=int),
        last_of: wp.array(dtype=int),
        length: wp.array(dtype=int),
        begins: wp.array(dtype=wp.float64),
        offset: wp.array(dtype=int),
        input_in: wp.array3d(dtype=wp.float64),
        s_out: Scratch,
        first: int,
        row: int,
        substeps: int,
        h: wp.float64,
        bound: wp.float64,
        output_out: wp.array2d(dtype=Real),
        track: int,
        coordinate_out: wp.array2d(dtype=Quat),
    ):
        """Push links at their load points as recorded (force x, y, z and whether the gripper holds, 1 or 0).

        Worlds that are blown come to rest under the wind first; displacement is counted from the calm pose all the
        same. ``grip`` [recordings, 12] holds the grasp point and the segment's direction in the link's frame, how far
        the grip may slide down (negative) and up, where it is in the world, and the largest force. With ``track`` 1
        the joints' coordinates are written too. A recording is written at sample ``offset``, or not where that is
        negative.
        """
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        rate = wp.float64(1.0) / (h * wp.float64(substeps))
        forget(e, m, fx, 1)
        for j in range(first_of[e], last_of[e]):
            n = length[j]
            place = grasped[j]
            at = offset[j]
            if j == first_of[e]:
                rest(e, m, x_in_out)
            forget(e, m, fx, 0)
            o = real(0.0, m.mass[e, 1])
            zero = Vec(o, o, o)
            for i in range(1, m.count[e] + 1):
                u_out.force[e, i] = zero
            nominal = Vec(real(grip[j, 0], o), real(grip[j, 1], o), real(grip[j, 2], o))
            along = Vec(real(grip[j, 3], o), real(grip[j, 4], o), real(grip[j, 5], o))
            u_out.point[e, place] = nominal
            locate_links(e, r, m, x_in_out, s_out)
            if wp.static(has_tip):
                if j == first_of[e]:
                    hold_tip(e, r, m, fx, s_out)
            if wp.static(lasts):  # find the calm pose after the damage so far
                if fx.active[e, has_lasting] == 1:
                    settle(e, r, m, x_in_out, u_out, fx, s_out, begins[j], bound, CALM)
                else:
                    rest(e, m, x_in_out)
                locate_links(e, r, m, x_in_out, s_out)
            start = s_out.accel[r, place] + rotate(s_out.pose[r, place], nominal)
            if wp.static(lasts):  # displacement counts from where the whole branch had its grasp point
                if fx.active[e, has_lasting] == 1:
                    start = Vec(real(grip[j, 8], o), real(grip[j, 9], o), real(grip[j, 10], o))
            calm = s_out.pose[r, place]
            if fx.active[e, has_resting] == 1:
                settle(e, r, m, x_in_out, u_out, fx, s_out, begins[j], bound, STILL)
            for k in range(n):
                locate_links(e, r, m, x_in_out, s_out)
                arm = rotate(s_out.pose[r, place], nominal)
                slip = zero
                if wp.static(has_slip):
                    if fx.active[e, slip_slot] == 1:
                        z = fx.memory[e, slip_row * fx.stride]
                        axis = rotate(s_out.pose[r, place], along)
                        arm = add_scaled(arm, axis, z.x)
                        slip = axis * z.y
                p = s_out.accel[r, place] + arm - start
                v = add_cross(s_out.alpha[r, place], s_out.spin[r, place], arm) + slip
                if at >= 0:
                    output_out[e, 6 * (at + k) + 0] = p.x
                    output_out[e, 6 * (at + k) + 1] = p.y
                    output_out[e, 6 * (at + k) + 2] = p.z
                    output_out[e, 6 * (at + k) + 3] = v.x
                    output_out[e, 6 * (at + k) + 4] = v.y
                    output_out[e, 6 * (at + k) + 5] = v.z
                    if track == 1:
                        for i in range(m.count[e] + 1):
                            coordinate_out[e, (at + k) * fx.stride + i] = x_in_out.coordinate[e, i]
                if k < n - 1:
                    ends = wp.int32(NEVER)
                    if wp.static(has_delay):
                        ends = opening(input_in, j, k, n)
                    for step in range(substeps):
                        recorded = Vec(
                            drawn(input_in, e, fx, j, k, k + 1, n, 0, step, substeps, 1, rate, 4, ends, o),
                            drawn(input_in, e, fx, j, k, k + 1, n, 1, step, substeps, 1, rate, 5, ends, o),
                            drawn(input_in, e, fx, j, k, k + 1, n, 2, step, substeps, 1, rate, 6, ends, o),
                        )
                        held = real(wp.min(input_in[j, k, 3] + input_in[j, k + 1, 3], wp.float64(1.0)), o)
                        recorded = recorded * held  # a late sensor still feels what an open gripper does not
                        contact = drawn(input_in, e, fx, j, k, k + 1, n, 3, step, substeps, 1, rate, 7, ends, o) * held
                        gravity = zero - s_out.accel0[r, 0]
                        now = ForceState(recorded, contact, s_out.pose[r, place], calm, gravity)
                        acting = force_law(e, 0, fx, now)
                        u_out.force[e, place] = acting
                        if wp.static(has_slip):
                            if fx.active[e, slip_slot] == 1:
                                q = slip_slot * PARAMETERS * fx.stride
                                law = Parameters(
                                    fx.parameter[e, q], fx.parameter[e, q + fx.stride],
                                    fx.parameter[e, q + 2 * fx.stride], fx.parameter[e, q + 3 * fx.stride], o, o,
                                )  # fmt: skip
                                far = slid(
                                    fx, e, slip_row * fx.stride, acting, law, real(grip[j, 11], o), grip[j, 6],
                                    grip[j, 7], real(h, o),
                                )  # fmt: skip
                                u_out.point[e, place] = add_scaled(nominal, along, far)
                        since = wp.float64(k * substeps + step) * h
                        advance(e, r, m, x_in_out, u_out, fx, s_out, h, begins[j] + since, bound, MOVING)

    @wp.kernel(enable_backward=False, module="unique")
    def joint(
        m: Model,
        x_in_out: State,
        u_out: Load,
        fx: Effects,
        driven: wp.array(dtype=int),
        hold: int,
        watched: wp.array(dtype=int),
        trajectory: wp.array(dtype=int),
        length: wp.array(dtype=int),
        begins: wp.array(dtype=wp.float64),
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
        rate = wp.float64(1.0) / (h * wp.float64(substeps))
        j = trajectory[e]
        n = length[j]
        c = watched.shape[0]
        forget(e, m, fx, 1)
        o = real(0.0, m.mass[e, 1])
        zero = Vec(o, o, o)
        for k in range(n):
            after = wp.min(k + 1, n - 1)
            for w in range(c):
                output_out[e, 3 * (k * c + w) + 0] = x_in_out.coordinate[e, watched[w]].x
                output_out[e, 3 * (k * c + w) + 1] = x_in_out.velocity[e, watched[w]].x
            for step in range(substeps):
                for d in range(driven.shape[0]):
                    i = driven[d]
                    recorded = drawn(input_in, e, fx, j, k, after, n, d, step, substeps, hold, rate, d, NEVER, o)
                    pose = s_out.pose[r, i]
                    now = ForceState(Vec(recorded, o, o), real(1.0, o), pose, pose, zero)
                    effort = u_out.effort[e, i]
                    effort.x = force_law(e, i, fx, now).x
                    u_out.effort[e, i] = effort
                since = wp.float64(k * substeps + step) * h
                advance(e, r, m, x_in_out, u_out, fx, s_out, h, begins[j] + since, bound, MOVING)
                if step == 0:
                    for w in range(c):
                        before = output_out[e, 3 * (k * c + w) + 1]
                        gained = x_in_out.velocity[e, watched[w]].x - before
                        output_out[e, 3 * (k * c + w) + 2] = gained * real(wp.float64(1.0) / h, before)

    return SimpleNamespace(point=point, joint=joint)
