"""Parts that any task can use: what the arm feels of itself, whether it feels a touch, the sum of rewards.

They take any task's struct; `touch` reads ``touch_force`` and ``touch_noise`` [N] from it.
"""

from typing import Any

import warp as wp

from ..lanes.philox import gaussian2, uniform4
from .parts import View

__all__ = ["episode_return", "proprioceptive", "torques", "touch"]


@wp.func
def episode_return(world: int, v: View, s: Any):
    """Sum of the rewards of the episode so far."""
    return v.clock.total[world]


@wp.func
def proprioceptive(world: int, first: int, v: View, s: Any, seen: wp.array2d(dtype=wp.float32)):
    """Joint positions, speeds, the hand's orientation."""
    dofs = v.q.shape[1]
    for j in range(dofs):
        seen[world, first + j] = v.q[world, j]
        seen[world, first + dofs + j] = v.qd[world, j]
    for j in range(4):
        seen[world, first + 2 * dofs + j] = v.turn[world][j]


@wp.func
def torques(world: int, first: int, v: View, s: Any, seen: wp.array2d(dtype=wp.float32)):
    """What the servos did in the last physics step [N m]."""
    for j in range(v.torque.shape[1]):
        seen[world, first + j] = v.torque[world, j]


@wp.func
def touch(world: int, first: int, v: View, s: Any, seen: wp.array2d(dtype=wp.float32)):
    """1 where the net force on any link, with the sensor's noise on it, exceeds a threshold."""
    found = wp.float32(0.0)
    for j in range(v.q.shape[1]):
        u = uniform4(v.key, world, v.clock.clock[world], j, 1)
        noise = s.touch_noise * gaussian2(u[0], u[1])[0]
        if wp.length(v.force[world, j]) + noise > s.touch_force:
            found = 1.0
    seen[world, first] = found
