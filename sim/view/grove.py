"""Where the capsules of many worlds are: from body frames to ends of axes, for worlds that stand side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..base.rotation import quat_rotate
from ..base.types import Array, IntArray
from ..formats.export_mesh import level_color
from ..trees.pose import rest_pose
from ..trees.tree import Tree


@dataclass(frozen=True)
class Grove:
    """C capsules on the bodies of W worlds.

    Attributes:
        world, body: World and body of every capsule, shape [C].
        start, end: Ends of its axis in the body's frame [m], shape [C, 3].
        radius: At start and end [m], shape [C, 2].
        color: sRGB in 0..1, shape [C, 3].
        place: Where the worlds' origins stand [m], shape [W, 3].
    """

    world: IntArray
    body: IntArray
    start: Array
    end: Array
    radius: Array
    color: Array
    place: Array

    def ends(self, position: Array, rotation: Array) -> tuple[Array, Array]:
        """Return the ends of all axes [m], shapes [C, 3].

        Args:
            position: Body frame origins in their worlds [m], shape [W, B, 3].
            rotation: Body orientations w, x, y, z, shape [W, B, 4].
        """
        at = position[self.world, self.body] + self.place[self.world]
        turn = rotation[self.world, self.body]
        return at + quat_rotate(turn, self.start), at + quat_rotate(turn, self.end)

    def moved(self, place: Array) -> Grove:
        """Return the same with the worlds elsewhere [m], shape [W, 3]."""
        return Grove(self.world, self.body, self.start, self.end, self.radius, self.color, place)


def grove_of(trees: Sequence[Tree]) -> Grove:
    """Return the capsules of trees, bodies in the order of their links, every world at its own origin."""
    counts = [len(tree.shape_link) for tree in trees]
    parts = {name: np.concatenate([getattr(tree, name) for tree in trees]) for name in
             ("shape_link", "shape_start", "shape_end", "shape_radius")}  # fmt: skip
    level = np.concatenate([tree.level[tree.shape_link] for tree in trees])
    return Grove(
        np.repeat(np.arange(len(trees)), counts), parts["shape_link"], parts["shape_start"], parts["shape_end"],
        parts["shape_radius"], level_color(level), np.zeros((len(trees), 3)),
    )  # fmt: skip


def rest_frames(trees: Sequence[Tree]) -> tuple[Array, Array]:
    """Return the body frames of trees with joints at zero, [W, B, 3] in m and [W, B, 4]; B is that of the largest."""
    most = max(tree.num_links for tree in trees)
    position, rotation = np.zeros((len(trees), most, 3)), np.zeros((len(trees), most, 4))
    rotation[..., 0] = 1.0
    for world, tree in enumerate(trees):
        position[world, : tree.num_links], rotation[world, : tree.num_links] = rest_pose(tree)
    return position, rotation


def side_by_side(grove: Grove, position: Array, rotation: Array) -> Array:
    """Return places [W, 3] on a grid, as far apart as most worlds are wide; a single world stays where it is."""
    count = len(grove.place)
    if count == 1:
        return np.zeros((1, 3))
    start, end = grove.moved(np.zeros((count, 3))).ends(position, rotation)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for corner in (start, end):
        np.minimum.at(low, grove.world, corner)
        np.maximum.at(high, grove.world, corner)
    span = np.where(np.isfinite(high - low), high - low, 0.0)
    spacing = 1.25 * float(np.median(np.maximum(span[:, :2].max(axis=1), 0.3 * span[:, 2])))
    columns = int(np.ceil(np.sqrt(count)))
    row, column = np.divmod(np.arange(count), columns)
    grid = np.column_stack([column - (columns - 1) / 2, row - (row.max()) / 2, np.zeros(count)])
    return max(spacing, 1e-3) * grid
