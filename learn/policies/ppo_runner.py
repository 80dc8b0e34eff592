"""rsl-rl's PPO runner, for tasks that write their observations in place, and with numbers instead of a log."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import Any

import torch

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")  # rsl-rl imports GitPython, which fails where there is no git

from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel, RNNModel
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

from ..runs.processes import Processes
from ..tasks.ppo_settings import PPOSettings
from ..tasks.task import Task


@dataclass(frozen=True)
class Iteration:
    """What an iteration brought, over all processes.

    Attributes:
        number: Iterations done, this one included.
        steps: World-steps of this iteration.
        episodes: Episodes that ended in it.
        reward: Mean reward of a step.
        metrics: Means of a task's metrics over the episodes that ended; None if none did.
        losses: Mean losses by name.
        learning_rate: Adam's step.
        action_std: Mean standard deviation of the actions.
        collect_seconds: Time in the task and for actions [s].
        learn_seconds: Time of the update [s].
    """

    number: int
    steps: int
    episodes: int
    reward: float
    metrics: dict[str, float | None]
    losses: dict[str, float]
    learning_rate: float
    action_std: float
    collect_seconds: float
    learn_seconds: float


class Tally:
    """Stands where the runner has its logger: sums on the device, one look at them an iteration.

    Args:
        after: Called at the end of every iteration.
        processes: Those of the run.
    """

    writer = None  # the runner then writes nothing of its own

    def __init__(self, after: Callable[[Iteration], None], processes: Processes) -> None:
        self.after, self.processes = after, processes
        self._names: tuple[str, ...] = ()
        self._sums: torch.Tensor | None = None
        self._steps = 0

    def init_logging_writer(self) -> None:
        """Do nothing: there is no writer."""

    def process_env_step(
        self, rewards: torch.Tensor, dones: torch.Tensor, extras: dict[str, Any], _intrinsic: torch.Tensor | None = None
    ) -> None:
        """Add a step's rewards, and the metrics of the worlds that are done."""
        done, log = dones > 0, extras["log"]
        self._names = tuple(log)
        parts = [rewards, done, *(torch.where(done, log[name], 0.0) for name in log)]
        sums = torch.stack([part.double().sum() for part in parts])
        self._sums = sums if self._sums is None else self._sums + sums
        self._steps += len(rewards)

    def log(
        self, *, it: int, collect_time: float, learn_time: float, loss_dict: dict[str, float], learning_rate: float,
        action_std: torch.Tensor, **_unused: object,
    ) -> None:  # fmt: skip
        """Report the iteration and begin the next."""
        assert self._sums is not None
        reward, episodes, *sums = self.processes.sum(self._sums.clone()).tolist()
        steps = self._steps * self.processes.count
        metrics = {n: s / episodes if episodes else None for n, s in zip(self._names, sums, strict=True)}
        self._sums, self._steps = None, 0
        std = float(action_std.detach().mean())
        self.after(Iteration(it + 1, steps, int(episodes), reward / steps, metrics, loss_dict, learning_rate, std,
                             collect_time, learn_time))  # fmt: skip


class InPlacePPO(PPO):
    """PPO for tasks whose next observation overwrites the last: rsl-rl keeps a reference until the step is over."""

    def act(self, obs: TensorDict) -> torch.Tensor:
        """Sample actions from observations that are copied into the rollout first."""
        kept = self.storage.observations[self.storage.step]
        kept.copy_(obs)
        actions: torch.Tensor = super().act(kept)
        return actions

    def numbers(self) -> dict[str, float]:
        """Return what an iteration tells beside losses, by name: nothing."""
        return {}


class Runner(OnPolicyRunner):
    """rsl-rl's runner without its log, on any device, that goes on where another has stopped.

    Args:
        task: Task to learn.
        settings: Numbers of PPO.
        processes: Those of the run, connected.
        after: Called at the end of every iteration.
        algorithm: What its configuration says beside the settings; `InPlacePPO` if it names no other.
    """

    alg: InPlacePPO

    def __init__(
        self, task: Task, settings: PPOSettings, processes: Processes, after: Callable[[Iteration], None],
        algorithm: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        self.processes = processes
        config = settings.runner_config()
        config["algorithm"] |= {"class_name": InPlacePPO, **(algorithm or {})}
        with redirect_stdout(io.StringIO()):  # it prints its networks
            super().__init__(task, config, None, str(task.device))
        self.logger = Tally(after, processes)

    def run(self, iterations: int) -> None:
        """Go through some iterations."""
        with redirect_stdout(io.StringIO()):
            self.learn(iterations)

    def state(self) -> dict[str, Any]:
        """Return networks, normalisers and optimiser with its learning rate."""
        found: dict[str, Any] = self.alg.save()
        return found

    def go_on_from(self, state: dict[str, Any], done: int) -> None:
        """Take over a state that was reached after some iterations."""
        self.alg.load(state, None, True)
        self.current_learning_iteration = done

    def memory(self) -> dict[str, torch.Tensor]:
        """Return copies of what recurrent networks hold of every world, by network; nothing of others."""
        held = {"actor": self.alg.actor.get_hidden_state(), "critic": self.alg.critic.get_hidden_state()}
        return {name: state.clone() for name, state in held.items() if state is not None}

    def remember(self, memory: Mapping[str, torch.Tensor]) -> None:
        """Take over what `memory` returned."""
        for name, state in memory.items():
            getattr(self.alg, name).reset(hidden_state=state.to(self.device))

    def _configure_multi_gpu(self) -> None:
        """As rsl-rl does, but with the processes connected already, so that CPU processes are possible too."""
        p = self.processes
        self.gpu_world_size, self.gpu_global_rank, self.gpu_local_rank = p.count, p.rank, p.local_rank
        self.is_distributed = p.count > 1
        config = {"global_rank": p.rank, "local_rank": p.local_rank, "world_size": p.count}
        self.cfg["multi_gpu"] = config if self.is_distributed else None


def policy_of(state: dict[str, Any], settings: PPOSettings, task: Task) -> MLPModel:
    """Return the deterministic policy of a saved state, for a task with the same observations and actions."""
    return network_of(state, settings, task.get_observations(), task.num_actions).to(task.device)


def network_of(state: dict[str, Any], settings: PPOSettings, observations: TensorDict, num_actions: int) -> MLPModel:
    """Return the policy's network of a saved state, for observations of these sizes, on the CPU."""
    config = settings.actor_config()
    kind = {"MLPModel": MLPModel, "RNNModel": RNNModel}[config.pop("class_name")]
    policy = kind(observations, {"actor": ["policy"]}, "actor", num_actions, **config)
    policy.load_state_dict(state["actor_state_dict"])
    policy.eval()
    return policy
