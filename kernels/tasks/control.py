"""What servos are asked for in every control period of a policy step.

The state s that an action moves is the joint speed. Period i = 0 .. n - 1 of a policy step, with the action a clipped
to [-1, 1], the measured speed s_i, the speed asked for s^d, and the most that a whole action changes it by, delta:

    ramp      s^d_{i+1} = limit ((1 - (i + 1)/n) a_{t-1} + (i + 1)/n a_t): from the last action to this in slices
    nominal   s^d_{i+1} = s_i   + delta a / n
    plai      s^d_{i+1} = s^d_i + delta a / n                                                        (4.4)
    s3ec      the same, but s^d_0 = s_t where a policy step begins                                   (4.5)

all within the joints' speed limits. ``ramp`` takes actions as speeds, the others as changes of speed.
"""

import warp as wp

from .parts import Clock

__all__ = ["LAWS", "drive"]

LAWS = ("ramp", "nominal", "plai", "s3ec")
"""Laws by number."""

RAMP, NOMINAL, PLAI = wp.constant(0), wp.constant(1), wp.constant(2)


@wp.func
def ask(law: int, period: int, periods: int, delta: float, limit: float, last: float, action: float, speed: float,
        asked: float):  # fmt: skip
    """Speed asked of a joint for one control period [rad/s]."""
    if law == RAMP:
        share = float(period + 1) / float(periods)
        return limit * ((1.0 - share) * last + share * action)
    start = asked
    if law == NOMINAL or (law != PLAI and period == 0):
        start = speed
    return wp.clamp(start + delta * action / float(periods), -limit, limit)


@wp.kernel(enable_backward=False)
def drive(
    action_in: wp.array2d(dtype=wp.float32),
    speed_limit_in: wp.array(dtype=wp.float32),
    speed_in: wp.array2d(dtype=wp.float32),
    law: int,
    period: int,
    periods: int,
    delta: float,
    clock_in: Clock,
    waiting_out: wp.array3d(dtype=wp.float32),
    target_out: wp.array2d(dtype=wp.float32),
):
    """Target speeds of one control period, by a law, of the action of as many steps ago as the world's latency says."""
    world = wp.tid()
    slots = waiting_out.shape[0]
    clock = clock_in.clock[world]
    late = (clock + slots - clock_in.action_delay[world]) % slots
    before = (late + slots - 1) % slots
    for j in range(target_out.shape[1]):
        waiting_out[clock % slots, world, j] = wp.clamp(action_in[world, j], -1.0, 1.0)
        target_out[world, j] = ask(law, period, periods, delta, speed_limit_in[j], waiting_out[before, world, j],
                                   waiting_out[late, world, j], speed_in[world, j], target_out[world, j])  # fmt: skip
