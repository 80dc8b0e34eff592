"""Effects of branches that an arm pushes: the laws of the plain step, beside contact."""

import numpy as np
import pytest
import torch
from bough.learn.tasks.memory import simulator_tensors
from bough.sim.base.errors import InputError
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from oracles.contact_case import LAWS, STRETCHED, contacts_of, drive, give, pushed_posts, pushes, simulator, ternary
from scipy.spatial.transform import Rotation

FAR = (6.0, 0.0, 0.0)


@pytest.mark.parametrize("width", [1, 8])
def test_out_of_reach_the_step_is_the_plain_one(width):
    """Move as the plain simulator's worlds do under the same laws, to the bit: contact adds nothing where none is."""
    trees = [ternary(np.random.default_rng(k), order=2, root=FAR) for k in range(4)]
    sim = simulator(trees, width=width, effects=tuple(LAWS))
    plain = Simulator(Model(trees, width=width), threads=1, effects=tuple(LAWS))
    for each in (sim, plain):
        give(each.effects)
        each.step(3)
        for _ in range(40):
            each.step(4)
    here, there = sim.state.qpos(), plain.state.qpos()
    np.testing.assert_array_equal(np.concatenate(here), np.concatenate(there))
    still = simulator(trees, width=width)
    still.step(163)
    assert np.abs(np.concatenate(still.state.qpos()) - np.concatenate(here)).max() > 1e-3


def test_neutral_effects_keep_the_bits_of_contact():
    """Sweep through trees with all effects compiled and none on: the same bits as without them."""
    trees = [ternary(np.random.default_rng(k)) for k in range(8)]
    ends = []
    for names in ((), tuple(LAWS)):
        sim = simulator(trees, width=8, effects=names)
        sim.target[:, 0] = 0.6
        touched = 0.0
        for _ in range(24):
            sim.step(10)
            touched = max(touched, float(sim.arm_force.abs().max()))
        assert touched > 1.0
        ends.append(np.concatenate([*map(np.ravel, sim.state.qpos()), sim.q.numpy().ravel()]))
    np.testing.assert_array_equal(*ends)


def test_a_push_settles_at_the_force_of_the_cubic_spring():
    """Push posts whose springs stiffen: K (1 + kappa |phi|^2) phi = r x f within 2 %, as for a plain spring."""
    trees, q, arm = pushed_posts(12)
    sim = simulator(trees, arm, q=q, gravity=(0.0, 0.0, 0.0), effects=tuple(LAWS))
    sim.effects["cubic_stiffness"]["cubic_radm2"].fill_(20.0)
    drive(sim, 14.0, lambda t: [0.15, 0, 0, 0, 0, 0])
    pushed, stiffened = 0, 0
    for w, _, turn, moment in pushes(sim, trees):
        tree = trees[w]
        pushed += 1
        spring = tree.stiffness[0] * (1.0 + 20.0 * turn @ turn) * turn
        assert np.linalg.norm(moment - spring) < 0.02 * np.linalg.norm(moment)
        stiffened += 20.0 * turn @ turn > 0.1
    assert pushed >= 10 and stiffened >= 4  # the law shows in many of them


def test_a_branch_that_yields_stays_bent():
    """Push posts far and let go: each stays s (|phi| - y) off, hardened in all directions, until it is reset.

    5 %: the arm's links turn a post a little about other axes while they slide along it.
    """
    trees, q, arm = pushed_posts(6)
    sim = simulator(trees, arm, q=q, gravity=(0.0, 0.0, 0.0), effects=tuple(LAWS))
    give(sim.effects, {"plastic_set": {"share": 0.5, "yield_rad": 0.02, "isotropic": 1.0}})
    angles = drive(
        sim, 6.0, lambda t: [0.25 if t < 2.0 else -0.25, 0, 0, 0, 0, 0],
        lambda sim: [np.linalg.norm(Rotation.from_quat(np.roll(x, -1)).as_rotvec()) for x in sim.state.qpos()],
    )  # fmt: skip
    most, free = angles.max(axis=0), np.array([not contacts_of(sim, w)["force"].any() for w in range(6)])
    bent = free & (most > 0.06)
    assert bent.sum() >= 3
    np.testing.assert_allclose(angles[-1][bent], 0.5 * (most[bent] - 0.02), rtol=0.05)
    sim.reset()
    sim.target.zero_()
    sim.step(240)
    assert max(np.abs(np.asarray(x)[1:]).max() for x in sim.state.qpos()) < 1e-4


def test_worlds_in_lanes_equal_worlds_alone():
    """Give the same bits in eight lanes as one world a thread, in contact and with values of every world's own."""
    trees, ends = [ternary(np.random.default_rng(k)) for k in range(8)], []
    for width in (1, 8):
        sim = simulator(trees, width=width, effects=tuple(LAWS))
        give(sim.effects)
        sim.effects["dry_friction"]["torque_Nm"].mul_(torch.linspace(0.2, 2.0, 8)[:, None])
        sim.target[:, 0] = 0.6
        sim.step(200)
        assert sim.faults() == [] and float(sim.arm_peak.max()) > 1.0
        ends.append(np.concatenate([*map(np.ravel, sim.state.qpos()), sim.q.numpy().ravel()]))
    np.testing.assert_array_equal(*ends)


def test_what_a_simulator_carries_includes_memories():
    """Go back to a snapshot in the middle of a push, and live through the same again, to the bit."""
    trees, q, arm = pushed_posts(4)
    sim = simulator(trees, arm, q=q, effects=tuple(LAWS))
    give(sim.effects)
    sim.target[:, 0] = 0.25
    sim.step(300)
    kept = {name: tensor.clone() for name, tensor in simulator_tensors(sim).items()}
    sim.step(120)
    end = np.concatenate(sim.state.qpos())
    for name, tensor in simulator_tensors(sim).items():
        tensor.copy_(kept[name])
    sim.step(120)
    np.testing.assert_array_equal(np.concatenate(sim.state.qpos()), end)


def test_effects_of_a_sensor_are_refused():
    """Name what makes sense in a measured case only."""
    with pytest.raises(InputError, match="'force_bias', an effect of measured cases"):
        simulator(ternary(np.random.default_rng(0)), q=STRETCHED, effects=("force_bias",))
