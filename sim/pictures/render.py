"""Pictures of trees and forests.

Wood is drawn as it is simulated, capsule by capsule. The sky, the ground and its squares are backdrop; leaves are
decoration, drawn only where they are asked for, and the picture says so. A rod on the ground shows the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import PIL.Image

from ..base.errors import InputError
from ..base.rotation import axis_angle_quat, quat_multiply, quat_rotate
from ..base.types import Array
from ..formats.export_mesh import Pose, level_color, shape_ends
from ..trees.pose import rest_pose
from ..trees.tree import Tree
from .foliage import foliage, leafy
from .scale import caption, rod, round_length
from .tracer import Ground, Image, Solids, Sunlight, View, develop, trace

MOST_TREES = 400
"""Trees that a picture of a forest shows at most: more would be pixels, and memory."""

LEAVES_NOTE = "Leaves are decoration: they are not simulated."
"""What a picture with leaves says."""

_TWIGS = 16_000  # twigs that a picture's trees share


def wood(tree: Tree, pose: Pose | None = None) -> Solids:
    """Return a tree's capsules, coloured by branching order; the pose as `sim.formats.export_mesh.mesh` takes it."""
    start, end = shape_ends(tree, pose)
    return Solids.cones(start, end, tree.shape_radius, level_color(tree.level[tree.shape_link]))


def forest_solids(
    trees: Sequence[Tree], poses: Sequence[Pose | None], *, leaves: bool, rng: np.random.Generator
) -> Solids:
    """Join the capsules of all trees, and their leaves if wanted.

    Raises:
        InputError: There is nothing to draw.
    """
    parts = [wood(tree, at) for tree, at in zip(trees, poses, strict=True)]
    if not any(len(part.start) for part in parts):
        raise InputError("picture", "", "no tree with a shape", "at least one capsule to draw")
    if leaves:
        twigs = int(np.clip(_TWIGS // max(sum(np.count_nonzero(leafy(t)) for t in trees), 1), 1, 13))
        bearing = [(tree, at) for tree, at in zip(trees, poses, strict=True) if len(tree.shape_link)]
        parts += [foliage(tree, at, rng, twigs=twigs) for tree, at in bearing]
    return Solids.joined(parts)


def forest_layout(count: int, spacing: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Places [count, 2] in metres on a jittered, staggered grid about the origin, and yaw angles [count] in rad."""
    columns = int(np.ceil(np.sqrt(1.3 * count)))
    row, column = np.divmod(np.arange(count), columns)
    in_row = np.minimum(columns, count - row * columns)
    x = column - (in_row - 1) / 2 + np.where(row % 2 == 1, 0.25, -0.25) * (count > columns)
    grid = np.stack([x, row - row.max() / 2], axis=1)
    return spacing * (grid + rng.uniform(-0.22, 0.22, grid.shape)), rng.uniform(0.0, 2 * np.pi, count)


def _planted(pose: Pose, place: Array, yaw: float) -> Pose:
    """Body frames turned by ``yaw`` about the first link's origin, which is put over ``place`` [2]."""
    pos, quat = pose
    turn = axis_angle_quat(np.array([0.0, 0.0, 1.0]), np.array(yaw))
    root, spot = np.array([*pos[0, :2], 0.0]), np.array([*place, 0.0])
    return quat_rotate(turn, pos - root) + spot, quat_multiply(turn, quat)


def _spacing(trees: Sequence[Tree], poses: Sequence[Pose]) -> float:
    """Distance between neighbours [m]: their crowns just part."""
    boxes = [wood(tree, at).boxes() for tree, at in zip(trees, poses, strict=True) if len(tree.shape_link)]
    spans = [high.max(axis=0) - low.min(axis=0) for low, high in boxes]
    widths = [max(s[0], s[1], 0.3 * s[2]) for s in spans]
    return 1.25 * float(np.median(widths)) if widths else 1.0


class _Stage:
    """Where a picture's trees stand: corners of the box that holds them, ground, height of a tree, the rod's length."""

    def __init__(self, solids: Solids) -> None:
        low, high = solids.boxes()
        self.low, self.high = low.min(axis=0), high.max(axis=0)
        self.ground = self.low[2] = min(0.0, float(self.low[2]))
        self.size = max(float(np.percentile(high[:, 2], 99.0)) - self.ground, 1e-3)
        self.rod = round_length(0.6 * self.size)

    def portrait(self, aspect: float) -> View:
        """Look at all of it from a little above its middle, along +y."""
        middle, reach = (self.low + self.high) / 2, (self.high - self.low) / 2
        half = np.tan(np.radians(35.0) / 2)
        distance = 1.12 * max(reach[0] / half, reach[2] * aspect / half) + reach[1]
        position = middle + distance * np.array([0.35, -0.94, 0.06])
        position[2] = max(position[2], self.ground + 0.1 * distance)
        return View(tuple(position), tuple(middle), fov=35.0)

    def overlook(self) -> View:
        """Look into the forest from before its edge, from a little above the crowns."""
        low, high, size = self.low, self.high, self.size
        middle, half = (low + high) / 2, max(high[0] - low[0], size) / 2
        away = max(0.35 * half + 1.6 * size, 2.4 * size)  # the trees in front fit into 16:9
        position = (middle[0] - 0.1 * half, low[1] - away, self.ground + 0.8 * size)
        return View(position, (middle[0], middle[1], self.ground + 0.45 * size), fov=47.0)

    def rod_foot(self, view: View, aspect: float) -> Array:
        """Return the ground before the trees, on the right of a view, where the picture shows it."""
        forward, right, up = view.axes()
        half = np.tan(np.radians(view.fov) / 2)
        low = forward - 0.88 * half * aspect * up  # near the lower edge
        ahead = forward * [1.0, 1.0, 0.0] / np.linalg.norm(forward[:2])
        corners = np.array([[x, y] for x in (self.low[0], self.high[0]) for y in (self.low[1], self.high[1])])
        away = max(((corners - view.position[:2]) @ ahead[:2]).min(), 0.5 * self.size)
        if low[2] < 0.0:
            away = max(away, (self.ground - view.position[2]) / low[2] * (low @ ahead))
        foot = np.array(view.position) + away * (ahead + 0.62 * half * right)
        foot[2] = self.ground
        return foot


def _draw(
    solids: Solids, stage: _Stage, view: View, light: Sunlight, width: int, height: int, samples: int,
    device: str | None, note: str,
) -> Image:  # fmt: skip
    """Draw solids, and a rod before them, on squares as wide as the rod is long; write its length and a note."""
    foot = stage.rod_foot(view, height / width)
    scene = Solids.joined([solids, rod(foot, stage.rod)])
    ground = Ground(stage.ground, tile=stage.rod, contrast=0.10)
    image = develop(trace(scene, ground, view, light, width, height, samples=samples, device=device))
    return caption(image, view, foot, stage.rod, note)


def render_trees(
    trees: Sequence[Tree], poses: Sequence[Pose | None] | None = None, *, width: int = 1280, height: int = 720,
    samples: int = 8, leaves: bool = False, view: View | None = None, light: Sunlight | None = None, seed: int = 0,
    device: str | None = None,
) -> Image:  # fmt: skip
    """Draw trees where their frames put them, seen from the side at mid height unless ``view`` says otherwise.

    Args:
        trees: Trees with at least one capsule among them.
        poses: Body frame origins [L, 3] in metres and orientations [L, 4] (w, x, y, z) a tree; joint zero if None.
        width: Picture width [pixels].
        height: Picture height [pixels].
        samples: Rays through a pixel that an outline crosses.
        leaves: Whether to dress outermost links with twigs and leaves; the picture says that they are decoration.
        view: Camera.
        light: Sun and sky.
        seed: Seed of the leaves.
        device: Warp device; the default one if None.

    Returns:
        sRGB picture, shape [height, width, 3], with a rod and its length for scale.

    Raises:
        InputError: There is nothing to draw.
    """
    poses = [None] * len(trees) if poses is None else poses
    solids = forest_solids(trees, poses, leaves=leaves, rng=np.random.default_rng(seed))
    stage = _Stage(solids)
    return _draw(
        solids, stage, view or stage.portrait(width / height), light or Sunlight(haze=0.006 / stage.size),
        width, height, samples, device, LEAVES_NOTE if leaves else "",
    )  # fmt: skip


def render_forest(
    trees: Sequence[Tree], path: str | Path, *, width: int = 1600, height: int = 900, samples: int = 8,
    leaves: bool = False, seed: int = 0, device: str | None = None,
) -> Image:  # fmt: skip
    """Plant trees on a jittered grid, each turned at random, and write a picture of the forest as PNG.

    Args:
        trees: Trees with at least one capsule among them, in their rest pose; the first `MOST_TREES` are drawn.
        path: PNG file to write.
        width: Picture width [pixels].
        height: Picture height [pixels].
        samples: Rays through a pixel that an outline crosses.
        leaves: Whether to dress outermost links with twigs and leaves; the picture says that they are decoration.
        seed: Seed of places and leaves.
        device: Warp device; the default one if None.

    Returns:
        The sRGB picture, shape [height, width, 3], with a rod and its length for scale.

    Raises:
        InputError: There is nothing to draw.
    """
    rng, trees = np.random.default_rng(seed), trees[:MOST_TREES]
    rest = [rest_pose(tree) for tree in trees]
    places, yaws = forest_layout(len(trees), _spacing(trees, rest), rng)
    poses = [_planted(*where) for where in zip(rest, places, yaws, strict=True)]
    solids = forest_solids(trees, poses, leaves=leaves, rng=rng)
    stage = _Stage(solids)
    light, note = Sunlight(haze=0.010 / stage.size), LEAVES_NOTE if leaves else ""
    image = _draw(solids, stage, stage.overlook(), light, width, height, samples, device, note)
    PIL.Image.fromarray(image).save(path, format="PNG")
    return image
