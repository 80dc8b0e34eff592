"""One step of the articulated-body kernels against one step of C MuJoCo (implicitfast)."""

from dataclasses import fields
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
import torch
from bough.sim.base import rotation
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.formats.export_mjcf import numbers, to_mjcf
from bough.sim.trees.tree import Joint, Tree
from oracles.mujoco_tree import compiled, one_step, rows
from oracles.random_tree import random_qpos, random_tree
from scipy.spatial.transform import Rotation

DT = 1e-3
ALL = tuple(Joint)
MOVING = (Joint.REVOLUTE, Joint.SPHERICAL, Joint.PRISMATIC)
#: Relative to the largest speed after the step. MuJoCo factorises the joint-space inertia, we fold articulated
#: inertias: they round differently. Measured: 2e-14 in float64 and 2e-6 in float32.
TOLERANCE = {64: 1e-11, 32: 2e-5}
#: Round-off of coordinates and positions of the order of one, after the dozen products that a chain of links takes.
ROUNDING = {64: 1e-13, 32: 1e-6}


def mild(rng: np.random.Generator, links: int, **options) -> Tree:
    """Make a tree that needs no implicit spring at `DT`: dampers strong enough for its springs."""
    options = {"joints": ALL, "damping_ratio": (0.4, 2.0), "stiffness": (1.0, 100.0)} | options
    tree = random_tree(rng, links, **options)
    if tree.joint[0] == Joint.FIXED:
        tree.joint[0], tree.rest[0] = Joint.SPHERICAL, [1.0, 0.0, 0.0, 0.0]
    return tree


def bent(rng: np.random.Generator, tree: Tree) -> Tree:
    """Turn the rest orientations of ball springs away from joint zero."""
    rest = tree.rest.copy()
    ball = tree.joint == Joint.SPHERICAL
    rest[ball] = np.roll(Rotation.from_rotvec(rng.normal(0.0, 0.5, (ball.sum(), 3))).as_quat(), 1, axis=1)
    return tree.with_(rest=rest)


def simulator_of(trees: list[Tree], width: int, precision: int, dt: float = DT) -> Simulator:
    """Make a simulator whose scratch memory and outputs are NaN and that has no implicit spring."""
    simulator = Simulator(Model(trees, width=width, precision=precision), dt=dt, threads=1)
    poison(simulator)
    explicit = simulator.model.arrays["damping"].torch
    torch.testing.assert_close(simulator._damping.torch, explicit, rtol=0, atol=0)
    return simulator


def poison(simulator: Simulator) -> None:
    """Fill everything that kernels must write before they read with NaN."""
    for field in simulator._launcher._fields.values():
        field.torch.fill_(torch.nan)
    simulator.position.fill_(torch.nan)
    simulator.rotation.fill_(torch.nan)


def random_state(rng: np.random.Generator, tree: Tree) -> tuple[np.ndarray, np.ndarray]:
    """Draw coordinates of the order of half a radian and velocities of two radians a second."""
    return random_qpos(rng, tree, 0.5), rng.normal(0.0, 2.0, tree.num_dofs)


def compare(simulator: Simulator, oracle: list, starts: list) -> None:
    """Step every world once and its oracle (model, data) too; compare velocities, coordinates and body frames."""
    precision = simulator.model.precision
    tolerance, rounding = TOLERANCE[precision], ROUNDING[precision]
    simulator.state.set_qpos([q for q, _ in starts])
    simulator.state.set_qvel([v for _, v in starts])
    simulator.step()
    position, turn = (t.numpy() for t in simulator.observe())
    qpos, qvel = simulator.state.qpos(), simulator.state.qvel()
    for w, ((model, data), start) in enumerate(zip(oracle, starts, strict=True)):
        tree = simulator.model.trees[w]
        want_q, want_v = one_step(model, data, *start, tree if tree.preload.any() else None)
        scale = tolerance * max(1.0, np.abs(want_v).max())
        np.testing.assert_allclose(qvel[w], want_v, rtol=0, atol=scale)
        np.testing.assert_allclose(aligned(qpos[w], want_q), want_q, rtol=0, atol=scale * DT + rounding)
        mujoco.mj_kinematics(model, data)
        bodies = tree.num_links
        if model.nbody == bodies + 1:
            np.testing.assert_allclose(position[w, :bodies], data.xpos[1:], rtol=0, atol=scale * DT + rounding)
            same = np.abs(np.sum(turn[w, :bodies] * data.xquat[1:], axis=1))
            np.testing.assert_allclose(same, 1.0, rtol=0, atol=rounding)


def aligned(q: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Return q with the sign of every number of ``like`` where only the sign differs (q and -q are one rotation)."""
    return np.where(np.abs(q + like) < np.abs(q - like), -q, q)


@pytest.mark.parametrize(("width", "precision"), [(1, 64), (1, 32), (8, 32), (16, 32)])
def test_one_step_is_mujoco_s(width, precision):
    """Step random states of random trees with every kind of joint, armature, anchors, rest poses and pre-loads."""
    rng = np.random.default_rng(1)
    sizes = [1, 2, 3, 5, 8, 13, 21, 40] * 2
    trees = [bent(rng, mild(rng, n, armature=0.01, bent_rest=True, preloaded=True)) for n in sizes]
    simulator = simulator_of(trees, width, precision)
    compare(simulator, [compiled(t, DT) for t in trees], [random_state(rng, t) for t in trees])


@pytest.mark.parametrize("kind", MOVING)
def test_each_kind_of_joint_alone(kind):
    """Step a tree of one kind of joint: an error of that kind cannot hide behind the others."""
    rng = np.random.default_rng(2)
    trees = [mild(rng, n, joints=(kind,)) for n in (1, 4, 12)]
    simulator = simulator_of(trees, 1, 64)
    compare(simulator, [compiled(t, DT) for t in trees], [random_state(rng, t) for t in trees])


@pytest.mark.parametrize(("width", "precision"), [(1, 64), (8, 32)])
def test_forces_at_points(width, precision):
    """Push and pull links at points off their axes, and drive joints: equal to MuJoCo's mj_applyFT."""
    rng = np.random.default_rng(3)
    trees = [mild(rng, n) for n in (1, 3, 7, 15, 6, 2, 9, 30)]
    simulator = simulator_of(trees, width, precision)
    starts, oracle = [random_state(rng, t) for t in trees], [compiled(t, DT) for t in trees]
    load, m = simulator.load, simulator.model
    force, effort = rng.normal(0.0, 5.0, (len(m.link_slot), 3)), rng.normal(0.0, 1.0, (len(m.link_slot), 3))
    point = rng.normal(0.0, 0.2, (len(m.link_slot), 3))
    local = rotation.quat_rotate(rotation.quat_conjugate(m.links.frame), point - m.links.anchor)
    ball = (m.links.kind == Joint.SPHERICAL)[:, None]
    turned = np.where(ball, rotation.quat_rotate(rotation.quat_conjugate(m.links.frame), effort), effort)
    for field, values in ((load.force, force), (load.point, local), (load.effort, turned)):
        field.assign(m.scatter(values, [0.0, 0.0, 0.0]))
    for w, (model, data) in enumerate(oracle):
        a, b = m.first_link[w : w + 2]
        data.qpos[:] = starts[w][0]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        data.qfrc_applied[:] += rows(trees[w], effort[a:b], "dofs")
        for i in range(b - a):
            at = data.xpos[i + 1] + data.xmat[i + 1].reshape(3, 3) @ point[a + i]
            mujoco.mj_applyFT(model, data, force[a + i], np.zeros(3), at, i + 1, data.qfrc_applied)
    compare(simulator, oracle, starts)


def with_massless(tree: Tree, before: int, kind: Joint, axis, stiffness: float, damping: float) -> Tree:
    """Insert a massless link with a joint of its own between a link and its parent."""
    changes = {}
    for item in fields(Tree):
        value = getattr(tree, item.name)
        if isinstance(value, np.ndarray) and not item.name.startswith("shape_"):
            changes[item.name] = np.insert(value, before, value[before], axis=0)
    p = changes["parent"]
    p[before + 1 :] += p[before + 1 :] >= before
    p[before + 1] = before
    changes["position"][before + 1], changes["rotation"][before + 1] = 0.0, [1.0, 0.0, 0.0, 0.0]
    changes["mass"][before], changes["inertia"][before], changes["armature"][before] = 0.0, 0.0, 0.0
    changes["joint"][before], changes["axis"][before], changes["rest"][before] = kind, axis, 0.0
    changes["stiffness"][before], changes["damping"][before] = stiffness, damping
    names = [*tree.link_name[:before], f"{tree.link_name[before]}_{kind.name}_{len(p)}", *tree.link_name[before:]]
    shape_link = tree.shape_link + (tree.shape_link >= before)
    return tree.with_(link_name=names, shape_link=shape_link, **changes).validate()


def test_massless_links_are_mujoco_s_joints_of_one_body():
    """Put several joints on one body in MuJoCo; here each but the last has a massless link of its own."""
    rng = np.random.default_rng(4)
    base = mild(rng, 6, joints=(Joint.SPHERICAL, Joint.REVOLUTE), anchored=0.0)
    root = ET.fromstring(to_mjcf(base))
    tree = base
    for kind, link in ((Joint.PRISMATIC, 0), (Joint.PRISMATIC, 0), (Joint.REVOLUTE, 0), (Joint.REVOLUTE, 3)):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        body = root.find(f".//body[@name='link{link}']")
        place = next(k for k, e in enumerate(body) if e.get("name", "") == f"link{link}_joint")
        joint = {"type": "hinge" if kind == Joint.REVOLUTE else "slide", "axis": numbers(axis)}
        body.insert(place, ET.Element("joint", stiffness="20", damping="3", **joint))
        index = tree.link_name.index(f"link{link}")
        tree = with_massless(tree, index, kind, axis, 20.0, 3.0)
    assert tree.num_links == 10
    oracle = compiled(tree, DT, xml=ET.tostring(root, encoding="unicode"))
    compare(simulator_of([tree], 1, 64), [oracle], [random_state(rng, tree)])


def test_gravity_of_any_direction():
    """Tilt gravity: the base's acceleration stands for it on every axis."""
    rng = np.random.default_rng(5)
    tree, gravity = mild(rng, 9), (1.0, -2.0, 3.0)
    simulator = Simulator(Model([tree], gravity=gravity, precision=64), dt=DT)
    model, data = compiled(tree, DT)
    model.opt.gravity[:] = gravity
    compare(simulator, [(model, data)], [random_state(rng, tree)])


def test_implicit_springs_are_extra_dampers_of_mujoco():
    """Give MuJoCo the effective damping as extra implicit damping without its force: the same step again.

    Backward Euler on a share gamma of a spring adds gamma h K to the matrix, and -gamma h K qd to the force.
    """
    rng = np.random.default_rng(6)
    tree, dt = random_tree(rng, 12, damping_ratio=(0.01, 0.05)), 1.0 / 240.0
    simulator = Simulator(Model([tree], precision=64), dt=dt, max_speed=1e6)
    m = simulator.model
    effective = m.gather(simulator._damping.numpy())[:, 0]
    assert (effective > tree.damping * 1.01).any()
    simulator._limit.torch.fill_(1e6)
    qpos, qvel = random_state(rng, tree)
    simulator.state.set_qpos(qpos)
    simulator.state.set_qvel(qvel)
    simulator.step()
    model, data = compiled(tree.with_(damping=effective), dt)
    _, want = one_step(model, data, qpos, qvel)
    np.testing.assert_allclose(simulator.state.qvel()[0], want, rtol=0, atol=1e-9 * np.abs(want).max())
