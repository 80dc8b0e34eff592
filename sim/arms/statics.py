"""An arm at rest, on the host: the torques that hold it against gravity, and the Jacobian of its end-effector."""

from __future__ import annotations

import numpy as np

from ..base.rotation import quat_rotate
from ..base.types import Array
from ..trees.pose import pose
from .arm import Arm


def statics(arm: Arm, q: Array, gravity: float = 9.81) -> tuple[Array, Array]:
    """Return what holds an arm at rest, and how its end-effector moves.

    With the potential energy U, the torque that holds joint j is dU/dq_j = sum over the links i that it carries of
    m_i g [a_j x (c_i - p_j)]_z, where a_j is its axis, p_j a point on it, and c_i a centre of mass. Column j of the
    Jacobian is a_j x (e - p_j), e the end-effector.

    Args:
        arm: The arm, D joints; the world is its base frame, z up.
        q: Joint positions [rad], shape [..., D].
        gravity: Downwards [m/s^2].

    Returns:
        Torques of the joints [N m], shape [..., D], and the Jacobian of the end-effector's position [m/rad], shape
        [..., 3, D].

    Raises:
        ValueError: The last dimension of ``q`` is not D.
    """
    tree = arm.tree
    origin, turn = pose(tree, q)
    points, axes = origin + quat_rotate(turn, tree.anchor), quat_rotate(turn, tree.axis)
    centres = origin + quat_rotate(turn, tree.com)
    end = origin[..., arm.end_link, :] + quat_rotate(turn[..., arm.end_link, :], arm.end_position)
    # [..., joint, link, 3]: a serial chain, so joint j carries the links from j on
    lifted = np.cross(axes[..., :, None, :], centres[..., None, :, :] - points[..., :, None, :])[..., 2]
    carried = np.triu(np.ones((arm.num_dofs, arm.num_dofs)))
    columns = np.cross(axes, end[..., None, :] - points)
    columns = columns * (np.arange(arm.num_dofs) <= arm.end_link)[:, None]
    return gravity * (lifted * carried) @ tree.mass, np.moveaxis(columns, -1, -2)
