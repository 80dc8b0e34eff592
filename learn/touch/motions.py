"""Arbitrary arm motions, and what stands in their way: a soft hand or a branch at one of seven places of the arm.

The shoulder turns about its own axis, so that a push on it makes no torque and cannot be felt; the seven places are
the lower and the upper half of the arm, forearm, both wrists, palm and fingers. A motion is drawn until the place moves
towards the wanted side of its link at some moment; the obstacle is put there, across the link.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.base.rotation import quat_rotate
from ...sim.base.types import Array
from ...sim.trees.measured import MeasuredBranch, measured_tree
from ...sim.trees.tree import Tree

#: Capsule of the arm, and the share of its axis, for every place.
PLACES: dict[str, tuple[int, float]] = {
    "arm": (1, 0.35),
    "elbow": (1, 0.85),
    "forearm": (2, 0.6),
    "wrist 1": (3, 0.6),
    "wrist 2": (4, 0.6),
    "palm": (5, 0.5),
    "fingers": (6, 0.7),
}
#: Sides of a link, counter-clockwise about its axis from the body frame's first axis across it.
DIRECTIONS = ("first", "second", "third", "fourth")
OBSTACLES = ("hand", "branch")
#: Commands a second [Hz].
COMMANDS = 60
#: Least speed of the place when it meets the obstacle [m/s], when it may be [share of the motion].
_LEAST_SPEED, _WHEN = 0.04, (0.15, 0.6)
#: Commands before the meeting from which the speeds stay the same, half a second to two beyond it.
_BEFORE = 15
#: Where joints start [rad], about what an arm that reaches forward takes; and how fast they are asked to be [rad/s].
_START = ((2.9, 4.7), (2.6, 4.2), (0.8, 2.6), (1.3, 4.4), (0.0, 2.4), (-1.9, 2.5))
_SPEED = 0.3
_TRIES = 400


@dataclass(frozen=True)
class Motion:
    """One motion and what it meets.

    Attributes:
        start: Joint positions [rad], [D].
        command: Commanded joint speeds [rad/s], [commands, D].
        tree: The obstacle; far away where nothing is met.
        place, direction, obstacle: Of `PLACES`, `DIRECTIONS`, `OBSTACLES`; empty where nothing is met.
    """

    start: Array
    command: Array
    tree: Tree
    place: str = ""
    direction: str = ""
    obstacle: str = ""


def random_command(rng: np.random.Generator, seconds: float, joints: int) -> Array:
    """Return joint speeds that change smoothly, a new wish every second or so [rad/s], [commands, D]."""
    count = round(seconds * COMMANDS)
    knots = np.cumsum(rng.uniform(0.6, 1.6, int(seconds / 0.6) + 3)) - 1.0
    wish = rng.normal(0.0, _SPEED * rng.uniform(0.3, 1.2), (len(knots), joints)) * (rng.random((len(knots), 1)) > 0.1)
    t = np.arange(count) / COMMANDS
    out = np.stack([np.interp(t, knots, wish[:, j]) for j in range(joints)], axis=1)
    return np.clip(out, -0.6, 0.6)


def random_motion(arm: Arm, rng: np.random.Generator, seconds: float) -> tuple[Array, Array, Array]:
    """Return start [D], commands [N, D] and the joint positions that they lead to [N, D], within the arm's limits."""
    low, high = np.array(_START).T
    while True:
        start = rng.uniform(low, high)
        command = random_command(rng, seconds, arm.num_dofs)
        q = start + np.cumsum(command, axis=0) / COMMANDS
        if within(arm, q):
            return start, command, q


def within(arm: Arm, q: Array) -> bool:
    """Return whether joint positions [N, D] stay clear of the arm's limits."""
    return bool(((q > arm.lower + 0.1) & (q < arm.upper - 0.1)).all())


def free_twin(motion: Motion, rng: np.random.Generator) -> Motion:
    """Return the same motion without what it meets: commands alone must not tell contact.

    The obstacle, which a world must have, stands far away.
    """
    away = obstacle("hand", np.array([50.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), rng)
    return Motion(motion.start, motion.command, away)


def obstructed_motion(
    arm: Arm, place: str, side: int, kind: str, rng: np.random.Generator, seconds: float
) -> Motion:  # fmt: skip
    """Return a motion in which a place of the arm runs into an obstacle with one of its four sides.

    Raises:
        RuntimeError: No motion was found, which does not happen with an arm that moves as the Jaco 2 does.
    """
    for _ in range(_TRIES):
        start, command, q = random_motion(arm, rng, seconds)
        k = int(rng.uniform(*_WHEN) * len(q))
        held = slice(k - _BEFORE, k + round(rng.uniform(0.5, 2.0) * COMMANDS))
        command[held] = command[k]
        q = start + np.cumsum(command, axis=0) / COMMANDS
        if not within(arm, q):
            continue
        point, axis, across = place_path(arm, place, q)
        velocity = np.gradient(point, 1.0 / COMMANDS, axis=0)
        velocity -= np.sum(velocity * axis, 1, keepdims=True) * axis
        speed = np.linalg.norm(velocity, axis=1)
        towards = velocity[k] / max(float(speed[k]), 1.0e-9)
        quarter = round(np.arctan2(towards @ np.cross(axis[k], across[k]), towards @ across[k]) / (np.pi / 2)) % 4
        if speed[k] > _LEAST_SPEED and quarter == side:
            tree = _across(kind, arm, place, point[k], axis[k], towards, rng)
            return Motion(start, command, tree, place, DIRECTIONS[side], kind)
    raise RuntimeError(f"no motion with {place} towards {DIRECTIONS[side]}")


def place_path(arm: Arm, place: str, q: Array) -> tuple[Array, Array, Array]:
    """Return a place's point [m], its link's axis and a direction across it that turns with the link, [N, 3] each."""
    capsule, share = PLACES[place]
    tree, link = arm.tree, int(arm.tree.shape_link[capsule])
    points, turn, _ = forward_kinematics(arm, q)
    body = tree.shape_end[capsule] - tree.shape_start[capsule]
    local = tree.shape_start[capsule] + share * body - tree.anchor[link]
    body = body / np.linalg.norm(body)
    helper = np.eye(3)[int(np.argmin(np.abs(body)))]
    across = helper - (helper @ body) * body
    across /= np.linalg.norm(across)
    turns = turn[:, link]
    return points[:, link] + quat_rotate(turns, local), quat_rotate(turns, body), quat_rotate(turns, across)


def _across(
    kind: str, arm: Arm, place: str, point: Array, axis: Array, towards: Array, rng: np.random.Generator
) -> Tree:  # fmt: skip
    """Return an obstacle that crosses a link in its way, from a random side of it."""
    along = np.cross(axis, towards) * rng.choice([-1.0, 1.0])
    along = along + rng.normal(0.0, 0.15, 3)
    along /= np.linalg.norm(along)
    radius = float(arm.tree.shape_radius[PLACES[place][0]].mean())
    middle = point + towards * (radius + (0.035 if kind == "hand" else 0.02))
    return obstacle(kind, middle, along, rng)


def obstacle(kind: str, middle: Array, along: Array, rng: np.random.Generator) -> Tree:
    """Return a hand or a branch that passes a point along a direction.

    A hand is a forearm of 0.35 m that turns about its elbow and gives way by 1 m for 30 to 250 N at the point; a branch
    has four segments, 0.5 m, and the stiffness of a green branch that bends as far for 10 to 150 N.
    """
    count, length, radius = (1, 0.35, (0.04, 0.035)) if kind == "hand" else (4, 0.5, (0.012, 0.006))
    lever = length * rng.uniform(0.6, 0.85)
    firm = np.exp(rng.uniform(*np.log((30.0, 250.0) if kind == "hand" else (10.0, 150.0))))  # N/m at the point
    # equal joints l/n apart, in series at the point: 1/k = sum (lever - i l/n)^2 / K
    arms = np.maximum(lever - np.arange(count) * length / count, 0.0)
    stiffness = np.full(count, firm * np.sum(arms**2))
    ends = np.linspace(radius[0], radius[1], count + 1)
    elevation, azimuth = np.arcsin(np.clip(along[2], -1, 1)), np.arctan2(along[1], along[0])
    mass = 1.2 if kind == "hand" else 0.12
    branch = MeasuredBranch(
        kind, tuple(f"{kind} {i}" for i in range(count)), np.full(count, length / count),
        np.stack([ends[:-1], ends[1:]], 1), np.full(count, elevation), np.full(count, azimuth),
        np.full(count, mass / count), middle - along * lever, 9.81, count - 1, 0.0,
    )  # fmt: skip
    return measured_tree(branch, stiffness, stiffness * (0.5 if kind == "hand" else 0.1))
