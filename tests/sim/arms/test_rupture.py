"""Branches that break: torques by hand, a pendulum in float64, every kind of joint, one world a thread and many."""

import numpy as np
import pytest
import torch
from bough.sim.base.host import simd_width
from bough.sim.trees.stiffness import hold_rest_pose
from bough.sim.trees.tree import Joint
from oracles.contact_case import DT, post, simulator, ternary
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

WIDTHS = [1, simd_width()]
#: Share of its damper that a broken joint keeps.
FIBRES = 0.02
#: Float32 angles of some tenths of a radian: quaternions to 1e-7, their arc tangent too.
SHARP = 1e-5
STIFFNESS = 100.0


def quaternion(vector) -> np.ndarray:
    """Return w, x, y, z of a rotation vector [rad]."""
    return np.roll(Rotation.from_rotvec(vector).as_quat(), 1)


def bent(rng):
    """Return a post for every kind of joint, how it is bent, and its spring's torque (a slide's force) by hand.

    Of ball joints K |log(rest^-1 q)|, of the others K |q - rest|.
    """
    turns = [rng.normal(size=3) * 0.3 for _ in range(3)]
    balls = [(post((50.0, 0.0, 1.0)), s * quaternion(v), STIFFNESS * np.linalg.norm(v))
             for v, s in zip(turns, (1.0, -1.0, 1.0), strict=True)]  # fmt: skip
    rest = post((50.0, 0.0, 1.0)).with_(rest=[quaternion(turns[0])])
    apart = (Rotation.from_rotvec(turns[0]).inv() * Rotation.from_rotvec(turns[1])).magnitude()
    balls.append((rest, quaternion(turns[1]), STIFFNESS * apart))
    hinge = post((50.0, 0.0, 1.0), joint=Joint.REVOLUTE)
    slide = post((50.0, 0.0, 1.0), joint=Joint.PRISMATIC)
    others = [
        (hinge, [0.7], STIFFNESS * 0.7), (hinge, [-2.0], STIFFNESS * 2.0), (slide, [-0.3], STIFFNESS * 0.3),
        (hinge.with_(rest=[[0.2, 0.0, 0.0, 0.0]]), [0.5], STIFFNESS * 0.3),
        (post((50.0, 0.0, 1.0), joint=Joint.FIXED), [], 0.0),
    ]  # fmt: skip
    return balls + others


def springs(sim) -> np.ndarray:
    """Stiffness, damper in effect and pre-load of every link of every world in turn, [links of all, 5]."""
    fields = sim.model.arrays["stiffness"], sim._damping, sim.model.arrays["preload"]
    return np.concatenate([sim.model.gather(f.numpy()) for f in fields], axis=1)


def healed(sim) -> np.ndarray:
    """Reset all worlds and return their springs."""
    sim.reset()
    return springs(sim)


@pytest.mark.parametrize("width", WIDTHS)
def test_joints_break_exactly_above_their_strength(width):
    """Every kind of joint twice, with a strength one part in 10^5 above its torque, and below: only those break."""
    cases = [case for case in bent(np.random.default_rng(0)) for _ in range(2)]
    sim = simulator([tree for tree, _, _ in cases], width=width, breakable=True)
    whole = springs(sim)
    sim.state.set_qpos([np.asarray(q, float) for _, q, _ in cases])
    torque = torch.tensor([torque for *_, torque in cases])
    weak = torch.arange(len(cases)) % 2 == 1
    sim.rupture.strength[:, 0] = torch.where(weak, torque * (1 - SHARP), torque * (1 + SHARP))
    sim.rupture.judge()
    broken = (weak & (torque > 0)).numpy()
    np.testing.assert_array_equal(sim.rupture.broken[:, 0], broken)
    expected = np.where(broken[:, None], whole * [0, FIBRES, 0, 0, 0], whole)
    np.testing.assert_allclose(springs(sim), expected, rtol=1e-6)
    np.testing.assert_array_equal(healed(sim), whole)


def test_a_broken_branch_falls_as_a_pendulum():
    """A leaning post that its pre-load holds: whole it swings about that pose, broken it falls, to 1 % of the angle.

    I phi'' = m g c sin(phi) - FIBRES D phi' in float64, phi from the upright. Its pre-load is gone with its spring.
    """
    tree = hold_rest_pose(post((50.0, 0.0, 1.0), direction=(1.0, 0.0, 1.0)))
    sim = simulator([tree] * 2, breakable=True, substeps=32)
    sim.state.set_qpos(quaternion([0.0, 0.1, 0.0]))  # about y, across the plane that it leans in
    sim.rupture.strength[0] = 5.0
    found = []
    for _ in range(120):
        sim.rupture.judge()
        sim.step()
        found.append([2 * np.arctan2(q[2], q[0]) for q in sim.state.qpos()])
    assert sim.rupture.broken[:, 0].tolist() == [1, 0]
    inertia = tree.inertia[0, 1, 1] + tree.mass[0] * 0.2**2

    def fall(t, y):
        return [y[1], (tree.mass[0] * 9.81 * 0.2 * np.sin(y[0]) - FIBRES * tree.damping[0] * y[1]) / inertia]

    ode = solve_ivp(fall, (0, 0.5), [np.pi / 4 + 0.1, 0.0], t_eval=DT * np.arange(1, 121), rtol=1e-9, atol=1e-12)
    falling, swinging = np.array(found).T
    assert ode.y[0, -1] > 2.0
    np.testing.assert_allclose(falling + np.pi / 4, ode.y[0], rtol=0.01)
    assert np.abs(swinging).max() < 0.1 and abs(swinging[-1]) < 0.01


def swept(width: int):
    """Make 20 worlds of different trees with joints of different strengths, beside arms that sweep through them."""
    rng = np.random.default_rng(4)
    trees = [hold_rest_pose(ternary(rng, order=2)) for _ in range(20)]
    sim = simulator(trees, width=width, breakable=True)
    sim.rupture.strength.copy_(torch.tensor(rng.uniform(1.0, 8.0, (20, 13)), dtype=torch.float32))
    sim.rupture.strength[::4] = torch.inf
    sim.target[:, 0] = 0.8
    return sim, np.array([tree.stiffness for tree in trees])


def angles(sim) -> np.ndarray:
    """Turn of every ball joint [rad] by SciPy, [worlds, links]."""
    q = np.array(sim.state.qpos()).reshape(-1, 4)
    return Rotation.from_quat(np.roll(q, -1, axis=1)).magnitude().reshape(sim.model.num_worlds, -1)


@pytest.mark.parametrize("width", WIDTHS)
def test_an_arm_breaks_what_its_push_bends_too_far(width):
    """After every step those joints are broken whose K times angle, by SciPy, has passed their strength at some step.

    Then one half of the worlds is reset: it is whole again, with its springs to the bit; the other half stays broken.
    """
    sim, stiffness = swept(width)
    whole, strength = springs(sim), sim.rupture.strength.numpy()
    expected = np.zeros(strength.shape, bool)
    for _ in range(160):
        sim.step()
        torque = np.where(expected, 0.0, stiffness * angles(sim))
        assert (np.abs(torque / strength - 1.0) > SHARP).all()  # none is too near to tell
        expected |= torque > strength
        np.testing.assert_array_equal(sim.rupture.broken, expected)
    assert sim.faults() == [] and not expected[::4].any() and 10 < expected.sum() < expected.size / 2
    half = torch.arange(20) % 2 == 0
    broken = springs(sim)
    sim.reset(half)
    links = np.repeat(half.numpy(), 13)
    np.testing.assert_array_equal(sim.rupture.broken, expected & ~half.numpy()[:, None])
    np.testing.assert_array_equal(springs(sim), np.where(links[:, None], whole, broken))
    np.testing.assert_array_equal(healed(sim), whole)


def test_lanes_change_no_bit():
    """The same worlds, one a thread and many a thread: the same joints break and all move alike to the bit."""
    one, many = (swept(width)[0] for width in WIDTHS)
    for _ in range(120):
        one.step()
        many.step()
    assert one.rupture.broken.any()
    assert torch.equal(one.rupture.broken, many.rupture.broken)
    np.testing.assert_array_equal(one.state.qpos(), many.state.qpos())


def test_note_takes_the_springs_of_whole_joints():
    """After a change the new springs are those that a reset gives back; a joint broken before keeps its old one."""
    sim = simulator([post((50.0, 0.0, 1.0))] * 2, breakable=True)
    sim.state.set_qpos(quaternion([0.3, 0.0, 0.0]))
    sim.rupture.strength[0] = 1.0
    sim.rupture.judge()
    sim.model.arrays["stiffness"].torch.mul_(2.0)
    sim.refresh()
    sim.rupture.note()
    sim.rupture.strength[:] = 1.0
    sim.rupture.judge()
    assert sim.rupture.broken[:, 0].tolist() == [1, 1]
    assert healed(sim)[:, 0].tolist() == [STIFFNESS, 2 * STIFFNESS]
