"""A point mass that is to reach a point: a task whose best policy is known in closed form.

x' = x + a / 5 in the plane, |a_i| <= 1, reward -|x'|^2, episodes of 20 steps, start even in [-1, 1]^2. The best action
is a = clip(-5 x, -1, 1): both coordinates go to zero as fast as they can and stay there. Buffers are written in place,
as a simulator's are; random numbers come from a generator of the task's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import torch
from bough.learn.tasks.measures import CLEARING_COLUMNS
from bough.learn.tasks.registry import TaskKind, TaskRegistry
from rsl_rl.env import VecEnv
from tensordict import TensorDict

LENGTH = 20
STEP = 0.2


@dataclass(frozen=True)
class Start:
    """Where points start: even in a square of this half width [m]."""

    width: float = 1.0


@dataclass(frozen=True)
class ReachSettings:
    """Observation groups left in, and how the points start."""

    groups: tuple[str, ...] = ("place", "time")
    start: Start = Start()


class Reach(VecEnv):
    """The task; all worlds' points in one tensor."""

    name = "reach"
    step_seconds = 0.05
    metrics = ("return", "success", "occlusion_drop", "breach", "steps_clear")

    def __init__(self, settings: ReachSettings, *, num_envs: int, seed: int, device: str, test: bool, version: int = 1):
        self.cfg, self.num_envs, self.num_actions, self.device = settings, num_envs, 2, device
        self.version, self.test = version, test
        self.max_episode_length = LENGTH
        self.episode_length_buf = torch.zeros(num_envs, dtype=torch.int32)
        self.generator = torch.Generator().manual_seed(seed)
        self.x = torch.zeros(num_envs, 2)
        self.sum = torch.zeros(num_envs)
        self.first = torch.zeros(num_envs)
        self.clear = torch.zeros(num_envs)
        width = 2 * ("place" in settings.groups) + ("time" in settings.groups)
        self.observation = torch.zeros(num_envs, width)
        self._restart(torch.ones(num_envs, dtype=torch.bool))
        self._observe()

    def _restart(self, mask):
        """Start episodes anew; a number is drawn for every world so that the stream does not depend on the mask."""
        drawn = self.cfg.start.width * (2 * torch.rand(self.num_envs, 2, generator=self.generator) - 1)
        self.x.copy_(torch.where(mask[:, None], drawn, self.x))
        for array in (self.sum, self.clear, self.episode_length_buf):
            array.masked_fill_(mask, 0)
        self.first.copy_(torch.where(mask, self.x.norm(dim=1), self.first))

    def _observe(self):
        parts = [self.x] if "place" in self.cfg.groups else []
        if "time" in self.cfg.groups:
            parts.append(self.episode_length_buf[:, None] / LENGTH)
        self.observation.copy_(torch.cat(parts, 1))

    def get_observations(self):
        return TensorDict({"policy": self.observation}, batch_size=[self.num_envs])

    def step(self, actions):
        self.x += STEP * actions.clamp(-1, 1)
        distance = self.x.norm(dim=1)
        reward = -distance.square()
        self.sum += reward
        self.clear += distance < 0.1
        self.episode_length_buf += 1
        dones = self.episode_length_buf >= LENGTH
        log = {
            "return": self.sum.clone(),
            "success": (self.clear >= 10).float(),
            "occlusion_drop": 1 - distance / self.first,
            "breach": (distance > 1).float(),
            "steps_clear": self.clear.clone(),
        }
        self._restart(dones)
        self._observe()
        return self.get_observations(), reward, dones, {"time_outs": dones.float(), "log": log}

    def snapshot(self):
        kept = ("x", "sum", "first", "clear", "episode_length_buf", "observation")
        return {n: getattr(self, n).clone() for n in kept} | {"generator": self.generator.get_state()}

    def restore(self, snapshot):
        for name, value in snapshot.items():
            if name == "generator":
                self.generator.set_state(value)
            else:
                getattr(self, name).copy_(value)

    def render(self, world):
        picture = np.zeros((24, 32, 3), np.uint8)
        i, j = (np.clip(self.x[world].numpy(), -1, 1) * 11 + 12).astype(int)
        picture[i, j] = 255
        return picture


class Crowded(Reach):
    """The task with a simulator's counter beside it: every step seven more contacts find no room, after 100 before."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.without_room = torch.tensor(100)
        self.simulator = SimpleNamespace(without_room=self.without_room)

    def step(self, actions):
        self.without_room += 7
        return super().step(actions)

    def snapshot(self):
        return super().snapshot() | {"without_room": self.without_room.clone()}


def registry(version: int = 1, kind: type[Reach] = Reach) -> TaskRegistry:
    """Return a registry with this task alone; ``version`` is the version it says it has."""

    def make(name, settings, **arguments):
        assert name == "reach"
        return kind(settings, **arguments, version=version)

    presets = {"cpu": ReachSettings(), "gpu": ReachSettings()}
    return TaskRegistry((TaskKind(("reach",), ("place", "time"), presets, make, CLEARING_COLUMNS),))


def best_return(start: np.ndarray) -> np.ndarray:
    """Return the largest return from starts [W, 2] in float64: a coordinate's k-th distance is max(|x| - k STEP, 0)."""
    k = np.arange(1, LENGTH + 1)[:, None, None]
    return -(np.maximum(np.abs(start) - k * STEP, 0.0) ** 2).sum((0, 2))
