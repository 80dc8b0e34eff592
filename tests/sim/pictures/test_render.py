"""Pictures of forests: where trees stand, what is drawn, the scale, the same seed the same picture."""

from __future__ import annotations

import numpy as np
import PIL.Image
import pytest
from bough.sim.base.errors import InputError
from bough.sim.formats.export_mesh import shape_ends
from bough.sim.pictures.foliage import foliage, leafy
from bough.sim.pictures.render import forest_layout, forest_solids, render_forest, render_trees, wood
from bough.sim.pictures.scale import caption, rod, round_length
from bough.sim.pictures.tracer import Solids, View, develop
from bough.sim.trees.pose import pose
from bough.sim.trees.tree import Joint, Tree
from oracles.random_tree import random_qpos, random_tree


def _post(height: float = 2.0) -> Tree:
    """One upright capsule of 20 cm radius."""
    link = {"parent": [-1], "joint": [Joint.SPHERICAL], "position": np.zeros((1, 3)), "rotation": [[1, 0, 0, 0]]}
    body = {"mass": [1.0], "com": np.zeros((1, 3)), "inertia": np.eye(3)[None], "stiffness": [0], "damping": [0]}
    shape = {"shape_link": [0], "shape_start": np.zeros((1, 3)), "shape_end": [[0, 0, height]]}
    return Tree("post", ["post"], shape_radius=[[0.2, 0.2]], **link, **body, **shape)


@pytest.mark.parametrize("count", [1, 2, 7, 64, 100])
def test_layout_keeps_trees_apart(count):
    """Keep any two of ``count`` trees at least 0.5 spacings apart: 1 less twice the jitter of 0.22."""
    places, yaws = forest_layout(count, 3.0, np.random.default_rng(count))
    assert places.shape == (count, 2)
    assert len(np.unique(yaws)) == count
    gap = np.linalg.norm(places[:, None] - places[None], axis=2) + 1e9 * np.eye(count)
    assert gap.min() >= 0.5 * 3.0
    assert np.abs(places.mean(axis=0)).max() <= 1.5 * 3.0


def test_develop_maps_light_to_bytes():
    """Keep black black, rise with the light, and end at white."""
    ramp = develop(np.linspace(0.0, 20.0, 200)[:, None].repeat(3, axis=1))
    assert (ramp[0] == 0).all()
    assert (ramp[-1] == 255).all()
    assert (np.diff(ramp[:, 0].astype(int)) >= 0).all()


def test_trees_are_drawn_where_their_pose_puts_them():
    """Find a post lying along x after a quarter turn about y: dark on the ground it covers, and nowhere upright."""
    tree, view = _post(), View((1.0, -8.0, 1.0), (1.0, 0.0, 1.0), fov=45.0)
    half = np.sqrt(0.5)
    lying = pose(tree, np.array([half, 0.0, half, 0.0]))
    pictures = [render_trees([tree], [at], width=160, height=160, view=view) for at in (None, lying)]
    empty = render_trees([_post(1e-3)], width=160, height=160, view=view)
    changed = [np.abs(p.astype(int) - empty.astype(int)).sum(axis=2) > 60 for p in pictures]
    # Pixels a metre at the posts' distance: 160 / (2 * 8 * tan 22.5 deg) = 24.1; the picture's middle is (1, 0, 1).
    column, row = int(80 - 24.1), int(80 - 24.1 * 0.7)
    assert changed[0][row - 3 : row + 3, column - 2 : column + 2].all()  # 1.7 m up the standing post
    assert not changed[1][row - 3 : row + 3, column - 2 : column + 2].any()
    column, row = int(80 + 24.1 * 0.7), int(80 + 24.1)
    assert changed[1][row - 2 : row + 2, column - 2 : column + 2].all()  # 1.7 m along the lying post


def test_foliage_grows_on_outermost_links_only():
    """Dress twig ends, leave the trunk bare, and stay near the tree."""
    tree = random_tree(np.random.default_rng(0), 30)
    dressed = leafy(tree)
    assert dressed[~np.isin(np.arange(30), tree.parent)].all()
    assert not dressed[0]
    made = foliage(tree, None, np.random.default_rng(1))
    leaf = made.leaf()
    assert leaf.any() and not leaf.all()
    low, high = Solids.joined([wood(tree)]).boxes()
    size = (high.max(axis=0) - low.min(axis=0)).max()
    assert (made.start > low.min(axis=0) - 0.6 * size).all() and (made.end < high.max(axis=0) + 0.6 * size).all()
    np.testing.assert_array_equal(made.through, np.where(leaf, 0.55, 0.0))
    assert (made.radius[leaf] == 0).all() and (made.radius[~leaf] > 0).all()
    rib = made.end - made.start
    np.testing.assert_allclose(np.sum(rib * made.side, axis=1), 0.0, atol=1e-12)  # square to each other


def test_what_is_simulated_is_what_is_drawn():
    """Draw every tree's capsules at its own pose, and nothing else; leaves only where they are asked for."""
    rng = np.random.default_rng(2)
    trees = [random_tree(rng, 5) for _ in range(3)]
    poses = [pose(t, random_qpos(rng, t)) for t in trees]
    drawn = forest_solids(trees, poses, leaves=False, rng=rng)
    ends = [shape_ends(t, p) for t, p in zip(trees, poses, strict=True)]
    np.testing.assert_array_equal(drawn.start, np.concatenate([e[0] for e in ends]))
    np.testing.assert_array_equal(drawn.end, np.concatenate([e[1] for e in ends]))
    np.testing.assert_array_equal(drawn.radius, np.concatenate([t.shape_radius for t in trees]))
    assert not drawn.leaf().any()
    assert forest_solids(trees, poses, leaves=True, rng=rng).leaf().any()


@pytest.mark.parametrize(
    ("length", "expected"), [(0.99, 0.5), (1.0, 1.0), (1.9, 1.0), (3.7, 2.0), (70.0, 50.0), (0.03, 0.02)]
)
def test_round_lengths(length, expected):
    """Round down to 1, 2 or 5 times a power of ten."""
    assert round_length(length) == pytest.approx(expected, rel=1e-12)


def test_rod_is_as_long_as_it_says():
    """Measure the rod from the ground to its top, balls included."""
    low, high = rod(np.array([1.0, 2.0, -0.3]), 0.5).boxes()
    np.testing.assert_allclose([low[:, 2].min(), high[:, 2].max()], [-0.3, 0.2], atol=1e-12)


def test_pictures_carry_a_scale():
    """Find the rod's red, 1 m of a post of 2 m, as long as the camera makes it; and words where they belong."""
    view = View((0.0, -8.0, 1.0), (0.0, 0.0, 1.0), fov=45.0)
    image = render_trees([_post()], width=320, height=320, view=view).astype(int)
    red = (image[..., 0] > 1.8 * image[..., 1]) & (image[..., 0] > 1.8 * image[..., 2])
    rows, columns = np.nonzero(red)
    # The rod stands as far ahead as the post's near side, on the ground that the post's lower ball lies on.
    low = view.pixels(np.array([0.0, -0.2, -0.2]), 320, 320)
    # Five bands, the first and the last red: from the ground to 1 m, within a row at both ends.
    metre = 320 / (2 * 7.8 * np.tan(np.radians(22.5)))
    np.testing.assert_allclose([rows.max(), rows.min()], [low[1], low[1] - metre], atol=2.0)
    assert np.ptp(columns) <= metre / 30 + 2
    empty = np.full((200, 300, 3), 120, np.uint8)
    marked = caption(empty, view, np.zeros(3), 1.0, "note") != 120
    assert marked[:100, 100:200].any() and marked[150:, :100].any() and not marked[:, 200:].any()


def test_pixels_of_points():
    """See the target in the middle, and what lies half the width to its right on the right edge."""
    view = View((1.0, -4.0, 0.5), (1.0, 0.0, 0.5), fov=90.0)
    points = np.array([[1.0, 0.0, 0.5], [5.0, 0.0, 0.5], [1.0, 0.0, 2.5]])
    np.testing.assert_allclose(view.pixels(points, 200, 100), [[100, 50], [200, 50], [100, 0]], atol=1e-9)


def test_forest_picture_is_written_and_repeats(tmp_path):
    """Write the picture that is returned, the same for the same seed and another for another."""
    rng = np.random.default_rng(3)
    trees = [random_tree(rng, 8) for _ in range(4)]
    size = {"width": 96, "height": 54}
    image = render_forest(trees, tmp_path / "a.png", **size, seed=5)
    np.testing.assert_array_equal(np.asarray(PIL.Image.open(tmp_path / "a.png")), image)
    np.testing.assert_array_equal(render_forest(trees, tmp_path / "b.png", **size, seed=5), image)
    assert (render_forest(trees, tmp_path / "c.png", **size, seed=6) != image).mean() > 0.1
    assert image.std() > 20  # sky, ground and trees, not one colour


def test_leaves_are_drawn_on_demand_and_declared(tmp_path):
    """Add green, and a note in the lower left corner that says that leaves are decoration; none without."""
    trees = [random_tree(np.random.default_rng(3), 8) for _ in range(4)]
    bare, dressed = (
        render_forest(trees, tmp_path / "x.png", width=320, height=180, leaves=leaves, seed=5).astype(int)
        for leaves in (False, True)
    )
    corner = np.abs(dressed - bare)[-12:, :120]
    assert (corner.max(axis=(1, 2)) > 60).any()
    assert not np.array_equal(dressed[:90], bare[:90])


def test_nothing_to_draw_is_refused(tmp_path):
    """Name what is missing, and write no file, when no tree has a capsule."""
    bare = _post().with_(shape_link=[], shape_start=np.zeros((0, 3)), shape_end=np.zeros((0, 3)), shape_radius=None)
    with pytest.raises(InputError, match="at least one capsule"):
        render_forest([bare], tmp_path / "none.png")
    assert not list(tmp_path.iterdir())
