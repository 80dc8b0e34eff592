"""Model predictive control by sampling, of an arm's kinematics alone: it knows no tree and feels nothing.

The rival of the thesis's chapter 4 (4.5.1), in the manner of Bhardwaj et al., "STORM" (2022): model predictive path
integral control (Williams et al. 2017) in joint space, by pytorch-mppi, for all worlds in one batch. Every policy step
it samples sequences of actions, rolls them out in a model, and takes the first action of their mean, weighted by
exp(- cost / TEMPERATURE). In the model a step of PLAN seconds changes joint speeds by the action and positions by the
speeds; the cost of a step is

    |hand - target| + SPEED |qd|^2 + LIMIT (how far joints are beyond their limits)

Of STORM's terms orientation, manipulability and collision with itself are left out.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint
from ...sim.base.rotation import quat_rotate
from ..tasks.task import Task

if TYPE_CHECKING:
    from tensordict import TensorDict

#: Length of a step of the plan [s], standard deviation of sampled actions, temperature.
PLAN, NOISE, TEMPERATURE = 0.1, 0.5, 0.02
#: Steps and sequences of plans in the arm's kinematics.
HORIZON, SAMPLES = 15, 64
#: Weights of squared speeds [m s^2/rad^2] and of joints beyond their limits [m/rad].
SPEED, LIMIT = 0.002, 10.0
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


class PlanModel(Protocol):
    """What a plan comes to: worlds as rows of numbers, W of them, or W * K where every world has K sequences.

    Attributes:
        size: Numbers of a row.
        samples: Sequences that are tried in every world at every step, K.
        horizon: Steps of each.
    """

    size: int
    samples: int
    horizon: int

    def begin(self, observations: TensorDict) -> torch.Tensor:
        """Return the rows that plans begin at, [W, size]."""

    def step(self, rows: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Return the rows after a step of the plan, [W * K, size], for actions [W * K, D]."""

    def cost(self, rows: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Return what that step costs [m], [W * K]."""


class SamplingMPC:
    """A policy for all worlds of ``reach`` that plans before it acts.

    Attributes:
        planner: pytorch-mppi's controller.
    """

    def __init__(self, task: Any, seed: int, model: PlanModel) -> None:
        """Take a task that is fresh, a seed and what a plan comes to."""
        from pytorch_mppi.mppi import MPPI_Batched

        self._task, self._model, self._device = task, model, torch.device(task.device)
        self._seed, self._calls, self._held = seed, 0, steps_of_plan(task)
        one = torch.ones(task.num_actions, device=self._device)
        with self._random():
            self.planner = MPPI_Batched(
                model.step, model.cost, model.size, NOISE**2 * torch.diag(one), task.num_envs,
                num_samples=model.samples, horizon=model.horizon, device=self._device, lambda_=TEMPERATURE,
                u_min=-one, u_max=one,
            )  # fmt: skip
            self.planner.U.zero_()

    def _random(self) -> _Seeded:
        """Return a context in which torch draws this call's own numbers."""
        self._calls += 1
        devices = [self._device] if self._device.type == "cuda" else []
        return _Seeded(self._seed + self._calls, devices)

    def __call__(self, observations: TensorDict) -> torch.Tensor:
        """Return actions [W, D] for observations, group ``policy`` [W, O]; a plan begins anew where an episode does."""
        self.planner.U.mul_((self._task.episode_length_buf > 0)[:, None, None])
        with self._random():
            onward = self._calls % self._held == 0
            actions: torch.Tensor = self.planner.command(self._model.begin(observations), onward)
        return actions


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


class Limits:
    """An arm's limits as tensors, and what being at them costs."""

    def __init__(self, task: Any) -> None:
        arm = task.simulator.arm
        self._fastest, self._lower, self._upper = (
            torch.as_tensor(v, dtype=torch.float32, device=task.device)
            for v in (arm.velocity_limit, arm.lower, arm.upper)
        )

    def slowed(self, qd: torch.Tensor) -> torch.Tensor:
        """Return joint speeds within their limits [rad/s]."""
        return qd.clamp(-self._fastest, self._fastest)

    def cost(self, q: torch.Tensor, qd: torch.Tensor) -> torch.Tensor:
        """Return SPEED |qd|^2 + LIMIT (how far joints are beyond their limits) [m], [N], of joints [N, D]."""
        beyond = (self._lower - q).clamp(min=0.0) + (q - self._upper).clamp(min=0.0)
        return SPEED * qd.square().sum(1) + LIMIT * beyond.sum(1)


def plans_for(task: Any) -> bool:
    """Return whether a task's actions are changes of joint speeds."""
    return getattr(task, "pace", None) is not None and task.pace.law != "ramp"


def steps_of_plan(task: Any) -> int:
    """Return the policy steps of a step of the plan, in which an action is held: as many as `PLAN` takes."""
    return max(1, round(PLAN / task.step_seconds))


class _Seeded:
    """Torch's random numbers from a seed, and afterwards as if none had been drawn."""

    def __init__(self, seed: int, devices: list[torch.device]) -> None:
        self._seed, self._fork = seed, torch.random.fork_rng(devices)

    def __enter__(self) -> None:
        self._fork.__enter__()
        torch.manual_seed(self._seed)

    def __exit__(self, *error: Any) -> None:
        self._fork.__exit__(*error)


def require_mppi() -> None:
    """Raise `InputError` where pytorch-mppi is not installed."""
    if find_spec("pytorch_mppi") is None:
        raise InputError("bough", "", "no pytorch_mppi", install_hint("mpc"))


def mpc(task: Task, seed: int) -> SamplingMPC:
    """Return sampling MPC without the tree, for a task that is fresh.

    Raises:
        InputError: The task is not ``reach``, or pytorch-mppi is not installed.
    """
    require_mppi()
    return SamplingMPC(task, seed, Kinematics(task))
