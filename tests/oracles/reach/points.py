"""The point mass as chapter 4 sees a task: its registry, for the command's test.

It lies here and not beside the test: work in a process of its own is found by the name of its module, and only this
folder is on the path there.
"""

from dataclasses import dataclass, field, replace

import torch
from bough.learn.tasks.measures import REACH_COLUMNS
from bough.learn.tasks.names import REACHING
from bough.learn.tasks.ppo_settings import PRESETS as PPO
from bough.learn.tasks.reach_settings import POLICIES, RECURRENT
from bough.learn.tasks.registry import TaskKind, TaskRegistry
from bough.learn.thesis.chapter4.runs import PATTERNS

from .task import LENGTH, Reach, Start

TINY = replace(PPO["cpu"], num_envs=4, horizon=8, hidden=(8,), checkpoint_every=1)
WIDTH = {"Ta": 1.0, "Tb": 0.5, "Tc": 1.5, "Td": 1.2, "fractal": 0.8}
MEASURES = {column.measure for column in REACH_COLUMNS} - {"broken"}


@dataclass(frozen=True)
class Trees:
    """What chapter 4 sets of the trees."""

    forest: str = "Ta"
    springs: str = "rudimentary"


@dataclass(frozen=True)
class PointSettings:
    """What chapter 4 sets of a task; points start further off in some forests, and feel nothing."""

    policy: str = "pcap"
    touch_force: float = 40.0
    groups: tuple[str, ...] = ("place", "time")
    scene: Trees = field(default_factory=Trees)

    @property
    def start(self):
        return Start(WIDTH[self.scene.forest])


class PointTask(Reach):
    """The point mass with the measures of ``reach``: its cost is called a force, its steps far off ruptures."""

    metrics = tuple(sorted(MEASURES))

    def step(self, actions):
        observations, reward, dones, extras = super().step(actions)
        log = extras["log"]
        own = {name: torch.zeros(self.num_envs) for name in MEASURES}
        own |= {"return": log["return"], "success": log["success"], "force": -log["return"], "rupture": log["breach"],
                "duration": 1.0 - log["steps_clear"] / LENGTH}  # fmt: skip
        return observations, reward, dones, extras | {"log": own}

    def strata(self):
        return {name: torch.arange(self.num_envs) % 5 == k for k, name in enumerate(PATTERNS)}

    def targets(self):
        return torch.arange(self.num_envs) // 5


def make(name, settings, **how):
    return PointTask(settings, **how)


def points():
    """Return a registry in which ``reach`` is the point mass."""
    presets = {"cpu": PointSettings()}
    kind = TaskKind(REACHING, ("place", "time"), presets, make, REACH_COLUMNS, {"cpu": TINY}, 10, POLICIES, RECURRENT)
    return TaskRegistry((kind,))
