"""Forward kinematics on the host, against C MuJoCo and a hand-computed example."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from bough.sim.base.rotation import quat_matrix
from bough.sim.formats.export_mjcf import to_mjcf
from bough.sim.trees.pose import pose, rest_pose, zero_qpos
from bough.sim.trees.tree import Joint, Tree
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.random_tree import random_qpos, random_tree

ALL = (Joint.FIXED, Joint.REVOLUTE, Joint.SPHERICAL, Joint.PRISMATIC)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), num_links=st.integers(1, 40))
def test_pose_equals_mujoco(seed, num_links):
    """Place every body of a random tree where mj_kinematics does, to round-off over a chain of 40 links."""
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, num_links, joints=ALL)
    model = mujoco.MjModel.from_xml_string(to_mjcf(tree))
    data, qpos = mujoco.MjData(model), random_qpos(rng, tree)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    pos, quat = pose(tree, qpos)
    np.testing.assert_allclose(pos, data.xpos[1:], atol=1e-12)
    np.testing.assert_allclose(quat_matrix(quat), data.xmat[1:].reshape(-1, 3, 3), atol=1e-12)


def test_pose_of_a_bent_chain_by_hand():
    """Turn a one-metre link by 90 degrees about y at its base: its child starts one metre along x."""
    link = {"parent": [-1, 0], "joint": [Joint.REVOLUTE, Joint.FIXED], "axis": [[0, 1, 0], [0, 0, 1]]}
    body = {"mass": [1, 1], "com": np.zeros((2, 3)), "inertia": np.tile(np.eye(3), (2, 1, 1))}
    place = {"position": [[0, 0, 2], [0, 0, 1]], "rotation": [[1, 0, 0, 0]] * 2}
    tree = Tree("chain", ["low", "high"], stiffness=[0, 0], damping=[0, 0], **link, **body, **place)
    pos, quat = pose(tree, np.array([np.pi / 2]))
    np.testing.assert_allclose(pos, [[0, 0, 2], [1, 0, 2]], atol=1e-15)
    np.testing.assert_allclose(quat, np.tile([np.sqrt(0.5), 0, np.sqrt(0.5), 0], (2, 1)), atol=1e-15)


def test_pose_is_batched():
    """Give each entry of a batch of coordinates the pose it has alone, and joint zero the rest pose."""
    rng = np.random.default_rng(3)
    tree = random_tree(rng, 12, joints=ALL)
    qpos = np.stack([[random_qpos(rng, tree) for _ in range(2)] for _ in range(3)])
    pos, quat = pose(tree, qpos)
    alone = pose(tree, qpos[2, 1])
    np.testing.assert_array_equal(pos[2, 1], alone[0])
    np.testing.assert_array_equal(quat[2, 1], alone[1])
    np.testing.assert_array_equal(rest_pose(tree)[0], pose(tree, zero_qpos(tree))[0])


def test_pose_refuses_a_wrong_length():
    """Refuse coordinates of another tree instead of reading past them."""
    tree = random_tree(np.random.default_rng(0), 3)
    with pytest.raises(ValueError, match="coordinates"):
        pose(tree, np.zeros(tree.num_coordinates + 1))
