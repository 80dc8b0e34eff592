"""What the machine offers, and what the environment leaves of it."""

import os

import pytest
from bough.sim.base.host import num_cores, num_threads


@pytest.mark.parametrize(
    ("told", "threads"), [("1", 1), ("1,4", 1), (" 1 ", 1), ("100000", None), ("", None), ("0", None), ("two", None)]
)
def test_work_is_split_as_the_environment_says(monkeypatch, told, threads):
    """Take the first number of OMP_NUM_THREADS, never more than there are cores; all cores where it says nothing."""
    monkeypatch.setenv("OMP_NUM_THREADS", told)
    assert num_cores() == len(os.sched_getaffinity(0))
    assert num_threads() == (threads or num_cores())
