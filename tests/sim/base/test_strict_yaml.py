"""YAML from strangers: aliases that repeat without end, nesting without end."""

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
