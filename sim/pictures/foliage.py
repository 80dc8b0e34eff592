"""Twigs and leaves for pictures: decoration on the outermost links, with no mass and no part in the physics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.types import Array
from ..formats.export_mesh import Pose, shape_ends
from ..trees.tree import Tree
from .tracer import Solids

_LEAVES = 12  # on a twig
_THROUGH = 0.55  # share of light that passes through a leaf
_TWIG_COLOR = np.array([0.30, 0.26, 0.14])
_LEAF_COLORS = np.array([[0.26, 0.40, 0.10], [0.36, 0.48, 0.12], [0.20, 0.36, 0.12], [0.50, 0.50, 0.14]])


def foliage(tree: Tree, poses: Pose | None, rng: np.random.Generator, *, twigs: int = 13) -> Solids:
    """Grow twigs with alternate leaves on the outermost links and on those that carry only a few of them.

    Args:
        tree: The tree, with at least one capsule.
        poses: Body frame origins [L, 3] in metres and orientations [L, 4] (w, x, y, z); joint zero if None.
        rng: Source of the scatter: the same state gives the same foliage.
        twigs: Number of twigs on a link.
    """
    start, end = shape_ends(tree, poses)
    chosen = leafy(tree)[tree.shape_link] & (np.linalg.norm(end - start, axis=1) > 0)
    height = float(max(start[:, 2].max(), end[:, 2].max()) - min(start[:, 2].min(), end[:, 2].min()))
    least = 0.35 * height / max(int(np.count_nonzero(chosen)), 4) ** (1 / 3)
    base, tip = _twigs(start[chosen], end[chosen], twigs, least, rng)
    radius = np.linalg.norm(tip - base, axis=1)[:, None] * [0.012, 0.005]
    return Solids.joined([Solids.cones(base, tip, radius, _TWIG_COLOR), _leaves(base, tip, rng)])


def leafy(tree: Tree) -> NDArray[np.bool_]:
    """Tell which links bear leaves, shape [L]: those without children, and branches with up to three links on them."""
    above = np.zeros(tree.num_links, dtype=np.int64)
    for i in range(tree.num_links - 1, -1, -1):
        if tree.parent[i] >= 0:
            above[tree.parent[i]] += 1 + above[i]
    return (above == 0) | ((above <= 3) & (tree.level > 0))


def _twigs(start: Array, end: Array, count: int, least: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Bases and tips [N * count, 3] of twigs around N branches: shorter, and more in line with them, to the end.

    They are scaled to the branch or to the length ``least`` [m], whichever is longer.
    """
    n = len(start)
    along = (end - start)[:, None]
    length = np.linalg.norm(along, axis=2, keepdims=True)
    where = np.linspace(1.0, 0.2, count)[None, :, None] + rng.normal(0.0, 0.03, (n, count, 1))
    spread = rng.normal(size=(n, count, 3))
    spread -= np.sum(spread * along, axis=2, keepdims=True) * along / length**2
    spread /= np.linalg.norm(spread, axis=2, keepdims=True)
    heading = along / length * (0.35 + 0.55 * where) + spread * (1.15 - 0.65 * where) + np.array([0.0, 0.0, 0.22])
    heading /= np.linalg.norm(heading, axis=2, keepdims=True)
    base = start[:, None] + np.minimum(where, 1.0) * along
    reach = np.maximum(length, least) * (0.62 - 0.22 * where) * rng.uniform(0.75, 1.2, (n, count, 1))
    return base.reshape(-1, 3), (base + reach * heading).reshape(-1, 3)


def _leaves(base: Array, tip: Array, rng: np.random.Generator) -> Solids:
    """Leaves on twigs, alternate, their faces about upwards."""
    n = len(base)
    twig = (tip - base)[:, None]
    length = np.linalg.norm(twig, axis=2, keepdims=True)
    where = np.linspace(0.15, 1.0, _LEAVES)[None, :, None] + rng.normal(0.0, 0.03, (n, _LEAVES, 1))
    rib = twig / length + 1.0 * rng.normal(size=(n, _LEAVES, 3)) + np.array([0.0, 0.0, -0.25])
    rib /= np.linalg.norm(rib, axis=2, keepdims=True)
    side = np.cross(rng.normal(0.0, 0.55, (n, _LEAVES, 3)) + np.array([0.0, 0.0, 1.0]), rib)
    side /= np.linalg.norm(side, axis=2, keepdims=True)
    size = 0.25 * np.sqrt(length * np.median(length)) * rng.uniform(0.7, 1.25, (n, _LEAVES, 1))
    root = base[:, None] + where * twig
    mix = rng.dirichlet([1.2, 1.0, 1.0, 0.25], n * _LEAVES)
    tint = mix @ _LEAF_COLORS * rng.uniform(0.8, 1.15, (n * _LEAVES, 1))
    start, end, half = (a.reshape(-1, 3) for a in (root, root + size * rib, 0.25 * size * side))
    return Solids(start, end, np.zeros((len(start), 2)), tint, half, np.full(len(start), _THROUGH))
