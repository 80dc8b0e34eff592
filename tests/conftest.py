"""Shared by all tests: the oracles on the path, the long files first, and no log files in the repository."""

import os
import sys
from pathlib import Path

import pytest

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
sys.path.insert(0, str(Path(__file__).parent))

#: Files that take minutes, longest first. They begin first, so that no worker is left with one when the other is done.
LONG = (
    "learn/gap/test_gap.py", "test_repository.py", "cli/test_diagnose_story.py", "cli/test_train_story.py",
    "cli/test_identify_story.py", "learn/gap/test_gap_real.py", "learn/thesis/test_chapter3.py",
    "sim/arms/test_contact_worlds.py", "sim/arms/test_contact.py", "cli/test_simulate_story.py",
    "kernels/test_ptx.py", "sim/engine/test_gpu_ready.py", "sim/engine/test_simulator_effects.py",
    "learn/inference/test_identify.py", "learn/thesis/test_chapter5.py", "sim/engine/test_simulator.py",
    "kernels/effects/test_effects.py", "learn/gap/test_gap_joints.py", "learn/systems/test_effect_systems.py",
)  # fmt: skip


def pytest_collection_modifyitems(items):
    """Put the files that take longest first; within a file and among the others the order stays."""
    ranks = {str(Path(__file__).parent / name): rank for rank, name in enumerate(LONG)}
    items.sort(key=lambda item: ranks.get(str(item.path), len(LONG)))


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """Run every test in a folder of its own: MuJoCo writes its log where it runs."""
    monkeypatch.chdir(tmp_path)
