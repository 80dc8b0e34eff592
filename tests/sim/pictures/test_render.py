"""Pictures of forests: where trees stand, what is drawn, the same seed the same picture."""

from __future__ import annotations

import numpy as np
import PIL.Image
import pytest
from bough.sim.base.errors import InputError
from bough.sim.formats.export_mesh import mesh
from bough.sim.pictures.foliage import foliage, leafy
from bough.sim.pictures.render import (
    View,
    develop,
    forest_layout,
    forest_mesh,
    render_forest,
    render_trees,
    vertex_normals,
)
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


def test_normals_of_a_flat_and_of_a_round_surface():
    """Point out of a post's side within the half-angle of its facets."""
    vertices, faces, _ = mesh(_post(), sides=48)
    normal = vertex_normals(vertices, faces)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-12)
    side = np.isclose(np.hypot(vertices[:, 0], vertices[:, 1]), 0.2)
    radial = vertices[side] * [1, 1, 0] / 0.2
    assert (np.sum(normal[side] * radial, axis=1) > np.cos(np.radians(15))).all()


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
    vertices, faces, colors, through = foliage(tree, None, np.random.default_rng(1))
    assert len(vertices) == len(colors) == len(through)
    assert faces.max() == len(vertices) - 1
    wood = mesh(tree)[0]
    size = np.ptp(wood, axis=0).max()
    assert (vertices > wood.min(axis=0) - 0.6 * size).all() and (vertices < wood.max(axis=0) + 0.6 * size).all()
    assert ((through == 0) | (through == 0.55)).all()


def test_forest_mesh_joins_every_tree():
    """Hold all trees' triangles, each at its own pose, on the ground."""
    rng = np.random.default_rng(2)
    trees = [random_tree(rng, 5) for _ in range(3)]
    poses = [pose(t, random_qpos(rng, t)) for t in trees]
    scene = forest_mesh(trees, poses, leaves=False, rng=rng)
    parts = [mesh(t, p) for t, p in zip(trees, poses, strict=True)]
    np.testing.assert_array_equal(scene.vertices, np.concatenate([p[0] for p in parts]))
    np.testing.assert_array_equal(scene.vertices[scene.faces[-1]], parts[-1][0][parts[-1][1][-1]])
    assert scene.ground <= scene.vertices[:, 2].min()


def test_forest_picture_is_written_and_repeats(tmp_path):
    """Write the picture that is returned, the same for the same seed and another for another."""
    rng = np.random.default_rng(3)
    trees = [random_tree(rng, 8) for _ in range(4)]
    size = {"width": 96, "height": 54, "samples": 1}
    image = render_forest(trees, tmp_path / "a.png", **size, seed=5)
    np.testing.assert_array_equal(np.asarray(PIL.Image.open(tmp_path / "a.png")), image)
    np.testing.assert_array_equal(render_forest(trees, tmp_path / "b.png", **size, seed=5), image)
    assert (render_forest(trees, tmp_path / "c.png", **size, seed=6) != image).mean() > 0.2
    assert image.std() > 20  # sky, ground and trees, not one colour


def test_nothing_to_draw_is_refused(tmp_path):
    """Name what is missing, and write no file, when no tree has a capsule."""
    bare = _post().with_(shape_link=[], shape_start=np.zeros((0, 3)), shape_end=np.zeros((0, 3)), shape_radius=None)
    with pytest.raises(InputError, match="at least one capsule"):
        render_forest([bare], tmp_path / "none.png")
    assert not list(tmp_path.iterdir())
