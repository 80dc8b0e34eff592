"""YAML from strangers: aliases, nesting and numbers without end, keys that are none."""

from pathlib import Path

import pytest
from bough.sim.base.errors import InputError
from bough.sim.trees.lsystem import LSystem
from bough.sim.wood.branch_file import read_branch_file


def test_aliases_are_not_written_out(tmp_path):
    """Refuse a value whose text would have 10^12 entries in one short line, without making that text."""
    lines = ["format: branch-model/1", "name: [" + ", ".join("x" * 10) + "]", "segments:", "  - &a0 [1]"]
    lines += [f"  - &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 13)]
    file = tmp_path / "model.yaml"
    file.write_text("\n".join([lines[0], "name: branch", *lines[2:]]))
    with pytest.raises(InputError) as error:
        read_branch_file(file)
    assert "segments" in str(error.value) and len(str(error.value)) < 400


def test_deep_lsystems_are_refused(tmp_path):
    """Refuse a list in ten thousand lists in one line."""
    file = Path(tmp_path / "bush.yaml")
    file.write_text("axiom: " + "[" * 10_000 + "]" * 10_000)
    with pytest.raises(InputError, match="nested too deeply"):
        LSystem.from_file(file)


LONG = "9" * 5000


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"name: {LONG}", ("line 2, column 7", "an integer of 5000 characters")),
        (f"name: 0x{'f' * 5000}", ("line 2, column 7", "an integer of 5002 characters")),
        (f"name: 0b{'1' * 90}", ("line 2, column 7", "an integer of 92 characters")),
        (f"name: [{'1:' * 3000}1]", ("line 2, column 8", "an integer of 6001 characters")),
        ("? [1, 2]\n: 3", ("line 2, column 3", "a list as a key")),
        ("name: {? {a: 1}\n : 3}", ("line 2, column 10", "a mapping as a key")),
        ("name: !!set {? [1]}", ("line 2, column 16", "a list as a key")),
        ("name: 9223372036854775807", ("line 2", "name", "9223372036854775807")),
    ],
)
def test_numbers_and_keys_that_are_none(tmp_path, line, words):
    """Refuse integers beyond 64 bits, which Python does not write out, and keys that are lists: where they stand."""
    file = tmp_path / "model.yaml"
    file.write_text(f"format: branch-model/1\n{line}\n")
    with pytest.raises(InputError) as error:
        read_branch_file(file)
    assert all(word in str(error.value) for word in words), str(error.value)
    assert len(str(error.value)) < 400
