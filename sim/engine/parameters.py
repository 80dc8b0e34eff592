"""From descriptions to the numbers the kernels read.

For every link a frame is chosen at its joint point along the principal axes of inertia about that point, so that the
kernels turn three moments instead of a full tensor; coordinates are measured from the spring's rest, so that a joint's
torque is -K log(coordinate). This module does both changes of frame, for all links of all worlds at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..base import rotation
from ..base.types import Array, IntArray
from ..trees.tree import Joint, Tree


@dataclass(frozen=True)
class Links:
    """Parameters of N links of all worlds, one after the other, in kernel frames (see `kernels.tree.layout`).

    Attributes:
        world: World of each link, shape [N].
        kind: `Joint` of each link, shape [N].
        offset: Joint point in the parent's link frame at rest [m], shape [N, 3].
        turn: Link frame in the parent's link frame at rest, shape [N, 4].
        axis: Joint axis in the link frame, shape [N, 3].
        mass, stiffness, damping, armature: SI units, shape [N].
        com: Centre of mass in the link frame [m], shape [N, 3].
        inertia: Principal moments about the joint point [kg m^2], shape [N, 3].
        preload: Joint force at the spring's rest, in the link frame [N m or N], shape [N, 3]; see `Tree`.
        frame: Link frame in the body frame, shape [N, 4].
        anchor: Joint point in the body frame [m], shape [N, 3].
        rest: Rest coordinate as in `Tree.rest`, shape [N, 4].
    """

    world: IntArray
    kind: IntArray
    offset: Array
    turn: Array
    axis: Array
    mass: Array
    com: Array
    inertia: Array
    stiffness: Array
    damping: Array
    armature: Array
    preload: Array
    frame: Array
    anchor: Array
    rest: Array

    def in_link_frame(self, n: int | IntArray, point: Array) -> Array:
        """Return points [..., 3] of the body frames of links ``n`` in their link frames [m]."""
        return rotation.quat_rotate(rotation.quat_conjugate(self.frame[n]), point - self.anchor[n])


def principal_frames(inertia: Array) -> tuple[Array, Array]:
    """Return principal moments [N, 3] and frames [N, 4] of symmetric tensors [N, 3, 3].

    Tensors that are diagonal already keep their axes, so that a capsule along z keeps its body frame.
    """
    moments = np.diagonal(inertia, axis1=1, axis2=2).copy()
    frames = np.tile([1.0, 0.0, 0.0, 0.0], (len(inertia), 1))
    off = np.abs(inertia - moments[:, :, None] * np.eye(3)).max(axis=(1, 2))
    full = off > 1e-12 * np.abs(moments).max(axis=1)
    if full.any():
        values, vectors = np.linalg.eigh(inertia[full])
        vectors[:, :, 2] *= np.sign(np.linalg.det(vectors))[:, None]
        moments[full], frames[full] = values, rotation.matrix_quat(vectors)
    return moments, frames


def inertia_about(tree_mass: Array, com: Array, inertia: Array, point: Array) -> Array:
    """Return tensors [N, 3, 3] about ``point`` by the parallel-axis theorem: I + m (|d|^2 1 - d d^T)."""
    d = com - point
    steiner = np.einsum("ni,ni->n", d, d)[:, None, None] * np.eye(3) - d[:, :, None] * d[:, None, :]
    return inertia + tree_mass[:, None, None] * steiner


def rest_rotation(kind: IntArray, axis: Array, rest: Array) -> Array:
    """Return the joint rotation at the spring's rest, shape [N, 4]."""
    turned = rotation.axis_angle_quat(axis, rest[:, 0])
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    out = np.where((kind == Joint.SPHERICAL)[:, None], rest, identity)
    return np.where((kind == Joint.REVOLUTE)[:, None], turned, out)


def link_parameters(trees: Sequence[Tree]) -> Links:
    """Return the parameters of all links of all trees."""

    def stacked(name: str) -> Array:
        """Return a parameter of all trees' links, one tree after the other."""
        return np.concatenate([getattr(t, name) for t in trees])

    counts = [t.num_links for t in trees]
    world = np.repeat(np.arange(len(trees)), counts)
    first = np.cumsum([0, *counts[:-1]])
    parent = np.concatenate([np.where(t.parent < 0, -1, t.parent + f) for t, f in zip(trees, first, strict=True)])
    kind = np.concatenate([t.joint for t in trees])
    anchor, axis, rest = (stacked(n) for n in ("anchor", "axis", "rest"))
    mass, com, body_rotation = stacked("mass"), stacked("com"), stacked("rotation")
    moments, frame = principal_frames(inertia_about(mass, com, stacked("inertia"), anchor))
    inverse = rotation.quat_conjugate(frame)
    slide = np.where((kind == Joint.PRISMATIC)[:, None], axis * rest[:, :1], 0.0)
    point = stacked("position") + rotation.quat_rotate(body_rotation, anchor + slide)
    above = parent >= 0
    parent_inverse = np.where(above[:, None], inverse[parent], [1.0, 0.0, 0.0, 0.0])
    offset = rotation.quat_rotate(parent_inverse, point - np.where(above[:, None], anchor[parent], 0.0))
    rest_turn = rotation.quat_multiply(body_rotation, rest_rotation(kind, axis, rest))
    turn = rotation.quat_multiply(rotation.quat_multiply(parent_inverse, rest_turn), frame)
    spherical = (kind == Joint.SPHERICAL)[:, None]
    preload = stacked("preload")
    turned_preload = rotation.quat_rotate(inverse, preload)
    return Links(
        world=world, kind=kind, offset=offset, turn=turn / np.linalg.norm(turn, axis=1, keepdims=True),
        axis=rotation.quat_rotate(inverse, axis), mass=mass, com=rotation.quat_rotate(inverse, com - anchor),
        inertia=moments,
        stiffness=stacked("stiffness"), damping=stacked("damping"), armature=stacked("armature"),
        preload=np.where(spherical, turned_preload, preload), frame=frame, anchor=anchor, rest=rest,
    )  # fmt: skip
