"""Shared by all tests: the oracles on the path, which tests are long, long files first, no log files left behind."""

import os
import signal
import sys
from pathlib import Path

import pytest

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
# Workers share the cores, and threads of torch and BLAS that wait for each other are ten times slower: 162 s for a test
# that takes 17 s alone. One thread each, set before torch is imported; commands that tests start inherit it.
for library in ("OMP", "OPENBLAS"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
# Tests are about the CPU, whose numbers they know to the bit, and which Warp would not choose where there is a GPU. The
# GPU has `benchmarks/gpu.py`, which compares it with the CPU.
os.environ["CUDA_VISIBLE_DEVICES"] = ""
# What a shell runs in the background ignores Ctrl-C, and so would every command that tests start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
TESTS = Path(__file__).parent
sys.path.insert(0, str(TESTS))

from long import LONG  # noqa: E402
from oracles.forked import Forked  # noqa: E402

#: Files that take longest, in this order. They begin first, so that no worker is left with one when the other is done.
#: Files that need one large kernel stand apart: two workers that meet at it would both compile it.
FIRST = (
    "learn/gap/test_gap.py", "learn/thesis/test_chapter3.py", "learn/gap/test_gap_real.py",
    "cli/test_diagnose_story.py", "test_pages.py", "test_repository.py", "cli/test_train_story.py",
    "learn/gap/test_joint_intervals.py", "learn/hidden/test_forms.py", "cli/test_identify_story.py",
    "learn/gap/test_gap_joints.py", "learn/gap/test_gap_nested.py", "sim/arms/test_contact_worlds.py",
    "sim/arms/test_arm_effects.py", "sim/newton/test_newton_conformance.py", "cli/test_simulate_story.py",
    "cli/test_hide_story.py", "kernels/test_ptx.py", "sim/engine/test_gpu_ready.py", "sim/newton/test_newton_bridge.py",
    "sim/engine/test_simulator_effects.py", "learn/inference/test_coverage.py", "learn/inference/test_identify.py",
    "learn/thesis/test_chapter5.py", "learn/thesis/test_chapter4.py", "sim/engine/test_simulator.py",
    "kernels/effects/test_effects.py", "learn/systems/test_effect_systems.py", "sim/arms/test_contact.py",
)  # fmt: skip


def pytest_configure(config):
    """Declare the marker of `long.LONG`."""
    config.addinivalue_line("markers", "long(reason): left to make test-all, see tests/long.py")


def pytest_collection_modifyitems(config, items):
    """Mark long tests with their reasons, and put long files first; within a file and among the others order stays."""
    unused = set(LONG)
    for item in items:
        name = f"{item.path.relative_to(TESTS)}::{item.name}"
        for key in LONG:
            if name.startswith(key):
                item.add_marker(pytest.mark.long(LONG[key]))
                unused.discard(key)
    if unused and config.args == config.getini("testpaths"):
        raise pytest.UsageError(f"tests/long.py: no test begins with {', '.join(sorted(unused))}")
    ranks = {TESTS / name: rank for rank, name in enumerate(FIRST)}
    items.sort(key=lambda item: ranks.get(item.path, len(FIRST)))


@pytest.fixture(scope="session")
def forked():
    """Return what runs programs in processes that need not import torch again."""
    out = Forked()
    yield out
    out.close()


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    """Run every test in a folder of its own: MuJoCo writes its log where it runs."""
    monkeypatch.chdir(tmp_path)
