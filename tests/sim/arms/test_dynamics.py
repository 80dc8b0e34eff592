"""Torques that a motion of an arm needs, against MuJoCo's inverse dynamics."""

import mujoco
import numpy as np
import pytest
from bough.sim.arms.dynamics import motion_torques
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.statics import statics
from oracles.mujoco_arm import compiled


@pytest.mark.parametrize("wrist", ["curved", "spherical"])
def test_motion_torques_are_mujoco_s_inverse_dynamics(wrist):
    """With the weight they are what mj_inverse says of random motions, to the round-off of the exported file."""
    arm = jaco2(wrist)
    arm = type(arm)(**(vars(arm) | {"tree": arm.tree.with_(armature=np.full(6, 0.03)), "friction": np.zeros(6)}))
    model, data = compiled(arm, servo=False, contact=False)
    rng = np.random.default_rng(3)
    q, qd, qdd = arm.home + rng.normal(size=(20, 6)), rng.normal(size=(20, 6)), 3 * rng.normal(size=(20, 6))
    expected = np.zeros((20, 6))
    for i in range(20):
        data.qpos[:6], data.qvel[:6], data.qacc[:6] = q[i], qd[i], qdd[i]
        mujoco.mj_inverse(model, data)
        expected[i] = data.qfrc_inverse[:6]
    found = motion_torques(arm, q, qd, qdd) + statics(arm, q)[0]
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
