"""What acts in a step of a replay: a recorded value, late or led as `time_delay` says, while the gripper holds."""

from typing import Any

import warp as wp

from ..lanes.algebra import add, mul, sub
from ..lanes.real import fma, real, where_neg
from ..tree.rollout import Moment, between, share_of
from .structs import PARAMETERS
from .terms import is_on

#: Samples until a gripper opens after which a shift does not see it.
NEVER = wp.constant(3)
#: Column of a branch's input that is 1 where the gripper may hold, else 0; as many columns on stands what the sensor
#: felt, in the place of each; then 1 where the gripper is timed with the force, 0 where it is timed with the motion.
CLOSED = wp.constant(3)
SENSED = wp.constant(4)
TOGETHER = wp.constant(8)
#: How far before a moment the change is taken that went before it, in samples.
EARLIER = wp.constant(wp.float64(1.0e-3))


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
    """Samples from k until the gripper next opens; `NEVER` where that is far, or the force's clock tells it."""
    if input_in[j, 0, TOGETHER] == wp.float64(0.0):
        for d in range(1, NEVER):
            if sample(input_in, j, k + d, n, CLOSED) == wp.float64(0.0):
                if sample(input_in, j, k + d - 1, n, CLOSED) > wp.float64(0.0):
                    return int(d)
    return int(NEVER)


@wp.func
def shifted(
    input_in: wp.array3d(dtype=wp.float64), j: int, k: int, n: int, c: int, low: int, high: int, ends: int,
    share: wp.float64, late: Any, lead: Any,
):  # fmt: skip
    """Recorded value ``late`` samples after the moment that is ``share`` of a sample past sample k.

    What a sensor of first order recorded, y, is led by ``lead`` samples: it followed y + lead y'. Lanes are late by
    ``low`` to ``high`` samples. The gripper opens ``ends`` samples after k, and the force falls to zero within the last
    of them. A recorded value that lies f of a sample inside this fall is 1 - f of the force, so f of the one before is
    added; one after it is not used, and what leads is the change before. What is linear between the samples after a
    shift is no more what it was, and a release is the largest change.
    """
    o = real(0.0, late)
    one = real(1.0, late)
    here = real(share, late)
    falling = wp.where(ends == 1, 1, 0)
    looked = here * real(float(1 - falling), late) + late
    moved = o
    slope = o
    last = real(sample(input_in, j, k + low - 1, n, c), late)
    for d in range(low, high + 2):
        value = real(sample(input_in, j, k + d, n, c), late)
        inside = real(float(d + 1 - ends), late) - late
        inside = where_neg(inside, o, inside)
        part = where_neg(inside - one, inside, one)
        before = last
        last = fma(part, last, where_neg(inside - one, value, o))
        past = looked - real(float(d), late)
        moved = fma(last, hat(past), moved)
        past = past - real(EARLIER, late) * real(float(falling), late)
        slope = slope + where_neg(past, where_neg(past + one, o, last - before), o)
    return fma(lead, slope, moved) * (one - here * real(float(falling), late))


@wp.func
def closed_at(
    input_in: wp.array3d(dtype=wp.float64), j: int, k: int, n: int, low: int, high: int, share: wp.float64, late: Any
):
    """Whether the gripper may hold at either sample about that moment, 1 or 0 in each lane, see `shifted`."""
    o = real(0.0, late)
    one = real(1.0, late)
    looked = real(share, late) + late
    closed = o
    for d in range(low, high + 2):
        value = real(sample(input_in, j, k + d, n, CLOSED), late)
        closed = closed + where_neg(o - hat(looked - real(float(d), late)), value, o)
    return where_neg(closed - one, closed, one)


@wp.func
def lags(e: int, fx: Any, delay: int, like: Any):
    """Below zero in the lanes whose sensor is late or slow, else 0: a group shares the law, not its lag."""
    late = fx.parameter[e, delay * PARAMETERS * fx.stride]
    slow = fx.parameter[e, (delay * PARAMETERS + 1) * fx.stride]
    o = real(0.0, like)
    return where_neg(late, late, o - late) + where_neg(slow, slow, o - slow)


@wp.func
def drawn(
    e: int, fx: Any, delay: int, input_in: wp.array3d(dtype=wp.float64), now: Moment, n: int, c: int, sensed: int,
    ends: int, rate: wp.float64, lead: Any,
):  # fmt: skip
    """Recorded value of column c in the middle of a step, of ``rate`` samples a second.

    Where the sensor lags it is that of column ``sensed``, `shifted`; not in worlds beside whose own sensor does not.
    """
    value = real(between(input_in, now, c), lead)
    if is_on(e, delay, fx):
        late = fx.parameter[e, delay * PARAMETERS * fx.stride] * real(rate, lead)
        moved = shifted(input_in, now.recording, now.sample, n, sensed, fx.lag[e, 0], fx.lag[e, 1], ends,
                        share_of(now), late, lead)  # fmt: skip
        value = where_neg(lags(e, fx, delay, lead), moved, value)
    return value


@wp.func
def led(e: int, fx: Any, delay: int, rate: wp.float64, o: Any):
    """Time constant of a force sensor of first order, in samples: the slow one is this one where it is negative."""
    lead = o
    if is_on(e, delay, fx):
        slow = fx.parameter[e, (delay * PARAMETERS + 1) * fx.stride]
        lead = where_neg(slow, o - slow, o) * real(rate, o)
    return lead


@wp.func
def holding(e: int, fx: Any, delay: int, input_in: wp.array3d(dtype=wp.float64), now: Moment, n: int, rate: wp.float64,
            like: Any):  # fmt: skip
    """Whether the gripper may hold, 1 or 0: of a gripper that is timed with the force when the force says so."""
    closed = input_in[now.recording, now.sample, CLOSED] + input_in[now.recording, now.after, CLOSED]
    held = real(wp.min(closed, wp.float64(1.0)), like)
    if is_on(e, delay, fx):
        if input_in[now.recording, 0, TOGETHER] > wp.float64(0.0):
            late = fx.parameter[e, delay * PARAMETERS * fx.stride] * real(rate, like)
            seen = closed_at(input_in, now.recording, now.sample, n, fx.lag[e, 0], fx.lag[e, 1], share_of(now), late)
            held = where_neg(lags(e, fx, delay, like), seen, held)
    return held


@wp.func
def acting(
    e: int, fx: Any, delay: int, input_in: wp.array3d(dtype=wp.float64), now: Moment, n: int, ends: int,
    rate: wp.float64, pose: Any, like: Any, law: wp.Function,
):  # fmt: skip
    """Force that acts in the middle of a step; ``like`` is a `ForceState` of the recording where it begins."""
    o = real(0.0, like.contact)
    lead = led(e, fx, delay, rate, o)
    recorded = type(like.force)(
        drawn(e, fx, delay, input_in, now, n, 0, SENSED + 0, ends, rate, lead),
        drawn(e, fx, delay, input_in, now, n, 1, SENSED + 1, ends, rate, lead),
        drawn(e, fx, delay, input_in, now, n, 2, SENSED + 2, ends, rate, lead),
    )
    held = holding(e, fx, delay, input_in, now, n, rate, o)
    recorded = recorded * held  # a late sensor still feels what an open gripper does not
    contact = drawn(e, fx, delay, input_in, now, n, CLOSED, SENSED + CLOSED, ends, rate, o) * held
    time = like.time + real((wp.float64(now.sample) + share_of(now)) / rate, o)
    return law(e, 0, fx, type(like)(recorded, contact, pose, like.first, like.gravity, like.opened, like.heading, time))
