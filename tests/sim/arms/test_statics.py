"""An arm at rest against C MuJoCo."""

import mujoco
import numpy as np
import pytest
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.statics import statics
from oracles.mujoco_arm import compiled


@pytest.mark.parametrize("wrist", ["curved", "spherical"])
def test_gravity_torque_and_jacobian_are_mujocos(wrist):
    """Give MuJoCo's bias force without speed, and its Jacobian of the end-effector, at random joint positions."""
    arm = jaco2(wrist)
    model, data = compiled(arm, servo=False, contact=False)
    q = np.random.default_rng(0).uniform(-3, 3, (20, arm.num_dofs))
    hold, jacobian = statics(arm, q)
    assert hold.shape == (20, 6) and jacobian.shape == (20, 3, 6)
    body = model.body(arm.tree.link_name[arm.end_link]).id
    for k, row in enumerate(q):
        data.qpos[: arm.num_dofs] = row
        mujoco.mj_forward(model, data)
        point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ arm.end_position
        expected = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, expected, None, point, body)
        # MJCF holds nine digits or more of masses and lengths, torques of up to 15 N m
        np.testing.assert_allclose(hold[k], data.qfrc_bias, atol=1e-6)
        np.testing.assert_allclose(jacobian[k], expected, atol=1e-7)
