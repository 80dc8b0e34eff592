"""Where the links of each world sit in a Newton model, and joint coordinates between the two layouts.

Conventions, found by experiment with Newton 1.8 and kept true by the tests:

- Newton's quaternions are x, y, z, w; bough's are w, x, y, z.
- A Newton joint has a frame of its own on both bodies: child = parent X_p J(q) X_c^-1. A link of a `Tree` is
  child = parent F A J(q) A^-1 with A the shift to the anchor. So F = X_p X_c^-1, the anchor is the origin of X_c, and
  axes and spherical coordinates turn by the rotation of X_c.
- ``joint_qd`` of a ball joint is the angular velocity against the parent in the parent's joint frame X_p, where
  MuJoCo and bough have it in the child's body frame.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import newton
import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.rotation import quat_multiply, quat_rotate
from ..base.types import Array, IntArray
from ..trees.tree import Joint

SOURCE = "Newton model"
_KINDS = {
    newton.JointType.FIXED: Joint.FIXED,
    newton.JointType.REVOLUTE: Joint.REVOLUTE,
    newton.JointType.BALL: Joint.SPHERICAL,
    newton.JointType.PRISMATIC: Joint.PRISMATIC,
}


@dataclass(frozen=True)
class WorldLayout:
    """Links of one world in `Tree` order, parents before their children.

    Attributes:
        joint: Newton joint of each link, shape [L].
        body: Newton body of each link, shape [L].
        parent: Parent link, -1 for the world, shape [L].
        kind: Kind of joint (`Joint`), shape [L].
        q_start, qd_start: First entry of each link in ``joint_q`` and ``joint_qd``, shape [L].
        position, rotation: Body frame in the parent's at joint zero [m; w, x, y, z], shapes [L, 3] and [L, 4].
        anchor: Origin of the joint in the body frame [m], shape [L, 3].
        turn: Orientation of the joint's frame in the body frame (w, x, y, z), shape [L, 4].
    """

    joint: IntArray
    body: IntArray
    parent: IntArray
    kind: IntArray
    q_start: IntArray
    qd_start: IntArray
    position: Array
    rotation: Array
    anchor: Array
    turn: Array


def read_layout(model: newton.Model) -> list[WorldLayout]:
    """Find the links of each world; a model built without worlds counts as one world.

    Raises:
        InputError: A joint of another kind than fixed, revolute, ball and prismatic, a closed loop, a body without a
            joint, bodies both inside and outside of worlds.
    """
    child = host(model, "joint_child")
    count = np.bincount(child, minlength=model.body_count)
    for body in np.flatnonzero(count != 1):
        found = "several joints (a closed loop)" if count[body] else "no joint"
        raise InputError(SOURCE, f"body {model.body_label[body]}", found, "one joint to its parent or the world")
    world = host(model, "body_world")[child]
    if len(np.unique(world < 0)) > 1:
        raise InputError(SOURCE, "", "bodies both inside and outside of worlds", "all bodies in worlds, or none")
    ordered = _parents_first(host(model, "joint_parent"), child)
    return [_read_world(model, ordered[world[ordered] == w]) for w in np.unique(world)]


def host(model: newton.Model, name: str) -> NDArray:
    """Copy of one of the model's arrays on the host."""
    return getattr(model, name).numpy()


def _parents_first(parent: IntArray, child: IntArray) -> IntArray:
    """Joint indices, the smallest first among those whose parent body has been reached."""
    waiting: dict[int, list[int]] = {}
    for joint, body in enumerate(parent):
        waiting.setdefault(int(body), []).append(joint)
    ready, out = waiting.get(-1, []), []
    while ready:
        out.append(heapq.heappop(ready))
        for joint in waiting.get(int(child[out[-1]]), []):
            heapq.heappush(ready, joint)
    if len(out) != len(parent):
        raise InputError(SOURCE, "", "joints that lead in a circle", "a tree of joints")
    return np.array(out, dtype=np.int64)


def _read_world(model: newton.Model, joint: IntArray) -> WorldLayout:
    body = host(model, "joint_child")[joint].astype(np.int64)
    link = {int(b): i for i, b in enumerate(body)} | {-1: -1}
    kinds = [newton.JointType(int(kind)) for kind in host(model, "joint_type")[joint]]
    for j, kind in zip(joint, kinds, strict=True):
        if kind not in _KINDS:
            allowed = ", ".join(k.name.lower() for k in _KINDS)
            raise InputError(SOURCE, f"joint {model.joint_label[j]}", f"a {kind.name} joint", allowed)
    above, below = (host(model, key)[joint].astype(np.float64) for key in ("joint_X_p", "joint_X_c"))
    turn = unit(wxyz(below[:, 3:]))
    rotation = quat_multiply(unit(wxyz(above[:, 3:])), conjugate(turn))
    return WorldLayout(
        joint=joint,
        body=body,
        parent=np.array([link[int(b)] for b in host(model, "joint_parent")[joint]], dtype=np.int64),
        kind=np.array([_KINDS[kind] for kind in kinds], dtype=np.int64),
        q_start=host(model, "joint_q_start")[joint].astype(np.int64),
        qd_start=host(model, "joint_qd_start")[joint].astype(np.int64),
        position=above[:, :3] - quat_rotate(rotation, below[:, :3]),
        rotation=rotation,
        anchor=below[:, :3],
        turn=turn,
    )


def coordinates_from_newton(layout: Sequence[WorldLayout], joint_q: Array) -> list[Array]:
    """Joint coordinates of every world in MuJoCo's order, each of shape [num_coordinates].

    Args:
        layout: What `read_layout` returned.
        joint_q: Newton's ``joint_q`` [m, rad, quaternion x, y, z, w], shape [joint_coord_count].
    """
    return [np.concatenate([np.zeros(0), *_world_coordinates(world, np.asarray(joint_q))]) for world in layout]


def _world_coordinates(world: WorldLayout, joint_q: Array) -> list[Array]:
    out = []
    for kind, start, turn in zip(world.kind, world.q_start, world.turn, strict=True):
        own = joint_q[start : start + Joint(kind).coordinates]
        out.append(turned(turn, unit(wxyz(own))) if kind == Joint.SPHERICAL else own)
    return out


def velocities_from_newton(layout: Sequence[WorldLayout], joint_q: Array, joint_qd: Array) -> list[Array]:
    """Joint velocities of every world in MuJoCo's order [m/s, rad/s], each of shape [num_dofs].

    Args:
        layout: What `read_layout` returned.
        joint_q: Newton's ``joint_q``, shape [joint_coord_count].
        joint_qd: Newton's ``joint_qd``, shape [joint_dof_count].
    """
    out = []
    for world in layout:
        parts = [np.zeros(0)]
        for i, q in enumerate(_world_coordinates(world, np.asarray(joint_q))):
            own = np.asarray(joint_qd)[world.qd_start[i] :][: Joint(world.kind[i]).dofs]
            spherical = world.kind[i] == Joint.SPHERICAL
            parts.append(quat_rotate(quat_multiply(conjugate(q), world.turn[i]), own) if spherical else own)
        out.append(np.concatenate(parts))
    return out


def coordinates_to_newton(layout: Sequence[WorldLayout], qpos: Sequence[Array]) -> Array:
    """Newton's ``joint_q``, shape [joint_coord_count], from each world's coordinates in MuJoCo's order."""
    out = np.zeros(sum(Joint(k).coordinates for world in layout for k in world.kind))
    for world, own in zip(layout, qpos, strict=True):
        for i, q in enumerate(split(own, [Joint(k).coordinates for k in world.kind])):
            if world.kind[i] == Joint.SPHERICAL:
                q = xyzw(turned(conjugate(world.turn[i]), unit(q)))
            out[world.q_start[i] : world.q_start[i] + len(q)] = q
    return out


def velocities_to_newton(layout: Sequence[WorldLayout], qpos: Sequence[Array], qvel: Sequence[Array]) -> Array:
    """Newton's ``joint_qd``, shape [joint_dof_count], from each world's coordinates and velocities, MuJoCo's order."""
    out = np.zeros(sum(Joint(k).dofs for world in layout for k in world.kind))
    for world, own_q, own_v in zip(layout, qpos, qvel, strict=True):
        positions = split(own_q, [Joint(k).coordinates for k in world.kind])
        for i, v in enumerate(split(own_v, [Joint(k).dofs for k in world.kind])):
            if world.kind[i] == Joint.SPHERICAL:
                v = quat_rotate(quat_multiply(conjugate(world.turn[i]), unit(positions[i])), v)
            out[world.qd_start[i] : world.qd_start[i] + len(v)] = v
    return out


def split(values: Array, sizes: Sequence[int]) -> list[Array]:
    """Cut a vector into pieces of the given sizes."""
    return np.split(np.asarray(values, dtype=np.float64), np.cumsum(sizes)[:-1])


def xyzw(q: Array) -> Array:
    """Quaternions x, y, z, w from w, x, y, z, shape [..., 4]."""
    return np.roll(q, -1, axis=-1)


def wxyz(q: Array) -> Array:
    """Quaternions w, x, y, z from x, y, z, w, shape [..., 4], as float64."""
    return np.roll(np.asarray(q, dtype=np.float64), 1, axis=-1)


def conjugate(q: Array) -> Array:
    """Inverse of unit quaternions w, x, y, z, shape [..., 4]."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def turned(turn: Array, q: Array) -> Array:
    """Rotation q, given in a frame of orientation ``turn``, in the frame that ``turn`` refers to: turn q turn^-1."""
    return quat_multiply(quat_multiply(turn, q), conjugate(turn))


def unit(v: Array) -> Array:
    """Vectors at length one, shape [..., n]."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)
