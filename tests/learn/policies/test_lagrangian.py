"""PPO under a constraint: a problem with a known optimum and multiplier, sums by hand, exact resume, reach's budget."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from bough.learn.policies.lagrangian import LagrangianPPO, gae
from bough.learn.policies.train import Plan, train
from bough.learn.runs.folder import MODEL, RunFolder
from bough.learn.tasks.clearing import make_reach
from bough.learn.tasks.measures import CLEARING_COLUMNS
from bough.learn.tasks.ppo_settings import PPOSettings
from bough.learn.tasks.reach_settings import ReachSettings
from bough.learn.tasks.registry import TaskKind, TaskRegistry
from bough.sim.base.errors import InputError
from bough.sim.scenes.reach_scene import ReachScene
from oracles.reach.task import Reach
from oracles.reach.task import ReachSettings as PointSettings

PPO = PPOSettings(num_envs=128, iterations=150, horizon=4, hidden=(8,), epochs=4, mini_batches=2, init_std=0.3,
                  entropy=0.0, checkpoint_every=75)  # fmt: skip


@dataclass(frozen=True)
class Settings(PointSettings):
    """What the mean cost may be."""

    limit: float = 0.5


class Bandit(Reach):
    """Episodes of one step: the first action a brings - (a - 1)^2 and costs a, whatever is seen.

    E[r] = - (m - 1)^2 - s^2 for a normal action of mean m. With E[a] <= d < 1 the best mean is d, and the multiplier
    2 (1 - d); with d > 1 the best is 1, and the multiplier 0.
    """

    def step(self, actions):
        observation, _, _, extras = super().step(torch.zeros_like(actions))
        done = torch.ones(self.num_envs, dtype=torch.bool)
        first = actions[:, 0]
        extras |= {"cost": first, "time_outs": torch.zeros(self.num_envs)}
        return observation, -(first - 1.0).square() - actions[:, 1].square(), done, extras

    @property
    def cost_limit(self):
        return self.cfg.limit


def registry():
    """Return a registry with this task alone."""

    def make(name, settings, **arguments):
        return Bandit(settings, **arguments)

    return TaskRegistry((TaskKind(("reach",), ("place", "time"), {"cpu": Settings()}, make, CLEARING_COLUMNS),))


def trained(out, limit, **ppo):
    settings = Settings(groups=("time",), limit=limit)
    return train(Plan("reach", settings, replace(PPO, **ppo), 0, "cpu"), out, registry(), resume=out.exists())


@pytest.mark.parametrize(("limit", "best", "price"), [(0.5, 0.5, 1.0), (0.8, 0.8, 0.4), (2.0, 1.0, 0.0)])
def test_optimum_and_multiplier_are_the_known_ones(limit, best, price, tmp_path):
    """Mean action to 0.05 and multiplier to 0.15: means over 50 iterations of 512 actions that spread by 0.3.

    The multiplier goes up by 0.05 x 0.05 / d an iteration where the action is 0.05 off, so that it settles in fifty.
    """
    trainer = trained(tmp_path / "run", limit)
    assert isinstance(trainer.runner.alg, LagrangianPPO)
    rows = RunFolder(tmp_path / "run").metrics()[-50:]
    cost, multiplier = (np.mean([row[name] for row in rows]) for name in ("cost", "multiplier"))
    assert cost == pytest.approx(best, abs=0.05) and multiplier == pytest.approx(price, abs=0.15)


def test_a_run_that_goes_on_has_the_same_bits(tmp_path):
    """Twenty iterations are the same as ten and ten: networks, both optimisers, the multiplier, what is logged."""
    whole = trained(tmp_path / "whole", 0.02, iterations=20, checkpoint_every=10)
    trained(tmp_path / "parts", 0.02, iterations=10)
    trained(tmp_path / "parts", 0.02, iterations=20)
    one, other = (RunFolder(tmp_path / n).newest().load(MODEL) for n in ("whole", "parts"))
    assert whole.runner.alg.multiplier > 0.0 and one["multiplier"] == other["multiplier"]
    for name in ("actor_state_dict", "cost_critic"):
        assert all(torch.equal(one[name][k], other[name][k]) for k in one[name])
    moments = [[s["exp_avg"] for s in m["cost_optimizer"]["state"].values()] for m in (one, other)]
    assert all(torch.equal(a, b) for a, b in zip(*moments, strict=True))
    rows = [RunFolder(tmp_path / n).metrics() for n in ("whole", "parts")]
    told = [[(r["cost"], r["multiplier"], r["cost_value_loss"]) for r in found] for found in rows]
    assert told[0] == told[1] and len(told[0]) == 20


def test_advantages_by_hand():
    """Three steps of one world, an end after the second; gamma 0.5, lambda 0.5, guesses 1, 2, 3 and last 4.

    Backwards: 30 + 0.5 x 4 - 3 = 29; 20 - 2 = 18 (the episode ends); 10 + 0.5 x 2 - 1 + 0.25 x 18 = 14.5.
    """
    gains, values = (torch.tensor(x).view(3, 1, 1) for x in ([10.0, 20.0, 30.0], [1.0, 2.0, 3.0]))
    dones = torch.tensor([0, 1, 0]).view(3, 1, 1)
    found = gae(gains, values, torch.tensor([[4.0]]), dones, 0.5, 0.5)
    assert found.flatten().tolist() == [14.5, 18.0, 29.0]


def test_reach_costs_the_mean_force_over_its_budget():
    """The cost of a step is the mean of F over its control periods over the budget, times the rewards' scale.

    Measured apart: F of every control period, as the simulator has it; the reward is PPO's, and no contact is in it.
    """
    small = ReachSettings(scene=ReachScene(order=2, attempts=32), episode_seconds=2.0, force_budget=4.0)
    both = [make_reach("reach", replace(small, policy=p), num_envs=8, seed=0) for p in ("ppo-lagrangian", "ppo")]
    task, plain = both
    assert task.cost_limit == 0.01 and plain.cost_limit is None and task.columns["touch"] == 19
    forces = []
    take = task._take
    task._take = lambda k: (take(k), forces.append(task.simulator.arm_force.norm(dim=(1, 2)).clone()))
    touched = 0.0
    for _ in range(12):
        forces.clear()
        _, reward, _, extras = task.step(torch.ones(8, 6))
        _, same, _, nothing = plain.step(torch.ones(8, 6))
        mean = torch.stack(forces).mean(0)
        torch.testing.assert_close(extras["cost"], 0.01 * mean / 4.0, rtol=1e-4, atol=1e-6)
        assert torch.equal(reward, same) and "cost" not in nothing
        touched += float(mean.sum())
    assert len(forces) == 6 and touched > 0.0
    with pytest.raises(InputError, match="force_budget: found 0"):
        replace(small, force_budget=0.0).check()
