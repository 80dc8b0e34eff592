"""The clearing task: rewards and counters by hand, observations by NumPy, memory that never moves, exact resume."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import warp as wp
from bough.kernels.tasks import parts as kernels
from bough.learn.policies.crowding import contacts_without_room
from bough.learn.tasks.clearing import make_task
from bough.learn.tasks.clearing_parts import clearing_parts
from bough.learn.tasks.names import CLEARING
from bough.learn.tasks.overlaps import Overlaps
from bough.learn.tasks.registry import plain, settings_from
from bough.learn.tasks.settings import GROUPS, PRESETS, TaskSettings, columns_of
from bough.sim.base.errors import InputError
from bough.sim.scenes.scene import SceneSettings
from torch.utils._python_dispatch import TorchDispatchMode

WORLDS = 12
SMALL = TaskSettings(scene=SceneSettings(distinct=4), episode_steps=8, max_noise=(0.005, 0.02))


def make(name="powerline", settings=SMALL, worlds=WORLDS, seed=0, **options):
    return make_task(name, settings, num_envs=worlds, seed=seed, device="cpu", **options)


@pytest.fixture(scope="module")
def shared():
    """One task for all tests, with a snapshot of its start."""
    task = make()
    return task, task.snapshot()


@pytest.fixture
def env(shared):
    """Return the shared task, at its start."""
    task, start = shared
    task.restore(start)
    return task


def actions(steps, worlds=WORLDS, seed=0):
    return 2 * torch.rand(steps, worlds, 6, generator=torch.Generator().manual_seed(seed)) - 1


def run(env, acts):
    """Step through actions; return observations, rewards and dones of every step."""
    rows = []
    for a in acts:
        o, r, d, _ = env.step(a)
        rows.append((o["policy"].clone(), r.clone(), d.clone()))
    return [torch.stack(column) for column in zip(*rows, strict=True)]


# ---- reward and counters -------------------------------------------------------------------------------------------


def test_reward_is_equation_5_9(env):
    """By hand: h = 1, still, clear: 0.25 + 0.4; otherwise float64 NumPy of the state that was acted in."""
    still = (env.scene.breach == 0.0).numpy()
    h = env.sensor.occlusion.numpy().copy()
    assert ((h == 1.0) & still).any()
    r = env.step(torch.zeros(WORLDS, 6))[1]
    np.testing.assert_allclose(r[(h == 1.0) & still], 0.65, atol=1e-6)
    for a in actions(3):  # seven steps in all: the episode has eight
        env.step(a)
        assert env.simulator.qd.abs().max() > 0.1
        h, breach, qd = (x.numpy().astype(float) for x in (env.sensor.occlusion, env.sensor.breach, env.simulator.qd))
        expected = (1 / (1 + h**2)) ** 2 - (qd**2).sum(1) / 100 + 0.4 * (breach == 0)
        bits = in_float32(h, breach, qd)
        found = env.step(a)[1].numpy()
        np.testing.assert_allclose(found, expected, atol=2e-6)
        np.testing.assert_array_equal(found, bits)


def in_float32(h, breach, qd):
    """Return equation 5.9 in the order of operations that version 2 of the task has always had, every one rounded."""
    f = np.float32
    h, breach, qd = h.astype(f), breach.astype(f), qd.astype(f)
    share, effort = f(1) / (f(1) + h * h), np.zeros_like(h)
    for j in range(qd.shape[1]):
        effort = effort + qd[:, j] * qd[:, j]
    return share * share - effort / f(100) + f(0.4) * (f(1) - breach)


def judged(occlusion, breach=None, longest=100):
    """Run the kernels of judging and closing on given scores [steps, worlds]; return counters and logs by step."""
    n = occlusion.shape[1]
    breach = np.zeros_like(occlusion) if breach is None else breach
    parts = clearing_parts("powerline", SMALL, 6)
    clock, own, view, rules = kernels.Clock(), parts.own(), kernels.View(), kernels.Rules()
    for struct, kinds in ((clock, {k: v.type.dtype for k, v in kernels.Clock.vars.items()}), (own, parts.arrays)):
        for name, kind in kinds.items():
            setattr(struct, name, wp.zeros(n, dtype=kind, device="cpu"))
    rules.longest, rules.reward_scale, own.success_steps = longest, 1.0, 10
    f = lambda *shape: wp.full(shape, np.nan, dtype=wp.float32, device="cpu")  # noqa: E731
    zeros = lambda *shape: wp.zeros(shape, dtype=wp.float32, device="cpu")  # noqa: E731
    slot = wp.array(np.arange(n), dtype=wp.int32, device="cpu")
    done, log, sums = wp.zeros(n, dtype=wp.bool, device="cpu"), f(n, 5), zeros(n, 6)
    alive = wp.full((n, 1, 1, 1), 1.0, dtype=wp.float32, device="cpu")
    view.clock, view.q, view.qd, composed = clock, zeros(n, 6), zeros(n, 6), parts.kernels()
    rows = []
    for h, b in zip(occlusion, breach, strict=True):
        own.occlusion, own.breach = (wp.array(x, dtype=wp.float32, device="cpu") for x in (h, b))
        wp.launch(composed.judge, dim=n, inputs=[view, own, rules, f(n)], device="cpu")
        inputs = [alive, slot, view, own, rules, zeros(1, n, 6), done, f(n), log, sums]
        wp.launch(composed.close, dim=n, inputs=inputs, device="cpu")
        rows.append((done.numpy().copy(), log.numpy().copy()))
    return rows, sums.numpy()


def test_success_takes_ten_clear_steps_in_a_row():
    """Nine clear steps, one covered, nine clear: none; ten in a row anywhere: success that stays."""
    h = np.full((30, 3), 0.5, np.float32)
    h[2:11, 0] = h[12:21, 0] = 0.0
    h[2:12, 1] = 0.0
    h[:, 2] = 0.0
    rows, _ = judged(h)
    success = np.array([log[:, 1] for _, log in rows])
    assert success[:, 0].sum() == 0
    assert (success[:11, 1] == 0).all() and (success[11:, 1] == 1).all()
    assert (success[:9, 2] == 0).all() and (success[9:, 2] == 1).all()


def test_log_is_that_of_the_finished_episode():
    """Return, drop, share in breach and steps clear of 12-step episodes by hand; sums add them up."""
    h = np.linspace(1.0, 0.0, 12, dtype=np.float32)[:, None].repeat(2, 1)
    h[:, 1] = 0.8
    breach = np.zeros((12, 2), np.float32)
    breach[:3, 1] = 1.0
    rows, sums = judged(np.concatenate([h, h]), np.concatenate([breach, breach]), longest=12)
    assert [i for i, (done, _) in enumerate(rows) if done.any()] == [11, 23]
    log = rows[11][1]
    reward = (1 / (1 + h.astype(float) ** 2)) ** 2 + 0.4 * (1 - breach)
    np.testing.assert_allclose(log[:, 0], reward.sum(0), rtol=1e-6)
    np.testing.assert_allclose(log[:, 2], [1.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(log[:, 3], [0.0, 0.25])
    np.testing.assert_allclose(log[:, 4], [1.0, 0.0])
    np.testing.assert_allclose(rows[23][1], log)
    np.testing.assert_allclose(sums, np.c_[2 * log, [2, 2]], rtol=1e-6)


# ---- observations --------------------------------------------------------------------------------------------------


def test_observations_are_table_5_1(env):
    """All 88 numbers of a moving world against float64 NumPy on the sensor's points and the simulator's state.

    Embedding to 5e-6 (float32 sums of 512 terms), the rest to the bit but for rounding of distances.
    """
    run(env, actions(3))
    s, seen = env.sensor, env.observation.numpy()
    assert seen.shape == (WORLDS, 88)
    sim = env.simulator
    np.testing.assert_array_equal(seen[:, :6], sim.q.numpy())
    np.testing.assert_array_equal(seen[:, 6:12], sim.qd.numpy())
    np.testing.assert_array_equal(seen[:, 12:16], sim.end_rotation.numpy())
    points, near, w = (x.numpy().astype(float) for x in (*s.clouds(), s.frequencies))
    rob, clr, wbr = (points[:, k].transpose(0, 2, 1) for k in range(3))
    every = np.ones_like(near)
    for cloud, mask, column in ((wbr, every, 16), (wbr, near, 32), (clr, every, 48), (rob, every, 64)):
        phase = cloud @ w.T
        features = np.stack([np.cos(phase), np.sin(phase)], -1).reshape(*phase.shape[:2], -1) / np.sqrt(len(w))
        mean = (features * mask[..., None]).sum(1) / np.maximum(mask.sum(1), 1)[:, None]
        np.testing.assert_allclose(seen[:, column : column + 16], mean, atol=5e-6)
    hand = sim.end_position.numpy().astype(float)
    for world in range(WORLDS):
        nearest = np.sort(np.linalg.norm(wbr[world] - hand[world], axis=1))[:5]
        np.testing.assert_allclose(seen[world, 81:86], nearest, atol=1e-6)
        pairs = np.linalg.norm(wbr[world][:, None] - clr[world][None], axis=-1)
        counts = [(pairs < 0.10 + slack).sum() for slack in (-1e-6, 1e-6)]  # float32 decides within a micrometre
        assert min(counts[0], 200) / 200 - 1e-7 <= seen[world, 87] <= min(counts[1], 200) / 200 + 1e-7
        margin = np.sort(np.linalg.norm(rob[world][:, None] - clr[world][None], axis=-1).ravel())[:5].mean()
        assert abs(margin - 0.04) < 1e-6 or seen[world, 86] == (margin < 0.04)


def test_touch_is_force_above_the_threshold(env):
    """Net forces written by hand: 50 N on one link of one world, 30 N elsewhere; noise of 1 N changes neither."""
    env.simulator.arm_force.zero_()
    env.simulator.arm_force[:, 2, 1] = 30.0
    env.simulator.arm_force[4, 5] = torch.tensor([30.0, 0.0, 40.0])
    env._launch(env._kernels.feel, env._view, env._own, env._seen)
    touch = env.observation[:, env.columns["touch"]]
    assert touch.tolist() == [float(w == 4) for w in range(WORLDS)]


@pytest.mark.parametrize("left_out", GROUPS)
def test_a_group_left_out_leaves_the_others_as_they_are(env, left_out):
    """Columns of all other features equal those of the full task, which draws the same points, to the bit."""
    kept = tuple(g for g in GROUPS if g != left_out)
    other = make(settings=replace(SMALL, groups=kept))
    acts = actions(3)
    full, part = run(env, acts)[0], run(other, acts)[0]
    wide = env.columns | {"end": 88}
    order = sorted(wide.values())
    assert set(other.columns) < set(env.columns)
    width = 0
    for name, first in other.columns.items():
        size = order[order.index(wide[name]) + 1] - wide[name]
        assert torch.equal(part[..., first : first + size], full[..., wide[name] : wide[name] + size])
        width += size
    assert part.shape[-1] == width


def test_servo_targets_follow_a_schedule_by_hand(monkeypatch):
    """At 10 and 60 Hz actions 0, 1, -0.5 become sixths of the way: 1/6 ... 1, then 0.75 ... -0.5, times the limit.

    World 1 acts a step late. An action that is held stays, and the next episode starts from standing still.
    """
    env = make(settings=replace(SMALL, action_delay=1, episode_steps=4), worlds=2)
    env._counts["action_delay"].copy_(torch.tensor([0, 1]))
    asked, step = [], env.simulator.step
    monkeypatch.setattr(
        env.simulator, "step", lambda count: (asked.append((count, env.simulator.target.clone())), step(count))
    )
    for a in (1.0, -0.5, -0.5, 2.0, 1.0):
        env.step(torch.full((2, 6), a))
        if env.done.all():
            env._counts["action_delay"].copy_(torch.tensor([0, 1]))
    assert [count for count, _ in asked] == [4] * 30
    sixths = np.arange(1, 7) / 6
    rise, fall, still = sixths, 1.0 - 1.5 * sixths, np.full(6, -0.5)
    expected = np.array([[*rise, *fall, *still, *(1.5 * sixths - 0.5), *rise],
                         [*(0 * rise), *rise, *fall, *still, *(0 * rise)]])  # fmt: skip
    found = torch.stack([target for _, target in asked], dim=1).numpy()
    np.testing.assert_allclose(found, expected[..., None] * env.simulator.arm.velocity_limit, atol=1e-6)


def test_one_control_period_a_step_is_the_action():
    """At 60 and 60 Hz the target is the limit times the action, to the bit."""
    env = make(settings=replace(SMALL, policy_rate=60.0), worlds=2)
    limit = torch.tensor(env.simulator.arm.velocity_limit, dtype=torch.float32)
    for a in actions(3, 2):
        env.step(a)
        assert torch.equal(env.simulator.target, limit * a)


def test_noise_on_points_changes_no_score():
    """Score a noisy world as its twin without noise, to the bit, reward and log included; what is seen differs."""
    few = replace(SMALL.scene, branches=1, pairs=(150.0, 250.0))  # scores below 1
    twins = [make(settings=replace(SMALL, scene=few, max_noise=(d, d))) for d in (0.0, 0.04)]
    for a in actions(SMALL.episode_steps):
        seen = [twin.step(a)[0]["policy"].clone() for twin in twins]
        for name in ("reward", "done", "time_out"):
            assert torch.equal(*(getattr(twin, name) for twin in twins))
        assert torch.equal(*(twin.sensor.occlusion for twin in twins))
        assert torch.equal(*(twin.sensor.breach for twin in twins))
        assert not torch.equal(seen[0][:, 87], seen[1][:, 87])
    assert all(torch.equal(*(twin._extras["log"][name] for twin in twins)) for name in twins[0].metrics)


def test_latency_delays_actions_and_observations_by_whole_steps():
    """With delays set by hand, world w acts a_{t-w%3} and sees what world 0 of a twin without delay saw w%3 ago."""
    late = make(settings=replace(SMALL, action_delay=2, observation_delay=2, episode_steps=50))
    c, delay = late._counts, torch.arange(WORLDS) % 3
    c["observation_delay"].copy_(delay)
    c["action_delay"].copy_(2 - delay)
    limit = torch.tensor(late.simulator.arm.velocity_limit, dtype=torch.float32)
    now = [wp.to_torch(late._warp["now"]).clone()] * 3
    asked = [torch.zeros(WORLDS, 6)] * 3
    for a in 1.5 * actions(6):
        late.step(a)
        now.append(wp.to_torch(late._warp["now"]).clone())
        asked.append(a.clamp(-1, 1))
        for w in range(WORLDS):
            assert torch.equal(late.observation[w], now[-1 - int(delay[w])][w])
            assert torch.equal(late.simulator.target[w], limit * asked[-1 - (2 - int(delay[w]))][w])


def test_start_is_covered_and_doing_nothing_fails(env):
    """Mean start score at least 0.7 (thesis 5.4.1) by the task's own sensor; no world clears itself."""
    assert env.sensor.occlusion.mean() >= 0.7
    for _ in range(SMALL.episode_steps):
        env.step(torch.zeros(WORLDS, 6))
        assert (env.sensor.occlusion > 0).all()


# ---- episodes ------------------------------------------------------------------------------------------------------


def test_episodes_end_by_length_and_only_those_worlds_restart(env):
    """Worlds whose age is set near the end restart; all others go on to the bit as if none had."""
    start, acts = env.snapshot(), actions(4)
    plain_run = run(env, acts)
    env.restore(start)
    env.episode_length_buf = torch.where(torch.arange(WORLDS) % 3 == 0, SMALL.episode_steps - 2, 0)
    mixed = run(env, acts)
    restarted = torch.arange(WORLDS) % 3 == 0
    assert torch.equal(mixed[2][1], restarted) and mixed[2][[0, 2, 3]].sum() == 0
    for a, b in zip(plain_run, mixed, strict=True):
        assert torch.equal(a[:, ~restarted], b[:, ~restarted])
    assert torch.equal(env.time_out, torch.zeros(WORLDS))
    still = mixed[0][1][restarted]
    assert torch.equal(still[:, :6], env.simulator.start_q[restarted]) and still[:, 6:12].abs().max() == 0
    assert torch.equal(env.episode_length_buf, torch.where(restarted, 2, 4).int())


def test_a_lost_world_ends_without_a_time_out_and_is_sound_again(env):
    """A NaN in one world's joints ends its episode; the other worlds and what is returned stay finite."""
    env.simulator.q[5] = float("nan")
    o, r, d, x = env.step(torch.zeros(WORLDS, 6))
    assert d.tolist() == [w == 5 for w in range(WORLDS)]
    assert x["time_outs"].sum() == 0 and env.lost.tolist() == [int(w == 5) for w in range(WORLDS)]
    assert o["policy"].isfinite().all() and r.isfinite().all()
    assert not run(env, actions(3))[2].any()


def test_episode_log_counts_finished_episodes_once(env):
    """Means over all that ended since the last call; then nothing."""
    env.episode_log()
    run(env, actions(SMALL.episode_steps - 1))
    *_, extras = env.step(torch.zeros(WORLDS, 6))
    assert env.done.all() and tuple(extras["log"]) == env.metrics and (env.time_out == 1).all()
    found = env.episode_log()
    assert found["episodes"] == WORLDS
    for name in env.metrics:
        assert found[name] == pytest.approx(float(extras["log"][name].mean()), rel=1e-5)
    assert env.episode_log() == {"episodes": 0.0}


# ---- what a test tells ---------------------------------------------------------------------------------------------


def test_overlaps_by_hand():
    """Upright rods 1 m apart; then one thing moves into another at a time by a known depth, in world 1 alone.

    Depths: link 1 into the base's neighbour 30 mm, a branch into the arm 10, into a branch 5, into the line 8, below
    the ground 20. Branches that overlap at the start never count.
    """
    start = np.ones((2, 6, 3), np.float32)  # the arm's base, its links 0 and 1, three branches
    start[:, :, 0] = [0.0, 1.0, 2.0, 3.0, 4.0, 4.01]  # the last two branches overlap from the start
    start[:, :, 1] = 0.0
    sim = SimpleNamespace(
        model=SimpleNamespace(device=wp.get_device("cpu")),
        capsules=SimpleNamespace(
            start=wp.array(start, dtype=wp.vec3), end=wp.array(start + np.float32([0, 0, 0.4]), dtype=wp.vec3),
            radius=wp.array(np.full((2, 6), 0.02, np.float32)), num_arm=3,
        ),
        line=SimpleNamespace(start=wp.array(np.float32([[9, -1, 1.2]] * 2), dtype=wp.vec3),
                             end=wp.array(np.float32([[9, 1, 1.2]] * 2), dtype=wp.vec3), radius=0.01),
        _arm=SimpleNamespace(constants=SimpleNamespace(
            shape_link=wp.array([-1, 0, 1], dtype=int), pair=wp.array([[0, 2]], dtype=int))),
    )  # fmt: skip
    watch = Overlaps(sim, wp.array(np.zeros((2, 3), np.float32), dtype=wp.vec3))
    both = torch.tensor([True, True])
    watch.measure(both)
    assert all(row == {"steps %": 0.0, "deepest mm": 0.0} for row in watch.rows().values())
    ends = [sim.capsules.start.numpy(), sim.capsules.end.numpy()]
    moves = [(2, (0.01, 0.0, 0.0)), (3, (1.03, 0.0, 0.0)), (3, (3.965, 0.0, 0.0)), (4, (8.978, 0.0, 0.0)),
             (3, (3.0, 0.0, -1.0))]  # fmt: skip
    for body, to in moves:
        kept = [e[1, body].copy() for e in ends]
        shift = np.float32([to[0] - kept[0][0], 0.0, to[2]])
        for e, before in zip(ends, kept, strict=True):
            e[1, body] = before + shift
        watch.measure(both)
        watch.measure(torch.tensor([True, False]))
        for e, before in zip(ends, kept, strict=True):
            e[1, body] = before
    depth = {"arm and arm": 30, "arm and branches": 10, "branches and branches": 5, "branches and line": 8,
             "branches and ground": 20}  # fmt: skip
    steps = 2 + 3 * len(moves)
    for kind, row in watch.rows().items():
        assert row["deepest mm"] == pytest.approx(depth.get(kind, 0.0), abs=0.01), kind
        assert row["steps %"] == pytest.approx(100 / steps if kind in depth else 0.0), kind


def test_in_tests_the_arm_does_not_pass_through_itself():
    """Random speeds for 4 s: in training the arm passes through itself by centimetres, in tests it does not.

    Ten millimetres at most where servos of up to 40 N m press links together; nothing touches the ground.
    """
    found = {}
    for test in (False, True):
        task = make(settings=replace(SMALL, episode_steps=200), worlds=24, test=test)
        watch, every = task.watch(), torch.ones(24, dtype=torch.bool)
        for a in actions(4, 24).repeat_interleave(10, dim=0):
            task.step(a)
            watch.measure(every)
        found[test] = watch.rows()
        assert not task.lost.any() and not task.simulator.overflow.any()
        assert found[test]["arm and ground"]["deepest mm"] == 0.0
    assert found[False]["arm and arm"]["deepest mm"] > 20.0
    assert found[True]["arm and arm"]["deepest mm"] < 10.0
    contacts = task.simulator.contacts
    assert contacts.arm_arm and contacts.branch_branch and contacts.ground is not None
    assert contacts.ground <= float(task.scene.root[:, 2].min())


@pytest.mark.parametrize("preset", list(PRESETS))
def test_room_for_contacts_follows_the_scene(preset):
    """In tests two contacts find room for every capsule of arm and branches; what finds none is told of the task."""
    task = make(settings=PRESETS[preset], worlds=4, test=True)
    capsules = task.simulator.capsules.radius.shape[1]
    assert task.simulator._touch.record.shape == (4, 2 * capsules) and 2 * capsules > 32
    assert contacts_without_room(task) == 0
    task.simulator.overflow[2] = 7
    assert contacts_without_room(task) == 7


# ---- memory and resume ---------------------------------------------------------------------------------------------


def test_what_a_step_returns_is_the_kernels_memory(env):
    """Pointers of observations, rewards, dones, time-outs and actions are the Warp arrays', before and after steps."""

    def pointers():
        o, r, d, x = env.step(env.actions)
        return [
            t.data_ptr() for t in (o["policy"], r, d, x["time_outs"], env.actions, env.get_observations()["policy"])
        ]

    names = ("observation", "reward", "done", "time_out", "actions", "observation")
    assert pointers() == pointers() == [env._warp[name].ptr for name in names]


class Calls(TorchDispatchMode):
    """Notes every torch operation that is not a view."""

    def __init__(self):
        super().__init__()
        self.names = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        self.names.append(str(func))
        return func(*args, **(kwargs or {}))


def test_a_step_allocates_and_copies_nothing(env, monkeypatch):
    """With actions in the task's own tensor a step makes no torch operation and asks Warp's allocators for nothing."""
    run(env, actions(2))
    asked, device = [], wp.get_device("cpu")
    allocator = type(device.get_allocator())
    for name in ("allocate", "alloc"):
        if hasattr(allocator, name):
            real = getattr(allocator, name)
            monkeypatch.setattr(allocator, name, lambda self, size, real=real: asked.append(size) or real(self, size))
    wp.zeros(4, device="cpu")
    assert asked, "the allocator is not where this test looks"
    asked.clear()
    with Calls() as calls:
        for _ in range(3):
            env.step(env.actions)
    assert asked == []
    assert calls.names == []


def test_a_captured_step_is_the_step(env):
    """A graph's replays, a reset among them, equal the launches one by one to the bit."""
    start, acts = env.snapshot(), actions(SMALL.episode_steps + 2)
    expected = run(env, acts)
    env.restore(start)
    env.capture()
    try:
        found = run(env, acts)
    finally:
        env._graph = None
    assert found[2].any()
    for a, b in zip(expected, found, strict=True):
        assert torch.equal(a, b)


def test_a_fresh_task_goes_on_from_a_snapshot_to_the_bit(env):
    """A second task of the same arguments, restored in mid-episode, repeats what the first did afterwards."""
    run(env, actions(5))
    kept, later = env.snapshot(), actions(SMALL.episode_steps, seed=1)
    shown = env.get_observations()["policy"].clone()
    expected = run(env, later)
    fresh = make()
    run(fresh, actions(2, seed=3))
    fresh.restore(kept)
    assert torch.equal(fresh.get_observations()["policy"], shown)
    for a, b in zip(expected, run(fresh, later), strict=True):
        assert torch.equal(a, b)


def test_a_snapshot_of_another_task_is_refused_and_changes_nothing(env):
    kept = env.snapshot()
    before = env.observation.clone()
    with pytest.raises(ValueError, match="another task"):
        env.restore({name: t for name, t in kept.items() if name != "task reward"})
    with pytest.raises(ValueError, match="shape"):
        env.restore(kept | {"task reward": torch.zeros(3)})
    assert torch.equal(env.observation, before)


def test_seeds_and_test_sets_differ(env):
    """The same seed gives the same start; another seed, or the test set of the same seed, another tree and place."""
    same, other, test = make(), make(seed=1), make(test=True)
    assert torch.equal(same.observation, env.observation)
    for task in (other, test):
        assert not torch.isclose(task.scene.root[:, :2], env.scene.root[:, :2]).any()
        assert (task.observation[:, 16:32] - env.observation[:, 16:32]).abs().max() > 1e-3
    assert (env.simulator.line_mask == 0).all() and (test.simulator.line_mask == 1).all()


# ---- other targets, settings, pictures -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["exposure", "inspection"])
def test_other_targets_are_covered_and_run(name):
    """A fruit and a panel: covered at the start by 0.7 on average, finite under random actions for an episode."""
    task = make(name, replace(SMALL, scene=replace(SMALL.scene, distinct=8)), worlds=32)
    assert task.sensor.occlusion.mean() >= 0.7
    observed, reward, done = run(task, actions(SMALL.episode_steps, 32))
    assert observed.isfinite().all() and reward.isfinite().all() and done[-1].all()
    target = task.sensor.clouds()[0][:, 1].numpy()
    length = np.linalg.norm(np.ptp(target, axis=2), axis=1)
    low, high = {"exposure": (0.15, 0.25), "inspection": (0.25, 0.60)}[name]  # a ball of 6 cm; 25-35 by 20 cm
    assert (length > low).all() and (length < high).all()


@pytest.mark.parametrize("preset", PRESETS)
def test_every_world_of_a_preset_has_a_tree_of_its_own(preset):
    """In training and in tests no two worlds have the same wood, and no tree of a test is one of training."""
    settings = replace(PRESETS[preset], episode_steps=4)
    tasks = [make(settings=settings, worlds=6, test=test) for test in (False, True)]
    wood = [tree.shape_radius.tobytes() for task in tasks for tree in task.simulator.model.trees]
    assert len(set(wood)) == 12


def test_settings_survive_json():
    for settings in (*PRESETS.values(), SMALL):
        assert settings_from(TaskSettings, plain(settings), "test") == settings
        for name in CLEARING:
            assert columns_of(settings.of(name), 6)[1] == 88


def test_a_picture_shows_arm_line_and_branches(env):
    """Uint8 [H, W, 3], and other worlds give other pictures."""
    one, two = env.render(0), env.render(1)
    assert one.dtype == np.uint8 and one.shape == two.shape == (360, 480, 3)
    assert (one != two).any() and one.std() > 5


@pytest.mark.parametrize(
    ("call", "found"),
    [
        (lambda: make("pruning"), "pruning"),
        (lambda: make(worlds=0), "0"),
        (lambda: make(settings=replace(SMALL, groups=("kme", "smell"))), "smell"),
        (lambda: make(settings=replace(SMALL, groups=())), "none"),
        (lambda: make(settings=replace(SMALL, policy_rate=7.0)), "7 Hz"),
        (lambda: make(settings=replace(SMALL, episode_steps=0)), "0"),
        (lambda: make(settings=replace(SMALL, scene=replace(SMALL.scene, reach=(1.0, 3.0)))), "3 m from the shoulder"),
        (lambda: make(settings=replace(SMALL, scene=replace(SMALL.scene, distance=(1.9, 2.0)))), "reach"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(call, found):
    with pytest.raises(InputError) as error:
        call()
    assert found in str(error.value) and "\n" not in str(error.value)
