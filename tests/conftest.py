"""Shared by all tests: the oracles on the path, and no log files in the repository."""

import os
import sys
from pathlib import Path

import pytest

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """Run every test in a folder of its own: MuJoCo writes its log where it runs."""
    monkeypatch.chdir(tmp_path)
