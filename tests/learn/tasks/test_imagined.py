"""Worlds in which actions are tried: policy steps as the task's own, latency and all, and what they feel."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bough.learn.tasks.clearing import make_reach
from bough.learn.tasks.imagined import ImaginedWorlds
from bough.learn.tasks.reach_settings import ReachSettings
from bough.sim.scenes.reach_scene import ReachScene

WORLDS, COUNT = 10, 3
SLOW = ReachSettings(scene=ReachScene(order=2, attempts=32), action_delay=2)
LEAN = torch.tensor([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def task():
    """Worlds of a test set in which actions come up to two steps late; most arms lean on branches."""
    made = make_reach("reach", SLOW, num_envs=WORLDS, seed=5, test=True)
    for _ in range(7):
        made.step(LEAN.expand(WORLDS, 6))
    assert len(set(made.own("action_delay").tolist())) > 1
    return made


def test_policy_steps_are_the_task_s_own(task):
    """Try six random steps in one copy of each world, nothing in the others, then do them: the same bits."""
    drawn = 2.0 * torch.rand((6, WORLDS, 6), generator=torch.Generator().manual_seed(0)) - 1.0
    worlds = ImaginedWorlds(task, COUNT, 80.0)
    worlds.take()
    tried = torch.zeros(6, WORLDS, COUNT, 6)
    tried[:, :, 1] = drawn
    for actions in tried:
        worlds.step(actions.flatten(0, 1))
    for actions in drawn:
        task.step(actions)
    names = ("q", "qd", "torque", "target", "end_position", "arm_force")
    one, still = ({n: getattr(worlds.simulator, n).unflatten(0, (-1, COUNT))[:, k] for n in names} for k in (1, 0))
    for name in names:
        assert torch.equal(one[name], getattr(task.simulator, name)), name
    assert not torch.equal(still["q"], one["q"]) and float(one["arm_force"].abs().max()) > 1.0


def test_forces_are_those_of_the_control_periods(task):
    """Of one step: the mean of F and the share of periods above 5 N, from a task that does it period by period."""
    worlds = ImaginedWorlds(task, 1, 5.0)
    worlds.take()
    before = task.own("force_sum").clone()
    worlds.step(LEAN.expand(WORLDS, 6))
    task.step(LEAN.expand(WORLDS, 6))
    periods = task.pace.control_periods
    np.testing.assert_allclose(worlds.force, (task.own("force_sum") - before) / periods, atol=1e-3)
    assert float(worlds.force.max()) > 1.0
    last = task.simulator.arm_force.square().sum((1, 2)).sqrt()
    whole = (worlds.hard == 1.0) | (worlds.hard == 0.0)
    assert torch.equal(worlds.hard[whole] == 1.0, last[whole] > 5.0) and whole.sum() >= WORLDS // 2
    np.testing.assert_allclose(worlds.hard * periods, (worlds.hard * periods).round(), atol=1e-5)


def test_limit_of_the_share_is_given(task):
    """Every period is above -1 N, none above 1e9."""
    for limit, share in ((-1.0, 1.0), (1e9, 0.0)):
        worlds = ImaginedWorlds(task, 1, limit)
        worlds.take()
        worlds.step(torch.zeros(WORLDS, 6))
        np.testing.assert_allclose(worlds.hard, share, atol=1e-6)


def test_nothing_of_the_task_moves(task):
    """Try what one likes: the task's snapshot stays as it was, to the bit."""
    worlds, before = ImaginedWorlds(task, COUNT, 80.0), task.snapshot()
    worlds.take()
    for _ in range(3):
        worlds.step(torch.ones(WORLDS * COUNT, 6))
    after = task.snapshot()
    assert all(torch.equal(after[name], value) for name, value in before.items())
    assert replace(SLOW) == task.cfg
