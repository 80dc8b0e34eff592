"""Grouping of different trees in the lanes of a thread: nothing lost, nothing reordered, masked links at rest."""

import sys

import numpy as np
import pytest
import torch
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.engine.topology import arrange
from bough.sim.trees.tree import Joint, Tree
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.random_tree import random_qpos, random_tree

ALL = tuple(Joint)
FORESTS = st.lists(st.tuples(st.integers(0, 10_000), st.integers(1, 14)), min_size=1, max_size=20)


def forest(drawn: list[tuple[int, int]]) -> list[Tree]:
    return [random_tree(np.random.default_rng(seed), links, joints=ALL) for seed, links in drawn]


@settings(max_examples=60, deadline=None)
@given(drawn=FORESTS, width=st.sampled_from([1, 8, 16]))
def test_every_link_has_a_place_of_its_kind(drawn, width):
    """Check what an overlay must keep: every link, its kind, its parent; parents precede; slots are unique."""
    trees = forest(drawn)
    layout = arrange(trees, width)
    assert len(set(layout.world_slot)) == len(trees)
    groups = layout.world_slot // width
    assert set(groups) == set(range(len(layout.count)))
    for g, count in enumerate(layout.count):
        assert (layout.parent[g, 1 : count + 1] < np.arange(1, count + 1)).all()
        used = np.concatenate([layout.place[w] for w in np.flatnonzero(groups == g)])
        assert set(used) == set(range(1, count + 1)), "no place without a link in some world"
    for tree, g, place in zip(trees, groups, layout.place, strict=True):
        assert len(set(place)) == tree.num_links
        np.testing.assert_array_equal(layout.kind[g, place], tree.joint)
        above = np.where(tree.parent < 0, 0, place[tree.parent])
        np.testing.assert_array_equal(layout.parent[g, place], above)


@settings(max_examples=40, deadline=None)
@given(drawn=FORESTS, width=st.sampled_from([8, 16]))
def test_order_of_links_does_not_depend_on_the_neighbours(drawn, width):
    """Order every tree's links by place: the same order alone and in any group, so that sums run alike."""
    trees = forest(drawn)
    together = arrange(trees, width)
    for w, tree in enumerate(trees):
        alone = arrange([tree], 1)
        np.testing.assert_array_equal(np.argsort(alone.place[0]), np.argsort(together.place[w]))


def test_worlds_of_one_topology_share_groups():
    """Shuffle a forest of three topologies, eight trees each: no group needs more places than its trees have links."""
    rng = np.random.default_rng(0)
    kinds = [random_tree(np.random.default_rng(k), n, joints=ALL) for k, n in ((1, 5), (2, 12), (3, 12))]
    which = rng.permutation(np.repeat([0, 1, 2], 8))
    layout = arrange([kinds[k] for k in which], 8)
    assert sorted(layout.count) == [5, 12, 12]
    for g in range(3):
        assert len(set(which[layout.world_slot // 8 == g])) == 1


def test_one_world_a_thread_keeps_the_worlds_order():
    """Leave slots in the order of the worlds at width 1."""
    trees = forest([(k, 1 + k % 5) for k in range(9)])
    np.testing.assert_array_equal(arrange(trees, 1).world_slot, np.arange(9))


@pytest.mark.parametrize("width", [8, 16])
def test_masked_links_stay_exactly_still(width):
    """Step wildly different trees in one group: the places that a world lacks keep identity and zero to the bit."""
    trees = forest([(k, 1 + 3 * k % 17) for k in range(width)])
    simulator = Simulator(Model(trees, width=width), threads=1)
    m, rng = simulator.model, np.random.default_rng(1)
    simulator.state.set_qpos([random_qpos(rng, t, 0.3) for t in trees])
    simulator.refresh()
    simulator.step(100)
    masked = torch.ones(m.groups * m.width, m.places + 1, dtype=torch.bool)
    masked[m.link_slot, m.link_place] = False
    assert masked[:, 1:].any()
    coordinate = simulator.state.coordinate.torch.reshape(-1, m.places + 1, 4)[masked]
    velocity = simulator.state.velocity.torch.reshape(-1, m.places + 1, 3)[masked]
    assert torch.equal(coordinate, torch.tensor([1.0, 0.0, 0.0, 0.0]).expand_as(coordinate))
    assert not velocity.any()
    assert not simulator.state.faults()
    assert np.abs(np.concatenate(simulator.state.qvel())).max() > 0.01


def chain(links: int) -> Tree:
    """Make a chain of light rods of 1 cm on ball joints."""
    n = links
    return Tree(
        name="chain", link_name=[f"rod{i}" for i in range(n)], parent=np.arange(n) - 1,
        joint=np.full(n, Joint.SPHERICAL), position=np.tile([0.0, 0.0, 0.01], (n, 1)),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)), mass=np.full(n, 1e-3), com=np.tile([0.0, 0.0, 0.005], (n, 1)),
        inertia=np.tile(1e-6 * np.eye(3), (n, 1, 1)), stiffness=np.full(n, 50.0), damping=np.full(n, 5.0),
    )  # fmt: skip


def test_a_chain_deeper_than_python_s_stack():
    """Lay out and step chains of more links than Python allows nested calls."""
    links = sys.getrecursionlimit() + 500
    trees = [chain(links), chain(links - 1), chain(links - 2), chain(links - 3)]
    for width in (1, 8):
        layout = arrange(trees, width)
        assert layout.count.max() == links
    simulator = Simulator(Model(trees, width=8))
    simulator.step(3)
    assert not simulator.state.faults()
    position, _ = simulator.observe()
    assert torch.isfinite(position).all() and abs(float(position[0, -1, 2]) - 0.01 * links) < 0.1
