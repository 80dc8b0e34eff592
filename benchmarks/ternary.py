"""The ternary trees of the benchmarks: 13, 40 and 121 links on ball joints."""

from __future__ import annotations

import numpy as np
from bough.sim.trees.tree import Joint, Tree, capsule_inertia

DT = 1.0 / 240.0
STIFFNESS = np.array([120.0, 40.0, 14.0, 5.0, 5.0])  # N m/rad by level; D = K / 10


def ternary_tree(order: int, rng: np.random.Generator, cull: float = 0.0) -> Tree:
    """Make a ternary tree of capsule links with masses and springs varied by 10 %, numbered depth first.

    Args:
        order: Levels beyond the trunk; 2, 3, 4 make 13, 40, 121 links.
        rng: Source of the variation.
        cull: Chance that a fork lacks a link, with all that it would carry.
    """
    parent, level, turn = [], [], []
    todo = [(-1, 0, 0)]
    while todo:
        above, depth, side = todo.pop()
        parent.append(above)
        level.append(depth)
        turn.append(side)
        if depth < order:
            todo += [(len(parent) - 1, depth + 1, k) for k in range(3) if rng.random() >= cull]
    return _capsules(f"ternary-{order}", np.array(parent), np.array(level), np.array(turn), rng)


def _capsules(name: str, parent: np.ndarray, level: np.ndarray, side: np.ndarray, rng: np.random.Generator) -> Tree:
    n = len(parent)
    vary = rng.uniform(0.9, 1.1, (4, n))
    length, radius = 0.6 * 0.7**level * vary[0], 0.03 * 0.6**level * vary[1]
    mass = 700.0 * np.pi * radius**2 * length * vary[2]
    moments = np.array([(a, a, b) for a, b in map(capsule_inertia, mass, radius, length)])
    about, tilt = 2 * np.pi * side / 3, np.where(level > 0, np.radians(35.0), 0.0)
    w, s = np.cos(tilt / 2), np.sin(tilt / 2)
    stiffness = STIFFNESS[level] * vary[3]
    return Tree(
        name=name, link_name=[f"link{i}" for i in range(n)], parent=parent, joint=np.full(n, Joint.SPHERICAL),
        position=np.where((parent >= 0)[:, None], length[parent][:, None] * [0.0, 0.0, 1.0], 0.0),
        rotation=np.stack([w, s * np.cos(about), s * np.sin(about), np.zeros(n)], axis=1), mass=mass,
        com=np.outer(length / 2, [0.0, 0.0, 1.0]), inertia=moments[:, :, None] * np.eye(3), stiffness=stiffness,
        damping=stiffness / 10.0, level=level,
    )  # fmt: skip
