"""What a policy was trained for, as far as an arm has to know it: its task's parts, rates and control."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...sim.arms.arm import Arm
from ...sim.arms.registry import ARMS
from ...sim.base.errors import InputError
from ..policies.evaluate import TrainedPolicy, read_policy
from ..robot.limits import FASTEST, STRONGEST, Limits, default_limits
from ..runs.folder import RunFolder
from ..tasks.assembled import Pace
from ..tasks.parts import Parts
from ..tasks.registry import TaskRegistry

CLEARS, REACHES = "powerline", "reach"
RATE = 60.0
"""Ticks of a service a second [Hz]: control periods of a policy have to be as long."""

_TOUCH = ("touch", "skin")


@dataclass(frozen=True)
class Plan:
    """A policy's task without its worlds.

    Attributes:
        name: ``powerline`` or ``reach``.
        settings: Its settings.
        arm: The arm that it moves.
        parts: What the task is made of.
        pace: How time passes; latencies are none: on a robot they are there by themselves.
    """

    name: str
    settings: Any
    arm: Arm
    parts: Parts
    pace: Pace

    @property
    def seeing(self) -> bool:
        """Whether the policy sees clouds of points."""
        return self.name == CLEARS and any(g.function is None for g in self.parts.groups)

    @property
    def feeling(self) -> bool:
        """Whether the policy is told of touch."""
        return any(g.name in _TOUCH for g in self.parts.groups)

    @property
    def step_seconds(self) -> float:
        """Length of a policy step [s]."""
        return 1.0 / self.pace.policy_rate

    @property
    def seconds(self) -> float:
        """Length of an episode [s]."""
        return self.pace.episode_steps * self.step_seconds


def plan_of(name: str, settings: Any, source: object, *, told: bool = False) -> Plan:
    """Return the plan of a task.

    Args:
        name: Name of the task.
        settings: Its settings.
        source: What errors name.
        told: Whether touch is told by a classifier of joint torques, whatever it was told by in training.

    Raises:
        InputError: The task is none that an arm can be given, or it steers at another rate than an arm's service.
    """
    if name not in (CLEARS, REACHES):
        raise InputError(str(source), "task", name, f"{CLEARS} or {REACHES}")
    if settings.control_rate != RATE:
        raise InputError(str(source), "control_rate", f"{settings.control_rate:g} Hz", f"{RATE:g} Hz, an arm's ticks")
    arm = ARMS.of(settings.arm, str(source), "arm")
    if name == CLEARS:
        from ..tasks.clearing_parts import clearing_parts
        from ..tasks.powerline import pace_of

        own = settings.of(name)
        return Plan(name, own, arm, clearing_parts(name, own, arm.num_dofs), _on_time(pace_of(own)))
    from ..tasks.reach import pace_of as reach_pace
    from ..tasks.reach_parts import reach_parts

    own = replace(settings, flag="classifier" if told else settings.flag)
    return Plan(name, own, arm, reach_parts(own, arm.num_dofs, test=True), _on_time(reach_pace(own)))


def _on_time(pace: Pace) -> Pace:
    return replace(pace, action_delay=0, observation_delay=0)


@dataclass(frozen=True)
class Driver:
    """A policy that can act on a robot.

    Attributes:
        plan: Its task.
        trained: The policy as its run left it.
        act: Called with an observation [1, O]; returns the action [1, D].
        restart: Called where an episode begins.
    """

    plan: Plan
    trained: TrainedPolicy
    act: Callable[[torch.Tensor], torch.Tensor]
    restart: Callable[[], None]


def limits_of(plan: Plan) -> Limits:
    """Return the limits within which a policy learnt: above any torque of the servos, and as fast changes of speed.

    A ramp between two actions changes a speed by twice its limit in a policy step at most, the other laws by their
    ``speed_step``. There is no table under the arm: a task's arm goes below its base where branches are. All else is
    as `default_limits` has it.
    """
    default, pace = default_limits(plan.arm), plan.pace
    change = 2.0 * plan.arm.velocity_limit if pace.law == "ramp" else np.full(plan.arm.num_dofs, pace.speed_step)
    acceleration = np.clip(change * pace.policy_rate, default.acceleration, FASTEST)
    return replace(default, acceleration=acceleration, torque=STRONGEST * plan.arm.torque_limit,
                   workspace_low=-default.workspace_high)  # fmt: skip


def read_driver(path: Path, registry: TaskRegistry, *, told: bool = False) -> Driver:
    """Read the newest policy of a run, as `bough evaluate` does.

    Args:
        path: Folder of the run.
        registry: Where its task is found.
        told: As `plan_of`.

    Raises:
        InputError: There is no policy, it is damaged, or its task is none that an arm can be given.
    """
    from tensordict import TensorDict

    from ..policies.ppo_runner import network_of

    trained = read_policy(RunFolder(path), registry)
    plan = plan_of(trained.name, trained.settings, path, told=told)
    _, width = plan.parts.columns_of_features()
    shown = TensorDict({"policy": torch.zeros(1, width)}, batch_size=[1])
    try:
        network = network_of(trained.state, trained.ppo, shown, plan.arm.num_dofs)
    except (RuntimeError, KeyError, TypeError, AttributeError) as error:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(trained.checkpoint, "", f"a network that does not fit ({first})", "this task's") from None

    @torch.inference_mode()
    def act(observation: torch.Tensor) -> torch.Tensor:
        """Return the policy's actions for observations [1, columns], without its noise."""
        action: torch.Tensor = network(TensorDict({"policy": observation}, batch_size=[1]))
        return action

    return Driver(plan, trained, act, network.reset)
