"""What an arm's driver tells of its joints, sample by sample, in all worlds (learn/touch/sensor.py says what it means).

    told = tau - g + c0 + c1 s + c2 v + drift + (n0 + n1 |v|) white,   s = tanh(v / V0)

in whole quanta, with tau what the servo does and g what carries the arm's weight. The drift keeps a share of itself
from one sample to the next; where an episode begins it is drawn anew. All numbers come from counters.
"""

import warp as wp

from ..lanes.philox import gaussian2, uniform4
from ..tasks.parts import Clock
from .features import V0

__all__ = ["Sensor", "Told", "tell"]

_V0 = wp.constant(V0)
#: Counters of random numbers that no part of a task draws from: one sample's noise, an episode's first drift.
_SAMPLE = wp.constant(2)
_FIRST = wp.constant(3)


@wp.struct
class Sensor:
    """A sensor of torques and speeds, [dof] each, as `learn.touch.sensor.TorqueSensor`; ``keep`` is the drift's."""

    offset: wp.array(dtype=wp.float32)
    dry: wp.array(dtype=wp.float32)
    viscous: wp.array(dtype=wp.float32)
    still: wp.array(dtype=wp.float32)
    moving: wp.array(dtype=wp.float32)
    drift: wp.array(dtype=wp.float32)
    keep: wp.array(dtype=wp.float32)
    torque_quantum: wp.array(dtype=wp.float32)
    speed_quantum: wp.array(dtype=wp.float32)


@wp.struct
class Told:
    """The last sample, [worlds, dof] or [worlds], and what the next one depends on.

    ``command`` is the mean of the speeds asked for since the sample before, ``due`` whether a sample was taken in this
    control period, ``restarted`` whether it is the first of its episode; ``asked`` sums speeds asked for, ``count``
    says how many.
    """

    torque: wp.array2d(dtype=wp.float32)
    command: wp.array2d(dtype=wp.float32)
    velocity: wp.array2d(dtype=wp.float32)
    drift: wp.array2d(dtype=wp.float32)
    asked: wp.array2d(dtype=wp.float32)
    count: wp.array(dtype=int)
    due: wp.array(dtype=wp.bool)
    restarted: wp.array(dtype=wp.bool)


@wp.func
def in_quanta(x: float, quantum: float) -> float:
    """The nearest whole quantum, x itself where there is none."""
    if quantum > 0.0:
        return quantum * wp.round(x / quantum)
    return x


@wp.kernel(enable_backward=False)
def tell(
    torque_in: wp.array2d(dtype=wp.float32), weight_in: wp.array2d(dtype=wp.float32),
    speed_in: wp.array2d(dtype=wp.float32), target_in: wp.array2d(dtype=wp.float32), clock_in: Clock, key: wp.vec2ui,
    sensor: Sensor, period: int, periods: int, every: int, told: Told, flag_out: wp.array(dtype=wp.float32),
):  # fmt: skip
    """Take note of one control period of a policy step (from 0), and a sample in every so many of them."""
    world = wp.tid()
    number = clock_in.clock[world] * periods + period
    if told.due[world]:
        told.restarted[world] = False
    fresh = period == 0 and clock_in.age[world] == 1
    if fresh:
        told.restarted[world] = True
        told.count[world] = 0
        flag_out[world] = 0.0
    count = told.count[world] + 1
    due = (number + 1) % every == 0
    for j in range(torque_in.shape[1]):
        if fresh:
            u = uniform4(key, world, number, j, _FIRST)
            told.drift[world, j] = sensor.drift[j] * gaussian2(u[0], u[1])[0]
            told.asked[world, j] = 0.0
        told.asked[world, j] = told.asked[world, j] + target_in[world, j]
        if due:
            v = speed_in[world, j]
            u = uniform4(key, world, number, j, _SAMPLE)
            g = gaussian2(u[0], u[1])
            keep = sensor.keep[j]
            drift = keep * told.drift[world, j] + wp.sqrt(1.0 - keep * keep) * sensor.drift[j] * g[0]
            steady = sensor.offset[j] + sensor.dry[j] * wp.tanh(v / _V0) + sensor.viscous[j] * v
            noise = drift + (sensor.still[j] + sensor.moving[j] * wp.abs(v)) * g[1]
            tau = torque_in[world, j] - weight_in[world, j]
            told.torque[world, j] = in_quanta(tau + steady + noise, sensor.torque_quantum[j])
            told.velocity[world, j] = in_quanta(v, sensor.speed_quantum[j])
            told.command[world, j] = told.asked[world, j] / float(count)
            told.drift[world, j] = drift
            told.asked[world, j] = 0.0
    told.due[world] = due
    told.count[world] = wp.where(due, 0, count)
