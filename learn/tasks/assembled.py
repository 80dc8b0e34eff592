"""A task assembled from its parts, as an rsl-rl environment in device memory: one launch a phase."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from ...kernels.tasks import parts as kernels
from ...kernels.tasks.control import LAWS, drive
from ...sim.arms.simulator import ArmSimulator
from ...sim.base.thread_pool import Launches, recorded
from ...sim.base.types import Array
from ...sim.pictures.tracer import View
from .memory import FinalObservation, copies, put_back, simulator_tensors
from .overlaps import Overlaps
from .parts import Parts


@dataclass(frozen=True)
class Pace:
    """How time passes in a task.

    Attributes:
        policy_rate: Actions a second [Hz].
        control_periods: Times that servos are asked for a speed in a policy step.
        period_steps: Physics steps between two of them.
        episode_steps: Policy steps of an episode.
        action_delay, observation_delay: Greatest latencies [policy steps], drawn every episode.
        law: What servos are asked for (`kernels.tasks.control.LAWS`).
        speed_step: Most that a whole action changes a joint's speed by in a policy step [rad/s]; ``ramp`` ignores it.
        reward_scale: What the trainer's rewards are times; measures are not.
    """

    policy_rate: float
    control_periods: int
    period_steps: int
    episode_steps: int
    action_delay: int = 0
    observation_delay: int = 0
    law: str = "ramp"
    speed_step: float = 0.0
    reward_scale: float = 1.0


def asking(simulator: ArmSimulator, pace: Pace, actions: wp.array, clock: Any, waiting: wp.array) -> list[Launches]:
    """Return the launches that ask the servos for a speed, one for each control period of a policy step.

    Args:
        simulator: Whose servos are asked.
        pace: How time passes.
        actions: What is wanted, [worlds, dof].
        clock: `kernels.tasks.parts.Clock`; ``clock`` and ``action_delay`` of it are read.
        waiting: Actions that their latency holds back, [slots, worlds, dof].
    """
    device, arm = simulator.model.device, simulator._arm.kernel[1]
    limit: wp.array = wp.array(simulator.arm.velocity_limit.astype(np.float32), dtype=wp.float32, device=device)
    law, count = LAWS.index(pace.law), pace.control_periods
    inputs = [[actions, limit, arm.qd, law, k, count, pace.speed_step, clock, waiting, arm.target]
              for k in range(count)]  # fmt: skip
    return [Launches([recorded(drive, simulator.model.num_worlds, given, device)]) for given in inputs]


class AssembledTask(VecEnv):
    """Worlds of one arm and one tree each that restart by themselves; a subclass says where things stand.

    A policy step is a fixed sequence of launches (`step`): judge the state that the action was chosen in; in every
    control period ask the servos, step the physics and sample; close episodes that are over, place those worlds anew,
    sense once, deliver. Everything is allocated once and written in place; what `step` returns is the same memory every
    time, overwritten by the next.

    A subclass makes its worlds and then calls `_assemble`; it has `_place` and may have `_look`.

    Attributes:
        name, version: As checkpoints know the task.
        num_envs, num_actions, max_episode_length, device: As rsl-rl wants them.
        cfg: The settings in effect.
        parts: What the task is made of.
        metrics: Names of what is said of every finished episode.
        step_seconds: Length of a policy step [s].
        cost_limit: What the mean cost of a step may be; None where the task has no constraint.
        actions: [worlds, dof]; `step` copies into it what is elsewhere.
        observation: What the policy sees, [worlds, columns] (`columns`).
        columns: First column of every feature.
        reward, done, time_out: What `step` returns, [worlds].
        simulator: Arms and trees.
        lost: How often the simulation lost each world, int32 [worlds].
    """

    simulator: ArmSimulator

    def _assemble(self, parts: Parts, pace: Pace, key: wp.vec2ui, shared: Mapping[str, wp.array] | None = None) -> None:
        """Allocate everything but the worlds, and record the launches.

        Args:
            parts: What the task is made of.
            pace: How time passes.
            key: Of the random numbers.
            shared: Arrays of ``own`` that are not the task's to allocate and to keep.

        Raises:
            InputError: The parts do not fit together.
        """
        self.parts, self.pace, self._device = parts.check(), pace, self.simulator.model.device
        self.version, self.metrics = parts.version, tuple(parts.measures)
        self.max_episode_length, self.step_seconds = pace.episode_steps, 1.0 / pace.policy_rate
        self.num_actions = self.simulator.arm.num_dofs
        self._kernels = parts.kernels()
        self.cost_limit = None if parts.cost is None else parts.cost_limit
        self._price = None if parts.cost is None else parts.price()
        self._fill_rules(key)
        self._make_view(key)
        self._make_own(dict(shared or {}))
        self._allocate()
        self._prepare()
        self._graph: Callable[[], None] | None = None
        self._final: FinalObservation | None = None
        self._recorded: dict[Any, Launches] = {}

    # ---- memory --------------------------------------------------------------------------------------------------

    def _array(self, *shape: int, dtype: Any = wp.float32) -> wp.array:
        made: wp.array = wp.zeros(shape, dtype=dtype, device=self._device)
        return made

    def _fill_rules(self, key: wp.vec2ui) -> None:
        r: Any = kernels.Rules()
        r.key, r.longest, r.reward_scale = key, self.pace.episode_steps, self.pace.reward_scale
        r.action_delay, r.observation_delay = self.pace.action_delay, self.pace.observation_delay
        self._rules = r

    def _make_view(self, key: wp.vec2ui) -> None:
        self._clock: Any = kernels.Clock()
        struct: Any = kernels.Clock
        for name, kind in struct.vars.items():
            setattr(self._clock, name, self._array(self.num_envs, dtype=kind.type.dtype))
        _, self._arm, _ = self.simulator._arm.kernel
        v: Any = kernels.View()
        for name in ("q", "qd", "torque", "target", "force"):
            setattr(v, name, getattr(self._arm, name))
        v.hand, v.turn, v.clock, v.key = self._arm.end_position, self._arm.end_rotation, self._clock, key
        self._view = v

    def _make_own(self, shared: dict[str, wp.array]) -> None:
        self._own: Any = self.parts.own()
        own = {name: self._array(self.num_envs, dtype=kind) for name, kind in self.parts.arrays.items()
               if name not in shared}  # fmt: skip
        for name, value in (shared | own | dict(self.parts.numbers)).items():
            setattr(self._own, name, value)
        clock = {name: getattr(self._clock, name) for name in self._clock._cls.vars}
        self._counts: dict[str, torch.Tensor] = {name: wp.to_torch(a) for name, a in (clock | own).items()}

    def _allocate(self) -> None:
        n, count, slots = self.num_envs, len(self.metrics), self.pace.observation_delay + 1
        self.columns, width = self.parts.columns_of_features()
        self._warp = {
            "actions": self._array(n, self.num_actions), "observation": self._array(n, width),
            "reward": self._array(n), "done": self._array(n, dtype=wp.bool), "time_out": self._array(n),
            "log": self._array(n, count), "sums": self._array(n, count + 1),
            "waiting": self._array(self.pace.action_delay + 2, n, self.num_actions),
        }  # fmt: skip
        if self._price is not None:
            self._warp["cost"] = self._array(n)
        if slots > 1:
            self._warp |= {"now": self._array(n, width), "kept": self._array(slots, n, width)}
        views = {name: wp.to_torch(array) for name, array in self._warp.items()}
        self.actions, self.observation, self.reward = (views[k] for k in ("actions", "observation", "reward"))
        self.done, self.time_out, self._sums = (views[k] for k in ("done", "time_out", "sums"))
        self._length: torch.Tensor = self._counts["length"]
        self.lost: torch.Tensor = self._counts["lost"]
        self._observations = TensorDict({"policy": self.observation}, batch_size=[n])
        log = {name: views["log"][:, k] for k, name in enumerate(self.metrics)}
        self._extras: dict[str, Any] = {"time_outs": self.time_out, "log": log}
        self._extras |= {name: views[name] for name in ("cost",) if name in views}

    def _prepare(self) -> None:
        """Note where observations are written, at once or to wait for their latency, and the servos' launches."""
        sim = self.simulator
        self._seen = self._warp.get("now", self._warp["observation"])
        self._slot: wp.array = wp.array(sim.model.world_slot.astype(np.int32), device=self._device)
        self._periods = asking(sim, self.pace, self._warp["actions"], self._clock, self._warp["waiting"])

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps since a world's episode began, int32 [worlds], the kernels' memory; assigning writes into it."""
        return self._length

    @episode_length_buf.setter
    def episode_length_buf(self, value: torch.Tensor) -> None:
        """Write steps since a world's episode began."""
        self._length.copy_(value)

    # ---- stepping ------------------------------------------------------------------------------------------------

    @abstractmethod
    def _place(self, mask: wp.array, episode: wp.array) -> None:
        """Say where things stand in the masked worlds (bool, [worlds]) of the given episodes (int, [worlds])."""

    def _look(self) -> None:
        """Write the observations that no part writes."""

    def _take(self, period: int) -> None:
        """Take a sample of what no part does, after a control period of the policy step, from 0."""

    def _launch(self, kernel: Any, *inputs: Any) -> None:
        """Launch a kernel, one thread a world; what it is given never changes, so the launch is recorded once."""
        if kernel not in self._recorded:
            self._recorded[kernel] = Launches([recorded(kernel, self.num_envs, inputs, self._device)])
        self._recorded[kernel]()

    def _begin(self) -> None:
        """Start the first episode of every world."""
        self._start()

    def _start(self) -> None:
        self.done.fill_(True)
        self._launch(self._kernels.begin, self._warp["done"], self._view, self._own, self._rules)
        self._restart()
        self.sense()
        self.done.fill_(False)

    def _restart(self) -> None:
        """Place the worlds that are done anew and put them at rest; capsules of all worlds are then where they are."""
        self._place(self._warp["done"], self._clock.episode)
        self.simulator.reset(self.done)

    def sense(self) -> None:
        """Write the observations of the worlds as they are."""
        self._look()
        self._launch(self._kernels.feel, self._view, self._own, self._seen)
        if "kept" in self._warp:
            self._launch(kernels.deliver, self._seen, self._clock, self._warp["kept"], self._warp["observation"])

    def _sense_on(self) -> None:
        """Sense as if no episode were over: at the next count, with capsules where they are."""
        self._launch(kernels.count_on, self._clock)
        self.simulator.look()
        self.sense()

    def keep_final(self) -> torch.Tensor:
        """Keep the last observation of every episode from now on; return its memory, [worlds, columns].

        It costs a second sensing per step. Where a world is done it holds what the policy would have seen had the
        episode gone on; of a world that the simulation lost it need not be finite.
        """
        if self._final is None:
            parts = {k: t for k, t in self._tensors().items() if not k.startswith(("simulator ", "scene "))}
            self._final, self._graph = FinalObservation(parts, self._warp["observation"]), None
        return self._final.observation

    def restart(self) -> None:
        """Begin a new episode in every world, as where one is over."""
        self._counts["episode"] += 1
        self._warp["waiting"].zero_()
        self._start()

    def _advance(self) -> None:
        """Launch one policy step; nothing is allocated, copied to the host or waited for."""
        self.judge()
        for period, ask in enumerate(self._periods):
            ask()
            self.simulator.step(self.pace.period_steps)
            self.sample(period)
        if self._price is not None:
            self._launch(self._price, self._view, self._own, self._warp["cost"])
        if self._final is not None:
            self._final.take(self._sense_on)
        self.end_step()
        self._restart()
        self.sense()

    def judge(self) -> None:
        """Judge the present state, which an action is about to be chosen in: the first phase of a policy step."""
        self._launch(self._kernels.judge, self._view, self._own, self._rules, self._warp["reward"])

    def sample(self, period: int) -> None:
        """Take samples after a control period of the policy step, from 0."""
        if self.parts.samples:
            self._launch(self._kernels.sample, self._view, self._own)
        self._take(period)

    def end_step(self) -> None:
        """End the policy step: say in `done` which episodes are over, and what has been measured of each so far.

        What is counted begins anew where one is over; worlds stay as they are.
        """
        w = self._warp
        self._launch(self._kernels.close, self.simulator.state.alive.entries(), self._slot, self._view, self._own,
                     self._rules, w["waiting"], w["done"], w["time_out"], w["log"], w["sums"])  # fmt: skip

    def own(self, name: str) -> torch.Tensor:
        """Return what the worlds remember by a name of `Parts.arrays` that is the task's own, a view [worlds, ...]."""
        return self._counts[name]

    def measured(self) -> dict[str, torch.Tensor]:
        """Return the measures of every world's episode as `end_step` last wrote them, views [worlds] by name."""
        log: dict[str, torch.Tensor] = self._extras["log"]
        return log

    def capture(self) -> None:
        """Record the policy step as one graph that `step` replays from now on.

        A GPU does so by itself at the first step. On a CPU a graph runs on one thread, so steps are not recorded there
        unless this is called.
        """
        with wp.ScopedCapture(device=self._device) as scope:
            self._advance()
        self._graph = lambda: wp.capture_launch(scope.graph)

    def get_observations(self) -> TensorDict:
        """Return the observations, group ``policy`` [worlds, columns]: the memory that the kernels write."""
        return self._observations

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Act for one policy step.

        Args:
            actions: Clipped to -1..1, [worlds, dof]; what they are is the control law's to say.

        Returns:
            Observations, rewards [worlds], dones (bool, [worlds]) and extras: ``time_outs`` [worlds] and ``log``, the
            measures [worlds] of the episodes so far, which count where a world is done; ``cost`` [worlds] of a task
            under a constraint. All are overwritten by the next step.
        """
        if actions.data_ptr() != self.actions.data_ptr():
            self.actions.copy_(actions)
        if self._graph is None:
            self._advance()
            if self._device.is_cuda:
                self.capture()
        else:
            self._graph()
        return self._observations, self.reward, self.done, self._extras

    def episode_log(self) -> dict[str, float]:
        """Return the means of all measures over the episodes that ended since the last call, and ``episodes``.

        The only look from the host at the device's sums; nothing but ``episodes`` is returned where none ended.
        """
        sums = self._sums.sum(0).cpu()
        self._sums.zero_()
        count = float(sums[-1])
        if count == 0.0:
            return {"episodes": 0.0}
        return {name: float(sums[k]) / count for k, name in enumerate(self.metrics)} | {"episodes": count}

    # ---- resume --------------------------------------------------------------------------------------------------

    def _tensors(self) -> dict[str, torch.Tensor]:
        out = {f"task {name}": wp.to_torch(array) for name, array in self._warp.items()}
        out |= {f"count {name}": tensor for name, tensor in self._counts.items()}
        return out | {f"simulator {name}": tensor for name, tensor in simulator_tensors(self.simulator).items()}

    def snapshot(self) -> dict[str, torch.Tensor]:
        """Return copies of everything that the future depends on."""
        return copies(self._tensors())

    def restore(self, snapshot: dict[str, torch.Tensor]) -> None:
        """Go back to a snapshot of a task made with the same arguments: what follows is the same to the bit.

        Raises:
            ValueError: The snapshot is of another task.
        """
        put_back(self._tensors(), snapshot)

    # ---- what a test tells ---------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def foot(self) -> torch.Tensor:
        """Foot of every world's trunk, where the ground is [m], [worlds, 3]."""

    def watch(self) -> Overlaps:
        """Return what counts how arm, branches, line and ground pass through each other, from the present state on."""
        foot: Any = wp.from_torch(self.foot, dtype=wp.vec3)
        return Overlaps(self.simulator, foot)

    @abstractmethod
    def solids(self, world: int) -> tuple[Array, Array, Array, Array]:
        """Return one world as capsules: start, end [C, 3] and radius [C] in m, 0 for none, colour [C, 3] in sRGB."""

    @abstractmethod
    def view(self, world: int) -> View:
        """Return where one world is looked at from."""

    @abstractmethod
    def render(self, world: int) -> NDArray[np.uint8]:
        """Return a picture of one world, [height, width, 3]."""
