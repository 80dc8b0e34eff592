"""Forward kinematics of a `Tree` on the host: where every body frame is for given joint coordinates.

For drawing, export and checks; the simulator has its own kernels. All functions take leading batch dimensions.
"""

from __future__ import annotations

import numpy as np

from ..base.rotation import axis_angle_quat, quat_multiply, quat_rotate
from ..base.types import Array, IntArray
from .tree import Joint, Tree


def zero_qpos(tree: Tree) -> Array:
    """Joint coordinates at joint zero, shape [num_coordinates]: 0 for scalar joints, 1, 0, 0, 0 for spherical ones."""
    qpos = np.zeros(tree.num_coordinates)
    qpos[coordinate_start(tree)[tree.joint == Joint.SPHERICAL]] = 1.0
    return qpos


def coordinate_start(tree: Tree) -> IntArray:
    """Index of each link's first entry in ``qpos``, shape [L]; a fixed link has the index of what follows it."""
    width = np.array([Joint(j).coordinates for j in tree.joint])
    return np.cumsum(width) - width


def rest_pose(tree: Tree) -> tuple[Array, Array]:
    """Body frames at joint zero: positions [L, 3] in metres and orientations [L, 4] (w, x, y, z)."""
    pos, quat = tree.position.copy(), tree.rotation.copy()
    for links in generations(tree.parent)[1:]:
        above = tree.parent[links]
        pos[links] = pos[above] + quat_rotate(quat[above], pos[links])
        quat[links] = quat_multiply(quat[above], quat[links])
    return pos, quat


def generations(parent: IntArray) -> list[IntArray]:
    """Return the links by their number of ancestors, ascending in each; ``parent`` [L] is -1 for the world."""
    depth: list[int] = []
    for p in parent.tolist():
        depth.append(0 if p < 0 else depth[p] + 1)
    return [np.flatnonzero(np.array(depth) == d) for d in range(max(depth, default=-1) + 1)]


def pose(tree: Tree, qpos: Array) -> tuple[Array, Array]:
    """Body frames in the world for joint coordinates in the tree's link order.

    A link's frame is its parent's frame times (position, rotation) times the joint's own motion, which turns about
    ``anchor`` or slides along ``axis`` in the link's frame, as in MuJoCo's ``mj_kinematics``.

    Args:
        tree: The tree, L links.
        qpos: Joint coordinates, shape [..., num_coordinates]: one per revolute [rad] and prismatic [m] joint, a
            quaternion w, x, y, z (normalised here) per spherical joint.

    Returns:
        Body frame origins [..., L, 3] in metres and orientations [..., L, 4] (w, x, y, z).

    Raises:
        ValueError: The last dimension of ``qpos`` is not ``tree.num_coordinates``.
    """
    qpos = np.asarray(qpos, dtype=np.float64)
    if qpos.shape[-1] != tree.num_coordinates:
        raise ValueError(f"qpos has {qpos.shape[-1]} coordinates, tree {tree.name} {tree.num_coordinates}")
    batch, start = qpos.shape[:-1], coordinate_start(tree)
    world = (np.zeros((*batch, 3)), np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*batch, 4)))
    pos, quat = np.empty((*batch, tree.num_links, 3)), np.empty((*batch, tree.num_links, 4))
    for i, p in enumerate(tree.parent):
        above_pos, above_quat = world if p < 0 else (pos[..., p, :], quat[..., p, :])
        shift, turn = _joint_motion(tree, i, qpos[..., start[i] :])
        frame = quat_multiply(above_quat, tree.rotation[i])
        pos[..., i, :] = above_pos + quat_rotate(above_quat, tree.position[i]) + quat_rotate(frame, shift)
        quat[..., i, :] = quat_multiply(frame, turn)
    return pos, quat


def _joint_motion(tree: Tree, i: int, q: Array) -> tuple[Array, Array]:
    """Shift [..., 3] and turn [..., 4] of link i against its frame at joint zero; q starts with its coordinates."""
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    joint = tree.joint[i]
    if joint == Joint.PRISMATIC:
        return q[..., :1] * tree.axis[i], identity
    if joint == Joint.REVOLUTE:
        turn = axis_angle_quat(tree.axis[i], q[..., 0])
    elif joint == Joint.SPHERICAL:
        turn = q[..., :4] / np.linalg.norm(q[..., :4], axis=-1, keepdims=True)
    else:
        turn = identity
    return tree.anchor[i] - quat_rotate(turn, tree.anchor[i]), turn
