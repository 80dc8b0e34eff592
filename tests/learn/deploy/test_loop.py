"""The loop against a twin on a clock of its own: pace, success, and what it does when it cannot see or write."""

import errno

import numpy as np
import pytest
import torch

pytest.importorskip("rsl_rl", reason="tasks need the extra train")

from bough.learn.deploy.log import RunLog, read_run
from bough.learn.deploy.loop import BlindError, Runner, Senses
from bough.learn.deploy.plan import Driver, plan_of
from bough.learn.deploy.report import summary
from bough.learn.deploy.run import Withheld
from bough.learn.deploy.simulated import SimulatedTwin
from bough.learn.deploy.stage import Stage
from bough.learn.deploy.truth import TruthClouds
from bough.learn.policies.tables import wilson
from bough.learn.robot.limits import default_limits
from bough.learn.tasks.reach_settings import ReachSettings
from bough.learn.tasks.settings import TaskSettings
from bough.sim.arms.arm import forward_kinematics
from bough.sim.arms.jaco2 import jaco2
from bough.sim.base.errors import InputError

SETTINGS = {"powerline": TaskSettings(), "reach": ReachSettings()}


def driver(name, act):
    return Driver(plan_of(name, SETTINGS[name], "test"), None, act, lambda: None)


def steady(speed):
    return lambda observation: torch.full((1, 6), speed)


def twin(name, number=0, seed=1):
    plan = plan_of(name, SETTINGS[name], "test")
    return SimulatedTwin(Stage(plan, seed, number), default_limits(plan.arm))


class Frozen(TruthClouds):
    """A camera that shows its picture of some time for ever."""

    def __init__(self, truth, after):
        super().__init__(truth)
        self._after, self._kept = after, None

    def latest(self):
        found = super().latest()
        if self._kept is None or found.time < self._after:
            self._kept = found
        return self._kept


class Dead(TruthClouds):
    """A camera whose segmenter dies."""

    def __init__(self, truth, after):
        super().__init__(truth)
        self._after = after

    def latest(self):
        found = super().latest()
        if found.time > self._after:
            self.trouble = "the segmenter has died"
            return None
        return found


@pytest.mark.parametrize("kind, word", [(Frozen, "old"), (Dead, "the segmenter has died")])
def test_a_policy_that_cannot_see_stops_the_arm(kind, word):
    """Freeze the camera, or kill its segmenter, after a second: the arm is stopped when what it saw is too old."""
    t = twin("powerline")
    senses = Senses(kind(t, 1.0), t, most_age=0.3)
    with pytest.raises(BlindError, match=word):
        Runner(driver("powerline", steady(0.2)), t, senses, t.clock, None).run(0)
    assert t.guard.stop is not None and t.now == pytest.approx(1.3, abs=0.05)
    for _ in range(9):
        t.next()
    assert not t.guard.velocity.any() and np.abs(t.state.qd).max() < 0.02


def test_a_log_that_cannot_be_written_stops_the_arm(tmp_path, monkeypatch):
    """Let the disk fill up after 40 lines: the arm is stopped, the error names the file, and whole lines are left."""
    import os

    t, write, left = twin("reach"), os.write, [40]

    def full(handle, data):
        left[0] -= 1
        return write(handle, data[: len(data) // 2]) if left[0] < 0 else write(handle, data)

    log = RunLog(tmp_path / "run.csv", 6)
    monkeypatch.setattr(os, "write", full)
    runner = Runner(driver("reach", steady(0.2)), t, Senses(None, t), t.clock, log)
    runner.aim(np.array([0.0, -0.5, 0.5]))
    with pytest.raises(OSError) as error:
        runner.run(0)
    assert error.value.errno == errno.ENOSPC and "run.csv" in str(error.value.filename)
    assert t.guard.stop is not None
    monkeypatch.undo()
    log.close()
    rows = read_run(tmp_path)
    assert len(rows["tick"]) == 40 and (np.diff(rows["tick"]) == 1).all()
    assert (tmp_path / "run.csv").read_bytes().endswith(b"\n")
    with pytest.raises(InputError, match="never overwritten"):
        RunLog(tmp_path / "run.csv", 6)


def test_a_hand_that_is_led_to_its_target_succeeds(tmp_path):
    """Lead the hand by its Jacobian: done as seen and in truth, at a pace of a sixtieth, every tick logged."""
    arm = jaco2()
    t = twin("reach", number=3)
    t.stage.task.simulator.capsules.radius.zero_()  # nothing in the way
    runner = None

    def towards(observation):
        q, way = observation[0, :6].numpy().astype(float), observation[0, 16:19].numpy().astype(float)
        step = 1e-5 * np.eye(6)
        jacobian = np.array([forward_kinematics(arm, q + d)[2][0] - forward_kinematics(arm, q - d)[2][0] for d in step])
        wanted = np.linalg.pinv(jacobian.T / 2e-5, rcond=0.05) @ (1.0 * way)
        return torch.tensor((wanted - observation[0, 6:12].numpy())[None] / 0.4, dtype=torch.float32)

    log = RunLog(tmp_path / "run.csv", 6)
    runner = Runner(driver("reach", towards), t, Senses(None, t), t.clock, log)
    runner.aim(t.told()[1]["target"])
    episode = runner.run(3)
    log.close()
    assert episode.success and episode.seen and episode.ended == "done", episode
    assert np.ptp(episode.periods) < 1e-6 and episode.missed == 0 and episode.seconds < 13.0
    rows = read_run(tmp_path)
    assert (np.diff(rows["tick"]) == 1).all() and rows["distance_m"][-1] < 0.06 < rows["distance_m"][0]
    assert rows["period"][:12].tolist() == [0, 1, 2, 3, 4, 5] * 2 and rows["step"][6] == 2
    told = summary([episode], {"task": "reach"})
    assert told["success"] == 1.0 and told["interval"] == list(wilson(1.0, 1)) and told["agreed"] == 1


def test_a_stop_of_the_service_ends_an_episode_and_is_told():
    """Limit torques to what standing takes: the episode ends by the stop's own words, without success."""
    t = twin("reach")
    t.guard.limits.torque[:] = 0.5
    runner = Runner(driver("reach", steady(1.0)), t, Senses(None, t), t.clock, None)
    runner.aim(np.array([0.0, -0.5, 0.5]))
    episode = runner.run(0)
    assert episode.ended.startswith("stop 1: torque of joint") and not episode.success and episode.seconds < 2.0


def test_a_dry_run_sends_nothing():
    """Withhold every answer for half a second: the arm has not been asked for anything, and the answers are known."""
    t, said = twin("powerline"), []
    link = Withheld(t, lambda state, speeds: said.append(speeds))
    runner = Runner(driver("powerline", steady(0.5)), link, Senses(TruthClouds(t), t), t.clock, None, seconds=0.5)
    runner.run(0)
    assert t.guard.accepted == 0 and t.state.q == pytest.approx(jaco2().home, abs=1e-3)
    # the ramp leads to half the speed limit in a policy step
    assert said[5] == pytest.approx(0.5 * jaco2().velocity_limit, rel=1e-5)


def test_missed_ticks_keep_the_policy_on_time():
    """Lose two ticks of three: policy steps still take a tenth of a second, and the ticks are counted."""
    t = twin("powerline")

    class Lossy:
        latest = property(lambda self: t.latest)
        send, stop, arm = t.send, t.stop, t.arm

        def next(self, after=None, timeout=3.0):
            for _ in range(3):
                state = t.next()
            return state

    runner = Runner(driver("powerline", steady(0.1)), Lossy(), Senses(TruthClouds(t), t), t.clock, None, seconds=2.0)
    episode = runner.run(0)
    assert episode.seconds == pytest.approx(2.0, abs=0.1) and episode.missed == 2 * len(episode.latencies)
    assert len(episode.ages) == 20
