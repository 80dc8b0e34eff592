"""Policies with a memory: a task that cannot be done without, exact resume, what they are asked for."""

from dataclasses import replace

import pytest
import torch
from bough.learn.policies.evaluate import evaluate, first_episodes, read_policy
from bough.learn.policies.export import export_policy
from bough.learn.policies.train import Plan, train
from bough.learn.runs.folder import MODEL, RunFolder
from bough.learn.tasks.measures import CLEARING_COLUMNS
from bough.learn.tasks.ppo_settings import PPOSettings
from bough.learn.tasks.registry import TaskKind, TaskRegistry, known_tasks
from bough.sim.base.errors import InputError
from oracles.reach.task import Reach, ReachSettings

PPO = PPOSettings(num_envs=64, iterations=40, horizon=8, hidden=(16,), epochs=4, mini_batches=2, init_std=0.5,
                  entropy=0.0, checkpoint_every=20, memory=(16,))  # fmt: skip
LENGTH = 4


class Recall(Reach):
    """A sign is shown in the first of four steps alone; in each a clipped action brings itself times the sign.

    Without a memory the sign can be used in the first step alone: a return of 1 in the mean at most. With it the best
    is 4.
    """

    def __init__(self, settings, **how):
        super().__init__(replace(settings, groups=("time", "place")), **how)
        self.max_episode_length = LENGTH

    @property
    def sign(self):
        return torch.where(self.x[:, 0] > 0.0, 1.0, -1.0)

    def _observe(self):
        first = self.episode_length_buf == 0
        self.observation.copy_(torch.stack([self.sign * first, torch.ones(self.num_envs), first.float()], 1))

    def step(self, actions):
        reward = self.sign * actions[:, 0].clamp(-1.0, 1.0)
        self.sum += reward
        self.episode_length_buf += 1
        done = self.episode_length_buf >= LENGTH
        log = {name: torch.zeros(self.num_envs) for name in self.metrics} | {"return": self.sum.clone()}
        self._restart(done)
        self._observe()
        return self.get_observations(), reward, done, {"time_outs": torch.zeros(self.num_envs), "log": log}


def registry():
    """Return a registry with this task alone."""

    def make(name, settings, **arguments):
        return Recall(settings, **arguments)

    return TaskRegistry((TaskKind(("reach",), ("place", "time"), {"cpu": ReachSettings()}, make, CLEARING_COLUMNS),))


def trained(out, **ppo):
    plan = Plan("reach", ReachSettings(), replace(PPO, **ppo), 0, "cpu")
    return train(plan, out, registry(), resume=out.exists())


def test_what_was_seen_once_is_remembered(tmp_path):
    """Reach a mean return above 3 of 4 with a memory, and none above 1.3 without (0.3: five standard errors, 64)."""
    with_memory, without = tmp_path / "with", tmp_path / "without"
    trained(with_memory)
    trained(without, memory=())
    best = [evaluate(p, registry(), sets=1, worlds=256)[0].mean("Test Rew") for p in (with_memory, without)]
    assert best[0] > 3.0 and best[1] < 1.3, best
    policy = read_policy(RunFolder(with_memory), registry())
    tests = [registry().make("reach", ReachSettings(), num_envs=9, seed=3, device="cpu", test=True) for _ in range(2)]
    found = [first_episodes(t, policy.on(t))["return"] for t in tests]
    assert torch.equal(*found)  # a policy begins with nothing in mind
    with pytest.raises(InputError, match="memory: found a recurrent policy"):
        export_policy(tmp_path, policy, registry())


def test_a_run_that_goes_on_has_the_same_bits(tmp_path):
    """Six iterations are the same as three and three, inside of episodes: what networks hold of every world is kept."""
    trained(tmp_path / "whole", iterations=6, horizon=3, checkpoint_every=3)
    trained(tmp_path / "parts", iterations=3, horizon=3)
    trained(tmp_path / "parts", iterations=6, horizon=3)
    whole, parts = (RunFolder(tmp_path / name).newest() for name in ("whole", "parts"))
    one, other = (f.load(MODEL)["actor_state_dict"] for f in (whole, parts))
    assert all(torch.equal(one[k], other[k]) for k in one)
    held = [f.load("rank-0")["memory"] for f in (whole, parts)]
    assert set(held[0]) == {"actor", "critic"} and held[0]["actor"].abs().sum() > 0.0
    assert all(torch.equal(held[0][k], held[1][k]) for k in held[0])


def test_reach_has_a_recurrent_pcap():
    """Give ``pcap-rnn`` a memory and no other policy; refuse one of two numbers, and fewer worlds than mini-batches."""
    kind = known_tasks().of("reach")
    memory = {p: kind.ppo_for(kind.of_policy(kind.presets["cpu"], p), "cpu").memory for p in kind.policies}
    assert {p for p, units in memory.items() if units} == {"pcap-rnn"} and memory["pcap-rnn"] == (128,)
    for change, words in (({"memory": (3, 3)}, "memory: found 3, 3"), ({"num_envs": 1}, "--num-envs: found 1")):
        with pytest.raises(InputError, match=words):
            replace(PPO, **change).check()
