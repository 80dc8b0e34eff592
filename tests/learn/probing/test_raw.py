"""Recordings of pulls: whole or kept as cut, averaged into the samples of a case."""

import numpy as np
import pytest
from bough.learn.probing.raw import RawRecording, samples_of
from bough.learn.robot.client import state_of
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.statics import statics
from bough.sim.base.errors import InputError

ARM = jaco2()


def state(tick, gripper=1.0, force=None, tag=None):
    """Return a state of a tick, at 60 a second from 7 s on."""
    said = {"tick": tick, "time_s": 7.0 + tick / 60, "robot_dof_pos": list(ARM.home), "robot_dof_vel": [0.0] * 6,
            "robot_dof_torque": [0.5, 1.0, -0.3, 0.1, 0.2, 0.0], "hand_pos": [1.0, 2.0, 3.0],
            "hand_rot": [0.0, 0.0, 0.0, 1.0]}  # fmt: skip
    said |= {} if gripper is None else {"robot_gripper": gripper}
    said |= {} if force is None else {"hand_force": force, "tag_pos": tag}
    return state_of(said, 0.0)


def test_samples_are_those_of_their_ticks(tmp_path):
    """Take a line in time back, rest place off, the gripper open from 2 s on."""
    path = tmp_path / "pull_1_1.csv"
    with RawRecording(path, ARM) as raw:
        for k in range(0, 250):
            t = k / 60
            raw(state(k, 1.0 if t < 2.0 else 0.4, [2 * t, 0.0, -t], [0.1 + 0.01 * t, 0.2, 0.3]))
        assert (tmp_path / "pull_1_1.csv.part").exists() and not path.exists()
    rows, quiet, begin = samples_of(path, np.array([0.1, 0.2, 0.3]), 20.0, 80)
    t = np.arange(80) / 20
    assert begin == pytest.approx(7.0) and quiet == [[pytest.approx(2.0), t[-1]]]
    # seven digits, and time to a microsecond
    assert rows[:, :4] == pytest.approx(np.column_stack([t, 2 * t, 0 * t, -t]), abs=1e-5)
    assert rows[:, 4:] == pytest.approx(np.column_stack([0.01 * t, 0 * t, 0 * t]), abs=1e-6)
    with pytest.raises(InputError, match="250 ticks"):
        samples_of(path, np.zeros(3), 20.0, 90)


def test_what_is_cut_short_is_kept_and_never_written_to_again(tmp_path):
    """Keep a part after an error, and one that a killed process left, under names of their own."""
    path = tmp_path / "pull_1_1.csv"
    with pytest.raises(RuntimeError), RawRecording(path, ARM) as raw:
        raw(state(1))
        raise RuntimeError
    (tmp_path / "pull_1_1.csv.part").write_text("left by kill -9\n")
    with RawRecording(path, ARM) as raw:
        raw(state(2))
    assert (tmp_path / "pull_1_1.cut-1.csv").read_text().count("\n") == 2
    assert (tmp_path / "pull_1_1.cut-2.csv").read_text() == "left by kill -9\n"
    assert path.read_text().count("\n") == 2 and raw.ticks == 1


def test_without_a_sensor_the_force_is_that_of_the_torques(tmp_path):
    """Take J' f of a force at the hand back to it; the place is the hand's."""
    force = np.array([1.0, -2.0, 3.0])
    bare = state(1, gripper=None)
    bare.torque[:] = statics(ARM, ARM.home)[1].T @ force
    path = tmp_path / "a.csv"
    with RawRecording(path, ARM) as raw:
        raw(bare)
    row = np.loadtxt(path, delimiter=",", skiprows=1)
    assert row[2:9] == pytest.approx([1.0, *force, 1.0, 2.0, 3.0], abs=1e-5)
