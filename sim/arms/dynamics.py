"""An arm in motion, on the host: the torques that a motion needs."""

from __future__ import annotations

import numpy as np

from ..base.rotation import quat_conjugate, quat_rotate
from ..base.types import Array
from ..trees.pose import pose
from .arm import Arm


def motion_torques(arm: Arm, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the joint torques that a motion needs beside the arm's weight and friction [N m].

    Newton and Euler's equations, link by link from the base out, in world axes (Luh, Walker & Paul 1980): link i turns
    at w_i = w_(i-1) + z_i q'_i, its centre c_i has the acceleration a_i, and joint j carries the links from j outward,

        tau_j = z_j . sum over i >= j of [I_i w'_i + w_i x I_i w_i + (c_i - p_j) x m_i a_i] + R_j q''_j

    with R the reflected inertia of the rotor. `statics` returns the weight.

    Args:
        arm: The arm, D joints.
        q: Joint positions [rad], shape [T, D].
        qd: Joint speeds [rad/s], shape [T, D].
        qdd: Joint accelerations [rad/s^2], shape [T, D].

    Returns:
        Torques [N m], shape [T, D].
    """
    tree = arm.tree
    origin, turn = pose(tree, q)
    points, axes = origin + quat_rotate(turn, tree.anchor), quat_rotate(turn, tree.axis)
    centres = origin + quat_rotate(turn, tree.com)
    spin, spinning, moving = (np.zeros((len(q), 3)) for _ in range(3))
    before = points[:, 0]
    force, moment = np.zeros((arm.num_dofs, len(q), 3)), np.zeros((arm.num_dofs, len(q), 3))
    for i in range(arm.num_dofs):
        moving = moving + _carried(spin, spinning, points[:, i] - before)
        rate = axes[:, i] * qd[:, i, None]
        spinning = spinning + axes[:, i] * qdd[:, i, None] + np.cross(spin, rate)
        spin, before = spin + rate, points[:, i]
        force[i] = tree.mass[i] * (moving + _carried(spin, spinning, centres[:, i] - points[:, i]))
        inertia = tree.inertia[i]
        moment[i] = _turned(turn[:, i], inertia, spinning) + np.cross(spin, _turned(turn[:, i], inertia, spin))
    out = tree.armature * qdd
    for j in range(arm.num_dofs):
        levers = np.moveaxis(centres[:, j:], 1, 0) - points[:, j]
        out[:, j] += (axes[:, j] * (moment[j:] + np.cross(levers, force[j:])).sum(axis=0)).sum(axis=-1)
    return out


def _carried(spin: Array, spinning: Array, lever: Array) -> Array:
    """Return the acceleration of a point of a body beside that of another, w' x r + w x (w x r), [T, 3]."""
    return np.cross(spinning, lever) + np.cross(spin, np.cross(spin, lever))


def _turned(turn: Array, inertia: Array, vector: Array) -> Array:
    """Return R I R^T v for a body's inertia about its centre, in its own axes, [T, 3]."""
    return quat_rotate(turn, quat_rotate(quat_conjugate(turn), vector) @ inertia.T)
