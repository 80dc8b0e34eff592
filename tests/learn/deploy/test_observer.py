"""What a policy sees on a robot is what it saw in training, and servos are asked for the same speeds."""

import numpy as np
import pytest
import torch

pytest.importorskip("rsl_rl", reason="tasks need the extra train")

from bough.learn.cameras.frames import Clouds
from bough.learn.deploy.observer import Observer
from bough.learn.deploy.plan import plan_of
from bough.learn.deploy.stage import make_world
from bough.learn.deploy.steering import Steering
from bough.learn.robot.client import state_of
from bough.learn.robot.log import Tick
from bough.learn.robot.wire import streamed
from bough.learn.tasks.reach_settings import ReachSettings
from bough.learn.tasks.settings import TaskSettings
from bough.learn.touch.record import carrying_torque


def state_on(task, arm):
    """Return what a client of the service is told of a task's only world, through its JSON."""
    import json

    sim = task.simulator
    q, qd, torque, at, turn = (
        x[0].numpy().astype(float) for x in (sim.q, sim.qd, sim.torque, sim.end_position, sim.end_rotation)
    )
    none = np.zeros(arm.num_dofs)
    tick = Tick(1, 0.0, 0.0, 0.0, q, qd, torque - carrying_torque(arm, q), none, none, at, turn, 0.0, "ready", 0, "",
                "", -1, 0, 0, "")  # fmt: skip
    return state_of(json.loads(streamed(tick)), 0.0)


def acted(task, steering, action):
    """Step a task by an action; return the speeds that its servos were asked for in every control period, and ours."""
    asked, ours = [], []
    step = task.simulator.step

    def spied(count):
        ours.append(steering.ask(task.simulator.qd[0].numpy()))
        asked.append(task.simulator.target[0].numpy().astype(float))
        step(count)

    task.simulator.step = spied
    steering.act(action)
    task.step(action)
    task.simulator.step = step
    return np.array(asked), np.array(ours)


def same(plan, task, look, steps=25):
    """Hold observation and speeds of a robot's loop to those of a task that random actions lead."""
    observer = Observer(plan, plan.arm, seed=getattr(getattr(task, "sensor", None), "_seed", 0))
    steering, rng = Steering(plan.arm, plan.pace), torch.Generator().manual_seed(1)
    action = torch.zeros(1, 6)
    for _ in range(steps):
        look(observer, task)
        seen = observer.observe(state_on(task, plan.arm))
        # float32 all the way; joint torques lose and regain the arm's weight, 10 N m, on the way
        torch.testing.assert_close(seen, task.get_observations()["policy"], rtol=2e-5, atol=1e-5)
        action = 0.8 * action + 0.5 * torch.randn(1, 6, generator=rng)
        asked, ours = acted(task, steering, action)
        assert asked == pytest.approx(ours, abs=1e-6) and asked.any()
    return observer


def test_a_clearing_policy_sees_on_a_robot_what_it_saw_in_training():
    """Give a robot the perfect clouds of a task's world: its 88 numbers and the speeds asked for."""
    plan = plan_of("powerline", TaskSettings(), "test")
    task = make_world(plan, 3, 0)

    def look(observer, task):
        points, _ = task.sensor.clouds()
        ends = [x[0].numpy().astype(float) for x in (task.simulator.line_start, task.simulator.line_end)]
        line = ends[0] + np.linspace(0, 1, 64)[:, None] * (ends[1] - ends[0])
        observer.look(Clouds(0.0, points[0, 2].T.numpy().copy(), line.astype(np.float32)))
        observer.pushed(task.simulator.arm_force[0].numpy(), 0.0)

    observer = same(plan, task, look)
    assert observer.observation.shape == (1, 88) and observer.seen("occlusion") > 0.0


@pytest.mark.parametrize("policy, control", [("pcap", "s3ec"), ("pcap", "plai"), ("ppo+", "nominal")])
def test_a_reaching_policy_sees_on_a_robot_what_it_saw_in_training(policy, control):
    """The same of reach, whose flag is set by the true forces' mean, and of all three laws of control."""
    plan = plan_of("reach", ReachSettings(policy=policy, control=control), "test")
    task = make_world(plan, 3, 4)

    def look(observer, task):
        observer.aim(task.places.target[0].numpy())
        observer.pushed(task.simulator.arm_force[0].numpy(), float(task.own("felt")[0]))

    same(plan, task, look, steps=40)
