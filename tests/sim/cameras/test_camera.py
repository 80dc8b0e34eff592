"""The simulated camera against closed forms: planes, capsules, the noise law, what a second imager does not see."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_rotate
from bough.sim.cameras.camera import Cameras
from bough.sim.cameras.label import Label
from bough.sim.cameras.pinhole import Pinhole, looking
from bough.sim.cameras.stereo import StereoDepth
from bough.sim.cameras.world import World
from bough.sim.pictures.tracer import Solids

WIDTH, HEIGHT = 80, 60
GREY = np.array([[0.5, 0.5, 0.5]])


def camera(position, target) -> Pinhole:
    position, target = np.array(position, float), np.array(target, float)
    where = tuple(float(x) for x in position)
    return Pinhole(WIDTH, HEIGHT, (70.0, 75.0, 39.0, 30.5), where, looking(position, target))


def capsule(start, end, radius, label=Label.BRANCH, ground=0.0) -> World:
    ends = np.array([start], float), np.array([end], float)
    return World.capsules(*ends, np.array([radius]), np.array([label]), GREY, ground)


def rays(at: Pinhole) -> np.ndarray:
    """Directions of all pixels [H, W, 3] in world axes, as long as their depth is 1."""
    fx, fy, cx, cy = at.intrinsics
    v, u = np.mgrid[: at.height, : at.width]
    return quat_rotate(np.array(at.rotation), np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)], axis=-1))


@pytest.fixture(scope="module")
def perfect() -> Cameras:
    return Cameras(WIDTH, HEIGHT, stereo=StereoDepth.perfect())


def test_depth_of_a_plane(perfect):
    """See the ground where each pixel's ray meets it: z = -h / d_z, in float32 over a metre to within 1e-5 of it."""
    at = camera([0.3, -0.2, 1.1], [0.9, 0.4, 0.2])
    shot = perfect.shoot(capsule([50, 0, 1], [50, 0, 2], 0.01, ground=-0.1), [at])
    down = rays(at)[..., 2]
    expected = np.where(down < 0, 1.2 / np.maximum(-down, 1e-9), 0.0)
    close = (expected > 0) & (expected < 20)
    assert close.mean() > 0.5
    np.testing.assert_allclose(shot.depth[0][close], expected[close], rtol=1e-5)
    assert (shot.label == Label.BACKGROUND).all()


def test_depth_of_a_capsule(perfect):
    """See a long upright capsule at the nearer root of the circle that a level ray cuts from it."""
    at = camera([0.0, 0.0, 1.0], [1.0, 0.0, 1.0])
    distance, radius = 0.6, 0.12
    shot = perfect.shoot(capsule([distance, 0, -3], [distance, 0, 5], radius, ground=-9.0), [at])
    across = (np.arange(WIDTH) - at.intrinsics[2]) / at.intrinsics[0]  # of a ray's level part at depth 1
    root = distance**2 - (1 + across**2) * (distance**2 - radius**2)
    hit = root > 0
    expected = (distance - np.sqrt(root[hit])) / (1 + across[hit] ** 2)
    assert hit.sum() > 20
    np.testing.assert_allclose(shot.depth[0][:, hit], np.tile(expected, (HEIGHT, 1)), rtol=2e-5)
    assert (shot.label[0][:, hit] == Label.BRANCH).all() and (shot.label[0][:, ~hit] == Label.BACKGROUND).all()


def test_cameras_of_a_batch_see_what_each_sees_alone(perfect):
    """Give every camera of a batch its own picture, to the bit."""
    world = World.joined([capsule([0.6, -0.2, 0.3], [0.7, 0.3, 1.2], 0.05), capsule([0.5, 0, 0.5], [0.9, 0, 0.5], 0.02,
                                                                                     Label.LINE)])  # fmt: skip
    eyes = [camera(p, [0.6, 0, 0.7]) for p in ([0, 0, 0.8], [0.1, -0.7, 1.0], [1.5, 0.4, 0.3])]
    together = perfect.shoot(world, eyes)
    for k, eye in enumerate(eyes):
        alone = perfect.shoot(world, [eye])
        for name in ("colour", "depth", "label"):
            np.testing.assert_array_equal(getattr(together, name)[k], getattr(alone, name)[0])
    assert {Label.BRANCH, Label.LINE, Label.BACKGROUND} <= set(np.unique(together.label))


def test_leaves_hide_what_is_behind_them(perfect):
    """Give leaves a label of their own, before wood that stands behind them and is listed first."""
    wood = capsule([0.8, 0, 0], [0.8, 0, 2], 0.05)
    leaf = Solids(np.array([[0.5, 0, 0.9]]), np.array([[0.5, 0, 1.1]]), np.zeros((1, 2)), GREY,
                  np.array([[0, 0.1, 0.0]]), np.array([0.5]))  # fmt: skip
    at = camera([0, 0, 1], [1, 0, 1])
    seen = perfect.shoot(World.joined([World.leaves(leaf), wood]), [at]).label[0]
    assert seen[30, 39] == Label.LEAF and seen[2, 39] == Label.BRANCH


@pytest.mark.parametrize("depth", [0.2, 0.5, 1.0])
def test_noise_grows_with_the_square_of_the_depth(depth):
    """Measure a wall with the deviation z^2 dd / (f b): 4800 pixels tell it to 1 %, asked to 5 %; mean to 5 errors."""
    stereo = replace(StereoDepth(), step=0.0, unit=0.0, graze=(-2.0, -1.0))
    seen = Cameras(WIDTH, HEIGHT, stereo=stereo, seed=1)
    wall = capsule([100.0 + depth, 0, -50], [100.0 + depth, 0, 50], 100.0, ground=-90.0)
    shot = seen.shoot(wall, [camera([0, 0, 0], [1, 0, 0])])
    assert (shot.depth > 0).all()
    error = (shot.depth - shot.true_depth) / shot.true_depth**2 * depth**2
    expected = depth**2 * 0.08 / (424 / math.tan(math.radians(43.5)) * 0.018)
    assert stereo.deviation(depth) == pytest.approx(expected)
    # z = f b / (d + e) is curved in e: its deviation and mean are off by some (sigma / z)^2, below 2 % at 1 m
    assert np.std(error) == pytest.approx(expected, rel=0.05)
    assert abs(np.mean(error)) < 5 * expected / math.sqrt(error.size) + 2 * expected**2 / depth
    again = seen.shoot(wall, [camera([0, 0, 0], [1, 0, 0])])
    assert (again.depth != shot.depth).mean() > 0.9  # every shot draws its noise anew


def test_the_second_imager_misses_a_strip_beside_what_is_near():
    """Leave a hole of the width f b (1/near - 1/far) on one side of a post before a wall, to within a pixel."""
    near, far, radius = 0.4, 1.2, 0.05
    stereo = replace(StereoDepth.perfect(), baseline=0.04, graze=(0.0, 1e-6))
    at = camera([0, 0, 0], [1, 0, 0])
    world = World.joined([capsule([near + radius, 0, -9], [near + radius, 0, 9], radius, ground=-90.0),
                          capsule([100 + far, 0, -50], [100 + far, 0, 50], 100.0)])  # fmt: skip
    row = Cameras(WIDTH, HEIGHT, stereo=stereo).shoot(world, [at]).depth[0, 30]
    post = np.flatnonzero((row > 0) & (row < 0.8))
    left, right = row[: post[0]], row[post[-1] + 1 :]
    # the tangents from both imagers touch the post at about its middle's depth
    width = at.intrinsics[0] * stereo.baseline * (1 / (near + radius) - 1 / far)
    assert abs((left == 0).sum() - width) <= 1 and (right == 0).sum() <= 1


def test_holes():
    """Give no depth below the nearest, beyond the farthest, on grazing ground and on what is thinner than a match."""
    seen = Cameras(WIDTH, HEIGHT)
    near = capsule([0.0, 0, -9], [0.0, 0, 9], 0.05, ground=-90.0)
    assert not seen.shoot(near, [camera([-0.11, 0, 0], [1, 0, 0])]).depth[0, 30, 39]
    assert seen.shoot(near, [camera([-0.30, 0, 0], [1, 0, 0])]).depth[0, 30, 39]
    assert not seen.shoot(near, [camera([-2.50, 0, 0], [1, 0, 0])]).depth[0, 30, 39]
    low = camera([0, 0, 0.05], [10, 0, 0.05])
    ground = seen.shoot(capsule([0, 0, 9], [0, 0, 10], 0.1), [low])
    flat = (ground.true_depth > 0.6) & (ground.true_depth < 2.0)  # seen under less than 5 degrees, cosine below 0.09
    assert flat.sum() > 80 and not ground.depth[flat].any()
    twig = seen.shoot(capsule([0.5, 0, -9], [0.5, 0, 9], 0.0012, ground=-90.0), [camera([0, 0, 0], [1, 0, 0])])
    wood = twig.label == Label.BRANCH
    assert wood.sum() > 20 and (twig.depth[wood] > 0).mean() < 0.5


@pytest.mark.parametrize("wrong", [{"baseline": 0.0}, {"farthest": 0.05}, {"noise": float("nan")}])
def test_depth_settings_that_mean_nothing(wrong):
    """Refuse numbers out of range."""
    with pytest.raises(InputError):
        StereoDepth(**wrong)


def test_cameras_that_cannot_be(perfect):
    """Refuse a picture without pixels, a rotation that is none, a batch of two sizes, looking straight down."""
    good = camera([0, 0, 1], [1, 0, 1])
    for change in ({"width": 0}, {"rotation": (1.0, 1.0, 0.0, 0.0)}, {"intrinsics": (0.0, 1.0, 1.0, 1.0)}):
        with pytest.raises(InputError):
            replace(good, **change)
    world = capsule([1, 0, 0], [1, 0, 1], 0.1)
    for eyes in ([], [replace(good, width=9)]):
        with pytest.raises(InputError):
            perfect.shoot(world, eyes)
    with pytest.raises(InputError):
        camera([0, 0, 1], [0, 0, 0])
