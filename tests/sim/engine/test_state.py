"""State: coordinates in MuJoCo's order there and back, start values, what is refused."""

import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.engine.model import Model
from bough.sim.engine.state import State
from bough.sim.trees.tree import Joint
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.random_tree import random_qpos, random_tree
from scipy.spatial.transform import Rotation

ALL = tuple(Joint)


def bent_tree(seed: int, links: int):
    """Make a tree with every kind of joint whose springs are all relaxed away from joint zero."""
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, links, joints=ALL, bent_rest=True)
    ball = tree.joint == Joint.SPHERICAL
    tree.rest[ball] = np.roll(Rotation.from_rotvec(rng.normal(0.0, 0.8, (ball.sum(), 3))).as_quat(), 1, axis=1)
    return tree


def same_rotation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a with the sign of b where they differ by sign alone."""
    return np.where(np.abs(a + b) < np.abs(a - b), -a, a)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), sizes=st.lists(st.integers(1, 9), min_size=1, max_size=9))
def test_qpos_and_qvel_come_back(seed, sizes):
    """Write random coordinates and velocities, read them back: float64 to round-off, float32 lanes to theirs."""
    rng = np.random.default_rng(seed)
    trees = [bent_tree(seed + k, n) for k, n in enumerate(sizes)]
    qpos, qvel = [random_qpos(rng, t) for t in trees], [rng.normal(size=t.num_dofs) for t in trees]
    for width, precision, tolerance in ((1, 64, 1e-14), (8, 32, 1e-6)):
        state = State(Model(trees, width=width, precision=precision))
        state.set_qpos(qpos)
        state.set_qvel(qvel)
        for got, want in zip(state.qpos(), qpos, strict=True):
            np.testing.assert_allclose(same_rotation(got, want), want, rtol=0, atol=5 * tolerance)
        for got, want in zip(state.qvel(), qvel, strict=True):
            np.testing.assert_allclose(got, want, rtol=0, atol=5 * tolerance)


def test_kernel_coordinates_are_turns_from_the_spring_s_rest():
    """Rest the springs where the joints are: kernel coordinates are the identity or zero, and so they start."""
    tree = bent_tree(3, 12)
    qpos = np.concatenate([r[: Joint(int(j)).coordinates] for r, j in zip(tree.rest, tree.joint, strict=True)])
    state = State(Model([tree], precision=64))
    np.testing.assert_allclose(same_rotation(state.qpos()[0], qpos), qpos, rtol=0, atol=1e-14)
    state.set_qpos(qpos)
    links = state.model.gather(state.coordinate.numpy())
    ball = tree.joint == Joint.SPHERICAL
    np.testing.assert_allclose(np.abs(links[ball]), [[1.0, 0, 0, 0]] * int(ball.sum()), rtol=0, atol=1e-14)
    np.testing.assert_allclose(links[~ball, 1], 0.0, atol=1e-14)


def test_quaternions_are_brought_to_unit_length():
    """Give quaternions of other lengths, as files with few digits hold them: the rotation counts."""
    tree = random_tree(np.random.default_rng(4), 3, joints=(Joint.SPHERICAL,))
    state, qpos = State(Model([tree], precision=64)), random_qpos(np.random.default_rng(5), tree)
    state.set_qpos(qpos * 3.0)
    np.testing.assert_allclose(same_rotation(state.qpos()[0], qpos), qpos, rtol=0, atol=1e-14)


def test_one_row_serves_all_worlds():
    """Set worlds of one tree from a single row."""
    tree, rng = bent_tree(6, 5), np.random.default_rng(7)
    qpos, qvel = random_qpos(rng, tree), rng.normal(size=tree.num_dofs)
    state = State(Model([tree] * 5, width=8))
    state.set_qpos(qpos)
    state.set_qvel(qvel)
    for got in state.qvel():
        np.testing.assert_allclose(got, qvel, rtol=0, atol=1e-5)
    for got in state.qpos():
        np.testing.assert_allclose(same_rotation(got, qpos), qpos, rtol=0, atol=1e-5)


def test_a_tree_without_freedom_has_empty_coordinates():
    """Accept the empty rows of a tree of fixed joints."""
    tree = random_tree(np.random.default_rng(8), 3, joints=(Joint.FIXED,))
    state = State(Model([tree]))
    state.set_qpos(np.zeros(0))
    state.set_qvel(np.zeros(0))
    assert [q.shape for q in (*state.qpos(), *state.qvel())] == [(0,), (0,)]


def wrong_rows(tree) -> dict:
    good = random_qpos(np.random.default_rng(0), tree)
    ball = int(np.flatnonzero(tree.joint == Joint.SPHERICAL)[0])
    at = sum(Joint(int(j)).coordinates for j in tree.joint[:ball])
    zero, nan = good.copy(), good.copy()
    zero[at : at + 4], nan[at] = 0.0, np.nan
    return {"short": good[:-1], "long": np.append(good, 0.0), "zero": zero, "nan": nan, "empty": good[:0]}


@pytest.mark.parametrize("case", ["short", "long", "zero", "nan", "empty"])
def test_a_wrong_qpos_is_refused(case):
    """Name the tree and what was found; the state stays as it was."""
    tree = random_tree(np.random.default_rng(9), 4, joints=(Joint.SPHERICAL, Joint.REVOLUTE))
    state = State(Model([tree], precision=64))
    before = state.coordinate.torch.clone()
    with pytest.raises(InputError, match="random-4: qpos") as error:
        state.set_qpos(wrong_rows(tree)[case])
    assert "allowed" in str(error.value) and "\n" not in str(error.value)
    assert (state.coordinate.torch == before).all()


def test_a_wrong_qvel_or_number_of_rows_is_refused():
    """Refuse velocities that do not fit the tree, and rows that do not fit the worlds."""
    tree = bent_tree(10, 4)
    state, n = State(Model([tree] * 3)), tree.num_dofs
    with pytest.raises(InputError, match=f"qvel: found {n + 1} numbers; allowed: {n}"):
        state.set_qvel(np.zeros(n + 1))
    with pytest.raises(InputError, match="qvel: found 2 rows; allowed: 3"):
        state.set_qvel([np.zeros(n)] * 2)
    with pytest.raises(InputError, match="qpos: found 4 rows; allowed: 3"):
        state.set_qpos([np.zeros(tree.num_coordinates)] * 4)
