"""A serial robot arm: a chain of revolute joints with velocity servos, and the capsules that it touches the world with.

An `Arm` is what every source (`jaco2`, `urdf`) is turned into and what the simulator takes. Its `Tree` holds the
links; what a tree of branches lacks (limits, servo, dry friction, end-effector, static base) stands beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import InputError
from ..base.rotation import quat_multiply, quat_rotate
from ..base.types import Array
from ..trees.pose import pose
from ..trees.tree import Joint, Tree

SERVO_GAIN = 80.0
"""Gain of a joint's velocity servo [N m s/rad]: the drive damping of the thesis (chapter 4)."""

_PER_JOINT = ("lower", "upper", "velocity_limit", "torque_limit", "gain", "friction", "home", "weight_error", "delay")
_LATER: Any = None  # stands for zero at every joint


@dataclass(frozen=True)
class Arm:
    """A serial arm of D revolute joints on a static base. Host NumPy, float64, SI units, z up.

    The servo of joint i asks for the torque that carries the arm's weight, less ``weight_error`` of it, and
    ``gain (target - speed)``, cut at ``torque_limit``. A hand or gripper is part of the last link.

    Attributes:
        name: Name of the arm.
        tree: The links in order from the base: ``parent = [-1, 0, 1, ...]``, every joint revolute, no springs. Its
            frames are those of `Tree`; the first link's parent is the base frame, which is the world's.
        lower, upper: Position limits [rad], infinite where a joint is continuous, shape [D].
        velocity_limit: Greatest target speed [rad/s], shape [D].
        torque_limit: Greatest servo torque [N m], shape [D].
        gain: Velocity servo [N m s/rad], shape [D].
        friction: Coulomb friction of the joints [N m], shape [D].
        end_link: Link that carries the end-effector frame.
        end_position: Origin of the end-effector frame in that link's body frame [m], shape [3].
        end_rotation: Its orientation there, unit quaternion w, x, y, z, shape [4].
        home: Joint positions to start from [rad], shape [D].
        base_start, base_end: Ends of the axes of the static base's B capsules, world axes [m], shape [B, 3].
        base_radius: Their radii [m], shape [B].
        weight_error: Share of the arm's weight that a joint's servo does not carry, shape [D]; none if not given.
        delay: How late a servo obeys its target [s], shape [D]; at once if not given.

    Raises:
        InputError: The tree is no serial chain of revolute joints, a link has no mass, no capsule is there to touch
            with, or a number has the wrong shape or is out of its range.
    """

    name: str
    tree: Tree
    lower: Array
    upper: Array
    velocity_limit: Array
    torque_limit: Array
    gain: Array
    friction: Array
    end_link: int
    end_position: Array
    end_rotation: Array
    home: Array
    base_start: Array
    base_end: Array
    base_radius: Array
    weight_error: Array = _LATER
    delay: Array = _LATER

    def __post_init__(self) -> None:
        for item in fields(self):
            if item.name not in ("name", "tree", "end_link"):
                given = getattr(self, item.name)
                value = np.zeros(self.tree.num_links) if given is _LATER else np.array(given, dtype=np.float64)
                object.__setattr__(self, item.name, value)
        _check_shapes(self)
        self.tree.validate(self.name)
        _check_chain(self.tree, self.name)
        for i in range(self.num_dofs):
            _check_joint(self, i)
        _check_frames(self)

    @property
    def num_dofs(self) -> int:
        """Number of joints D, which is also the number of links."""
        return self.tree.num_links

    @property
    def num_capsules(self) -> int:
        """Number of capsules on the moving links."""
        return len(self.tree.shape_link)


def _check_shapes(arm: Arm) -> None:
    count, capsules = arm.tree.num_links, arm.base_radius.size
    shapes: dict[str, tuple[int, ...]] = {name: (count,) for name in _PER_JOINT}
    shapes |= {"end_position": (3,), "end_rotation": (4,), "base_radius": (capsules,)}
    shapes |= {"base_start": (capsules, 3), "base_end": (capsules, 3)}
    for name, shape in shapes.items():
        value = getattr(arm, name)
        if value.shape != shape:
            raise InputError(arm.name, name, f"numbers of shape {value.shape}", f"shape {shape}")
        if np.isnan(value).any() or (name not in ("lower", "upper") and np.isinf(value).any()):
            raise InputError(arm.name, name, f"{value}", "finite numbers")


def _check_chain(tree: Tree, source: str | Path) -> None:
    for i, name in enumerate(tree.link_name):
        place = f"link {name}"
        if tree.parent[i] != i - 1:
            raise InputError(source, place, f"parent number {tree.parent[i]}", f"{i - 1}: links in order from the base")
        if tree.joint[i] != Joint.REVOLUTE:
            raise InputError(source, place, f"a {Joint(tree.joint[i]).name.lower()} joint", "a revolute joint")
        if tree.mass[i] <= 0:
            raise InputError(source, place, "no mass", "a mass above zero on every link that moves")
        if tree.stiffness[i] != 0 or tree.preload[i].any():
            raise InputError(source, place, "a joint spring", "joints that only a servo drives")
    if not len(tree.shape_link):
        raise InputError(source, "", "no collision shape on a moving link", "at least one")


def _check_joint(arm: Arm, i: int) -> None:
    def need(ok: bool | np.bool_, found: str, allowed: str) -> None:
        """Raise `InputError` that names the joint's link unless ``ok``."""
        if not ok:
            raise InputError(arm.name, f"joint of link {arm.tree.link_name[i]}", found, allowed)

    need(arm.lower[i] < arm.upper[i], f"limits {arm.lower[i]:g} to {arm.upper[i]:g} rad", "a lower below an upper one")
    need(arm.lower[i] <= arm.home[i] <= arm.upper[i], f"home {arm.home[i]:g} rad", "a home within the limits")
    need(arm.velocity_limit[i] > 0, f"velocity limit {arm.velocity_limit[i]:g} rad/s", "above zero")
    need(arm.torque_limit[i] > 0, f"torque limit {arm.torque_limit[i]:g} N m", "above zero")
    need(arm.gain[i] >= 0, f"gain {arm.gain[i]:g} N m s/rad", "zero or more")
    need(arm.friction[i] >= 0, f"friction {arm.friction[i]:g} N m", "zero or more")
    need(abs(arm.weight_error[i]) <= 1, f"weight error {arm.weight_error[i]:g}", "a share of the weight, -1 to 1")
    need(0 <= arm.delay[i] <= 1, f"delay {arm.delay[i]:g} s", "0 to 1")


def _check_frames(arm: Arm) -> None:
    if not 0 <= arm.end_link < arm.num_dofs:
        raise InputError(arm.name, "end_link", f"{arm.end_link}", f"0 to {arm.num_dofs - 1}")
    if abs(np.linalg.norm(arm.end_rotation) - 1) > 1e-6:
        raise InputError(arm.name, "end_rotation", f"{arm.end_rotation}", "a unit quaternion w, x, y, z")
    if not (arm.tree.shape_radius > 0).all() or not (arm.base_radius > 0).all():
        raise InputError(arm.name, "capsules", "a radius of zero", "radii above zero")


def forward_kinematics(arm: Arm, q: Array) -> tuple[Array, Array, tuple[Array, Array]]:
    """Where the joints and the end-effector are for given joint positions, on the host.

    Args:
        arm: The arm, D joints.
        q: Joint positions [rad], shape [..., D].

    Returns:
        Points on the joint axes (the links' anchors) in world axes [m], shape [..., D, 3]; orientations of the links'
        body frames, w, x, y, z, shape [..., D, 4]; and the end-effector's position [..., 3] and orientation [..., 4].

    Raises:
        ValueError: The last dimension of ``q`` is not D.
    """
    origin, turn = pose(arm.tree, q)
    points = origin + quat_rotate(turn, arm.tree.anchor)
    carrier = turn[..., arm.end_link, :]
    end = origin[..., arm.end_link, :] + quat_rotate(carrier, arm.end_position)
    return points, turn, (end, quat_multiply(carrier, arm.end_rotation))


def arm_capsules(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Return the ends of the capsules' axes for joint positions ``q`` [dof], the base's first [m], [C, 3] each."""
    points, turn, _ = forward_kinematics(arm, q)
    tree = arm.tree
    link = tree.shape_link

    def placed(p: Array) -> Array:
        """Return points of the links' capsules, given in their bodies' frames, in world axes [m], [C, 3]."""
        return points[link] + quat_rotate(turn[link], p - tree.anchor[link])

    ends = ((arm.base_start, tree.shape_start), (arm.base_end, tree.shape_end))
    start, end = (np.concatenate([base, placed(own)]) for base, own in ends)
    return start, end
