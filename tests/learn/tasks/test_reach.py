"""Reaching: rewards, flags, forces, laws of control and test sets by hand, every policy's table B.1, exact resume."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import warp as wp
from bough.kernels.tasks import parts as kernels
from bough.kernels.tasks.control import LAWS, drive
from bough.learn.policies.crowding import contacts_without_room
from bough.learn.tasks.clearing import make_reach
from bough.learn.tasks.reach_parts import reach_parts
from bough.learn.tasks.reach_settings import POLICIES, ReachSettings, columns_of
from bough.learn.tasks.registry import known_tasks
from bough.sim.arms.jaco2 import jaco2
from bough.sim.base.errors import InputError
from bough.sim.scenes.reach_scene import PATTERNS, ReachScene, fixed_targets, grow_reach_trees, joint_strength
from bough.sim.scenes.scene import arm_reach
from bough.sim.trees.tree import Joint

WORLDS = 10
SMALL = ReachSettings(scene=ReachScene(order=2, attempts=32), episode_seconds=0.5)


@pytest.fixture(scope="module")
def shared():
    """One task of training for all tests, with a snapshot of its start."""
    task = make_reach("reach", SMALL, num_envs=WORLDS, seed=0)
    return task, task.snapshot()


@pytest.fixture
def env(shared):
    """Return the shared task, at its start."""
    task, start = shared
    task.restore(start)
    return task


def zeros(*shape, dtype=wp.float32):
    return wp.zeros(shape, dtype=dtype, device="cpu")


def worlds_at(parts, hand, target, **state):
    """Return view and own struct of worlds with given hands and targets [W, 3], and arrays of the struct."""
    n = len(hand)
    view, clock, own = kernels.View(), kernels.Clock(), parts.own()
    for name, kind in kernels.Clock.vars.items():
        setattr(clock, name, zeros(n, dtype=kind.type.dtype))
    for name, kind in parts.arrays.items():
        if name == "joint_broken":
            continue
        setattr(own, name, wp.array(state[name], dtype=kind, device="cpu") if name in state else zeros(n, dtype=kind))
    for name, value in parts.numbers.items():
        setattr(own, name, value)
    own.joint_broken = wp.zeros((n, 2), dtype=int, device="cpu")
    own.target, view.hand = (wp.array(np.float32(x), dtype=wp.vec3, device="cpu") for x in (target, hand))
    view.clock, view.q, view.torque = clock, zeros(n, 6), zeros(n, 6)
    view.qd = wp.array(np.full((n, 6), 0.5, np.float32), device="cpu")
    view.force = wp.array(np.zeros((n, 6, 3), np.float32), dtype=wp.vec3, device="cpu")
    view.turn = zeros(n, dtype=wp.vec4)
    return view, own


# ---- reward, forces, flag ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("policy", ["ppo", "pcap"])
def test_reward_is_equation_4_3(policy):
    """By hand: 30 cm off, then inside 5, 2.5 and 1.25 cm, 0.5 rad/s at six joints; 40 N, 41 N and 81 N felt.

    (1 / (1 + 0.09))^2 = 0.841680, times 2, less 0.01 x 1.5; inside the spheres the first is times 2, 4 and 8. PPO's
    does not change with the force: its kernel has no term that reads it.
    """
    d = np.array([0.3, 0.04, 0.02, 0.01, 0.3, 0.3])
    felt = np.float32([40.0, 0.0, 0.0, 0.0, 41.0, 81.0])
    parts = reach_parts(replace(SMALL, policy=policy), 6)
    view, own = worlds_at(parts, np.zeros((6, 3)), np.c_[d, 0 * d, 0 * d], felt=felt)
    rules, reward = kernels.Rules(), zeros(6)
    rules.reward_scale = 0.01
    wp.launch(parts.kernels().judge, dim=6, inputs=[view, own, rules, reward], device="cpu")
    closer = [gain / (1.0 + x * x) ** 2 - 0.015 for x, gain in ((0.04, 4.0), (0.02, 8.0), (0.01, 16.0))]
    plain = np.array([1.668360, *closer, 1.668360, 1.668360])
    contact = plain * [1.2, 1.2, 1.2, 1.2, 0.0, 0.0] + [0, 0, 0, 0, 0, -1.2]
    expected = plain if policy == "ppo" else contact
    np.testing.assert_allclose(reward.numpy(), 0.01 * expected, rtol=2e-6)
    np.testing.assert_allclose(view.clock.total.numpy(), expected, rtol=2e-6)


def test_reward_is_forfeited_and_punished_by_the_force_of_touch():
    """With f_u = 20 N: 1.2 times as much at 20 N felt, nothing at 21 and 40 N, -1.2 at 41 N, 30 cm off."""
    parts = reach_parts(replace(SMALL, touch_force=20.0), 6)
    felt = np.float32([20.0, 21.0, 40.0, 41.0])
    view, own = worlds_at(parts, np.zeros((4, 3)), np.tile([0.3, 0.0, 0.0], (4, 1)), felt=felt)
    rules, reward = kernels.Rules(), zeros(4)
    rules.reward_scale = 1.0
    wp.launch(parts.kernels().judge, dim=4, inputs=[view, own, rules, reward], device="cpu")
    np.testing.assert_allclose(reward.numpy(), [1.2 * 1.668360, 0.0, 0.0, -1.2], rtol=2e-6)


@pytest.mark.parametrize("touch_force", [40.0, 10.0])
def test_forces_of_control_periods_by_hand(touch_force):
    """One link 30 and 40 N across (50 N), another 120 N beside it (130 N), then none: F, means of three, counts.

    The hand of world 1 is 4.9 cm off from the third period on. Above 80 N is one period whatever force the policy's
    flag is set by: policies are compared by what they do, not by what they were rewarded for.
    """
    parts = reach_parts(replace(SMALL, touch_force=touch_force), 6)
    view, own = worlds_at(parts, np.zeros((2, 3)), [[1.0, 0, 0], [0.06, 0, 0]])
    composed = parts.kernels()
    felt = []
    for k, links in enumerate(([(30.0, 0.0, 40.0)], [(30.0, 0.0, 40.0), (0.0, 120.0, 0.0)], [])):
        force = np.zeros((2, 6, 3), np.float32)
        for j, f in enumerate(links):
            force[0, j] = f
        view.force = wp.array(force, dtype=wp.vec3, device="cpu")
        if k == 2:
            view.hand = wp.array(np.float32([[0, 0, 0], [0.011, 0, 0]]), dtype=wp.vec3, device="cpu")
        wp.launch(composed.sample, dim=2, inputs=[view, own], device="cpu")
        felt.append(float(own.felt.numpy()[0]))
    np.testing.assert_allclose(felt, [50 / 3, 60.0, 60.0], rtol=1e-6)
    assert own.force_sum.numpy()[0] == pytest.approx(180.0) and own.broken.numpy().tolist() == [1, 0]
    assert own.arrived.numpy().tolist() == [0, 3]


def test_rolling_retracting_and_slowing_by_hand():
    """Two worlds, nine control periods, the hand on a line to its target 1 m off; F is 5 N in the last two, or never.

    Ways of the hand: 0 (the first has none), then 40, 30, 20 mm (slowing twice), 25 mm (no longer), 15 and 10 mm, then
    8 mm and 2 mm back in contact: two periods of slowing right before contact, two of contact. In the first of those
    the shoulder turns faster than the wrist, in the second the wrist; only there the hand moves off.
    """
    wood = replace(SMALL, scene=replace(SMALL.scene, strength=50.0))
    parts, hand = reach_parts(wood, 6), 0.0
    view, own = worlds_at(parts, np.zeros((2, 3)), [[1.0, 0, 0]] * 2)
    composed = parts.kernels()
    steps = [(0, 0), (40, 0), (30, 0), (20, 0), (25, 0), (15, 0), (10, 0), (8, 5), (-2, 5)]
    for k, (way, newton) in enumerate(steps):
        hand += 1e-3 * way
        force = np.zeros((2, 6, 3), np.float32)
        force[0, 2, 1] = newton
        view.force = wp.array(force, dtype=wp.vec3, device="cpu")
        view.hand = wp.array(np.float32([[hand, 0, 0]] * 2), dtype=wp.vec3, device="cpu")
        speed = [0.3, 0, 0, 0.2, 0, 0] if k < 8 else [0.1, 0, 0, 0, -0.2, 0]
        view.qd = wp.array(np.float32([speed] * 2), device="cpu")
        wp.launch(composed.sample, dim=2, inputs=[view, own], device="cpu")
    own.joint_broken = wp.array([[0, 1], [0, 0]], dtype=int, device="cpu")
    clock, log = view.clock, zeros(2, len(parts.measures))
    rules = kernels.Rules()
    rules.longest = 99
    given = [zeros(1, 1, 1, 2), wp.array([0, 1], dtype=int, device="cpu"), view, own, rules, zeros(2, 2, 6),
             zeros(2, dtype=wp.bool), zeros(2), log, zeros(2, len(parts.measures) + 1)]  # fmt: skip
    wp.launch(composed.close, dim=2, inputs=given, device="cpu")
    said = dict(zip(parts.measures, log.numpy().T, strict=True))
    assert clock.length.numpy().tolist() == [0, 0]
    np.testing.assert_allclose(said["rolling"], [1 / 9, 0])
    np.testing.assert_allclose(said["retracting"], [1 / 9, 0])
    np.testing.assert_allclose(said["slowing"], [2 / 9, 0])
    np.testing.assert_allclose(said["broken"], [1, 0])
    assert "broken" not in reach_parts(SMALL, 6).measures


def test_flag_has_noise_of_one_newton():
    """At 40 N felt a flag of noise is set in half of 4000 worlds, at 39 N in 15.9 %: within five standard errors."""
    parts = reach_parts(SMALL, 6)
    n = 4000
    felt = np.repeat(np.float32([40.0, 39.0]), n // 2)
    view, own = worlds_at(parts, np.zeros((n, 3)), np.ones((n, 3)), felt=felt)
    view.key = wp.vec2ui(3, 4)
    seen = zeros(n, 20)
    wp.launch(parts.kernels().feel, dim=n, inputs=[view, own, seen], device="cpu")
    flag = seen.numpy()[:, 19]
    assert set(flag) == {0.0, 1.0}
    assert abs(flag[: n // 2].mean() - 0.5) < 5 * 0.5 / np.sqrt(n / 2)
    assert abs(flag[n // 2 :].mean() - 0.1587) < 5 * 0.366 / np.sqrt(n / 2)
    np.testing.assert_allclose(seen.numpy()[:, 16:19], 1.0)


def test_skin_feels_every_link():
    """Forces of 5, 7 and -3 N on the fourth link in 3000 worlds, with noise of 1 N: means to five standard errors."""
    n = 3000
    parts = reach_parts(replace(SMALL, policy="skin"), 6)
    view, own = worlds_at(parts, np.zeros((n, 3)), np.ones((n, 3)))
    force = np.zeros((n, 6, 3), np.float32)
    force[:, 3] = [5.0, 7.0, -3.0]
    view.force, view.key = wp.array(force, dtype=wp.vec3, device="cpu"), wp.vec2ui(5, 6)
    seen = zeros(n, 37)
    wp.launch(parts.kernels().feel, dim=n, inputs=[view, own, seen], device="cpu")
    felt = seen.numpy()[:, 19:].reshape(n, 6, 3)
    np.testing.assert_allclose(felt.mean(0), force[0], atol=5 / np.sqrt(n))
    np.testing.assert_allclose(felt.std(0), 1.0, atol=5 / np.sqrt(2 * n))
    assert abs(np.corrcoef(felt.reshape(n, 18).T) - np.eye(18)).max() < 5 / np.sqrt(n)


def test_every_policy_sees_what_table_b_1_says(env):
    """19 numbers for PPO and CPO, a flag more for PCAP, six torques more for PPO+ and CPO+; state and offset agree."""
    widths = {p: columns_of(replace(SMALL, policy=p), 6)[1] for p in POLICIES}
    assert widths == {"ppo": 19, "cpo": 19, "pcap": 20, "ppo+": 25, "cpo+": 25, "ppo-lagrangian": 20, "skin": 37,
                      "pcap-rnn": 20}  # fmt: skip
    for _ in range(2):
        env.step(torch.ones(WORLDS, 6))
    sim, seen = env.simulator, env.observation
    assert torch.equal(seen[:, :16], torch.cat([sim.q, sim.qd, sim.end_rotation], 1))
    np.testing.assert_allclose(seen[:, 16:19], env.places.target - sim.end_position, atol=1e-7)


# ---- control -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "asked"),
    [
        ("nominal", [0.11, 0.11, 0.11, 0.09, 0.09, 0.09]),
        ("plai", [0.01, 0.02, 0.03, 0.02, 0.01, 0.0]),
        ("s3ec", [0.11, 0.12, 0.13, 0.09, 0.08, 0.07]),
        ("ramp", [0.2, 0.4, 0.6, 0.2, -0.2, -0.6]),
    ],
)
def test_laws_of_control_by_hand(law, asked):
    """A joint at 0.1 rad/s throughout, three periods a step, 0.03 rad/s a whole action; actions 1 and then -2.

    An action is clipped to -1 ... 1, so that the second asks for a change of -0.03 in three parts. ``ramp`` leads from
    0 to the limit of 0.6 rad/s and on to minus the limit.
    """
    clock, target, waiting = kernels.Clock(), zeros(1, 1), zeros(2, 1, 1)
    clock.clock, clock.action_delay = zeros(1, dtype=int), zeros(1, dtype=int)
    limit = wp.array([0.6], dtype=wp.float32, device="cpu")
    speed = wp.array([[0.1]], dtype=wp.float32, device="cpu")
    found = []
    for action in (1.0, -2.0):
        given = wp.array([[action]], dtype=wp.float32, device="cpu")
        for period in range(3):
            wp.launch(drive, dim=1, inputs=[given, limit, speed, LAWS.index(law), period, 3, 0.03, clock, waiting,
                                            target], device="cpu")  # fmt: skip
            found.append(float(target.numpy()[0, 0]))
        clock.clock.fill_(clock.clock.numpy()[0] + 1)
    np.testing.assert_allclose(found, asked, atol=1e-7)


# ---- worlds --------------------------------------------------------------------------------------------------------


def test_test_sets_have_fixed_targets_and_five_patterns():
    """60 targets, within reach and in the tree's direction, whatever the seed; unseen trees turned as asked."""
    sets = [make_reach("reach", SMALL, num_envs=WORLDS, seed=seed, test=True) for seed in (1, 2)]
    arm = jaco2()
    shoulder, reach = arm_reach(arm)
    targets = fixed_targets(SMALL.scene, arm)
    assert len(np.unique(targets, axis=0)) == 60
    assert (np.linalg.norm(targets - shoulder, axis=1) <= reach).all()
    for task in sets:
        np.testing.assert_allclose(task.places.target, np.repeat(targets[:2], 5, axis=0), atol=1e-6)
        w, z = task.places.turn[:, 0].numpy(), task.places.turn[:, 3].numpy()
        turn = 2.0 * np.degrees(np.arctan2(z, w)) % 360.0
        np.testing.assert_allclose(turn, np.tile(PATTERNS, 2), atol=1e-3)
        trunk = task.places.root[:, :2].numpy()
        ahead = np.einsum("wi,wi->w", trunk, targets[np.arange(WORLDS) // 5, :2])
        assert (ahead / np.linalg.norm(trunk, axis=1) > 0.0).all()
        assert {name: int(mask.sum()) for name, mask in task.strata().items()} == dict.fromkeys(task.strata(), 2)
    first, second = ([t.mass.sum() for t in task.simulator.model.trees] for task in sets)
    assert not set(first) & set(second)


@pytest.mark.parametrize(
    ("options", "stiffest"), [({}, 100.0), ({"springs": "beam"}, None), ({"forest": "fractal"}, 100.0),
                              ({"joint": "revolute", "forest": "Tc"}, 100.0)],
)  # fmt: skip
def test_every_world_has_a_tree_of_its_own(options, stiffest):
    """No two alike; 100 N m/rad at level 1, half as much at level 2, a fifth of it damping; beams by equation 4.2."""
    scene = replace(SMALL.scene, **options)
    trees = grow_reach_trees(scene, jaco2(), 6, seed=3, domain="test")
    assert len({float(t.mass.sum()) for t in trees}) == 6
    for tree in trees:
        moving = tree.joint != Joint.FIXED
        assert (tree.stiffness[moving] >= 2.0).all() and (tree.damping[moving] >= 1.0).all()
        if stiffest:
            by_level = {int(level): tree.stiffness[moving & (tree.level == level)] for level in (1, 2)}
            np.testing.assert_allclose(by_level[1], 100.0)
            np.testing.assert_allclose(by_level[2], 50.0)
            np.testing.assert_allclose(tree.damping[moving & (tree.level == 1)], 20.0)


def test_all_contacts_are_on_in_tests_alone(env):
    """In training arm and branches touch; in tests the arm itself, branches each other and all a ground below them too.

    There is no line in this task. Two contacts find room in a test for every capsule of arm and branches.
    """
    contacts = env.simulator.contacts
    assert contacts.arm_branch and not (contacts.arm_arm or contacts.branch_branch or contacts.arm_line)
    assert contacts.ground is None
    task = make_reach("reach", SMALL, num_envs=WORLDS, seed=0, test=True)
    contacts, capsules = task.simulator.contacts, task.simulator.capsules.radius.shape[1]
    assert contacts.arm_branch and contacts.arm_arm and contacts.branch_branch and not contacts.arm_line
    assert contacts.ground is not None and contacts.ground <= float(task.foot[:, 2].min())
    assert task.simulator._touch.record.shape == (WORLDS, 2 * capsules) and 2 * capsules > 32
    task.simulator.overflow[2] = 7
    assert contacts_without_room(task) == 7


def test_episodes_end_near_the_target_in_training_alone(env):
    """Within 2.5 cm a training's world ends as at its step limit, succeeded; a test's goes on; targets then change."""
    test = make_reach("reach", SMALL, num_envs=WORLDS, seed=5, test=True)
    for task, ends in ((env, True), (test, False)):
        task.places.target[3] = task.simulator.end_position[3] + torch.tensor([0.0, 0.0, 0.02])
        before = task.places.target.clone()
        _, _, done, extras = task.step(torch.zeros(WORLDS, 6))
        assert done.tolist() == [ends and w == 3 for w in range(WORLDS)]
        assert extras["time_outs"].bool().tolist() == done.tolist()
        assert extras["log"]["success"].tolist() == [float(w == 3) for w in range(WORLDS)]
        assert torch.equal((task.places.target != before).any(1), done)


def test_wood_breaks_at_its_bending_strength():
    """50 MPa break a round joint of 10 mm radius at 39.3 N m; broken joints are counted, kept, and whole again.

    Wood of 0.5 kPa breaks where the arm first bends it; the share of worlds with a broken joint is then told.
    """
    tree = grow_reach_trees(SMALL.scene, jaco2(), 1, seed=3, domain="test")[0]
    radius = tree.shape_radius[list(tree.shape_link).index(1), 0]
    bears = joint_strength(tree, 50.0)[1]
    assert bears == pytest.approx(50e6 * np.pi * radius**3 / 4.0)
    assert 50e6 * np.pi * 0.01**3 / 4.0 == pytest.approx(39.27, abs=0.01)
    weak = replace(SMALL, scene=replace(SMALL.scene, strength=5e-4))
    task = make_reach("reach", weak, num_envs=WORLDS, seed=0)
    for _ in range(2):
        task.step(torch.ones(WORLDS, 6))
    broken = task.simulator.rupture.broken.sum(1)
    assert broken.max() > 0
    kept = task.snapshot()
    ends = []
    for _ in range(2):
        task.restore(kept)
        assert torch.equal(task.simulator.rupture.broken.sum(1), broken)
        for _ in range(3):
            _, _, done, extras = task.step(torch.ones(WORLDS, 6))
        ends.append((extras["log"]["broken"].clone(), task.observation.clone()))
    assert done.all() and ends[0][0].max() > 0
    assert all(torch.equal(a, b) for a, b in zip(*ends, strict=True))
    assert not task.simulator.rupture.broken.any()


def test_restored_task_goes_on_to_the_same_bits(env):
    """Through ends of episodes and new places."""
    actions = 2 * torch.rand(8, WORLDS, 6, generator=torch.Generator().manual_seed(1)) - 1
    for a in actions[:3]:
        env.step(a)
    kept = env.snapshot()
    runs = []
    for _ in range(2):
        env.restore(kept)
        runs.append([torch.cat([o["policy"].ravel(), r, d.float()]) for o, r, d, _ in map(env.step, actions)])
        runs[-1] = [x.clone() for x in runs[-1]]
    assert all(torch.equal(a, b) for a, b in zip(*runs, strict=True))


# ---- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "found"),
    [({"policy": "sac"}, "policy: found sac"), ({"control": "pid"}, "control: found pid"),
     ({"flag": "nose"}, "flag: found nose"), ({"groups": ("torque",)}, "groups: found none"),
     ({"policy_rate": 7.0}, "policy_rate: found 7 Hz"), ({"scene": ReachScene(reach=(0.3, 2.0))}, "reach: found 2 m")],
)  # fmt: skip
def test_settings_that_cannot_be(change, found):
    """One line: what was found, what is allowed."""
    with pytest.raises(InputError) as error:
        make_reach("reach", replace(SMALL, **change), num_envs=1)
    assert found in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("given", "says"),
    [(["--policy", "sac"], "sac; allowed: pcap, ppo, cpo, ppo+, cpo+, ppo-"), (["--set", "forest=oak"], "forest")],
)
def test_command_refuses(forked, given, says, tmp_path):
    """Exit with 2, one line, and nothing written."""
    out = tmp_path / "run"
    done = forked.run("train", "reach", "--out", out, *given)
    assert done.returncode == 2 and says in done.stderr and len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert not out.exists()


@pytest.mark.parametrize(
    ("change", "found"),
    [({"measures": {}}, "measures: found no distance"), ({"rewards": ()}, "rewards: found none"),
     ({"numbers": {}}, "numbers: found"),
     ({"measures": reach_parts(SMALL, 6).measures | {"steps": None}}, "measures: found steps")],
)  # fmt: skip
def test_parts_that_do_not_fit(change, found):
    """One line: the task, the part, what was found."""
    with pytest.raises(InputError) as error:
        replace(reach_parts(SMALL, 6), **change).check()
    assert str(error.value).startswith("reach") and found in str(error.value)


def test_settings_are_changed_by_name():
    """Fields of the settings and of their scene, each as the type that it has."""
    kind = known_tasks().of("reach")
    changed = kind.changed(SMALL, ("forest=Tb", "within=0.03", "order=4", "policy=ppo+"), "evaluate")
    assert (changed.scene.forest, changed.within, changed.scene.order, changed.policy) == ("Tb", 0.03, 4, "ppo+")
    assert kind.changed(SMALL, (), "train") is SMALL
    for refused in ("colour=red", "within=near"):
        with pytest.raises(InputError) as error:
            kind.changed(SMALL, (refused,), "train")
        assert refused.partition("=")[0] in str(error.value)
