"""Parts of a clearing task: reward, counters, measures.

A policy step judges the state that the action was chosen in, then acts:

    r = (1 / (1 + h^2))^2 - sum_j qd_j^2 / 100 + 0.4 [no breach]                                    (5.9)

with the occlusion h and the safety breach of points without noise, whatever the policy was shown, and the joint speeds
qd.
"""

import warp as wp

from ..lanes.philox import uniform4
from .parts import View

__all__ = [
    "Clearing", "breach_share", "cleared", "covered_no_more", "draw_noise", "effort", "forget", "no_breach",
    "remember", "steps_clear", "success",
]  # fmt: skip


@wp.struct
class Clearing:
    """Scores and what is remembered of them, [worlds] each; numbers of the task.

    ``streak`` counts steps without occlusion in a row, ``max_noise`` is the reach d_max of the noise on points, drawn
    from ``noise_range`` [m].
    """

    occlusion: wp.array(dtype=wp.float32)
    breach: wp.array(dtype=wp.float32)
    max_noise: wp.array(dtype=wp.float32)
    streak: wp.array(dtype=int)
    clear: wp.array(dtype=int)
    breaches: wp.array(dtype=int)
    succeeded: wp.array(dtype=int)
    first_occlusion: wp.array(dtype=wp.float32)
    last_occlusion: wp.array(dtype=wp.float32)
    success_steps: int
    touch_force: float
    touch_noise: float
    noise_range: wp.vec2


@wp.func
def cleared(world: int, v: View, s: Clearing):
    """Reward of little occlusion."""
    h = s.occlusion[world]
    share = 1.0 / (1.0 + h * h)
    return share * share


@wp.func
def effort(world: int, v: View, s: Clearing):
    """Reward of slow joints."""
    total = wp.float32(0.0)
    for j in range(v.qd.shape[1]):
        total = total + v.qd[world, j] * v.qd[world, j]
    return -total / 100.0


@wp.func
def no_breach(world: int, v: View, s: Clearing):
    """Reward of keeping the safety margin."""
    return 0.4 * (1.0 - s.breach[world])


@wp.func
def remember(world: int, v: View, s: Clearing):
    """Count a judged state."""
    h = s.occlusion[world]
    if v.clock.age[world] == 0:
        s.first_occlusion[world] = h
    s.last_occlusion[world] = h
    s.breaches[world] = s.breaches[world] + int(s.breach[world])
    s.streak[world] = wp.where(h == 0.0, s.streak[world] + 1, 0)
    s.clear[world] = s.clear[world] + wp.where(h == 0.0, 1, 0)
    if s.streak[world] >= s.success_steps:
        s.succeeded[world] = 1


@wp.func
def forget(world: int, v: View, s: Clearing):
    """Begin to count anew."""
    s.streak[world] = 0
    s.clear[world] = 0
    s.breaches[world] = 0
    s.succeeded[world] = 0


@wp.func
def draw_noise(world: int, v: View, s: Clearing):
    """Draw an episode's reach d_max of the noise on points."""
    u = uniform4(v.key, world, v.clock.episode[world], 0, 0)
    s.max_noise[world] = s.noise_range[0] + (s.noise_range[1] - s.noise_range[0]) * u[2]


@wp.func
def success(world: int, v: View, s: Clearing):
    """1 where the target was clear for long enough."""
    return float(s.succeeded[world])


@wp.func
def covered_no_more(world: int, v: View, s: Clearing):
    """Share of the starting occlusion that is gone."""
    first = s.first_occlusion[world]
    return wp.where(first > 0.0, 1.0 - s.last_occlusion[world] / first, 0.0)


@wp.func
def breach_share(world: int, v: View, s: Clearing):
    """Share of steps inside the safety margin."""
    return float(s.breaches[world]) / float(wp.max(v.clock.age[world], 1))


@wp.func
def steps_clear(world: int, v: View, s: Clearing):
    """Steps without occlusion."""
    return float(s.clear[world])
