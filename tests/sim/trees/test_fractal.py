"""Fractal trees and chains: counts, areas at forks, angles and the plane they lie in."""

import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_rotate
from bough.sim.trees.fractal import grow_chain, grow_fractal
from bough.sim.trees.pose import pose, rest_pose
from bough.sim.trees.tree import Joint, Tree


def headings(tree: Tree) -> np.ndarray:
    return quat_rotate(rest_pose(tree)[1], np.array([0.0, 0.0, 1.0]))


@pytest.mark.parametrize(("levels", "children"), [(1, 3), (2, 1), (3, 1), (4, 2), (3, 3), (2, 5)])
def test_counts_links(levels: int, children: int) -> None:
    """Check sum of k^level links, k children at every fork, and levels that count the forks below."""
    tree = grow_fractal(levels, children=children).validate()
    assert tree.num_links == sum(children**level for level in range(levels))
    assert np.bincount(tree.level).tolist() == [children**level for level in range(levels)]
    assert {len(c) for c in tree.children()} <= {0, children}


@pytest.mark.parametrize("exponent", [2.0, 2.5])
@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_forks_preserve_the_area(exponent: float, noise: float) -> None:
    """Check r^p = sum of the children's r^p at every fork, noise or not."""
    tree = grow_fractal(4, children=3, exponent=exponent, noise=noise, seed=4)
    power = tree.shape_radius[:, 0] ** exponent
    for i, c in enumerate(tree.children()):
        if c:
            assert power[c].sum() == pytest.approx(power[i], rel=1e-12)
            assert (np.ptp(power[c]) > 1e-3 * power[i]) == (noise > 0)


def test_geometry_without_noise() -> None:
    """Check lengths, fork angles and even spacing about the parent by hand."""
    tree = grow_fractal(3, children=3, length=0.8, length_ratio=0.7, fork_angle_deg=25.0, noise=0.0)
    assert tree.shape_end[:, 2] == pytest.approx(0.8 * 0.7**tree.level)
    along = headings(tree)
    for i, c in enumerate(tree.children()):
        if c:
            assert along[c] @ along[i] == pytest.approx(np.cos(np.radians(25.0)) * np.ones(3))
            # Three directions at angle f to an axis, 120 degrees apart about it: cosine 1 - 3/2 sin^2 f between them.
            between = along[c] @ along[np.roll(c, 1)].T
            assert np.diag(between) == pytest.approx((1 - 1.5 * np.sin(np.radians(25.0)) ** 2) * np.ones(3))


def test_noise_is_relative_and_seeded() -> None:
    """Check the spread of lengths and of fork angles over one large tree, and that the seed decides it."""
    tree = grow_fractal(9, noise=0.1, seed=7)
    ratio = tree.shape_end[1:, 2] / tree.shape_end[tree.parent[1:], 2] / 0.75
    along = headings(tree)
    fork = np.degrees(np.arccos(np.sum(along[1:] * along[tree.parent[1:]], axis=1))) / 30.0
    for values in (ratio, fork):  # 510 draws: five standard errors of mean and spread
        assert abs(values.mean() - 1) < 5 * 0.1 / np.sqrt(510)
        assert abs(values.std() / 0.1 - 1) < 5 / np.sqrt(2 * 510)
    assert np.array_equal(grow_fractal(9, noise=0.1, seed=7).position, tree.position)
    assert not np.array_equal(grow_fractal(9, noise=0.1, seed=8).position, tree.position)


def test_chain_is_planar_and_tapers() -> None:
    """Check a chain's angles, lengths and radii by hand, and that its revolute joints keep it in its plane."""
    tree = grow_chain(3, length=0.5, radius=0.02, fork_angle_deg=40.0).validate()
    assert list(tree.parent) == [-1, 0, 1] and set(tree.joint) == {Joint.REVOLUTE}
    angle = np.radians([0, 40, 80])
    assert headings(tree) == pytest.approx(np.stack([0 * angle, np.sin(angle), np.cos(angle)], axis=1))
    assert tree.shape_end[:, 2] == pytest.approx([0.5, 0.375, 0.28125])
    assert tree.shape_radius[:, 0] ** 2 == pytest.approx([4e-4, 2e-4, 1e-4])
    assert list(tree.level) == [0, 1, 2] and tree.stiffness == pytest.approx([120, 40, 120 / 9])
    bent, turned = pose(tree, np.array([0.1, 0.2, -0.3]))
    assert bent[:, 0] == pytest.approx(np.zeros(3), abs=1e-15)
    moved = quat_rotate(turned, np.array([0.0, 0.0, 1.0]))
    assert np.arctan2(moved[:, 1], moved[:, 2]) == pytest.approx(angle + np.array([0.1, 0.3, 0.0]))


@pytest.mark.parametrize(
    ("call", "found"),
    [
        (lambda: grow_fractal(0), "levels: found 0"),
        (lambda: grow_fractal(2, children=0), "children: found 0"),
        (lambda: grow_fractal(30), "at most 100000 links"),
        (lambda: grow_fractal(10**9, children=3), "at most 100000 links"),
        (lambda: grow_fractal(2, radius=-1.0), "radius: found -1"),
        (lambda: grow_fractal(2, length=float("inf")), "length: found inf"),
        (lambda: grow_fractal(2, noise=1.5), "noise: found 1.5"),
        (lambda: grow_fractal(2, stiffness="x"), "stiffness: found 'x'"),
        (lambda: grow_chain(0), "branches: found 0"),
        (lambda: grow_chain(2, length_ratio=0.0), "length_ratio: found 0"),
    ],
)
def test_refuses_bad_arguments(call, found: str) -> None:
    """Check that each is named."""
    with pytest.raises(InputError) as info:
        call()
    assert found in str(info.value)
