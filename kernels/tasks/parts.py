"""What a task is made of: device functions of one world, composed at build time into one kernel a phase.

A part is a function of (world, view, own), ``own`` being the task's struct of what it remembers and its numbers:

    reward terms       r <- r + f or, for a factor, r <- r f, in the order that they are declared in
    notes              what is remembered of a state that is judged, before its age is counted
    samples            the same after every control period
    measures           what is said of an episode
    end conditions     whether an episode is over, as its length or a lost world say by themselves
    reset rules        what a new episode begins with
    observation groups functions of (world, first column, view, own, observation)

Parts that are not declared are not compiled: nothing is asked at run time about what a task has.
"""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.philox import uniform4

__all__ = ["Clock", "Rules", "View", "count_on", "deliver", "phase_kernels", "price_kernel"]


@wp.struct
class Clock:
    """What every task counts, [worlds] each.

    ``length`` is the episode's age as the trainer sees (and may set) it, ``age`` the steps that were really made;
    ``clock`` counts policy steps for ever, ``lost`` worlds that the guard froze, ``total`` sums rewards.
    """

    length: wp.array(dtype=int)
    age: wp.array(dtype=int)
    episode: wp.array(dtype=int)
    clock: wp.array(dtype=int)
    lost: wp.array(dtype=int)
    action_delay: wp.array(dtype=int)
    observation_delay: wp.array(dtype=int)
    total: wp.array(dtype=wp.float32)


@wp.struct
class Rules:
    """Numbers of every task: key of random numbers, steps of an episode, greatest latencies, what rewards are times."""

    key: wp.vec2ui
    longest: int
    action_delay: int
    observation_delay: int
    reward_scale: float


@wp.struct
class View:
    """What parts see of the arm: joints [worlds, dof] in rad, rad/s, N m, net contact force on each link [N], hand.

    ``hand`` is the end-effector [m], ``turn`` its orientation w, x, y, z, ``target`` the speeds that servos are asked
    for.
    """

    q: wp.array2d(dtype=wp.float32)
    qd: wp.array2d(dtype=wp.float32)
    torque: wp.array2d(dtype=wp.float32)
    target: wp.array2d(dtype=wp.float32)
    force: wp.array2d(dtype=wp.vec3)
    hand: wp.array(dtype=wp.vec3)
    turn: wp.array(dtype=wp.vec4)
    clock: Clock
    key: wp.vec2ui


# ---- chains ------------------------------------------------------------------------------------------------------

_taken: dict[str, int] = {}


def _function(body: Callable[..., Any], name: str) -> Any:
    """Return a device function whose name no other has: Warp overloads functions of one name."""
    _taken[name] = count = _taken.get(name, -1) + 1
    return wp.func(body, name=name if count == 0 else f"{name}_{count}")


def _sum_of(terms: Sequence[tuple[Any, bool]], key: str) -> Any:
    def none(world: int, v: Any, s: Any):
        """The reward before any term: 0."""
        return wp.float32(0.0)

    def plus(before: Any, term: Any, name: str) -> Any:
        """Return the function before + term."""

        def added(world: int, v: Any, s: Any):
            """Reward of a world up to here, plus this term."""
            return before(world, v, s) + term(world, v, s)

        return _function(added, name)

    def times(before: Any, term: Any, name: str) -> Any:
        """Return the function before x term."""

        def scaled(world: int, v: Any, s: Any):
            """Reward of a world up to here, times this factor."""
            return before(world, v, s) * term(world, v, s)

        return _function(scaled, name)

    chain = _function(none, f"reward_{key}")
    for n, (term, factor) in enumerate(terms):
        chain = (times if factor else plus)(chain, term, f"reward_{key}_{n}")
    return chain


def _all_of(parts: Sequence[Any], key: str) -> Any:
    """Device function that calls parts one after the other."""

    def none(world: int, v: Any, s: Any):
        """Do nothing; where a chain begins."""
        pass

    def then(before: Any, part: Any, name: str) -> Any:
        """Return the function that calls those before and then a part."""

        def both(world: int, v: Any, s: Any):
            """Call the parts before, then this one, for a world."""
            before(world, v, s)
            part(world, v, s)

        return _function(both, name)

    chain = _function(none, key)
    for n, part in enumerate(parts):
        chain = then(chain, part, f"{key}_{n}")
    return chain


def _any_of(conditions: Sequence[Any], key: str) -> Any:
    def none(world: int, v: Any, s: Any):
        """False; where a chain of conditions begins."""
        return wp.bool(False)

    def either(before: Any, condition: Any, name: str) -> Any:
        """Return the function that is true where those before or a condition are."""

        def met(world: int, v: Any, s: Any):
            """Whether a world meets this condition or any before."""
            return before(world, v, s) or condition(world, v, s)

        return _function(met, name)

    chain = _function(none, key)
    for n, condition in enumerate(conditions):
        chain = either(chain, condition, f"{key}_{n}")
    return chain


def _log_of(measures: Sequence[Any], key: str) -> Any:
    def none(world: int, v: Any, s: Any, log: Any):
        """Write nothing; where a chain of measures begins."""
        pass

    def then(before: Any, measure: Any, column: int, name: str) -> Any:
        """Return the function that writes the columns before and then a measure into its own."""

        def written(world: int, v: Any, s: Any, log: Any):
            """Write the measures up to this one into a world's row of ``log`` [worlds, measures]."""
            before(world, v, s, log)
            log[world, wp.static(column)] = measure(world, v, s)

        return _function(written, name)

    chain = _function(none, f"log_{key}")
    for k, measure in enumerate(measures):
        chain = then(chain, measure, k, f"log_{key}_{k}")
    return chain


def _sight_of(groups: Sequence[tuple[Any, int]], key: str) -> Any:
    def none(world: int, v: Any, s: Any, seen: Any):
        """Show nothing; where a chain of groups begins."""
        pass

    def then(before: Any, group: Any, first: int, name: str) -> Any:
        """Return the function that writes the groups before and then a group from column ``first`` on."""

        def shown(world: int, v: Any, s: Any, seen: Any):
            """Write the groups of observations up to this one into a world's row of ``seen`` [worlds, columns]."""
            before(world, v, s, seen)
            group(world, wp.static(first), v, s, seen)

        return _function(shown, name)

    chain = _function(none, f"sight_{key}")
    for n, (group, first) in enumerate(groups):
        chain = then(chain, group, first, f"sight_{key}_{n}")
    return chain


# ---- phases ------------------------------------------------------------------------------------------------------


@wp.func
def pick(u: float, most: int) -> int:
    """Whole number 0..most of a uniform one."""
    return wp.min(int(u * float(most + 1)), most)


@wp.func
def begin_counting(world: int, r: Rules, c: Clock):
    """Draw a new episode's latencies; what is counted starts at zero."""
    u = uniform4(r.key, world, c.episode[world], 0, 0)
    c.action_delay[world] = pick(u[0], r.action_delay)
    c.observation_delay[world] = pick(u[1], r.observation_delay)
    c.length[world] = 0
    c.age[world] = 0
    c.total[world] = 0.0


@wp.func
def is_lost(
    world: int, alive: wp.array4d(dtype=wp.float32), slot: wp.array(dtype=int), v: View,
) -> bool:  # fmt: skip
    """Whether the simulation lost a world: its tree was frozen, or its arm is no longer finite."""
    lanes = alive.shape[3]
    lost = alive[slot[world] // lanes, 0, 0, slot[world] % lanes] < 0.0
    for j in range(v.q.shape[1]):
        if not (wp.isfinite(v.q[world, j]) and wp.isfinite(v.qd[world, j])):
            lost = True
    return lost


def phase_kernels(
    key: str, own: Any, *, rewards: Sequence[tuple[Any, bool]], notes: Sequence[Any], samples: Sequence[Any],
    measures: Sequence[Any], ends: Sequence[Any], cuts: Sequence[Any], resets: Sequence[Any],
    groups: Sequence[tuple[Any, int]],
) -> SimpleNamespace:  # fmt: skip
    """Return the kernels ``begin``, ``judge``, ``sample``, ``close`` and ``feel`` of a task, one thread a world.

    Args:
        key: Name of the task, part of the functions' names.
        own: The task's struct.
        rewards: Terms, each with whether it is a factor.
        notes: Functions (world, view, own) that write what is remembered of a judged state into ``own``.
        samples: The same of a control period.
        resets: The same where a new episode begins.
        measures: Functions that return what is said of an episode, float.
        ends: Functions that return whether an episode is over for good, bool.
        cuts: The same where what would have come counts on (a time-out).
        groups: Functions of observation groups, each with its first column.
    """
    judging = _judging(key, own, rewards, notes)
    return SimpleNamespace(
        judge=judging, sample=_sampling(key, own, samples), feel=_feeling(key, own, groups),
        begin=_beginning(key, own, resets), close=_closing(key, own, measures, ends, cuts, resets),
    )  # fmt: skip


def _judging(key: str, own: Any, rewards: Sequence[tuple[Any, bool]], notes: Sequence[Any]) -> Any:
    Own, reward_of, note = own, _sum_of(rewards, key), _all_of(notes, f"note_{key}")

    @wp.kernel(enable_backward=False, module="unique")
    def judge(v: View, own_out: Own, r: Rules, reward_out: wp.array(dtype=wp.float32)):
        """Reward of the present state, and what is remembered of it."""
        world = wp.tid()
        reward = reward_of(world, v, own_out)
        reward_out[world] = r.reward_scale * reward
        c = v.clock
        c.total[world] = c.total[world] + reward
        note(world, v, own_out)
        c.age[world] = c.age[world] + 1
        c.length[world] = c.length[world] + 1

    return judge


def _sampling(key: str, own: Any, samples: Sequence[Any]) -> Any:
    Own, sampled = own, _all_of(samples, f"sample_{key}")

    @wp.kernel(enable_backward=False, module="unique")
    def sample(v: View, own_out: Own):
        """Remember a control period."""
        sampled(wp.tid(), v, own_out)

    return sample


def price_kernel(own: Any, cost: Any) -> Any:
    """Return the kernel ``price`` of a task under a constraint: what a policy step costs, one thread a world."""
    Own = own

    @wp.kernel(enable_backward=False, module="unique")
    def price(v: View, own_in: Own, cost_out: wp.array(dtype=wp.float32)):
        """Cost of the policy step that was just made; nothing where a world was lost."""
        world = wp.tid()
        found = cost(world, v, own_in)
        cost_out[world] = wp.where(wp.isfinite(found), found, 0.0)

    return price


def _beginning(key: str, own: Any, resets: Sequence[Any]) -> Any:
    Own, reset = own, _all_of(resets, f"first_{key}")

    @wp.kernel(enable_backward=False, module="unique")
    def begin(mask_in: wp.array(dtype=wp.bool), v: View, own_out: Own, r: Rules):
        """Draw the first episode of the masked worlds."""
        world = wp.tid()
        if mask_in[world]:
            begin_counting(world, r, v.clock)
            reset(world, v, own_out)

    return begin


def _closing(
    key: str, own: Any, measures: Sequence[Any], ends: Sequence[Any], cuts: Sequence[Any], resets: Sequence[Any]
) -> Any:
    Own, count = own, len(measures)
    log = _log_of(measures, key)
    ended, cut = _any_of(ends, f"end_{key}"), _any_of(cuts, f"cut_{key}")
    reset = _all_of(resets, f"reset_{key}")

    @wp.kernel(enable_backward=False, module="unique")
    def close(
        alive_in: wp.array4d(dtype=wp.float32), slot_in: wp.array(dtype=int), v: View, own_out: Own, r: Rules,
        waiting_out: wp.array3d(dtype=wp.float32), done_out: wp.array(dtype=wp.bool),
        time_out_out: wp.array(dtype=wp.float32), log_out: wp.array2d(dtype=wp.float32),
        sums_out: wp.array2d(dtype=wp.float32),
    ):  # fmt: skip
        """Say which episodes are over and begin the next there.

        ``log_out`` holds the measures of the episode so far; ``sums_out`` their sums over finished episodes, and how
        many those were.
        """
        world = wp.tid()
        c = v.clock
        lost = is_lost(world, alive_in, slot_in, v)
        c.clock[world] = c.clock[world] + 1
        over = c.length[world] >= r.longest or cut(world, v, own_out)
        stopped = lost or ended(world, v, own_out)
        log(world, v, own_out, log_out)
        done_out[world] = over or stopped
        time_out_out[world] = wp.where(over and not stopped, 1.0, 0.0)
        if over or stopped:
            for k in range(count):
                sums_out[world, k] = sums_out[world, k] + log_out[world, k]
            sums_out[world, count] = sums_out[world, count] + 1.0
            if lost:
                c.lost[world] = c.lost[world] + 1
            c.episode[world] = c.episode[world] + 1
            begin_counting(world, r, c)
            reset(world, v, own_out)
            for slot in range(waiting_out.shape[0]):
                for j in range(waiting_out.shape[2]):
                    waiting_out[slot, world, j] = 0.0

    return close


def _feeling(key: str, own: Any, groups: Sequence[tuple[Any, int]]) -> Any:
    Own, show = own, _sight_of(groups, key)

    @wp.kernel(enable_backward=False, module="unique")
    def feel(v: View, own_in: Own, observation_out: wp.array2d(dtype=wp.float32)):
        """Write the observation groups."""
        show(wp.tid(), v, own_in, observation_out)

    return feel


@wp.kernel(enable_backward=False)
def count_on(clock_out: Clock):
    """Count a policy step, as ``close`` does."""
    world = wp.tid()
    clock_out.clock[world] = clock_out.clock[world] + 1


@wp.kernel(enable_backward=False)
def deliver(
    now_in: wp.array2d(dtype=wp.float32),
    clock_in: Clock,
    kept_out: wp.array3d(dtype=wp.float32),
    observation_out: wp.array2d(dtype=wp.float32),
):
    """Observation <- what was sensed as many steps ago as the world's latency says; a new episode knows its start."""
    world = wp.tid()
    slots = kept_out.shape[0]
    clock = clock_in.clock[world]
    late = (clock + slots - clock_in.observation_delay[world]) % slots
    for k in range(now_in.shape[1]):
        kept_out[clock % slots, world, k] = now_in[world, k]
    if clock_in.age[world] == 0:
        for slot in range(slots):
            for k in range(now_in.shape[1]):
                kept_out[slot, world, k] = now_in[world, k]
    for k in range(now_in.shape[1]):
        observation_out[world, k] = kept_out[late, world, k]
