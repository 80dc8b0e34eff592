"""Tensors over all worlds: what is written acts and is read back, in every memory order, and nowhere else."""

from __future__ import annotations

import bough.sim.engine.arrays as arrays
import mujoco
import numpy as np
import pytest
import torch
import warp as wp
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.simulator import ArmSimulator
from bough.sim.base.errors import InputError
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.engine.tensors import QUANTITIES
from bough.sim.trees.species import grow_forest
from bough.sim.trees.tree import Joint
from oracles.mujoco_tree import compiled
from oracles.random_tree import random_qpos, random_tree

DT = 1e-3
MOVING = (Joint.SPHERICAL, Joint.REVOLUTE, Joint.PRISMATIC)


def _trees(count: int = 5, **options):
    """Different trees with every kind of joint, dampers strong enough for explicit springs at `DT`."""
    rng = np.random.default_rng(4)
    options = {"joints": tuple(Joint), "damping_ratio": (0.4, 2.0), "stiffness": (1.0, 100.0)} | options
    return [random_tree(rng, int(n), **options) for n in rng.integers(2, 9, count)]


def _simulator(trees, width: int = 1, precision: int = 64) -> Simulator:
    return Simulator(Model(trees, width=width, precision=precision, device="cpu"), dt=DT)


def _padded(rows, longest: int) -> torch.Tensor:
    """Rows of different lengths as one tensor; what a world lacks is NaN, which must not be read."""
    out = np.full((len(rows), longest, *np.shape(rows[0])[1:]), np.nan)
    for world, row in enumerate(rows):
        out[world, : len(row)] = row
    return torch.from_numpy(out)


@pytest.fixture(params=[False, True], ids=["by world", "by link"])
def memory(request, monkeypatch):
    """Both orders of memory, that of a CPU and that of a GPU."""
    if request.param:
        monkeypatch.setattr(arrays, "link_major", lambda device: True)


def test_pushed_links_move_as_with_c_mujoco_s_xfrc_applied():
    """Push, twist and drive links and joints of different trees: a hundred steps as MuJoCo takes them.

    The step is MuJoCo's implicitfast; 1e-9 is a hundred steps' rounding (1e-11 each, `test_articulated`).
    """
    trees, rng = _trees(), np.random.default_rng(5)
    simulator = _simulator(trees)
    wrench = [rng.normal(size=(t.num_links, 6)) * [0.5, 0.5, 0.5, 0.02, 0.02, 0.02] for t in trees]
    effort = [0.05 * rng.normal(size=t.num_dofs) for t in trees]
    tensors, links = simulator.tensors, max(t.num_links for t in trees)
    tensors.set("force", _padded([w[:, :3] for w in wrench], links))
    tensors.set("torque", _padded([w[:, 3:] for w in wrench], links))
    tensors.set("effort", _padded(effort, max(t.num_dofs for t in trees)))
    simulator.step(100)
    qpos, qvel = tensors.get("qpos"), tensors.get("qvel")
    for world, tree in enumerate(trees):
        model, data = compiled(tree, DT)
        data.xfrc_applied[1:], data.qfrc_applied[:] = wrench[world], data.qfrc_applied + effort[world]
        mujoco.mj_step(model, data, 100)
        assert np.abs(data.qvel).max() > 1e-3
        np.testing.assert_allclose(qvel[world, : model.nv], data.qvel, rtol=0, atol=1e-9)
        np.testing.assert_allclose(qpos[world, : model.nq], data.qpos, rtol=0, atol=1e-9)


@pytest.mark.parametrize("width", [1, 8])
def test_coordinates_are_read_back_to_the_bit(memory, width):
    """Write coordinates and rates over NaN and read them back; frames along the links round nothing."""
    trees = grow_forest("Ta", count=9, order=1, noise=0.3, seed=1)
    simulator, rng = _simulator(trees, width, 32), np.random.default_rng(2)
    simulator.state.coordinate.torch.fill_(torch.nan)
    simulator.state.velocity.torch.fill_(torch.nan)
    written = {"qpos": [random_qpos(rng, t) for t in trees], "qvel": [rng.normal(size=t.num_dofs) for t in trees]}
    for name, rows in written.items():
        given = _padded(rows, max(map(len, rows))).float()
        simulator.tensors.set(name, given)
        got = simulator.tensors.get(name)
        assert torch.equal(got[~given.isnan()], given[~given.isnan()])


def test_tensors_agree_with_the_host_s_order(memory):
    """Compare coordinates, rates and parameters with the arrays on the host; rest poses are bent."""
    trees, rng = _trees(bent_rest=True, preloaded=True), np.random.default_rng(3)
    simulator = _simulator(trees, 8, 32)
    qpos, qvel = [random_qpos(rng, t) for t in trees], [rng.normal(size=t.num_dofs) for t in trees]
    simulator.state.set_qpos(qpos)
    simulator.state.set_qvel(qvel)
    tensors = simulator.tensors
    got = {name: tensors.get(name).fill_(torch.nan) for name in QUANTITIES}  # poisoned; the same memory again below
    for name in QUANTITIES:
        assert tensors.get(name).data_ptr() == got[name].data_ptr()
    for world, tree in enumerate(trees):
        n = tree.num_links
        np.testing.assert_allclose(got["qpos"][world, : len(qpos[world])], qpos[world], atol=2e-6)
        np.testing.assert_allclose(got["qvel"][world, : len(qvel[world])], qvel[world], atol=4e-6)
        np.testing.assert_allclose(got["point"][world, :n], tree.com, atol=1e-6)
        for name in ("stiffness", "damping", "armature", "mass"):
            assert torch.equal(got[name][world, :n], torch.tensor(getattr(tree, name), dtype=torch.float32))
        assert got["mass"][world, n:].isnan().all()  # never written
        column = tensors.dof_column[world, :n].tolist()
        moving = [c for c in column if c >= 0]
        assert moving == sorted(moving) and column.count(-1) == (tree.joint == Joint.FIXED).sum()


def test_worlds_that_are_not_named_keep_their_bits(memory):
    """Write two worlds by mask, then by number: they get their rows, the other three keep every bit."""
    trees = _trees(joints=MOVING)
    simulator = _simulator(trees, 8, 32)
    tensors, mask = simulator.tensors, torch.tensor([False, True, False, False, True])
    before = {name: tensors.get(name).clone() for name in ("qvel", "force", "stiffness", "mass")}
    for name, old in before.items():
        tensors.set(name, old + 1.0, mask)
        assert torch.equal(tensors.get(name)[~mask], old[~mask])
        written = (tensors.get(name)[mask] != 0.0).reshape(2, -1).sum(1)
        np.testing.assert_allclose((tensors.get(name) - old)[mask].reshape(2, -1).sum(1), written, rtol=1e-5)
        tensors.set(name, old[[4, 1, 0]], torch.tensor([4, 1, 99]))  # there is no world 99
        np.testing.assert_allclose(tensors.get(name), old, atol=1e-6)


def test_new_parameters_act_as_trees_that_were_built_with_them():
    """Double springs, dampers and masses and add armature in place: the motion of trees that had them from the start.

    Masses carry inertias along, as a denser wood does. 1e-12: rounding of float64 over 20 steps.
    """
    trees = _trees(joints=MOVING)
    changed = [t.with_(stiffness=2 * t.stiffness, damping=3 * t.damping, mass=2 * t.mass, inertia=2 * t.inertia,
                       armature=t.armature + 0.01) for t in trees]  # fmt: skip
    simulator, want = _simulator(trees), _simulator(changed)
    tensors = simulator.tensors
    for name, factor in (("stiffness", 2.0), ("damping", 3.0), ("mass", 2.0)):
        tensors.set(name, factor * tensors.get(name))
    tensors.set("armature", 0.01)
    for each in (simulator, want):
        each.tensors.set("qvel", 0.5)
        each.step(20)
    assert torch.equal(tensors.get("stiffness"), want.tensors.get("stiffness"))
    np.testing.assert_allclose(tensors.get("qvel"), want.tensors.get("qvel"), rtol=0, atol=1e-12)


def test_writing_stepping_and_reading_are_one_graph(memory):
    """Record a push, a step and a look as a graph: replayed with other forces it is the plain calls, bit by bit."""
    trees = _trees(joints=MOVING)
    forces = [torch.full((5, max(t.num_links for t in trees), 3), 0.1 * (k + 1)) for k in range(4)]
    plain, recorded = _simulator(trees, 1, 32), _simulator(trees, 1, 32)
    for force in forces:
        plain.tensors.set("force", force)
        plain.step()
    given = forces[0].clone()
    recorded.tensors.set("force", given)
    seen = recorded.tensors.get("qpos")
    recorded._prepare_step(1, split=False)
    with wp.ScopedCapture(device="cpu") as scope:
        recorded.tensors.set("force", given)
        recorded.step()
        recorded.tensors.get("qpos")
        with pytest.raises(InputError, match="inside a graph"):
            recorded.tensors.set("mass", 1.0)
    for force in forces:
        given.copy_(force)
        wp.capture_launch(scope.graph)
    assert torch.equal(seen, plain.tensors.get("qpos"))
    assert recorded.tensors.get("qpos").data_ptr() == seen.data_ptr()


def test_a_graph_is_recorded_anew_once_there_is_a_load():
    """Capture a step first and push then: the graph applies the force."""
    simulator, plain = (_simulator(_trees(joints=MOVING), 1, 32) for _ in range(2))
    replay = simulator.capture(3)
    for each in (simulator, plain):
        each.tensors.set("force", 0.3)
        each.tensors.set("damping", 2.0 * each.tensors.get("damping"))
    replay()
    plain.step(3)
    assert torch.equal(simulator.tensors.get("qvel"), plain.tensors.get("qvel"))


def test_a_quaternion_is_made_one():
    """Take a quaternion of any length for its direction, and none at all for the identity, as MuJoCo does."""
    trees = grow_forest("Ta", count=1, order=1, seed=1)
    simulator = _simulator(trees)
    ball = torch.zeros(1, trees[0].num_coordinates, dtype=torch.float64)
    ball[0, :4] = torch.tensor([0.0, 3.0, 0.0, 4.0])
    simulator.tensors.set("qpos", ball)
    got = simulator.tensors.get("qpos")[0].reshape(-1, 4)
    np.testing.assert_allclose(got[0], [0.0, 0.6, 0.0, 0.8], atol=1e-15)
    assert torch.equal(got[1:, 0], torch.ones(len(got) - 1, dtype=torch.float64)) and not got[1:, 1:].any()


def test_bad_calls_are_refused_with_what_is_allowed():
    """Name what is there where a name, a shape or worlds do not fit, and where nothing would read a load."""
    simulator = _simulator(_trees())
    with pytest.raises(InputError, match="'speed'; allowed: qpos, qvel, effort"):
        simulator.tensors.get("speed")
    with pytest.raises(InputError, match=r"force: found shape \(2, 3\)"):
        simulator.tensors.set("force", torch.zeros(2, 3))
    with pytest.raises(InputError, match="a mask of shape"):
        simulator.tensors.set("force", 0.0, torch.ones(3, dtype=torch.bool))
    with pytest.raises(InputError, match=r"float32 of shape"):
        simulator.tensors.set("force", 0.0, torch.ones(3))
    arm = ArmSimulator(grow_forest("Ta", count=1, order=1, seed=1), jaco2(), device="cpu", width=1)
    with pytest.raises(InputError, match="a load on branches, which a step without effects does not read"):
        arm.tensors.set("force", 1.0)
