"""MPC that knows the tree: what its plans cost, what the knowledge is worth, and how it is asked for."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from bough.cli.main import main
from bough.learn.policies.evaluate import evaluate, first_episodes, untrained
from bough.learn.policies.mpc_tree import FORCE, LOST, RUPTURE, KnownTree
from bough.learn.policies.train import Plan, train
from bough.learn.runs.threads import one_thread
from bough.learn.tasks.clearing import make_reach
from bough.learn.tasks.ppo_settings import PPOSettings
from bough.learn.tasks.reach_settings import ReachSettings
from bough.learn.tasks.registry import known_tasks
from bough.sim.base.errors import InputError
from bough.sim.scenes.reach_scene import ReachScene
from oracles.reach.task import ReachSettings as PointSettings
from oracles.reach.task import registry

pytest.importorskip("pytorch_mppi")
SMALL = ReachSettings(policy="ppo", scene=ReachScene(order=2, attempts=32), episode_seconds=3.0)


@pytest.mark.parametrize("rate", [10.0, 30.0])
def test_a_step_of_a_plan_costs_what_it_comes_to(rate):
    """Plan a step of 0.1 s in two copies, then do it: distance, speeds and forces as the task finds them.

    At 30 Hz a step of the plan is three of the policy, the force is their mean. Joints are within their limits, and no
    world is lost; one that is, by a state that is no number, costs `LOST`.
    """
    settings = replace(SMALL, policy_rate=rate, control_rate=60.0)
    task = make_reach("reach", settings, num_envs=10, seed=5, test=True)
    held = round(rate / 10.0)
    action = torch.tensor([0.0, 10.0 / rate, 0.0, 0.0, 0.0, 0.0]).expand(10, 6)  # on into the branches
    for _ in range(6 * held):
        task.step(action)
    model = KnownTree(task, 2)
    before = task.own("force_sum").clone(), task.own("broken").clone()
    rows = model.begin(task.get_observations()).repeat_interleave(2, 0)
    twice = action.repeat_interleave(2, 0)
    cost = model.cost(model.step(rows, twice), twice)
    for _ in range(held):
        task.step(action)
    sim, periods = task.simulator, held * task.pace.control_periods
    away = (sim.end_position - task.places.target).norm(dim=1) + 0.002 * sim.qd.square().sum(1)
    force, broken = ((task.own(n) - b) / periods for n, b in zip(("force_sum", "broken"), before, strict=True))
    expected = away + FORCE * force + RUPTURE * broken
    np.testing.assert_allclose(cost, expected.repeat_interleave(2), atol=1e-5)
    assert float(force.max()) > 1.0
    assert float(model.cost(torch.full((2, 1), torch.nan), twice).max()) == LOST


def test_knowing_the_tree_is_worth_something():
    """In the same ten worlds it presses at most half as hard as without, succeeds as often, and repeats itself."""
    task = make_reach("reach", SMALL, num_envs=10, seed=2, test=True)
    start, found = task.snapshot(), {}
    for name in ("mpc", "mpc-tree"):
        task.restore(start)
        with one_thread():
            found[name] = first_episodes(task, untrained(name, task, 0))
    blind, knowing = found["mpc"], found["mpc-tree"]
    assert float(knowing["success"].mean()) >= max(0.9, float(blind["success"].mean()))
    assert float(knowing["force"].mean()) < 0.5 * float(blind["force"].mean())
    task.restore(start)
    policy = untrained("mpc-tree", task, 0)
    again = [policy(task.get_observations()).clone() for _ in range(2)]
    task.restore(start)
    assert torch.equal(untrained("mpc-tree", task, 0)(task.get_observations()), again[0])
    assert not torch.equal(again[0], again[1])  # a plan goes on where it was left


def test_a_plan_begins_anew_with_an_episode():
    """A world that has just restarted acts as one that has never acted; others go on with their plans."""
    task = make_reach("reach", SMALL, num_envs=2, seed=2, test=True)
    policies = [untrained("mpc", task, 0) for _ in range(2)]
    seen = task.get_observations()
    policies[0].planner.U.fill_(0.5)
    policies[1].planner.U[1].fill_(0.5)
    task.episode_length_buf = torch.tensor([0, 3])
    one, other = (policy(seen) for policy in policies)
    assert torch.equal(one, other)
    assert not torch.equal(one, untrained("mpc", task, 0)(seen))


def test_it_stands_beside_a_run_and_counts_to_the_oracle(tmp_path):
    """Ask for it as a user does: a row of the table, and one of those that say which worlds are possible."""
    small = replace(SMALL, episode_seconds=0.5)
    ppo = PPOSettings(num_envs=4, iterations=1, horizon=8, hidden=(8,))
    for name in ("one", "two"):
        train(Plan("reach", small, ppo, 0, "cpu"), tmp_path / name, known_tasks())
    asked = ["evaluate", str(tmp_path / "one"), "--sets", "1", "--worlds", "5", "--device", "cpu",
             "--baselines", "mpc-tree", "--oracle", str(tmp_path / "two")]  # fmt: skip
    assert main(asked) == 0
    found = json.loads((tmp_path / "one" / "evaluation.json").read_text())
    assert [row["policy"] for row in found["rows"]] == ["trained", "mpc-tree", "two"]
    assert found["oracle"]["ensemble"] == ["trained", "two", "mpc-tree"]
    assert evaluate(tmp_path / "one", known_tasks(), sets=1, worlds=5)[0].policy == "trained"


def test_it_is_filmed_by_its_name(tmp_path, capsys):
    """Play it; a task without arm and tree is refused in one line."""
    film = ["--seconds", "0.2", "--fps", "10", "--film", "png", "--device", "cpu"]
    assert main(["play", "mpc-tree", "--task", "reach", "--out", str(tmp_path / "film"), *film]) == 0
    assert "reach, mpc-tree: 0.2 s" in capsys.readouterr().out
    point = registry().make("reach", PointSettings(), num_envs=2, seed=0, device="cpu", test=True)
    with pytest.raises(InputError, match="mpc-tree: found reach; allowed: reach"):
        untrained("mpc-tree", point, 0)
