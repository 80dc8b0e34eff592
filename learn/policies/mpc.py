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
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint
from ...sim.base.rotation import quat_rotate
from ..tasks.task import Task

if TYPE_CHECKING:
    from tensordict import TensorDict

#: Length of a step of the plan [s], steps, sequences, standard deviation of sampled actions, temperature.
PLAN, HORIZON, SAMPLES, NOISE, TEMPERATURE = 0.1, 15, 64, 0.5, 0.02
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


class SamplingMPC:
    """A policy for all worlds of ``reach``, from what they observe: joints, speeds, the way to the target.

    Attributes:
        planner: pytorch-mppi's controller.
    """

    def __init__(self, task: Any, seed: int) -> None:
        """Take a task whose actions are changes of joint speeds, fresh, and a seed.

        Raises:
            InputError: It does not observe joints, speeds and the way to a target, or pytorch-mppi is not installed.
        """
        require_mppi()
        columns = getattr(task, "columns", {})
        if not set(_NEEDED) <= set(columns) or getattr(task, "pace", None) is None or task.pace.law == "ramp":
            raise InputError("mpc", "", task.name, "reach, with its groups proprioceptive and offset")
        from pytorch_mppi.mppi import MPPI_Batched

        arm, self._dofs, self._device = task.simulator.arm, task.num_actions, torch.device(task.device)
        sizes = (self._dofs, self._dofs, 3)
        self._columns = [slice(columns[n], columns[n] + k) for n, k in zip(_NEEDED, sizes, strict=True)]
        self._hand = HandKinematics(arm, self._device)
        self._step = max(PLAN, task.step_seconds)
        self._change = task.pace.speed_step * self._step / task.step_seconds
        self._limits = [torch.as_tensor(v, dtype=torch.float32, device=self._device)
                        for v in (arm.velocity_limit, arm.lower, arm.upper)]  # fmt: skip
        one = torch.ones(self._dofs, device=self._device)
        self._seed, self._calls = seed, 0
        with self._random():
            self.planner = MPPI_Batched(
                self._model, self._cost, 2 * self._dofs + 3, NOISE**2 * torch.diag(one), task.num_envs,
                num_samples=SAMPLES, horizon=HORIZON, device=self._device, lambda_=TEMPERATURE, u_min=-one, u_max=one,
            )  # fmt: skip
            self.planner.U.zero_()

    def _random(self) -> Any:
        """Return a context in which torch draws this call's own numbers."""
        self._calls += 1
        devices = [self._device] if self._device.type == "cuda" else []
        return _Seeded(self._seed + self._calls, devices)

    def __call__(self, observations: TensorDict) -> torch.Tensor:
        """Return actions [W, D] for observations, group ``policy`` [W, O]."""
        q, qd, offset = (observations["policy"][:, columns] for columns in self._columns)
        with self._random():
            actions: torch.Tensor = self.planner.command(torch.cat([q, qd, self._hand(q) + offset], 1))
        return actions

    def _model(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        q, qd, target = state.split([self._dofs, self._dofs, 3], 1)
        fastest = self._limits[0]
        qd = (qd + self._change * action).clamp(-fastest, fastest)
        return torch.cat([q + self._step * qd, qd, target], 1)

    def _cost(self, state: torch.Tensor, _action: torch.Tensor) -> torch.Tensor:
        q, qd, target = state.split([self._dofs, self._dofs, 3], 1)
        _, lower, upper = self._limits
        beyond = (lower - q).clamp(min=0.0) + (q - upper).clamp(min=0.0)
        away: torch.Tensor = (self._hand(q) - target).norm(dim=1)
        return away + SPEED * qd.square().sum(1) + LIMIT * beyond.sum(1)


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
    return SamplingMPC(task, seed)
