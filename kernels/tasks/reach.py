"""Parts of ``reach``: equation 4.3, contact forces, and what the arm knows of its target and of a touch.

With the hand's distance d from the target, joint speeds qd, and F the norm of the net contact forces of all links,
its mean over the last three control periods:

    r_d = (1 / (1 + d^2))^2          r_b = 7 r_d below 1.25 cm, 3 r_d below 2.5 cm, r_d below 5 cm, else 0
    r_s = - sum_j qd_j^2             r_c = 1.2 if F <= f_u, else 0        r_p = -1.2 if F > 2 f_u, else 0     (4.3)

PPO is rewarded g_d (r_d + r_b) + g_s r_s; all others {g_d (r_d + r_b) + g_s r_s} r_c + r_p (table B.1).
"""

import warp as wp

from ..lanes.philox import gaussian2, uniform4
from .parts import View

__all__ = [
    "FLAGS", "Reach", "behave", "broken_joints", "distance", "duration", "forget", "gentle", "mean_force", "near",
    "nearly_there", "offset", "remember", "retracting", "rolling", "ruptures", "rupturing", "sample", "skin", "slowing",
    "smooth", "step_force", "success",
]  # fmt: skip

#: The last joints, those of the wrist.
_WRIST = wp.constant(3)
#: Contact at all [N], a joint that turns [rad/s], and a hand that moves off, in a control period [m].
_TOUCHING, _TURNING, _MOVING = wp.constant(1.0), wp.constant(0.1), wp.constant(1.0e-3)


@wp.struct
class Reach:
    """What a world remembers, [worlds] each, and the numbers of the task.

    ``target`` is where the hand is to go [m]; ``recent`` holds F of the last three control periods and ``felt`` their
    mean [N]; ``told`` is what a classifier of joint torques tells (`kernels.touch`); ``samples`` counts control
    periods, ``arrived`` is the first of them that ended within ``within`` of the target, 0 before; ``force_sum`` and
    ``broken`` sum F and count F above ``rupture_force``, ``force_before`` is the sum before a policy step. ``hand``,
    ``went`` and ``touched`` are the hand, its way and whether there was contact in the last control period, ``run`` how
    many of them it has been slowing down for; ``rolled``, ``retracted`` and ``slowed`` count (`behave`).
    ``joint_broken`` [worlds, links] are the tree's joints.
    """

    target: wp.array(dtype=wp.vec3)
    recent: wp.array(dtype=wp.vec3)
    felt: wp.array(dtype=wp.float32)
    force_sum: wp.array(dtype=wp.float32)
    force_before: wp.array(dtype=wp.float32)
    broken: wp.array(dtype=int)
    told: wp.array(dtype=wp.float32)
    samples: wp.array(dtype=int)
    arrived: wp.array(dtype=int)
    hand: wp.array(dtype=wp.vec3)
    went: wp.array(dtype=wp.float32)
    touched: wp.array(dtype=int)
    run: wp.array(dtype=int)
    rolled: wp.array(dtype=int)
    retracted: wp.array(dtype=int)
    slowed: wp.array(dtype=int)
    joint_broken: wp.array2d(dtype=int)
    within: float
    touch_force: float
    touch_noise: float
    rupture_force: float
    distance_gain: float
    smooth_gain: float
    contact_gain: float
    force_budget: float
    cost_scale: float
    periods: int
    step_periods: int


@wp.func
def away(world: int, v: View, s: Reach):
    """Distance of the hand from the target [m]."""
    return wp.length(s.target[world] - v.hand[world])


@wp.func
def near(world: int, v: View, s: Reach):
    """g_d (r_d + r_b)."""
    d = away(world, v, s)
    share = 1.0 / (1.0 + d * d)
    reward = share * share
    if d < 0.25 * s.within:
        reward = 8.0 * reward
    elif d < 0.5 * s.within:
        reward = 4.0 * reward
    elif d < s.within:
        reward = 2.0 * reward
    return s.distance_gain * reward


@wp.func
def smooth(world: int, v: View, s: Reach):
    """g_s r_s."""
    total = wp.float32(0.0)
    for j in range(v.qd.shape[1]):
        total = total + v.qd[world, j] * v.qd[world, j]
    return -s.smooth_gain * total


@wp.func
def gentle(world: int, v: View, s: Reach):
    """r_c, a factor."""
    return wp.where(s.felt[world] <= s.touch_force, s.contact_gain, 0.0)


@wp.func
def rupturing(world: int, v: View, s: Reach):
    """r_p."""
    return wp.where(s.felt[world] > 2.0 * s.touch_force, -s.contact_gain, 0.0)


@wp.func
def sample(world: int, v: View, s: Reach):
    """Remember the forces of a control period, and whether the hand has arrived."""
    square = wp.float32(0.0)
    for j in range(v.force.shape[1]):
        square = square + wp.length_sq(v.force[world, j])
    force = wp.sqrt(square)
    last = s.recent[world]
    s.recent[world] = wp.vec3(last[1], last[2], force)
    s.felt[world] = (last[1] + last[2] + force) / 3.0
    s.force_sum[world] = s.force_sum[world] + force
    s.broken[world] = s.broken[world] + wp.where(force > s.rupture_force, 1, 0)
    s.samples[world] = s.samples[world] + 1
    if s.arrived[world] == 0 and away(world, v, s) < s.within:
        s.arrived[world] = s.samples[world]


@wp.func
def fastest(world: int, v: View, first: int, last: int):
    """Greatest speed of some joints [rad/s]."""
    most = wp.float32(0.0)
    for j in range(first, last):
        most = wp.max(most, wp.abs(v.qd[world, j]))
    return most


@wp.func
def behave(world: int, v: View, s: Reach):
    """Count what the arm does in a control period k, with the hand's way w_k in it; called after `sample`.

    rolling      F_k > 1 N and max |qd_wrist| >= max(max |qd_others|, 0.1 rad/s), the wrist being the last three joints
    retracting   F_k > 1 N and d_k - d_(k-1) > 1 mm
    slowing      F_i <= 1 N and w_i < w_(i-1) for i up to k - 1, a run right before F_k > 1 N; all of it counts then
    """
    force = s.recent[world][2]
    hand = v.hand[world]
    touching = force > _TOUCHING
    way = wp.float32(0.0)
    if s.samples[world] > 1:
        way = wp.length(hand - s.hand[world])
    if touching:
        wrist = v.qd.shape[1] - _WRIST
        if fastest(world, v, wrist, v.qd.shape[1]) >= wp.max(fastest(world, v, 0, wrist), _TURNING):
            s.rolled[world] = s.rolled[world] + 1
        before = wp.length(s.target[world] - s.hand[world])
        if s.samples[world] > 1 and away(world, v, s) - before > _MOVING:
            s.retracted[world] = s.retracted[world] + 1
        if s.touched[world] == 0:
            s.slowed[world] = s.slowed[world] + s.run[world]
    s.run[world] = wp.where(not touching and way < s.went[world], s.run[world] + 1, 0)
    s.hand[world] = hand
    s.went[world] = way
    s.touched[world] = wp.where(touching, 1, 0)


@wp.func
def remember(world: int, v: View, s: Reach):
    """Note the forces before a policy step."""
    s.force_before[world] = s.force_sum[world]


@wp.func
def step_force(world: int, v: View, s: Reach):
    """Mean of F over the control periods of a policy step, over the budget, times ``cost_scale``."""
    mean = (s.force_sum[world] - s.force_before[world]) / float(s.step_periods)
    return s.cost_scale * mean / s.force_budget


@wp.func
def forget(world: int, v: View, s: Reach):
    """Begin anew."""
    s.recent[world] = wp.vec3(0.0, 0.0, 0.0)
    s.felt[world] = 0.0
    s.force_sum[world] = 0.0
    s.force_before[world] = 0.0
    s.broken[world] = 0
    s.samples[world] = 0
    s.arrived[world] = 0
    s.went[world] = 0.0
    s.touched[world] = 0
    s.run[world] = 0
    s.rolled[world] = 0
    s.retracted[world] = 0
    s.slowed[world] = 0


@wp.func
def nearly_there(world: int, v: View, s: Reach):
    """Whether the hand is within half the distance that is success."""
    return away(world, v, s) < 0.5 * s.within


@wp.func
def success(world: int, v: View, s: Reach):
    """1 where the hand has been at the target."""
    return wp.where(s.arrived[world] > 0, 1.0, 0.0)


@wp.func
def mean_force(world: int, v: View, s: Reach):
    """Mean of F over all control periods, reached or not [N]."""
    return s.force_sum[world] / float(wp.max(s.samples[world], 1))


@wp.func
def ruptures(world: int, v: View, s: Reach):
    """Share of control periods with F above the force that ruptures."""
    return float(s.broken[world]) / float(wp.max(s.samples[world], 1))


@wp.func
def rolling(world: int, v: View, s: Reach):
    """Share of control periods in which the wrist rolls along what it touches (`behave`)."""
    return float(s.rolled[world]) / float(wp.max(s.samples[world], 1))


@wp.func
def retracting(world: int, v: View, s: Reach):
    """Share of control periods in which the hand moves off its target while the arm touches something (`behave`)."""
    return float(s.retracted[world]) / float(wp.max(s.samples[world], 1))


@wp.func
def slowing(world: int, v: View, s: Reach):
    """Share of control periods in which the hand slows down right before contact (`behave`)."""
    return float(s.slowed[world]) / float(wp.max(s.samples[world], 1))


@wp.func
def broken_joints(world: int, v: View, s: Reach):
    """Joints of the tree that broke."""
    count = wp.int32(0)
    for link in range(s.joint_broken.shape[1]):
        count = count + s.joint_broken[world, link]
    return float(count)


@wp.func
def duration(world: int, v: View, s: Reach):
    """Time to the target as a share of the step limit, 1 where it was not reached (figure B.1)."""
    return wp.where(s.arrived[world] > 0, float(s.arrived[world]) / float(s.periods), 1.0)


@wp.func
def distance(world: int, v: View, s: Reach):
    """Distance of the hand from the target at the end [m]."""
    return away(world, v, s)


@wp.func
def offset(world: int, first: int, v: View, s: Reach, seen: wp.array2d(dtype=wp.float32)):
    """Way from the hand to the target."""
    d = s.target[world] - v.hand[world]
    for k in range(3):
        seen[world, first + k] = d[k]


@wp.func
def threshold(world: int, first: int, v: View, s: Reach, seen: wp.array2d(dtype=wp.float32)):
    """1 where F, with the sensor's noise on it, exceeds a threshold (thesis 4.3.4)."""
    u = uniform4(v.key, world, v.clock.clock[world], 0, 1)
    noise = s.touch_noise * gaussian2(u[0], u[1])[0]
    seen[world, first] = wp.where(s.felt[world] + noise > s.touch_force, 1.0, 0.0)


@wp.func
def classified(world: int, first: int, v: View, s: Reach, seen: wp.array2d(dtype=wp.float32)):
    """1 where a classifier of joint torques tells contact; nothing was told where an episode begins."""
    seen[world, first] = wp.where(v.clock.age[world] > 0, s.told[world], 0.0)


@wp.func
def skin(world: int, first: int, v: View, s: Reach, seen: wp.array2d(dtype=wp.float32)):
    """Net contact force on every link in the base's axes [N], each component with the sensor's noise on it."""
    for j in range(v.force.shape[1]):
        u = uniform4(v.key, world, v.clock.clock[world], j, 1)
        g = gaussian2(u[0], u[1])
        h = gaussian2(u[2], u[3])
        noise = s.touch_noise * wp.vec3(g[0], g[1], h[0])
        for k in range(3):
            seen[world, first + 3 * j + k] = v.force[world, j][k] + noise[k]


FLAGS = {"threshold": threshold, "classifier": classified}
"""Sources of the flag of touch by name, observation groups of one column: the one place where ``reach`` finds them."""
