"""Inverse dynamics against C MuJoCo's mj_inverse, and back through the forward kernel."""

import mujoco
import numpy as np
import pytest
import torch
from bough.sim.base import rotation
from bough.sim.base.errors import InputError
from bough.sim.engine.inverse_dynamics import InverseDynamics
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.formats.import_mjcf import load_mjcf
from bough.sim.trees.tree import Joint
from oracles.mujoco_tree import OFF, compiled, hold
from oracles.random_mjcf import RandomMjcf
from oracles.random_tree import random_qpos, random_tree
from scipy.spatial.transform import Rotation

#: Relative to the largest effort: round-off of a sum over some ten links. Measured: 4e-15 and 2e-6.
TOLERANCE = {64: 1e-12, 32: 2e-5}
ALL = tuple(Joint)


def inverse_of(simulator: Simulator) -> InverseDynamics:
    """Make inverse dynamics whose scratch memory and output are NaN."""
    inverse = InverseDynamics(simulator)
    for field in simulator._launcher._fields.values():
        field.torch.fill_(torch.nan)
    inverse.effort.torch.fill_(torch.nan)
    return inverse


def state_of(rng: np.random.Generator, tree) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw coordinates of half a radian, velocities of two and accelerations of ten a second."""
    n = tree.num_dofs
    return random_qpos(rng, tree, 0.5), rng.normal(0.0, 2.0, n), rng.normal(0.0, 10.0, n)


def mujoco_efforts(model, data, qpos, qvel, qacc, tree=None) -> np.ndarray:
    """Efforts by mj_inverse; MuJoCo counts forces applied from outside as part of what it returns."""
    data.qpos[:], data.qvel[:], data.qacc[:] = qpos, qvel, qacc
    if tree is not None:
        hold(tree, model, data)
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse - data.qfrc_applied


@pytest.mark.parametrize(("width", "precision"), [(1, 64), (1, 32), (8, 32), (16, 32)])
def test_efforts_are_mujoco_s(width, precision):
    """Take random states of random trees with every kind of joint, armature, anchors, rest poses and pre-loads."""
    rng = np.random.default_rng(1)
    sizes = [1, 2, 3, 5, 8, 13, 21, 40] * 2
    options = {"joints": ALL, "armature": 0.01, "bent_rest": True, "preloaded": True}
    trees = [random_tree(rng, n, **options) for n in sizes]
    assert sum(t.num_dofs == 0 for t in trees) < 3
    simulator = Simulator(Model(trees, width=width, precision=precision), dt=1e-3, threads=1)
    starts = [state_of(rng, t) for t in trees]
    simulator.state.set_qpos([s[0] for s in starts])
    simulator.state.set_qvel([s[1] for s in starts])
    found = inverse_of(simulator).efforts([s[2] for s in starts])
    for tree, start, ours in zip(trees, starts, found, strict=True):
        want = mujoco_efforts(*compiled(tree), *start, tree)
        np.testing.assert_allclose(ours, want, rtol=0, atol=TOLERANCE[precision] * np.abs(want).max(initial=0))


def test_a_preload_is_a_strained_spring():
    """Hold a tree as MuJoCo's springs that are relaxed elsewhere do, up to K |psi|^2 |phi| / 12 of a strain psi = P/K.

    A torque that is constant in the link's axes would be off by K |psi| |phi| / 2.
    """
    rng = np.random.default_rng(7)
    tree = random_tree(rng, 8, joints=(Joint.SPHERICAL,))
    strain = rng.normal(size=(8, 3))
    strain *= 0.05 / np.linalg.norm(strain, axis=1, keepdims=True)
    loaded = tree.with_(preload=tree.stiffness[:, None] * strain)
    qpos, still = random_qpos(rng, tree, 0.3), np.zeros(tree.num_dofs)
    model, data = compiled(tree)
    relaxed = Rotation.from_quat(tree.rest, scalar_first=True) * Rotation.from_rotvec(strain)
    model.qpos_spring[:] = relaxed.as_quat(scalar_first=True).ravel()
    want = mujoco_efforts(model, data, qpos, still, still)
    simulator = Simulator(Model(loaded, precision=64), dt=1e-3)
    simulator.state.set_qpos(qpos)
    off = np.linalg.norm((inverse_of(simulator).efforts(still)[0] - want).reshape(8, 3), axis=1)
    pose = Rotation.from_quat(qpos.reshape(8, 4), scalar_first=True)
    turned = (Rotation.from_quat(tree.rest, scalar_first=True).inv() * pose).magnitude()
    least = tree.stiffness * 0.05**2 * turned / 12
    assert (off < 1.2 * least + tree.stiffness * 0.05**3).all()
    assert (off < 0.05 * tree.stiffness * 0.05 * turned / 2).all()


@pytest.mark.parametrize("seed", range(8))
def test_efforts_of_imported_mechanisms(seed, tmp_path):
    """Compile random MJCF in MuJoCo and read it here: bodies of several joints, refs, springs, any gravity."""
    text = RandomMjcf(seed, 6).text
    (tmp_path / "arm.xml").write_text(text)
    mechanism = load_mjcf(tmp_path / "arm.xml", ("all",))
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= int(OFF)
    start = state_of(np.random.default_rng(seed), mechanism.tree)
    simulator = Simulator(Model(mechanism.tree, gravity=mechanism.gravity, precision=64), dt=1e-3)
    simulator.state.set_qpos(start[0])
    simulator.state.set_qvel(start[1])
    want = mujoco_efforts(model, mujoco.MjData(model), *start)
    # both compile the masses from the file's shapes, to 1e-9 of each other (tests/sim/test_import.py)
    np.testing.assert_allclose(inverse_of(simulator).efforts(start[2])[0], want, rtol=0, atol=1e-8 * np.abs(want).max())


def test_efforts_undo_the_forward_step():
    """Apply the efforts under the same forces at points: the step gains h times the acceleration asked for."""
    rng, h = np.random.default_rng(2), 1e-4
    trees = [random_tree(rng, n, joints=ALL, armature=0.01, preloaded=True) for n in (1, 4, 9, 20)]
    # without dampers nothing is implicit, so that the forward step solves M qdd = effort - bias exactly
    trees = [t.with_(damping=np.zeros(t.num_links), joint=np.maximum(t.joint, 1), rest=upright(t)) for t in trees]
    simulator = Simulator(Model(trees, precision=64), dt=h, threads=1)
    m, load = simulator.model, simulator.load
    torch.testing.assert_close(simulator._damping.torch, torch.zeros_like(simulator._damping.torch))
    starts = [state_of(rng, t) for t in trees]
    simulator.state.set_qpos([s[0] for s in starts])
    simulator.state.set_qvel([s[1] for s in starts])
    for field, size in ((load.force, 5.0), (load.point, 0.2)):
        field.assign(m.scatter(rng.normal(0.0, size, (len(m.link_slot), 3)), [0.0, 0.0, 0.0]))
    inverse = inverse_of(simulator)
    inverse.efforts([s[2] for s in starts])
    load.effort.torch.copy_(inverse.effort.torch)
    simulator.step()
    for (_, before, want), after in zip(starts, simulator.state.qvel(), strict=True):
        # the difference of velocities of the order of 10 loses log10(10 / (h 10)) of sixteen digits
        np.testing.assert_allclose((after - before) / h, want, rtol=0, atol=1e-8 * np.abs(want).max())


def upright(tree) -> np.ndarray:
    """Rest coordinates at joint zero where every fixed joint has become a revolute one."""
    return np.where((tree.joint == Joint.SPHERICAL)[:, None], [1.0, 0.0, 0.0, 0.0], 0.0)


def test_forces_at_points_are_mujoco_s():
    """Subtract the forces that act from outside: equal to mj_inverse less mj_applyFT."""
    rng = np.random.default_rng(3)
    tree = random_tree(rng, 7)
    simulator = Simulator(Model(tree, precision=64), dt=1e-3)
    m, load = simulator.model, simulator.load
    force, point = rng.normal(0.0, 5.0, (7, 3)), rng.normal(0.0, 0.2, (7, 3))
    local = rotation.quat_rotate(rotation.quat_conjugate(m.links.frame), point - m.links.anchor)
    for field, values in ((load.force, force), (load.point, local)):
        field.assign(m.scatter(values, [0.0, 0.0, 0.0]))
    qpos, qvel, qacc = state_of(rng, tree)
    simulator.state.set_qpos(qpos)
    simulator.state.set_qvel(qvel)
    model, data = compiled(tree)
    want = mujoco_efforts(model, data, qpos, qvel, qacc)
    applied = np.zeros(model.nv)
    for i in range(7):
        at = data.xpos[i + 1] + data.xmat[i + 1].reshape(3, 3) @ point[i]
        mujoco.mj_applyFT(model, data, force[i], np.zeros(3), at, i + 1, applied)
    ours = inverse_of(simulator).efforts(qacc)[0]
    np.testing.assert_allclose(ours, want - applied, rtol=0, atol=1e-12 * np.abs(want).max())


def test_refuses_accelerations_of_another_length():
    """Say how many numbers a world takes."""
    tree = random_tree(np.random.default_rng(4), 3, joints=(Joint.REVOLUTE,))
    inverse = InverseDynamics(Simulator(Model(tree, precision=64)))
    with pytest.raises(InputError, match="allowed: 3"):
        inverse.efforts(np.zeros(4))
