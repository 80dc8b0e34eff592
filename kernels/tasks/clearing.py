"""Kernels of a clearing task: actions in, reward and counters, what the arm feels, observations as late as they are.

A policy step judges the state that the action was chosen in, then acts:

    r = (1 / (1 + h^2))^2 - sum_j qd_j^2 / 100 + 0.4 [no breach]                                    (5.9)

with the occlusion h and the safety breach of points without noise, whatever the policy was shown, and the joint speeds
qd. The action becomes the servos' target over the step's control periods, in equal slices (thesis 4.4).
"""

import warp as wp

from ..lanes.philox import gaussian2, uniform4

__all__ = ["Counters", "TaskRules", "act", "begin", "close", "deliver", "feel", "judge"]


@wp.struct
class Counters:
    """What a world remembers between policy steps, [worlds] each.

    ``length`` is the episode's age as the trainer sees (and may set) it, ``age`` the steps that were really made;
    ``streak`` counts steps without occlusion in a row, ``lost`` worlds that the guard froze.
    """

    length: wp.array(dtype=int)
    age: wp.array(dtype=int)
    episode: wp.array(dtype=int)
    clock: wp.array(dtype=int)
    streak: wp.array(dtype=int)
    clear: wp.array(dtype=int)
    breaches: wp.array(dtype=int)
    succeeded: wp.array(dtype=int)
    lost: wp.array(dtype=int)
    action_delay: wp.array(dtype=int)
    observation_delay: wp.array(dtype=int)
    first_occlusion: wp.array(dtype=wp.float32)
    last_occlusion: wp.array(dtype=wp.float32)
    total: wp.array(dtype=wp.float32)


@wp.struct
class TaskRules:
    """Numbers of the task, the same in all worlds."""

    key: wp.vec2ui
    longest: int
    success_steps: int
    touch_force: float
    touch_noise: float
    max_noise: wp.vec2
    action_delay: int
    observation_delay: int


@wp.func
def pick(u: float, most: int) -> int:
    """Whole number 0..most of a uniform one."""
    return wp.min(int(u * float(most + 1)), most)


@wp.func
def draw_episode(world: int, r: TaskRules, c: Counters, max_noise_out: wp.array(dtype=wp.float32)):
    """Draw a new episode's latencies and the reach d_max of its point noise; its counters start at zero."""
    u = uniform4(r.key, world, c.episode[world], 0, 0)
    c.action_delay[world] = pick(u[0], r.action_delay)
    c.observation_delay[world] = pick(u[1], r.observation_delay)
    max_noise_out[world] = r.max_noise[0] + (r.max_noise[1] - r.max_noise[0]) * u[2]
    c.length[world] = 0
    c.age[world] = 0
    c.streak[world] = 0
    c.clear[world] = 0
    c.breaches[world] = 0
    c.succeeded[world] = 0
    c.total[world] = 0.0


@wp.kernel(enable_backward=False)
def begin(
    mask_in: wp.array(dtype=wp.bool), r: TaskRules, counters_out: Counters, max_noise_out: wp.array(dtype=wp.float32)
):
    """Draw the first episode of the masked worlds."""
    world = wp.tid()
    if mask_in[world]:
        draw_episode(world, r, counters_out, max_noise_out)


@wp.kernel(enable_backward=False)
def judge(
    occlusion_in: wp.array(dtype=wp.float32),
    breach_in: wp.array(dtype=wp.float32),
    speed_in: wp.array2d(dtype=wp.float32),
    r: TaskRules,
    counters_out: Counters,
    reward_out: wp.array(dtype=wp.float32),
):
    """Reward (5.9) of the present state, and what it adds to the counters."""
    world = wp.tid()
    c = counters_out
    h = occlusion_in[world]
    cleared = 1.0 / (1.0 + h * h)
    effort = wp.float32(0.0)
    for j in range(speed_in.shape[1]):
        effort = effort + speed_in[world, j] * speed_in[world, j]
    reward = cleared * cleared - effort / 100.0 + 0.4 * (1.0 - breach_in[world])
    reward_out[world] = reward
    c.total[world] = c.total[world] + reward
    if c.age[world] == 0:
        c.first_occlusion[world] = h
    c.last_occlusion[world] = h
    c.age[world] = c.age[world] + 1
    c.length[world] = c.length[world] + 1
    c.breaches[world] = c.breaches[world] + int(breach_in[world])
    c.streak[world] = wp.where(h == 0.0, c.streak[world] + 1, 0)
    c.clear[world] = c.clear[world] + wp.where(h == 0.0, 1, 0)
    if c.streak[world] >= r.success_steps:
        c.succeeded[world] = 1


@wp.kernel(enable_backward=False)
def act(
    action_in: wp.array2d(dtype=wp.float32),
    speed_limit_in: wp.array(dtype=wp.float32),
    share: float,
    counters_in: Counters,
    waiting_out: wp.array3d(dtype=wp.float32),
    target_out: wp.array2d(dtype=wp.float32),
):
    """Target speed <- limit x a share of the way from the last action to this one, for one control period.

    This one is the action, clipped to [-1, 1], of as many steps ago as the world's latency says, and the last one that
    of a step before. A share of 1 is the action to the bit.
    """
    world = wp.tid()
    slots = waiting_out.shape[0]
    clock = counters_in.clock[world]
    late = (clock + slots - counters_in.action_delay[world]) % slots
    before = (late + slots - 1) % slots
    for j in range(target_out.shape[1]):
        waiting_out[clock % slots, world, j] = wp.clamp(action_in[world, j], -1.0, 1.0)
        asked = (1.0 - share) * waiting_out[before, world, j] + share * waiting_out[late, world, j]
        target_out[world, j] = speed_limit_in[j] * asked


@wp.kernel(enable_backward=False)
def close(
    alive_in: wp.array4d(dtype=wp.float32),
    slot_in: wp.array(dtype=int),
    joint_in: wp.array2d(dtype=wp.float32),
    speed_in: wp.array2d(dtype=wp.float32),
    r: TaskRules,
    counters_out: Counters,
    waiting_out: wp.array3d(dtype=wp.float32),
    max_noise_out: wp.array(dtype=wp.float32),
    done_out: wp.array(dtype=wp.bool),
    time_out_out: wp.array(dtype=wp.float32),
    log_out: wp.array2d(dtype=wp.float32),
    sums_out: wp.array2d(dtype=wp.float32),
):
    """Say which episodes are over, by their length or because the simulation lost the world, and begin the next there.

    ``log_out`` holds return, success, occlusion drop, share of steps in breach and steps clear, of the episode so far;
    ``sums_out`` their sums over finished episodes, and how many those were.
    """
    world = wp.tid()
    c = counters_out
    lanes = alive_in.shape[3]
    lost = alive_in[slot_in[world] // lanes, 0, 0, slot_in[world] % lanes] < 0.0
    for j in range(joint_in.shape[1]):
        if not (wp.isfinite(joint_in[world, j]) and wp.isfinite(speed_in[world, j])):
            lost = True
    c.clock[world] = c.clock[world] + 1
    over = c.length[world] >= r.longest
    first = c.first_occlusion[world]
    log_out[world, 0] = c.total[world]
    log_out[world, 1] = float(c.succeeded[world])
    log_out[world, 2] = wp.where(first > 0.0, 1.0 - c.last_occlusion[world] / first, 0.0)
    log_out[world, 3] = float(c.breaches[world]) / float(wp.max(c.age[world], 1))
    log_out[world, 4] = float(c.clear[world])
    done_out[world] = over or lost
    time_out_out[world] = wp.where(over and not lost, 1.0, 0.0)
    if over or lost:
        for k in range(5):
            sums_out[world, k] = sums_out[world, k] + log_out[world, k]
        sums_out[world, 5] = sums_out[world, 5] + 1.0
        if lost:
            c.lost[world] = c.lost[world] + 1
        c.episode[world] = c.episode[world] + 1
        draw_episode(world, r, c, max_noise_out)
        for slot in range(waiting_out.shape[0]):
            for j in range(waiting_out.shape[2]):
                waiting_out[slot, world, j] = 0.0


@wp.kernel(enable_backward=False)
def feel(
    joint_in: wp.array2d(dtype=wp.float32),
    speed_in: wp.array2d(dtype=wp.float32),
    turn_in: wp.array(dtype=wp.vec4),
    force_in: wp.array2d(dtype=wp.vec3),
    r: TaskRules,
    counters_in: Counters,
    columns_in: wp.array(dtype=int),
    observation_out: wp.array2d(dtype=wp.float32),
):
    """Write joint positions, speeds, the hand's orientation and touch at columns_in[0..3], -1 for a group left out.

    Touch is 1 where the net force on any link, with the sensor's noise on it, exceeds the threshold.
    """
    world = wp.tid()
    dofs = joint_in.shape[1]
    if columns_in[0] >= 0:
        for j in range(dofs):
            observation_out[world, columns_in[0] + j] = joint_in[world, j]
            observation_out[world, columns_in[1] + j] = speed_in[world, j]
        for j in range(4):
            observation_out[world, columns_in[2] + j] = turn_in[world][j]
    if columns_in[3] >= 0:
        touch = wp.float32(0.0)
        for j in range(dofs):
            u = uniform4(r.key, world, counters_in.clock[world], j, 1)
            noise = r.touch_noise * gaussian2(u[0], u[1])[0]
            if wp.length(force_in[world, j]) + noise > r.touch_force:
                touch = 1.0
        observation_out[world, columns_in[3]] = touch


@wp.kernel(enable_backward=False)
def deliver(
    now_in: wp.array2d(dtype=wp.float32),
    counters_in: Counters,
    kept_out: wp.array3d(dtype=wp.float32),
    observation_out: wp.array2d(dtype=wp.float32),
):
    """Observation <- what was sensed as many steps ago as the world's latency says; a new episode knows its start."""
    world = wp.tid()
    slots = kept_out.shape[0]
    clock = counters_in.clock[world]
    late = (clock + slots - counters_in.observation_delay[world]) % slots
    for k in range(now_in.shape[1]):
        kept_out[clock % slots, world, k] = now_in[world, k]
    if counters_in.age[world] == 0:
        for slot in range(slots):
            for k in range(now_in.shape[1]):
                kept_out[slot, world, k] = now_in[world, k]
    for k in range(now_in.shape[1]):
        observation_out[world, k] = kept_out[late, world, k]
