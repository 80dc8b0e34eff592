"""Hints at optional parts: commands that install them, wherever bough was installed from."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest
from bough.sim.base.extras import install_hint
from packaging.requirements import Requirement

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[3]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


def test_a_checkout_installs_its_own_extra():
    """Say the folder, so that the command works in every other folder too."""
    assert shlex.split(install_hint("view")) == ["pip", "install", "-e", f"{ROOT}[view]"]


@pytest.mark.parametrize("extra", ["view", "train", "robot", "sysid"])
def test_a_wheel_names_the_packages(tmp_path, extra):
    """Name what the extra stands for where there is no checkout: bough itself may be on no index."""
    words = shlex.split(install_hint(extra, tmp_path))
    assert words[:2] == ["pip", "install"]
    named = {str(Requirement(word)) for word in words[2:]}
    assert named == {str(Requirement(line)) for line in EXTRAS[extra]}


def test_no_message_asks_an_index_for_bough():
    """Find ``bough[...]`` in no source of the package but the helper, and every hint at an extra that exists."""
    for path in [p for room in ("sim", "learn", "cli", "perception") for p in (ROOT / room).rglob("*.py")]:
        text = path.read_text()
        assert path.name == "extras.py" or "bough[" not in text, path
        assert {*re.findall(r"""install_hint\(["'](\w+)["']\)""", text)} <= set(EXTRAS), path
