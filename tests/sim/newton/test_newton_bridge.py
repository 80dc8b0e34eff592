"""Trees to Newton models and back, and joint coordinates, against Newton's own forward kinematics."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import warp as wp
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_matrix, quat_multiply
from bough.sim.formats.import_mjcf import load_mjcf
from bough.sim.newton.bridge import from_newton, to_newton
from bough.sim.newton.layout import (
    coordinates_from_newton,
    coordinates_to_newton,
    read_layout,
    velocities_from_newton,
    velocities_to_newton,
)
from bough.sim.trees.pose import pose
from bough.sim.trees.tree import Joint, Tree
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.random_mjcf import RandomMjcf
from oracles.random_tree import random_tree

ALL = (Joint.SPHERICAL, Joint.REVOLUTE, Joint.PRISMATIC, Joint.FIXED)
# Newton keeps float32: 6e-8 relative for one rounding, ten of them for products of poses along a branch.
FLOAT32 = 1e-6


def _trees(seed, sizes):
    rng = np.random.default_rng(seed)
    return [random_tree(rng, n, joints=ALL, armature=0.1, bent_rest=True, preloaded=True) for n in sizes]


def _random_rest(trees, seed):
    """Give spherical joints random rest orientations, which MJCF could not express but Newton can."""
    rng = np.random.default_rng(seed)
    for tree in trees:
        ball = tree.joint == Joint.SPHERICAL
        q = rng.normal(size=(tree.num_links, 4))
        tree.rest[ball] = (q / np.linalg.norm(q, axis=1, keepdims=True))[ball]
    return trees


def _random_motion(tree, rng):
    qpos, qvel = rng.normal(size=tree.num_coordinates), rng.normal(size=tree.num_dofs)
    start = 0
    for kind in tree.joint:
        if kind == Joint.SPHERICAL:
            qpos[start : start + 4] /= np.linalg.norm(qpos[start : start + 4])
        start += Joint(kind).coordinates
    return qpos, qvel


def _moved(tree, qpos, qvel, h):
    """Coordinates after time h at constant joint velocity; spherical ones turn in the body frame."""
    out, q, v = qpos.copy(), 0, 0
    for kind in map(Joint, tree.joint):
        if kind == Joint.SPHERICAL:
            turn = qvel[v : v + 3] * h / 2  # h is 1e-6: cos = 1 and sin = x to 1e-12
            out[q : q + 4] = quat_multiply(qpos[q : q + 4], np.array([1.0, *turn]))
        else:
            out[q : q + kind.coordinates] += qvel[v : v + kind.dofs] * h
        q, v = q + kind.coordinates, v + kind.dofs
    return out


def _forward(model, joint_q, joint_qd):
    """Newton's body positions, orientations (w, x, y, z), centre velocities and angular velocities in the world."""
    state = model.state()
    newton.eval_fk(model, wp.array(joint_q, dtype=wp.float32), wp.array(joint_qd, dtype=wp.float32), state)
    q, qd = state.body_q.numpy(), state.body_qd.numpy()
    return q[:, :3], np.roll(q[:, 3:], 1, axis=1), qd[:, :3], qd[:, 3:]


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), sizes=st.lists(st.integers(1, 12), min_size=1, max_size=3))
def test_round_trip_keeps_every_field(seed, sizes):
    """Make a model of different trees and describe it again: equal to float32, world by world."""
    trees = _random_rest(_trees(seed, sizes), seed)
    for tree, back in zip(trees, from_newton(to_newton(trees, device="cpu")), strict=True):
        _assert_same(tree, back)


def _assert_same(tree: Tree, back: Tree) -> None:
    assert back.name == tree.name and back.link_name == tree.link_name
    for key in ("parent", "joint", "level", "shape_link"):
        np.testing.assert_array_equal(getattr(back, key), getattr(tree, key), err_msg=key)
    kept = {"axis": np.isin(tree.joint, (Joint.REVOLUTE, Joint.PRISMATIC))}
    kept |= dict.fromkeys(("stiffness", "damping", "armature", "rest"), tree.joint != Joint.FIXED)
    plain = ("position", "rotation", "anchor", "mass", "com", "inertia", "preload", *kept)
    for key in (*plain, "shape_start", "shape_end", "shape_radius"):
        chosen = kept.get(key, slice(None))
        a, b = getattr(back, key)[chosen], getattr(tree, key)[chosen]
        np.testing.assert_allclose(a, b, rtol=FLOAT32, atol=FLOAT32, err_msg=key)


@pytest.mark.parametrize("seed", range(3))
def test_body_poses_are_newtons(seed):
    """Compare bough's forward kinematics with Newton's for random coordinates of three different worlds."""
    trees, rng = _trees(seed, (2, 7, 20)), np.random.default_rng(seed)
    model = to_newton(trees, device="cpu")
    layout = read_layout(model)
    motion = [_random_motion(tree, rng) for tree in trees]
    joint_q = coordinates_to_newton(layout, [q for q, _ in motion])
    pos, quat, _, _ = _forward(model, joint_q, np.zeros(model.joint_dof_count))
    for tree, world, (qpos, _) in zip(trees, layout, motion, strict=True):
        expected = pose(tree, qpos)
        np.testing.assert_allclose(pos[world.body], expected[0], atol=10 * FLOAT32)
        np.testing.assert_allclose(quat_matrix(quat[world.body]), quat_matrix(expected[1]), atol=10 * FLOAT32)


def _velocities_by_differences(tree, qpos, qvel, h=1e-6):
    """Velocities of the centres of mass and angular velocities in the world, by central differences of the poses."""
    (p0, q0), (p1, q1) = (pose(tree, _moved(tree, qpos, qvel, s * h)) for s in (-1, 1))
    c0, c1 = (p + np.einsum("lij,lj->li", quat_matrix(q), tree.com) for p, q in ((p0, q0), (p1, q1)))
    spin = quat_matrix(q1) @ np.swapaxes(quat_matrix(q0), 1, 2)
    omega = np.stack([spin[:, 2, 1] - spin[:, 1, 2], spin[:, 0, 2] - spin[:, 2, 0], spin[:, 1, 0] - spin[:, 0, 1]], 1)
    return (c1 - c0) / (2 * h), omega / (4 * h)


@pytest.mark.parametrize("seed", range(3))
def test_joint_velocities_are_newtons(seed):
    """Compare Newton's body velocities with finite differences: the frame of a ball joint's velocity must be right."""
    trees, rng = _trees(seed, (3, 15)), np.random.default_rng(seed)
    model = to_newton(trees, device="cpu")
    layout = read_layout(model)
    motion = [_random_motion(tree, rng) for tree in trees]
    qpos, qvel = ([m[k] for m in motion] for k in (0, 1))
    joint_qd = velocities_to_newton(layout, qpos, qvel)
    _, _, linear, angular = _forward(model, coordinates_to_newton(layout, qpos), joint_qd)
    for tree, world, q, v in zip(trees, layout, qpos, qvel, strict=True):
        expected = _velocities_by_differences(tree, q, v)
        np.testing.assert_allclose(linear[world.body], expected[0], atol=2e-5)
        np.testing.assert_allclose(angular[world.body], expected[1], atol=2e-5)


def _turned_joints() -> newton.ModelBuilder:
    """Build two bodies on a ball and a revolute joint whose frames on the child are turned and shifted."""
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    turn = wp.quat_rpy(0.3, -0.7, 1.1)
    a = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)), com=wp.vec3(0.1, 0.2, 0.3), label="robot/a")
    b = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)), com=wp.vec3(0.0, 0.0, 0.5), label="robot/b")
    above = {"parent_xform": wp.transform(wp.vec3(0.0, 1.0, 0.5), wp.quat_rpy(-0.4, 0.2, 0.9))}
    below = {"child_xform": wp.transform(wp.vec3(0.3, 0.0, -0.2), turn)}
    ball = builder.add_joint_ball(-1, a, stiffness=5.0, damping=0.5, **above, **below)
    builder.joint_rest_q[:4] = list(wp.quat_rpy(0.5, 0.0, 0.0))
    hinge = builder.add_joint_revolute(a, b, axis=wp.vec3(0.6, 0.0, 0.8), stiffness=3.0, rest_q=0.4, **above, **below)
    builder.add_articulation([ball, hinge], label="robot")
    return builder


def test_turned_joint_frames():
    """Describe a model whose joint frames are turned on the child: poses and velocities still agree with Newton's."""
    model = _turned_joints().finalize(device="cpu")
    (tree,), layout, rng = from_newton(model), read_layout(model), np.random.default_rng(0)
    assert (tree.name, tree.link_name) == ("robot", ["a", "b"])
    qpos, qvel = _random_motion(tree, rng)
    joint_q, joint_qd = coordinates_to_newton(layout, [qpos]), velocities_to_newton(layout, [qpos], [qvel])
    pos, quat, linear, angular = _forward(model, joint_q, joint_qd)
    expected, speed = pose(tree, qpos), _velocities_by_differences(tree, qpos, qvel)
    np.testing.assert_allclose(pos, expected[0], atol=FLOAT32)
    np.testing.assert_allclose(quat_matrix(quat), quat_matrix(expected[1]), atol=FLOAT32)
    np.testing.assert_allclose(linear, speed[0], atol=2e-5)
    np.testing.assert_allclose(angular, speed[1], atol=2e-5)
    np.testing.assert_allclose(coordinates_from_newton(layout, joint_q)[0], qpos, atol=1e-12)
    np.testing.assert_allclose(velocities_from_newton(layout, joint_q, joint_qd)[0], qvel, atol=1e-12)


def test_spring_is_relaxed_where_newton_relaxes_it():
    """Put Newton's rest coordinates through the conversion: they are the tree's rest, in turned joint frames too."""
    model = _turned_joints().finalize(device="cpu")
    tree = from_newton(model)[0]
    relaxed = coordinates_from_newton(read_layout(model), model.joint_rest_q.numpy())[0]
    np.testing.assert_allclose(tree.rest[0], relaxed[:4], atol=FLOAT32)
    np.testing.assert_allclose(tree.rest[1, 0], relaxed[4], atol=FLOAT32)
    np.testing.assert_allclose(tree.stiffness, [5, 3])
    np.testing.assert_allclose(tree.damping, [0.5, 0])


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_coordinates_there_and_back(seed):
    """Convert random coordinates and velocities to Newton's layout and back."""
    trees, rng = _trees(seed, (4, 1, 6)), np.random.default_rng(seed)
    layout = read_layout(to_newton(trees, device="cpu"))
    motion = [_random_motion(tree, rng) for tree in trees]
    qpos, qvel = ([m[k] for m in motion] for k in (0, 1))
    joint_q = coordinates_to_newton(layout, qpos)
    back = velocities_from_newton(layout, joint_q, velocities_to_newton(layout, qpos, qvel))
    for a, b in zip(coordinates_from_newton(layout, joint_q) + back, qpos + qvel, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_newtons_mjcf_import_agrees(tmp_path):
    """Compare bough's reading of MJCF with Newton's, through `from_newton`, on files Newton reads as MuJoCo does."""
    for seed in range(12):
        text = RandomMjcf(seed, bodies=6, multi=False, ref=False, frames=False, plain=True).text
        (tmp_path / "m.xml").write_text(text)
        builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
        builder.add_mjcf(text)
        theirs, ours = from_newton(builder.finalize(device="cpu"))[0], load_mjcf(tmp_path / "m.xml", ("all",)).tree
        np.testing.assert_array_equal(theirs.joint, ours.joint)
        for key in ("position", "anchor", "mass", "com", "inertia", "stiffness", "damping", "armature"):
            a, b = getattr(theirs, key), getattr(ours, key)
            np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5, err_msg=f"{seed} {key}")


def test_worlds_keep_their_gravity_and_height():
    """Check gravity of every world and that the bodies start where the trees stand."""
    trees = _trees(3, (3, 4))
    model = to_newton(trees, gravity=(0.0, 1.0, -2.0), device="cpu")
    np.testing.assert_allclose(model.gravity.numpy()[:2], [[0, 1, -2]] * 2)
    expected = np.concatenate([pose(t, _zero(t))[0] for t in trees])
    np.testing.assert_allclose(model.body_q.numpy()[:, :3], expected, atol=FLOAT32)


def _zero(tree):
    return np.concatenate([np.eye(1, Joint(k).coordinates)[0] * (k == Joint.SPHERICAL) for k in tree.joint])


def _one_body(**joint) -> newton.ModelBuilder:
    builder = newton.ModelBuilder()
    body = builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)), label="body")
    joint_kind = joint.pop("kind")
    builder.add_articulation([getattr(builder, f"add_joint_{joint_kind}")(child=body, label="j", **joint)])
    return builder


def test_free_joint_is_refused():
    """Name the joint and its kind."""
    with pytest.raises(InputError, match="joint j: found a FREE joint"):
        from_newton(_one_body(kind="free").finalize(device="cpu"))


def test_different_springs_of_a_ball_joint_are_refused():
    """Name the joint and its three values."""
    builder = _one_body(kind="ball", parent=-1, stiffness=2.0)
    builder.joint_stiffness[1] = 3.0
    with pytest.raises(InputError, match="joint j: found stiffness"):
        from_newton(builder.finalize(device="cpu"))


def test_closed_loop_is_refused():
    """Name the body that two joints lead to."""
    builder = _one_body(kind="revolute", parent=-1, axis=newton.Axis.X)
    with pytest.warns(UserWarning, match="Parallel joints"):
        builder.add_joint_revolute(-1, 0, axis=newton.Axis.X, label="loop")
    with pytest.raises(InputError, match="body body: found several joints"):
        from_newton(builder.finalize(device="cpu"))


def test_loose_body_is_refused():
    """Name the body that no joint leads to."""
    builder = _one_body(kind="revolute", parent=-1, axis=newton.Axis.X)
    builder.add_link(mass=1.0, inertia=wp.mat33(np.eye(3)), label="loose")
    with pytest.raises(InputError, match="body loose: found no joint"):
        from_newton(builder.finalize(device="cpu", skip_all_validations=True))
