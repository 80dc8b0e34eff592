"""Drop the links an arm cannot reach."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base.errors import InputError
from ..base.rotation import quat_matrix
from ..base.types import Array, IntArray
from .pose import rest_pose
from .tree import Tree


def cull(tree: Tree, base_position: Sequence[float], reach: float, *, lump: bool = True) -> Tree:
    """Keep the links within reach and those that carry them.

    A link is within reach if, with all joints at zero, the surface of one of its capsules is at most ``reach`` away
    from ``base_position``. Names, levels and joints of the links kept stay the same.

    Args:
        tree: The tree.
        base_position: Point the reach is measured from, world frame [m].
        reach: Greatest distance [m].
        lump: Whether mass and inertia of the links dropped go to the link that carried them, as if frozen in the rest
            pose: it then weighs on the joints left exactly as before. Otherwise they vanish.

    Raises:
        InputError: ``reach`` is negative, or no link is within reach.
    """
    if not reach >= 0.0:
        raise InputError(tree.name, "reach", f"{reach:g} m", "zero or more")
    distance = link_distance(tree, base_position)
    keep = distance <= reach
    if not keep.any():
        found = f"no link within {reach:g} m of {np.asarray(base_position)}"
        raise InputError(tree.name, "reach", found, f"{distance.min():.3g} m or more")
    for i in reversed(range(tree.num_links)):
        if keep[i] and tree.parent[i] >= 0:
            keep[tree.parent[i]] = True
    return keep_links(tree, keep) if lump else _subset(tree, keep)


def link_distance(tree: Tree, point: Sequence[float]) -> Array:
    """Distance of each link's capsules from a point, joints at zero [m], shape [L]: 0 inside, inf without capsules.

    A tapered capsule counts with its greater radius.
    """
    position, rotation = rest_pose(tree)
    turn, link = quat_matrix(rotation)[tree.shape_link], tree.shape_link
    start = position[link] + np.einsum("sij,sj->si", turn, tree.shape_start)
    along = np.einsum("sij,sj->si", turn, tree.shape_end - tree.shape_start)
    to_point = np.asarray(point, dtype=np.float64) - start
    square = np.einsum("si,si->s", along, along)
    share = np.clip(np.einsum("si,si->s", to_point, along) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    surface = np.linalg.norm(to_point - share[:, None] * along, axis=1) - tree.shape_radius.max(axis=1)
    out = np.full(tree.num_links, np.inf)
    np.minimum.at(out, link, np.maximum(surface, 0.0))
    return out


def keep_links(tree: Tree, keep: np.ndarray) -> Tree:
    """Return the tree without the links that ``keep`` (bool, [L]) leaves out; their mass goes to what carries them.

    A link may only be left out with everything that it carries.
    """
    if keep.all():
        return tree
    return _subset(_lumped(tree, keep), keep)


def _lumped(tree: Tree, keep: np.ndarray) -> Tree:
    """Return the tree with the mass of links not kept moved, leaf by leaf, to the links they hang on."""
    position, rotation = rest_pose(tree)
    turn = quat_matrix(rotation)
    mass = tree.mass.copy()
    centre = position + np.einsum("nij,nj->ni", turn, tree.com)
    inertia = np.einsum("nij,njk,nlk->nil", turn, tree.inertia, turn)
    for i in reversed(range(tree.num_links)):
        p = tree.parent[i]
        if keep[i] or p < 0:
            continue
        total = mass[p] + mass[i]
        if total > 0.0:
            apart = centre[i] - centre[p]
            reduced = mass[p] * mass[i] / total
            inertia[p] += inertia[i] + reduced * (apart @ apart * np.eye(3) - np.outer(apart, apart))
            centre[p] = (mass[p] * centre[p] + mass[i] * centre[i]) / total
            mass[p] = total
    com = np.einsum("nji,nj->ni", turn, centre - position)
    return tree.with_(mass=mass, com=com, inertia=np.einsum("nji,njk,nkl->nil", turn, inertia, turn))


def _subset(tree: Tree, keep: np.ndarray) -> Tree:
    """Links where ``keep`` is set; parents of links kept are kept."""
    number: IntArray = np.cumsum(keep) - 1
    shapes = keep[tree.shape_link]
    links = (
        "joint", "position", "rotation", "mass", "com", "inertia", "stiffness", "damping", "anchor", "axis", "armature",
        "rest", "preload", "level",
    )  # fmt: skip
    return tree.with_(
        link_name=[name for name, kept in zip(tree.link_name, keep, strict=True) if kept],
        parent=np.where(tree.parent[keep] < 0, -1, number[tree.parent[keep]]),
        shape_link=number[tree.shape_link[shapes]],
        **{name: getattr(tree, name)[shapes] for name in ("shape_start", "shape_end", "shape_radius")},
        **{name: getattr(tree, name)[keep] for name in links},
    )
