"""Twigs and leaves for pictures: decoration on the outermost links, with no mass and no part in the physics."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..base.types import Array, IntArray
from ..formats.export_mesh import Pose, capsules_mesh, shape_ends
from ..trees.tree import Tree

_LEAVES = 12  # on a twig
_TUFTS, _BLADES = 26000, 6  # tufts of grass in a picture, blades in a tuft
_TWIG_COLOR = np.array([0.30, 0.26, 0.14])
_LEAF_COLORS = np.array([[0.26, 0.40, 0.10], [0.36, 0.48, 0.12], [0.20, 0.36, 0.12], [0.50, 0.50, 0.14]])


def foliage(
    tree: Tree, poses: Pose | None, rng: np.random.Generator, *, twigs: int = 13
) -> tuple[Array, IntArray, Array, Array]:
    """Grow twigs with alternate leaves on the outermost links and on those that carry only a few of them.

    Args:
        tree: The tree, with at least one capsule.
        poses: Body frame origins [L, 3] in metres and orientations [L, 4] (w, x, y, z); joint zero if None.
        rng: Source of the scatter: the same state gives the same foliage.
        twigs: Number of twigs on a link.

    Returns:
        Vertices [V, 3] in metres; faces [F, 3]; sRGB colours [V, 3] in 0..1; share of light that passes through each
        vertex's surface [V], zero for twigs.
    """
    start, end = shape_ends(tree, poses)
    chosen = leafy(tree)[tree.shape_link] & (np.linalg.norm(end - start, axis=1) > 0)
    height = float(max(start[:, 2].max(), end[:, 2].max()) - min(start[:, 2].min(), end[:, 2].min()))
    least = 0.35 * height / max(int(np.count_nonzero(chosen)), 4) ** (1 / 3)
    base, tip = _twigs(start[chosen], end[chosen], twigs, least, rng)
    radius = np.linalg.norm(tip - base, axis=1)[:, None] * [0.012, 0.005]
    wood, wood_faces = capsules_mesh(base, tip, radius, sides=4, cap_rings=1)
    leaf, leaf_faces, tint = _leaves(base, tip, rng)
    colors = np.concatenate([np.broadcast_to(_TWIG_COLOR, wood.shape), tint])
    through = np.concatenate([np.zeros(len(wood)), np.full(len(leaf), 0.55)])
    return np.concatenate([wood, leaf]), np.concatenate([wood_faces, leaf_faces + len(wood)]), colors, through


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


def _leaves(base: Array, tip: Array, rng: np.random.Generator) -> tuple[Array, IntArray, Array]:
    """Leaves on twigs: vertices [V, 3], faces [F, 3], colours [V, 3]; a leaf is a rhombus folded along its rib."""
    n = len(base)
    twig = (tip - base)[:, None]
    length = np.linalg.norm(twig, axis=2, keepdims=True)
    where = np.linspace(0.15, 1.0, _LEAVES)[None, :, None] + rng.normal(0.0, 0.03, (n, _LEAVES, 1))
    rib = twig / length + 1.0 * rng.normal(size=(n, _LEAVES, 3)) + np.array([0.0, 0.0, -0.25])
    rib /= np.linalg.norm(rib, axis=2, keepdims=True)
    face = rng.normal(0.0, 0.55, (n, _LEAVES, 3)) + np.array([0.0, 0.0, 1.0])
    side = np.cross(face, rib)
    side /= np.linalg.norm(side, axis=2, keepdims=True)
    fold = np.cross(rib, side)
    size = 0.25 * np.sqrt(length * np.median(length)) * rng.uniform(0.7, 1.25, (n, _LEAVES, 1))
    root = base[:, None] + where * twig
    middle, half = root + 0.5 * size * rib + 0.08 * size * fold, 0.3 * size * side
    corners = np.stack([root, middle - half, root + size * rib, middle + half], axis=2).reshape(-1, 3)
    faces = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(n * _LEAVES)[:, None, None]
    mix = rng.dirichlet([1.2, 1.0, 1.0, 0.25], n * _LEAVES)
    tint = mix @ _LEAF_COLORS * rng.uniform(0.8, 1.15, (n * _LEAVES, 1))
    return corners, faces.reshape(-1, 3), np.repeat(tint, 4, axis=0)


def grass(
    eye: Array, target: Array, fov: float, ground: float, size: float, rng: np.random.Generator
) -> tuple[Array, IntArray, Array, Array]:
    """Scatter tufts of grass over the ground that a camera sees, ever sparser with the distance.

    Args:
        eye: Position of the camera [m], shape [3].
        target: Point it looks at [m], shape [3].
        fov: Whole width of the picture [degrees].
        ground: Height of the ground [m].
        size: Height of a tree [m], to which the blades are scaled.
        rng: Source of the scatter.

    Returns:
        The same as `foliage`.
    """
    shape = (_TUFTS, _BLADES)
    far = size * np.exp(rng.uniform(np.log(0.8), np.log(14.0), _TUFTS))
    turn = np.arctan2(*(target - eye)[1::-1]) + np.radians(0.65 * fov) * rng.uniform(-1, 1, _TUFTS)
    centre = np.stack([eye[0] + far * np.cos(turn), eye[1] + far * np.sin(turn), np.full(_TUFTS, ground)], axis=1)
    base = centre[:, None] + rng.normal(0.0, 0.015 * size, (*shape, 3)) * [1.0, 1.0, 0.0]
    tall = size * rng.uniform(0.008, 0.026, (_TUFTS, 1, 1)) * rng.uniform(0.6, 1.2, (*shape, 1))
    tip = base + tall * (rng.normal(0.0, 0.45, (*shape, 3)) * [1.0, 1.0, 0.0] + [0.0, 0.0, 1.0])
    facing = rng.uniform(0.0, np.pi, (*shape, 1))
    half = 0.09 * tall * np.concatenate([np.cos(facing), np.sin(facing), 0.0 * facing], axis=2)
    corners = np.stack([base - half, base + half, tip], axis=2).reshape(-1, 3)
    tint = np.array([0.30, 0.39, 0.15]) + rng.uniform(size=(_TUFTS, 1)) * [0.17, 0.08, 0.07]
    faces = np.arange(len(corners)).reshape(-1, 3)
    return corners, faces, np.repeat(tint, 3 * _BLADES, axis=0), np.full(len(corners), 0.5)
