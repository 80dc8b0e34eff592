"""Model predictive control by sampling: what plans are made of, whatever they are tried in.

The thesis's rival in chapter 4 (4.5.1), in the manner of Bhardwaj et al., "STORM" (2022): model predictive path
integral control (Williams et al. 2017) in joint space, by pytorch-mppi, for all worlds in one batch. Every policy step
it samples sequences of actions, rolls them out in a model, and takes the first action of their mean, weighted by
exp(- cost / TEMPERATURE). A step of a plan takes PLAN seconds and costs, whatever the model,

    |hand - target| + SPEED |qd|^2 + LIMIT (how far joints are beyond their limits)

Of STORM's terms orientation, manipulability and collision with itself are left out. Models are the arm's kinematics
(`mpc_kinematics`) and the simulation itself (`mpc_tree`).
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol

import torch

from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint

if TYPE_CHECKING:
    from tensordict import TensorDict

#: Length of a step of the plan [s], standard deviation of sampled actions, temperature.
PLAN, NOISE, TEMPERATURE = 0.1, 0.5, 0.02
#: Weights of squared speeds [m s^2/rad^2] and of joints beyond their limits [m/rad].
SPEED, LIMIT = 0.002, 10.0


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
