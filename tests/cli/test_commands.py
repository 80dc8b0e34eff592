"""Parts of the commands that stories do not reach: reading starts, telling bodies from helper links, seeds, memory."""

import mujoco
import numpy as np
import pytest
from bough.cli.forest import Forest, tree_height, write_forest
from bough.cli.simulate import Simulate, read_qpos, start_rows
from bough.sim.base.console import shown
from bough.sim.base.errors import InputError
from bough.sim.engine.stepping import Stepping
from bough.sim.engine.trajectory import own_bodies
from bough.sim.formats.export_mjcf import to_mjcf
from bough.sim.formats.import_mjcf import load_mjcf
from bough.sim.trees.species import grow, grow_forest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from oracles.random_mjcf import RandomMjcf

TABLES = st.tuples(st.integers(1, 4), st.integers(1, 6)).flatmap(
    lambda shape: arrays(np.float64, shape, elements=st.floats(allow_nan=False, allow_infinity=False))
)


@settings(max_examples=40, deadline=None)
@given(TABLES, st.sampled_from([" ", ", ", "\t"]), st.booleans())
def test_starts_read_back_as_written(tmp_path_factory, table, between, text):
    """Read any table of finite numbers back to the same bits, from text with comments and from .npy."""
    path = tmp_path_factory.mktemp("start") / ("start.txt" if text else "start.npy")
    if text:
        lines = [between.join(repr(float(x)) for x in row) + "  # a world" for row in table]
        path.write_text("# starts\n\n" + "\n".join(lines))
    else:
        np.save(path, table)
    np.testing.assert_array_equal(read_qpos(path, table.shape[1]), table)


def test_one_number_a_line_is_one_start(tmp_path):
    """Take a column of nq numbers for the start of all worlds."""
    (tmp_path / "start.txt").write_text("1\n0\n0\n0\n")
    np.testing.assert_array_equal(read_qpos(tmp_path / "start.txt", 4), [[1.0, 0.0, 0.0, 0.0]])


@pytest.mark.parametrize("content", [b"", b"no array", np.array([[[1.0]]]), np.array(["a"]), np.array([1j])])
def test_arrays_that_are_no_start_are_refused(tmp_path, content):
    """Name the file for .npy that is empty, no array, of three dimensions or not of real numbers."""
    path = tmp_path / "start.npy"
    path.write_bytes(content) if isinstance(content, bytes) else np.save(path, content)
    with pytest.raises(InputError, match=r"start\.npy: found "):
        read_qpos(path, 1)


@pytest.mark.parametrize("seed", range(6))
def test_bodies_are_those_of_mujoco(tmp_path, seed):
    """Keep one link a body of MuJoCo's, in its order, however many joints the bodies have."""
    text = RandomMjcf(seed, 8).text
    (tmp_path / "tree.xml").write_text(text)
    tree = load_mjcf(tmp_path / "tree.xml", ("all",)).tree
    model = mujoco.MjModel.from_xml_string(text)
    bodies = own_bodies(tree)
    assert len(bodies) == model.nbody - 1
    np.testing.assert_allclose(tree.mass[bodies], model.body_mass[1:], rtol=1e-9)


def test_a_forest_is_that_of_grow_forest(tmp_path):
    """Write the trees that `grow_forest` grows from the same seed, and give their heights."""
    made = write_forest(Forest(out=tmp_path / "out", species="tb", count=3, order=1, seed=11, picture_width=0))
    expected = grow_forest("Tb", 3, 1, seed=11)
    for i, (a, b) in enumerate(zip(made, expected, strict=True)):
        assert (tmp_path / f"out/tree_{i:04d}.xml").read_text() == to_mjcf(b) == to_mjcf(a)


def test_height_of_a_tree_without_noise():
    """Measure Ta of order 0: one internode of 200 units and 4 mm a unit."""
    np.testing.assert_allclose(tree_height(grow("Ta", 0, noise=0.0)), 0.8, rtol=1e-12)


def test_bent_starts_turn_by_the_angle_asked_for(tmp_path):
    """Turn every joint by a normal angle of the given deviation: over 17 x 400 joints within 5 %."""
    (tmp_path / "tree.xml").write_text(to_mjcf(grow("Ta", 2)))
    mechanism = load_mjcf(tmp_path / "tree.xml", ("all",))
    options = Simulate(source=tmp_path / "tree.xml", out=tmp_path, bend=0.3, worlds=400, seed=2)
    rows = start_rows(options, mechanism).reshape(400, 17, 4)
    np.testing.assert_allclose(np.linalg.norm(rows, axis=-1), 1.0, atol=1e-12)
    angle = 2.0 * np.arctan2(np.linalg.norm(rows[..., 1:], axis=-1), rows[..., 0])
    np.testing.assert_allclose(np.sqrt(np.mean(angle**2)), 0.3, rtol=0.05)


def test_memory_is_asked_for_before_it_is_taken():
    """Refuse more worlds or more times than the machine's memory holds, and let the usual pass."""
    Stepping().check_memory(480, 64, 121)
    for steps, worlds in ((480, 10**9), (10**13, 1)):
        with pytest.raises(InputError, match="GiB"):
            Stepping().check_memory(steps, worlds, 17)


def test_paths_are_shown_short_where_they_lie_here(tmp_path, monkeypatch):
    """Show a path under the present folder relative to it, and any other in full."""
    monkeypatch.chdir(tmp_path)
    assert shown(tmp_path / "a/b") == "a/b"
    assert shown("/somewhere/else") == "/somewhere/else"
    assert shown(tmp_path) == "."
