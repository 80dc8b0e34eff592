"""Sampling MPC without the tree: its kinematics, what it reaches, what it knows, and how it is asked for."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from bough.cli.main import main
from bough.learn.policies.evaluate import evaluate, first_episodes, untrained
from bough.learn.policies.mpc_kinematics import HandKinematics
from bough.learn.policies.train import Plan, train
from bough.learn.runs.threads import one_thread
from bough.learn.tasks.clearing import make_reach
from bough.learn.tasks.ppo_settings import PPOSettings
from bough.learn.tasks.reach_settings import ReachSettings
from bough.learn.tasks.registry import known_tasks
from bough.sim.arms.arm import forward_kinematics
from bough.sim.arms.jaco2 import jaco2
from bough.sim.base.errors import InputError
from bough.sim.scenes.reach_scene import ReachScene
from oracles.reach.task import ReachSettings as PointSettings
from oracles.reach.task import registry

pytest.importorskip("pytorch_mppi")
SCENE = ReachScene(order=2, attempts=32)
FREE = ReachSettings(policy="ppo", scene=replace(SCENE, away=10.0), episode_seconds=6.0)


def test_hand_is_where_the_arm_s_kinematics_say():
    """Agree to 2e-6 m (float32, six turns) at random joint positions, all of them continuous."""
    q = np.random.default_rng(0).uniform(-6.0, 6.0, (200, 6))
    _, _, (expected, _) = forward_kinematics(jaco2(), q)
    found = HandKinematics(jaco2(), "cpu")(torch.as_tensor(q, dtype=torch.float32))
    np.testing.assert_allclose(found, expected, atol=2e-6)


def test_free_targets_are_reached_and_the_same_seed_does_the_same():
    """Nearly all of 20 free targets in 6 s; torch's own random numbers are left alone."""
    task = make_reach("reach", FREE, num_envs=20, seed=1, test=True)
    start = task.snapshot()
    before, found = torch.get_rng_state(), []
    for seed in (0, 0, 1):
        task.restore(start)
        with one_thread():
            found.append(first_episodes(task, untrained("mpc", task, seed)))
    assert torch.equal(before, torch.get_rng_state())
    assert float(found[0]["success"].mean()) >= 0.9 and float(found[0]["force"].max()) == 0.0
    assert torch.equal(found[0]["distance"], found[1]["distance"])
    assert not torch.equal(found[0]["distance"], found[2]["distance"])


def test_it_knows_no_tree_and_feels_nothing():
    """Act alike where trees stand in the way and where they are 10 m off, while joints and targets are the same."""
    near, far = (make_reach("reach", replace(FREE, policy="pcap", scene=s), num_envs=5, seed=1, test=True)
                 for s in (SCENE, FREE.scene))  # fmt: skip
    actions = [untrained("mpc", task, 3)(task.get_observations()) for task in (near, far)]
    assert torch.equal(near.places.target, far.places.target) and torch.equal(*actions)
    assert actions[0].abs().max() <= 1.0
    flagged = near.get_observations().clone()
    flagged["policy"][:, near.columns["touch"]] = 1.0
    assert torch.equal(untrained("mpc", near, 3)(flagged), actions[0])


def test_it_stands_beside_a_run(tmp_path):
    """Test it in the worlds of a run, with patterns, and count it to the oracle."""
    small = replace(FREE, scene=SCENE, episode_seconds=1.0)
    ppo = PPOSettings(num_envs=4, iterations=1, horizon=8, hidden=(8,))
    for name in ("one", "two"):
        train(Plan("reach", small, ppo, 0, "cpu"), tmp_path / name, known_tasks())
    evaluate(tmp_path / "one", known_tasks(), sets=1, worlds=10, baselines=("mpc",), oracle=(tmp_path / "two",))
    found = json.loads((tmp_path / "one" / "evaluation.json").read_text())
    rows = {row["policy"]: row for row in found["rows"]}
    assert list(rows) == ["trained", "mpc", "two"] and len(rows["mpc"]["strata"]) == 5
    assert rows["mpc"]["Off cm"]["mean"] < rows["trained"]["Off cm"]["mean"]
    assert found["oracle"]["ensemble"] == ["trained", "two", "mpc"]


def test_it_is_filmed_by_its_name(tmp_path, capsys):
    """Play it as a user would type it; the clearing tasks, whose actions are speeds, are refused in one line."""
    film = ["--seconds", "0.3", "--fps", "10", "--film", "png", "--device", "cpu"]
    assert main(["play", "mpc", "--task", "reach", "--out", str(tmp_path / "film"), *film]) == 0
    assert "reach, mpc: 0.3 s" in capsys.readouterr().out and len(list((tmp_path / "film" / "frames").iterdir())) == 4
    assert main(["play", "mpc", "--task", "powerline", "--out", str(tmp_path / "no"), *film]) == 2
    assert "mpc: found powerline; allowed: reach" in capsys.readouterr().err and not (tmp_path / "no").exists()


def test_tasks_without_an_arm_are_refused():
    """Say in one line what it needs."""
    task = registry().make("reach", PointSettings(), num_envs=2, seed=0, device="cpu", test=True)
    with pytest.raises(InputError, match="mpc: found reach; allowed: reach, with its groups"):
        untrained("mpc", task, 0)
