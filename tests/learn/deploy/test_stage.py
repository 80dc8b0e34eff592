"""A twin that holds a task: its measures are the task's, scenes begin anew while stopped, and the truth is told."""

import json

import numpy as np
import pytest
import torch

pytest.importorskip("rsl_rl", reason="tasks need the extra train")

from bough.learn.deploy.plan import plan_of
from bough.learn.deploy.stage import Stage, make_world, scene_plan
from bough.learn.deploy.steering import Steering
from bough.learn.robot.backend import Staged
from bough.learn.robot.guard import PERIOD, Guard
from bough.learn.robot.limits import default_limits
from bough.learn.robot.wire import packed, unpacked
from bough.learn.tasks.reach_settings import ReachSettings
from bough.learn.tasks.settings import TaskSettings
from bough.sim.arms.arm import arm_capsules
from bough.sim.base.errors import InputError
from bough.sim.cameras.described import unpacked as scene_of
from bough.sim.cameras.world import Label


@pytest.mark.parametrize("name", ["powerline", "reach"])
def test_a_stage_counts_as_its_task_does(name):
    """Lead arm and task by the same speeds for two seconds: all measures of the task, to the bit."""
    plan = plan_of(name, TaskSettings() if name == "powerline" else ReachSettings(), "test")
    stage, task, steering = Stage(plan, 5, 2), make_world(plan, 5, 2), Steering(plan.arm, plan.pace)
    stage.read(0.0)
    generator, now = torch.Generator().manual_seed(2), 0.0
    for _ in range(20):
        action = torch.randn(1, 6, generator=generator)
        steering.act(action)
        for _ in range(plan.pace.control_periods):
            stage.send(steering.ask(stage.task.simulator.qd[0].numpy()))
            now += PERIOD
            stage.read(now)
        task.step(action)
    told = stage.truth()
    expected = {f"measure {key}": float(value[0]) for key, value in task.measured().items()}
    assert {key: float(told[key]) for key in expected} == pytest.approx(expected, abs=1e-6)
    assert float(told["seconds"]) == pytest.approx(2.0) and not told["over"]
    arm, q = int(told["arm"]), stage.task.simulator.q[0].numpy().astype(float)
    assert np.abs(q - plan.arm.home).max() > 0.1, "the arm has moved, and what is told of it with it"
    np.testing.assert_allclose(told["start"][:arm], arm_capsules(plan.arm, q)[0], atol=1e-5)
    if name == "reach":
        assert expected["measure distance"] > 0.05
    else:
        assert told["occlusion"] == pytest.approx(task.sensor.occlusion.numpy())


def test_nothing_counts_before_the_arm_is_asked_to_move():
    """Let a scene stand for a second: no policy step has been judged, and the arm is at home."""
    plan = plan_of("reach", ReachSettings(), "test")
    stage = Stage(plan, 0)
    for n in range(60):
        stage.send(np.zeros(6))
        sample = stage.read(n * PERIOD)
    told = stage.truth()
    assert float(told["seconds"]) == 0.0 and "measure success" not in told
    assert sample.q == pytest.approx(plan.arm.home, abs=0.01) and np.abs(sample.torque).max() < 0.5


def test_scenes_differ_come_again_and_are_told():
    """Begin scenes 0, 1 and 0 of reach: other targets and trees, then the same again; the truth survives its bytes."""
    plan = plan_of("reach", ReachSettings(), "test")
    stage = Stage(plan, 4)
    assert isinstance(stage, Staged)
    told = []
    for number in (0, 5, 0):
        stage.begin(number)
        told.append(unpacked(packed(stage.truth())))
    first, other, again = told
    assert np.linalg.norm(first["target"] - other["target"]) > 0.01 and int(other["number"]) == 5
    for key, value in first.items():
        np.testing.assert_array_equal(value, again[key], err_msg=key)
    wood = int(first["arm"])
    assert (first["radius"][wood:] > 0).sum() > 5 and first["force"].shape == (6, 3)
    with pytest.raises(ValueError, match="numbers of type"):
        unpacked(json.dumps({"x": ["|O", [1]]}).encode() + b"\n" + bytes(8))


def test_cameras_are_told_of_arm_branches_and_line():
    """Unpack a clearing scene as cameras get it: all three kinds, the line as long as the truth says."""
    stage = Stage(scene_plan("powerline", "robot serve"), 1)
    world = scene_of(stage.scene()).world
    assert {Label.ROBOT, Label.BRANCH, Label.LINE} <= set(world.label)
    k = int(np.flatnonzero(world.label == Label.LINE)[0])
    line = stage.truth()["line"]
    length = np.linalg.norm(world.solids.end[k] - world.solids.start[k])
    assert length == pytest.approx(float(np.linalg.norm(line[-1] - line[0])), abs=1e-5) and length > 0.5


def test_a_new_scene_takes_a_stop():
    """Ask the guard for a new scene: refused and counted while armed, accepted and counted while a stop holds."""
    limits = default_limits(plan_of("reach", ReachSettings(), "test").arm)
    guard = Guard(limits, lambda q: np.ones(len(q)), armed=True)
    assert guard.stage().reason == "not stopped" and guard.refused["not stopped"] == 1
    guard.halt(0.0, "a test")
    assert guard.stage().accepted and guard.accepted == 1 and guard.stop is not None


def test_scenes_that_are_none_are_refused(tmp_path):
    """Refuse a scene that is no task of an arm, an empty folder, and a task at another rate."""
    for scene in ("exposure", str(tmp_path / "nothing"), str(tmp_path)):
        with pytest.raises(InputError):
            scene_plan(scene, "robot serve")
    with pytest.raises(InputError, match="60 Hz"):
        plan_of("reach", ReachSettings(control_rate=120.0), "test")
