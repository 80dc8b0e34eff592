"""Cameras as processes: pace, a slow segmenter, and what the consumer learns when one of them fails."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from bough.learn.cameras.colours import ByColour
from bough.learn.cameras.pipeline import CameraClouds
from bough.learn.cameras.ring import Ring
from bough.sim.arms.jaco2 import jaco2
from oracles.cameras.sources import DEPTH, Carry, Slow, Wall, level_rig

START = 60.0  # s that processes may take to start where eight of them share two cores
LIMIT = 0.4
SLACK = 0.3  # s that a loaded machine may keep this process from looking


def opened(source, rig=None, arm=None, **options) -> CameraClouds:
    rig = level_rig(source.cameras) if rig is None else rig
    options = {"segmenter": partial(ByColour, rig), "limit": LIMIT} | options
    return CameraClouds(source, rig, arm, **options)


def until(clouds, wanted, seconds=START, tell=None):
    """Ask 100 times a second until the answer is as wanted; return it and the age of what was seen."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if tell is not None:
            tell()
        found = clouds.latest()
        if wanted(found):
            return found
        time.sleep(0.01)
    raise AssertionError(clouds.trouble)


def shared_memory() -> set[str]:
    """Return the names in shared memory that are bough's or Python's."""
    return {p.name for p in Path("/dev/shm").iterdir() if p.name.startswith(("psm_", "pym-", "sem.mp"))}


def test_clouds_of_a_wall():
    """See a wall where it is, the line in its red half, young; trouble is empty then, and full once closed."""
    before = shared_memory()
    with opened(Wall()) as clouds:
        assert clouds.latest() is None and clouds.trouble
        found = until(clouds, lambda c: c is not None)
        assert clouds.trouble == "" and 0 <= time.monotonic() - found.time < LIMIT + SLACK
        for points, side in ((found.branches, -1), (found.line, 1)):
            assert points.dtype == np.float32 and len(points) > 50
            np.testing.assert_allclose(points[:, 0], DEPTH, atol=0.006)  # six deviations of the noise
            assert (side * points[:, 2] > -0.01).all()
        later = until(clouds, lambda c: c is not None and c.time > found.time)
        assert later.time > found.time and max(clouds.ages) <= LIMIT
        processes = list(clouds.processes.values())
    assert clouds.latest() is None and not any(p.is_alive() for p in processes)
    assert shared_memory() <= before


@pytest.mark.parametrize("fault", ["freeze_at", "silent_at"])
def test_a_camera_that_freezes(fault):
    """Refuse clouds within the limit once one of two cameras repeats its picture, or none comes; tell why."""
    with opened(Wall(cameras=2, **{fault: 20})) as clouds:
        until(clouds, lambda c: c is not None)
        why = "same picture" if fault == "freeze_at" else "s old"
        until(clouds, lambda c: c is None and why in clouds.trouble, seconds=30)
        assert "s old" in clouds.trouble and max(clouds.ages) <= LIMIT


@pytest.mark.parametrize("victim", ["camera", "segmenter", "clouds"])
def test_a_process_that_is_killed(victim):
    """Learn of a kill -9 at the next look, name the process, hang nowhere, leave no shared memory."""
    before = shared_memory()
    clouds = opened(Wall(), segmenter=partial(Slow, 0.05), keyed=True, tracker=Carry)
    try:
        until(clouds, lambda c: c is not None)
        os.kill(clouds.processes[victim].pid, signal.SIGKILL)
        killed = time.monotonic()
        until(clouds, lambda c: c is None, seconds=LIMIT + SLACK)
        assert time.monotonic() - killed < LIMIT + SLACK
        until(clouds, lambda c: clouds.trouble == f"{victim}: killed by signal 9", seconds=5)
        time.sleep(0.2)
        assert clouds.latest() is None  # nothing starts again by itself
    finally:
        begun = time.monotonic()
        clouds.close()
    assert time.monotonic() - begun < 10 and not any(p.is_alive() for p in clouds.processes.values())
    assert shared_memory() <= before


def test_a_slow_segmenter_holds_nobody_up():
    """Have clouds of every picture while key frames take a second: a look takes no time, and ages stay young."""
    with opened(Wall(), segmenter=partial(Slow, 1.0), keyed=True, tracker=Carry) as clouds:
        until(clouds, lambda c: c is not None)
        times, took = set(), []
        for _ in range(100):
            begun = time.process_time()
            found = clouds.latest()
            took.append(time.process_time() - begun)
            if found is not None:
                times.add(found.time)
            time.sleep(0.015)
        assert len(times) > 5  # pictures, of which a second and a half has 45, not two key frames
        assert np.median(took) < 0.005


def test_key_frames_alone_are_as_old_as_they_are():
    """Without a tracker refuse clouds that the segmenter took longer for than the limit."""
    with opened(Wall(), segmenter=partial(Slow, 0.8), keyed=True) as clouds:
        until(clouds, lambda c: "s old" in clouds.trouble)
        assert clouds.ages == []


def test_the_arm_is_cut_out_where_its_joints_are_told():
    """See nothing before the arm's joints are told, and the wall from then on."""
    arm = jaco2()
    with opened(Wall(), arm=arm) as clouds:
        until(clouds, lambda c: "joint positions" in clouds.trouble)
        found = until(clouds, lambda c: c is not None, tell=lambda: clouds.tell(time.monotonic(), arm.home))
        assert len(found.branches) > 0


def test_a_recording_that_is_over_says_so():
    """Tell that no more pictures come."""
    with opened(Wall(end_at=5)) as clouds:
        until(clouds, lambda c: clouds.trouble == "camera: the recording is over")


PARENT = """
import sys, time
sys.path.insert(0, {tests!r})
from functools import partial
from bough.learn.cameras.colours import ByColour
from bough.learn.cameras.pipeline import CameraClouds
from oracles.cameras.sources import Wall, level_rig
if __name__ == "__main__":
    clouds = CameraClouds(Wall(), level_rig(), None, segmenter=partial(ByColour, level_rig()))
    while clouds.latest() is None:
        time.sleep(0.02)
    print(*(p.pid for p in clouds.processes.values()), flush=True)
    time.sleep(600)
"""


def test_processes_end_with_their_parent(tmp_path):
    """End within seconds when the process that opened them is killed with -9, and leave no shared memory."""
    before = shared_memory()
    script = tmp_path / "parent.py"
    script.write_text(PARENT.format(tests=str(Path(__file__).parents[2])))
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)
    try:
        children = [int(word) for word in parent.stdout.readline().split()]
        assert len(children) == 2
    finally:
        parent.kill()
        parent.wait()
    end = time.monotonic() + 20
    while any(_lives(c) for c in children) and time.monotonic() < end:
        time.sleep(0.05)
    assert not any(_lives(c) for c in children)
    assert shared_memory() <= before


def _lives(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_a_ring_keeps_the_newest():
    """Read the newest write whole, a copy of it; its history is in order, without the slot that is written next."""
    ring = Ring({"number": ("i8", ()), "row": ("f4", (3,))}, slots=4)
    assert ring.read() is None and not len(ring.history())
    for k in range(7):
        ring.write(number=k, row=np.full(3, k))
        seen = ring.read()
        assert seen["number"] == k and (seen["row"] == k).all()
    ring.write(number=9, row=0)
    assert seen["number"] == 6
    np.testing.assert_array_equal(ring.history()["number"], [5, 6, 9])
