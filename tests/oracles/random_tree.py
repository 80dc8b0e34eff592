"""Random trees for property tests: mixed joints, branching, capsules with their own inertia."""

from __future__ import annotations

import numpy as np
from bough.sim.trees.tree import Joint, Tree, capsule_inertia
from scipy.spatial.transform import Rotation


def random_tree(
    rng: np.random.Generator,
    num_links: int,
    *,
    joints: tuple[Joint, ...] = (Joint.SPHERICAL, Joint.REVOLUTE),
    max_children: int = 4,
    anchored: float = 0.3,
    stiffness: tuple[float, float] = (1.0, 300.0),
    damping_ratio: tuple[float, float] = (0.01, 2.0),
    armature: float = 0.0,
    bent_rest: bool = False,
    preloaded: bool = False,
) -> Tree:
    """Make a tree of capsule links, numbered depth-first as MuJoCo numbers the bodies of its MJCF.

    Every link is a solid capsule of wood (700 kg/m^3) along its own z axis that carries 1 to ``max_children`` links
    at its end until the links are used up; directions fan out upwards.

    Args:
        rng: Source of all randomness: the same state gives the same tree.
        num_links: Number of links L.
        joints: Kinds of joint to draw from, evenly.
        max_children: Most children of one link.
        anchored: Share of links whose joint turns about a point other than the body frame's origin.
        stiffness: Range of joint stiffness, log-uniform [N m/rad or N/m].
        damping_ratio: Range of the damping ratio c / (2 sqrt(k I)), log-uniform, with the inertia I of the link
            alone about its joint (its mass for a prismatic joint).
        armature: Upper bound of the joints' armature, uniform [kg m^2 or kg].
        bent_rest: Whether springs are relaxed away from joint zero (always at zero for spherical joints, whose rest
            orientation MJCF cannot express).
        preloaded: Whether joints carry pre-loads [N m or N].
    """
    n, parent = num_links, _random_parents(rng, num_links, max_children)
    joint = rng.choice([int(j) for j in joints], size=n)
    length, radius = rng.uniform(0.1, 0.6, n), rng.uniform(0.005, 0.03, n)
    mass = 700.0 * np.pi * radius**2 * (length + 4.0 / 3.0 * radius)
    spring, zeta = _log_uniform(rng, stiffness, n), _log_uniform(rng, damping_ratio, n)
    moved = np.where(joint == Joint.PRISMATIC, mass, mass * length**2 / 3.0)
    axis = rng.normal(size=(n, 3))
    rest = np.zeros((n, 4))
    rest[:, 0] = np.where(joint == Joint.SPHERICAL, 1.0, bent_rest * rng.uniform(-0.1, 0.1, n))
    return Tree(
        name=f"random-{n}",
        link_name=[f"link{i}" for i in range(n)],
        parent=parent,
        joint=joint,
        anchor=rng.uniform(-0.05, 0.05, (n, 3)) * (rng.random(n) < anchored)[:, None],
        axis=axis / np.linalg.norm(axis, axis=1, keepdims=True),
        mass=mass,
        stiffness=spring,
        damping=2.0 * zeta * np.sqrt(spring * moved),
        armature=rng.uniform(0.0, 1.0, n) * armature,
        rest=rest,
        preload=rng.normal(size=(n, 3)) * preloaded,
        level=_depth(parent),
        shape_link=np.arange(n),
        shape_start=np.zeros((n, 3)),
        shape_radius=np.stack([radius * 1.1, radius * 0.9], axis=1),
        **_placed_capsules(rng, parent, mass, radius, length),
    ).validate()


def _placed_capsules(
    rng: np.random.Generator, parent: np.ndarray, mass: np.ndarray, radius: np.ndarray, length: np.ndarray
) -> dict[str, np.ndarray]:
    """Body frames, mass distribution and far ends of capsules, each set at its parent's far end.

    The body frame is turned at random against the capsule, so that its axes are not the principal ones.
    """
    n = len(parent)
    twist, tilt = Rotation.random(n, rng), Rotation.from_rotvec(rng.normal(0.0, 0.6, (n, 3)))
    moments = np.array([(a, a, b) for a, b in map(capsule_inertia, mass, radius, length)])
    body = twist.inv().as_matrix()
    tip = twist.inv().apply(np.outer(length, [0.0, 0.0, 1.0]))
    above = Rotation.concatenate([twist[int(p)].inv() if p >= 0 else Rotation.identity() for p in parent])
    return {
        "position": np.where((parent >= 0)[:, None], tip[parent], [0.0, 0.0, 0.3]),
        "rotation": np.roll((above * tilt * twist).as_quat(), 1, axis=1),
        "com": tip / 2.0,
        "inertia": np.einsum("nij,nj,nkj->nik", body, moments, body),
        "shape_end": tip,
    }


def _log_uniform(rng: np.random.Generator, bounds: tuple[float, float], n: int) -> np.ndarray:
    return np.exp(rng.uniform(*np.log(bounds), n))


def _depth(parent: np.ndarray) -> np.ndarray:
    """Count the links between each link and the root, shape [n]."""
    depth = np.zeros(len(parent), dtype=np.int64)
    for i in range(1, len(parent)):
        depth[i] = depth[parent[i]] + 1
    return depth


def _random_parents(rng: np.random.Generator, n: int, max_children: int) -> np.ndarray:
    """Parents [n] of a random tree, one root, 1 to ``max_children`` children a link, numbered depth-first."""
    children: list[list[int]] = [[] for _ in range(n)]
    used, open_links = 1, [0]
    while used < n:
        i = open_links.pop(rng.integers(len(open_links)))
        for _ in range(min(int(rng.integers(1, max_children + 1)), n - used)):
            children[i].append(used)
            open_links.append(used)
            used += 1
    parent, stack, number = np.full(n, -1, dtype=np.int64), [(0, -1)], 0
    while stack:
        i, above = stack.pop()
        parent[number] = above
        stack += [(c, number) for c in reversed(children[i])]
        number += 1
    return parent


def random_qpos(rng: np.random.Generator, tree: Tree, angle: float = 1.0) -> np.ndarray:
    """Joint coordinates [num_coordinates] in link order: turns and slides of the order of ``angle`` [rad or m]."""
    parts = []
    for j in tree.joint:
        if j == Joint.SPHERICAL:
            parts.append(np.roll(Rotation.from_rotvec(rng.normal(0.0, angle, 3)).as_quat(), 1))
        else:
            parts.append(rng.normal(0.0, angle, Joint(int(j)).dofs))
    return np.concatenate(parts) if parts else np.zeros(0)
