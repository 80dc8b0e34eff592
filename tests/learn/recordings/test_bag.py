"""Bags as a killed recorder leaves them."""

import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="bags need pip install 'bough[touch]'")

from bough.learn.recordings.bag import read_bag
from oracles.probed_bag import Bag, probe

#: Overwrites all messages in a transaction that does not fit into memory, and is gone before its end.
KILLED = """
import os, sqlite3, sys
base = sqlite3.connect(sys.argv[1])
base.execute("PRAGMA cache_size = 1")
base.execute("UPDATE messages SET data = zeroblob(300)")
os._exit(9)
"""


def test_what_a_killed_recorder_has_half_written_is_taken_back(tmp_path):
    """Read the messages as they were before a transaction that a process did not live to end."""
    p = probe(seconds=1.0)
    bag = Bag(tmp_path / "cut.db3")
    bag.joints(p)
    file = bag.write() / "cut.db3"
    before = file.read_bytes()
    assert subprocess.run([sys.executable, "-c", KILLED, str(file)], check=False).returncode == 9
    assert file.with_name("cut.db3-journal").exists() and file.read_bytes() != before
    (file.parent / "metadata.yaml").unlink()
    _, q, effort = read_bag(file.parent).streams["/j2n6s300_driver/out/joint_state"].arrays()
    np.testing.assert_array_equal(q, p.q)
    np.testing.assert_array_equal(effort, p.effort)
