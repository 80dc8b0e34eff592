"""The shape of a branch whose grasp point is known: the least bending of its springs that takes it there.

A case records where one point is. What is drawn between that point and the base is the pose of least spring energy,
min sum_i k_i |a_i|^2 with x(a) = target, a_i the turn of joint i as a vector. It is found by repeated linearisation:
with J = dx/da at the last pose the minimum is a = K^-1 J' (J K^-1 J')^-1 (target - x + J a).
"""

from __future__ import annotations

import numpy as np

from ...sim.base.rotation import cross, quat_multiply, quat_rotate
from ...sim.base.types import Array
from ...sim.trees.measured import MeasuredBranch, axis_rotation

_ROUNDS = 12
_NEAR = 1e-9
"""Least squared length of a lever, as a share of the branch's, so that a straight branch can be solved for [1]."""


def bent(branch: MeasuredBranch, grasp: tuple[int, Array], moved: Array, stiffness: Array) -> tuple[Array, Array]:
    """Return the body frames of a branch at T moments, [T, R, 3] in m and [T, R, 4].

    Args:
        branch: R segments.
        grasp: Segment that is held and the grasp point in its frame [m].
        moved: Displacement of the grasp point from rest [m], shape [T, 3].
        stiffness: Springs of the joints [N m/rad], shape [R].
    """
    held, point = grasp
    rest = axis_rotation(branch.elevation, branch.azimuth)
    target = branch.lower_end[held] + quat_rotate(rest[held], point) + moved
    turn = np.zeros((len(moved), held + 1, 3))
    soft = np.repeat(1.0 / np.maximum(stiffness[: held + 1], 1e-12), 3)
    for _ in range(_ROUNDS):
        position, rotation = _frames(branch, rest, turn)
        at = position[:, held] + quat_rotate(rotation[:, held], np.broadcast_to(point, moved.shape))
        j = _jacobian(at[:, None] - position[:, : held + 1])
        wanted = (target - at) + np.einsum("tcn,tn->tc", j, turn.reshape(len(moved), -1))
        weight = np.einsum("tcn,n,tdn->tcd", j, soft, j)
        weight += _NEAR * np.trace(weight, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        turn = (soft * np.einsum("tcn,tc->tn", j, np.linalg.solve(weight, wanted[..., None])[..., 0])).reshape(
            turn.shape
        )
    return _frames(branch, rest, turn)


def _frames(branch: MeasuredBranch, rest: Array, turn: Array) -> tuple[Array, Array]:
    """Return body frames where every joint turns its segment, and all beyond, by a vector in world axes [T, J, 3]."""
    count = len(turn)
    position, rotation = np.empty((count, len(rest), 3)), np.empty((count, len(rest), 4))
    whole = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    at = np.tile(branch.base_position, (count, 1)).astype(float)
    for i, length in enumerate(branch.length):
        if i < turn.shape[1]:
            whole = quat_multiply(_exp(turn[:, i]), whole)
        position[:, i], rotation[:, i] = at, quat_multiply(whole, rest[i])
        at = at + quat_rotate(rotation[:, i], np.broadcast_to([0.0, 0.0, length], at.shape))
    return position, rotation


def _exp(turn: Array) -> Array:
    """Return the quaternions of rotation vectors [T, 3]."""
    angle = np.linalg.norm(turn, axis=1, keepdims=True)
    return np.concatenate([np.cos(0.5 * angle), 0.5 * np.sinc(angle / (2.0 * np.pi)) * turn], axis=1)


def _jacobian(lever: Array) -> Array:
    """Return d x / d a = a x lever, levers [T, J, 3], as [T, 3, 3 J]."""
    columns = [cross(np.broadcast_to(axis, lever.shape), lever) for axis in np.eye(3)]
    return np.stack(columns, axis=2).reshape(len(lever), -1, 3).swapaxes(1, 2)
