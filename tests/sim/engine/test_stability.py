"""Implicit shares of springs: a step that needs them gets them, stays bounded and finds the equilibrium."""

import mujoco
import numpy as np
import pytest
import torch
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.trees.tree import Joint, Tree
from oracles.mujoco_tree import compiled, equilibrium, trajectory
from oracles.random_tree import random_qpos, random_tree

DT = 1.0 / 240.0


def effective(simulator: Simulator) -> np.ndarray:
    """Damping in effect, D + gamma h K, of all links of all worlds."""
    return simulator.model.gather(simulator._damping.numpy())[:, 0]


def springy(seed: int, links: int, **options) -> Tree:
    """Make a tree of stiff springs with weak dampers on ball joints, whose twist no explicit step resolves."""
    options = {"joints": (Joint.SPHERICAL, Joint.REVOLUTE), "stiffness": (30.0, 300.0), "max_children": 3} | options
    return random_tree(np.random.default_rng(seed), links, **options)


def spectral_radius(tree: Tree, damping: np.ndarray, dt: float, qpos: np.ndarray | None = None) -> float:
    """Greatest growth a step of small motions about a pose (joint zero), gravity left out.

    With MuJoCo's joint-space inertia M:
    v' = v - h (M + h D')^-1 (K q + D' v),  q' = q + h v',  D' the damping in effect.
    """
    model, data = compiled(tree, dt)
    data.qpos[:] = data.qpos if qpos is None else qpos
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    dofs = np.array([Joint(int(j)).dofs for j in tree.joint])
    K, D = np.diag(np.repeat(tree.stiffness, dofs)), np.diag(np.repeat(damping, dofs))
    solve, one = np.linalg.inv(M + dt * D), np.eye(model.nv)
    kick, drag = -dt * solve @ K, one - dt * solve @ D
    step = np.block([[one + dt * kick, dt * drag], [kick, drag]])
    return float(np.abs(np.linalg.eigvals(step)).max())


@pytest.mark.parametrize("links", [1, 4, 12, 30])
def test_small_motions_do_not_grow(links):
    """Take the step's eigenvalues from MuJoCo's inertia: beyond one with explicit springs, within one with ours."""
    tree = springy(links, links, damping_ratio=(0.001, 0.02))
    simulator = Simulator(Model([tree], precision=64), dt=DT)
    assert spectral_radius(tree, tree.damping, DT) > 1.01
    assert spectral_radius(tree, effective(simulator), DT) < 1.0


def test_small_motions_of_a_heavy_load_on_a_light_link_do_not_grow():
    """Carry heavy links with stiff springs on a light one with a soft spring, bent.

    What the springs further out take leaves the light link a negative inertia, which its own share must make up for.
    """
    rng = np.random.default_rng(8)
    for _ in range(40):
        tree = random_tree(rng, int(rng.integers(1, 9)), joints=tuple(Joint))
    start = random_qpos(np.random.default_rng(0), tree, 0.3)
    simulator = Simulator(Model([tree], precision=64), dt=DT)
    simulator.state.set_qpos(start)
    simulator.refresh()
    assert tree.mass[0] < 0.1 * tree.mass.sum()
    assert spectral_radius(tree, tree.damping, DT, start) > 1.5
    assert spectral_radius(tree, effective(simulator), DT, start) < 1.0


def test_share_of_a_single_hinge():
    """Compare with the closed form: gamma h K = n + h K / 2 where n = h K / 2 - 2 margin I / h - D > 0, else 0."""
    for stiffness, damping in ((1.0, 0.0), (50.0, 0.01), (300.0, 0.01), (300.0, 0.5), (300.0, 2.0)):
        tree = springy(0, 1, joints=(Joint.REVOLUTE,)).with_(stiffness=[stiffness], damping=[damping])
        arm = tree.com[0] - tree.anchor[0]
        full = tree.inertia[0] + tree.mass[0] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        about_axis = tree.axis[0] @ full @ tree.axis[0]
        need = stiffness * DT / 2 - 2 * Simulator.MARGIN * about_axis / DT - damping
        extra = need + stiffness * DT / 2 if need > 0 else 0.0
        got = effective(Simulator(Model([tree], precision=64), dt=DT))
        np.testing.assert_allclose(got, damping + extra, rtol=1e-12)


def test_no_share_where_explicit_springs_are_safe():
    """Leave trees alone that MuJoCo steps with room to spare: their dampers keep their bits and nothing is limited."""
    trees = [springy(k, 3 + k, damping_ratio=(0.5, 2.0), stiffness=(1.0, 30.0)) for k in range(8)]
    simulator = Simulator(Model(trees, width=8), dt=1e-3)
    assert torch.equal(simulator._damping.torch, simulator.model.arrays["damping"].torch)
    assert (simulator._limit.torch == simulator.max_speed).all()


def test_a_world_s_share_does_not_depend_on_its_neighbours():
    """Put a tree that needs implicit springs beside seven that do not: those keep their dampers."""
    calm = [springy(k, 4, damping_ratio=(0.5, 2.0), stiffness=(1.0, 5.0)) for k in range(7)]
    simulator = Simulator(Model([*calm, springy(9, 4, damping_ratio=(0.001, 0.01))], width=8), dt=1e-3)
    damping = np.concatenate([t.damping for t in simulator.model.trees])
    raised = effective(simulator) > damping * (1 + 1e-6)
    assert raised[-4:].all() and not raised[:-4].any()


UNSTABLE = [(1, 3), (2, 5), (3, 9), (4, 13), (5, 20), (6, 40), (7, 5), (8, 9)]


def weakly_damped() -> tuple[list[Tree], list[np.ndarray]]:
    trees = [springy(seed, n, damping_ratio=(0.01, 0.1)) for seed, n in UNSTABLE]
    rng = np.random.default_rng(11)
    return trees, [random_qpos(rng, t, 0.2) for t in trees]


@pytest.mark.parametrize(("width", "precision"), [(1, 64), (8, 32)])
def test_bounded_where_mujoco_blows_up(width, precision):
    """Step for 10 s at 1/240 s what MuJoCo cannot: no world freezes, and none ever holds more energy than at the start.

    A hundredth of the moving energy is allowed for the integrator's own ripple.
    """
    trees, starts = weakly_damped()
    assert sum(trajectory(t, q, DT, 240) is None for t, q in zip(trees, starts, strict=True)) >= 6
    simulator = Simulator(Model(trees, width=width, precision=precision), dt=DT)
    simulator.state.set_qpos(starts)
    simulator.refresh()
    first = simulator.energy()[0]
    for _ in range(100):
        simulator.step(24)
        assert (simulator.energy()[0].sum(axis=1) < first.sum(axis=1) + 0.01 * np.abs(first).sum(axis=1)).all()
    assert simulator.state.faults() == []


@pytest.mark.parametrize(("precision", "bound"), [(64, 1e-5), (32, 1e-4)])
def test_equilibrium_where_mujoco_blows_up(precision, bound):
    """Let the same trees settle: to 0.01 mm (float64) or 0.1 mm (float32) at MuJoCo's own equilibrium.

    MuJoCo's comes from a run of 1 s at a 32nd of the step and Newton's method on its static forces from there.
    """
    trees, starts = weakly_damped()
    settled = [w for w, tree in enumerate(trees) if tree.num_links < 10]  # the others swing for minutes
    trees, starts = [trees[w] for w in settled], [starts[w] for w in settled]
    simulator = Simulator(Model(trees, precision=precision, width=1), dt=DT)
    simulator.state.set_qpos(starts)
    simulator.refresh()
    simulator.step(240 * 120)
    position, _ = simulator.observe()
    assert simulator.state.faults() == []
    for w, (tree, start) in enumerate(zip(trees, starts, strict=True)):
        model, data = compiled(tree, DT / 32)
        data.qpos[:] = start
        mujoco.mj_step(model, data, 32 * 240)
        assert np.isfinite(data.qpos).all()
        want = equilibrium(tree, data.qpos)
        np.testing.assert_allclose(position[w, : tree.num_links].numpy(), want, rtol=0, atol=bound)


def test_refresh_follows_changed_parameters():
    """Stiffen the springs of a running model: refresh finds new shares, and takes back those no longer needed."""
    tree = springy(3, 6, damping_ratio=(0.5, 2.0), stiffness=(1.0, 5.0))
    simulator = Simulator(Model([tree], precision=64), dt=1e-3)
    damping, stiffness = effective(simulator), simulator.model.arrays["stiffness"]
    np.testing.assert_array_equal(damping, tree.damping)
    stiffness.torch.mul_(1e4)
    simulator.refresh()
    assert (effective(simulator) > tree.damping * 1.5).any()
    stiffness.torch.mul_(1e-4)
    simulator.refresh()
    np.testing.assert_array_equal(effective(simulator), tree.damping)
