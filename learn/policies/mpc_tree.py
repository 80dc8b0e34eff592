"""Model predictive control that knows the tree: plans are tried in copies of the simulation itself.

The other end from `mpc_kinematics`: what perfect knowledge of geometry, springs, state and servos is worth. The
sampling is the same; a step of the plan is the simulation's, and it costs the same and, of the norm F of the net
contact forces of all links in the step's control periods,

    FORCE mean(F) + RUPTURE (share of the periods with F above 80 N, which counts as a rupture)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch

from ...sim.base.errors import InputError
from ..tasks.imagined import ImaginedWorlds
from ..tasks.reach_settings import RUPTURE_FORCE
from ..tasks.task import Task
from .mpc import Limits, SamplingMPC, plans_for, require_mppi, steps_of_plan

if TYPE_CHECKING:
    from tensordict import TensorDict

#: Steps and sequences of a plan: about a quarter of what the kinematics alone are given, for each is simulated.
HORIZON, SAMPLES = 8, 32
#: Weights of the contact force [m/N] and of a period with a rupture [m].
FORCE, RUPTURE = 0.005, 0.5
#: What a step costs in which the simulation loses a world [m].
LOST = 10.0


class KnownTree:
    """Plans in copies of a task's worlds, trees and all; what is observed is not looked at.

    A row is what the step cost [m]: the copies themselves are the state.
    """

    size, horizon = 1, HORIZON

    def __init__(self, task: Any, samples: int = SAMPLES) -> None:
        """Take a task whose actions are changes of joint speeds, and how many sequences to try in every world.

        Raises:
            InputError: It is another task.
        """
        if not plans_for(task) or not hasattr(task, "places"):
            raise InputError("mpc-tree", "", task.name, "reach")
        self.samples, self._held, self._limits = samples, steps_of_plan(task), Limits(task)
        self._target = task.places.target
        self._worlds = ImaginedWorlds(task, samples, RUPTURE_FORCE)
        self._nothing = torch.zeros((task.num_envs, self.size), device=task.device)

    def begin(self, observations: TensorDict) -> torch.Tensor:
        """Bring the copies to where the worlds are."""
        self._worlds.take()
        return self._nothing

    def step(self, rows: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Simulate a step of the plan in every copy."""
        cost = torch.zeros_like(rows[:, 0])
        for _ in range(self._held):
            self._worlds.step(action)
            cost += (FORCE * self._worlds.force + RUPTURE * self._worlds.hard) / self._held
        return (cost + self._place())[:, None]

    def cost(self, rows: torch.Tensor, _action: torch.Tensor) -> torch.Tensor:
        """Return what the step cost [m]."""
        return rows[:, 0].nan_to_num(LOST, LOST, LOST)

    def _place(self) -> torch.Tensor:
        """Return what the copies' place costs: the hand's distance, speeds and joint limits [m]."""
        sim = self._worlds.simulator
        away = (sim.end_position.unflatten(0, (-1, self.samples)) - self._target[:, None]).norm(dim=-1)
        return away.flatten() + self._limits.cost(sim.q, sim.qd)


def mpc_tree(task: Task, seed: int) -> SamplingMPC:
    """Return sampling MPC that knows the tree, for a task that is fresh.

    Raises:
        InputError: The task is not ``reach``, or pytorch-mppi is not installed.
    """
    require_mppi()
    return SamplingMPC(task, seed, KnownTree(task))
