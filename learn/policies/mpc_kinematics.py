"""MPC without the tree: plans in an arm's kinematics alone, which know nothing else and feel nothing.

In the model a step changes joint speeds by the action, and positions by the speeds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.base.errors import InputError
from ...sim.base.rotation import quat_rotate
from ..tasks.task import Task
from .mpc import Limits, SamplingMPC, plans_for, require_mppi, steps_of_plan

if TYPE_CHECKING:
    from tensordict import TensorDict

#: Steps and sequences of a plan.
HORIZON, SAMPLES = 15, 64
_NEEDED = ("q", "qd", "offset")


class HandKinematics:
    """Where an arm's hand is, for batches of joint positions, in torch.

    Product of exponentials: at q = 0 joint j turns about the axis z_j through p_j, so that
    x(q) = T_1(q_1) ... T_D(q_D) x(0), T_j a turn about that axis.
    """

    def __init__(self, arm: Arm, device: str | torch.device) -> None:
        point, turn, (end, _) = forward_kinematics(arm, np.zeros(arm.num_dofs))
        axis = quat_rotate(turn, arm.tree.axis)

        def there(values: Any) -> torch.Tensor:
            """Return numbers as float32 on the device."""
            return torch.as_tensor(np.asarray(values), dtype=torch.float32, device=device)

        self._point, self._axis, self._end = there(point), there(axis), there(end)

    def __call__(self, q: torch.Tensor) -> torch.Tensor:
        """Return the hand's position in the base's axes [m], [N, 3], for joint positions [rad], [N, D]."""
        x = self._end.expand(len(q), 3)
        for j in reversed(range(q.shape[1])):
            z, r = self._axis[j].expand(len(q), 3), x - self._point[j]
            s, c = q[:, j : j + 1].sin(), q[:, j : j + 1].cos()
            along = (z * r).sum(1, keepdim=True) * z
            x = self._point[j] + along + c * (r - along) + s * torch.linalg.cross(z, r)
        return x


class Kinematics:
    """Plans in an arm's kinematics alone, from what a policy observes: joints, speeds, the way to the target.

    A row is q [rad], qd [rad/s] and the target in the base's axes [m].
    """

    samples, horizon = SAMPLES, HORIZON

    def __init__(self, task: Any) -> None:
        """Take a task whose actions are changes of joint speeds.

        Raises:
            InputError: It does not observe joints, speeds and the way to a target.
        """
        columns = getattr(task, "columns", {})
        if not set(_NEEDED) <= set(columns) or not plans_for(task):
            raise InputError("mpc", "", task.name, "reach, with its groups proprioceptive and offset")
        self._dofs, self._sizes = task.num_actions, (task.num_actions, task.num_actions, 3)
        self.size, self._limits = sum(self._sizes), Limits(task)
        self._columns = [slice(columns[n], columns[n] + k) for n, k in zip(_NEEDED, self._sizes, strict=True)]
        self._hand = HandKinematics(task.simulator.arm, task.device)
        self._step = steps_of_plan(task) * task.step_seconds
        self._change = task.pace.speed_step * steps_of_plan(task)

    def begin(self, observations: TensorDict) -> torch.Tensor:
        """Return what is observed as rows."""
        q, qd, offset = (observations["policy"][:, columns] for columns in self._columns)
        return torch.cat([q, qd, self._hand(q) + offset], 1)

    def step(self, rows: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Change speeds by the action, and positions by the speeds."""
        q, qd, target = rows.split(self._sizes, 1)
        qd = self._limits.slowed(qd + self._change * action)
        return torch.cat([q + self._step * qd, qd, target], 1)

    def cost(self, rows: torch.Tensor, _action: torch.Tensor) -> torch.Tensor:
        """Return the hand's distance, and what speeds and joint limits cost [m]."""
        q, qd, target = rows.split(self._sizes, 1)
        away: torch.Tensor = (self._hand(q) - target).norm(dim=1)
        return away + self._limits.cost(q, qd)


def mpc(task: Task, seed: int) -> SamplingMPC:
    """Return sampling MPC without the tree, for a task that is fresh.

    Raises:
        InputError: The task is not ``reach``, or pytorch-mppi is not installed.
    """
    require_mppi()
    return SamplingMPC(task, seed, Kinematics(task))
