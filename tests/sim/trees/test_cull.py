"""Culling against sampled distances and the mechanics of the whole tree."""

import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_matrix, quat_rotate
from bough.sim.trees.cull import cull, link_distance
from bough.sim.trees.pose import rest_pose
from bough.sim.trees.species import grow
from bough.sim.trees.stiffness import hold_rest_pose
from bough.sim.trees.tree import Joint, Tree
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.random_tree import random_tree


def sampled_distance(tree: Tree, point: np.ndarray, count: int = 4001) -> np.ndarray:
    """Distance to the nearest of many balls along each capsule; one capsule a link, one radius."""
    position, rotation = rest_pose(tree)
    start = position + quat_rotate(rotation, tree.shape_start)
    end = position + quat_rotate(rotation, tree.shape_end)
    share = np.linspace(0, 1, count)[:, None, None]
    gap = np.linalg.norm(start + share * (end - start) - point, axis=-1).min(axis=0)
    return np.maximum(gap - tree.shape_radius.max(axis=1), 0.0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 12))
def test_distance_is_the_sampled_one(seed: int, links: int) -> None:
    """Check the distance to capsules against 4001 samples of each axis (at most 0.6 m: within 0.1 mm)."""
    rng = np.random.default_rng(seed)
    tree, point = random_tree(rng, links), rng.normal(0, 0.5, 3)
    distance = link_distance(tree, point)
    assert np.all(distance <= sampled_distance(tree, point) + 1e-12)
    assert distance == pytest.approx(sampled_distance(tree, point), abs=1e-4)


def test_inside_is_zero_and_no_capsule_is_far() -> None:
    """Check a point inside a capsule, and a link that has none."""
    tree = grow("Ta", 1, noise=0.0)
    assert link_distance(tree, (0, 0, 0.4))[0] == 0.0
    bare = tree.with_(shape_link=tree.shape_link[:-1], shape_start=tree.shape_start[:-1],
                      shape_end=tree.shape_end[:-1], shape_radius=tree.shape_radius[:-1])  # fmt: skip
    assert np.isinf(link_distance(bare, (0, 0, 0))[-1])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 30), st.floats(0.05, 0.95))
def test_keeps_what_is_reached_and_what_carries_it(seed: int, links: int, quantile: float) -> None:
    """Check the links kept against a plain walk from every reached link to the ground, and where they stay."""
    rng = np.random.default_rng(seed)
    tree, point = random_tree(rng, links), rng.normal(0, 0.5, 3)
    distance = link_distance(tree, point)
    reach = float(np.quantile(distance, quantile)) + 1e-9
    wanted = set()
    for i in np.flatnonzero(distance <= reach):
        while i >= 0:
            wanted.add(int(i))
            i = tree.parent[i]
    small = cull(tree, point, reach).validate()
    order = sorted(wanted)
    assert small.link_name == [tree.link_name[i] for i in order]
    for a, b in zip(rest_pose(small), rest_pose(tree), strict=True):
        assert a == pytest.approx(b[order], abs=1e-14)
    assert np.array_equal(small.stiffness, tree.stiffness[order]) and np.array_equal(small.level, tree.level[order])
    assert np.array_equal(small.shape_end, tree.shape_end[order])
    assert list(small.shape_link) == list(range(len(order)))


def total_momenta(tree: Tree) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, first moment and inertia about the world's origin of the whole tree at rest."""
    position, rotation = rest_pose(tree)
    turn, centre = quat_matrix(rotation), position + quat_rotate(rotation, tree.com)
    about = np.einsum("nij,njk,nlk->il", turn, tree.inertia, turn)
    for m, c in zip(tree.mass, centre, strict=True):
        about = about + m * (c @ c * np.eye(3) - np.outer(c, c))
    return tree.mass.sum(), tree.mass @ centre, about


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 25))
def test_lumping_keeps_the_mechanics(seed: int, links: int) -> None:
    """Check mass, moment and inertia of the whole, and the load on every joint left, before and after."""
    rng = np.random.default_rng(seed)
    joints = (Joint.REVOLUTE, Joint.SPHERICAL, Joint.PRISMATIC, Joint.FIXED)
    tree, point = random_tree(rng, links, joints=joints), rng.normal(0, 0.5, 3)
    small = cull(tree, point, float(np.median(link_distance(tree, point))) + 1e-9)
    for a, b in zip(total_momenta(small), total_momenta(tree), strict=True):
        assert a == pytest.approx(b, rel=1e-10, abs=1e-10)
    load = dict(zip(tree.link_name, hold_rest_pose(tree).preload, strict=True))
    for name, preload in zip(small.link_name, hold_rest_pose(small).preload, strict=True):
        assert preload == pytest.approx(load[name], rel=1e-10, abs=1e-10)


def test_lumps_two_sticks_by_hand() -> None:
    """Check mass, centre and inertia of a link that takes over its child, and of one that does not."""
    tree = Tree(
        name="pair", link_name=["a", "b"], parent=[-1, 0], joint=[2, 2], position=[[0, 0, 0], [0, 0, 1]],
        rotation=[[1, 0, 0, 0], [np.sqrt(0.5), np.sqrt(0.5), 0, 0]], mass=[1, 3], com=[[0, 0, 0.5]] * 2,
        inertia=[np.diag([2.0, 2.0, 0.1])] * 2, stiffness=[0, 0], damping=[0, 0], shape_link=[0, 1],
        shape_start=np.zeros((2, 3)), shape_end=[[0, 0, 1]] * 2, shape_radius=0.01 * np.ones((2, 2)),
    )  # fmt: skip
    # b lies along -y from (0, 0, 1): centre (0, -0.5, 1); a's is (0, 0, 0.5); reduced mass 3/4, apart (0, -0.5, 0.5).
    small = cull(tree, (0, 0, -0.5), 0.6)
    assert small.mass == pytest.approx([4.0])
    assert small.com[0] == pytest.approx([0, -0.375, 0.875])
    apart = np.array([0, -0.5, 0.5])
    wanted = np.diag([2, 2, 0.1]) + np.diag([2, 0.1, 2]) + 0.75 * (0.5 * np.eye(3) - np.outer(apart, apart))
    assert small.inertia[0] == pytest.approx(wanted)
    assert cull(tree, (0, 0, -0.5), 0.6, lump=False).mass == pytest.approx([1.0])


def test_refuses_a_tree_out_of_reach() -> None:
    """Check that the distance that would be enough is named, and a negative reach."""
    with pytest.raises(InputError, match=r"no link within 0.5 m of .*; allowed: 1.99 m or more"):
        cull(grow("Ta", 1, noise=0.0), (2.0, 0, 0.4), 0.5)
    with pytest.raises(InputError, match="reach: found -1 m"):
        cull(grow("Ta", 1), (0, 0, 0), -1.0)
