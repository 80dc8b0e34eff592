"""Clearing branches from a target with the whole arm, as an rsl-rl environment in device memory (thesis 5.3-5.5)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from ...kernels.tasks import clearing as kernels
from ...perception.sensor import Sensor
from ...sim.arms.arm import Arm
from ...sim.arms.jaco2 import jaco2
from ...sim.arms.simulator import ArmSimulator, Contacts
from ...sim.base.errors import InputError
from ...sim.base.thread_pool import Launches, recorded
from ...sim.scenes.scene import Axes, Scene, fork_height, grow_trees, seed_sequence, share_trees
from ...sim.trees.tree import Tree
from ...sim.wood.effects import give_effects, names_of
from .memory import copies, put_back, simulator_tensors
from .overlaps import Overlaps
from .settings import TaskSettings, columns_of
from .task import METRICS

_COUNTERS = (
    "length", "age", "episode", "clock", "streak", "clear", "breaches", "succeeded", "lost", "action_delay",
    "observation_delay",
)  # fmt: skip
_MEASURES = ("first_occlusion", "last_occlusion", "total")


class Powerline(VecEnv):
    """Worlds of one tree, one target and one arm each, that restart by themselves.

    A policy step is a fixed sequence of launches (`step`): judge the state that the action was chosen in (eq. 5.9); in
    every control period act and step the physics; close episodes that are over, place those worlds anew, sense once,
    deliver. Everything is
    allocated here and written in place; what `step` returns is the same memory every time, overwritten by the next.

    Attributes:
        name, version: As checkpoints know the task.
        num_envs, num_actions, max_episode_length, device: As rsl-rl wants them.
        cfg: The settings in effect.
        step_seconds: Length of a policy step [s].
        actions: Speeds asked for, a share of each joint's limit, [worlds, dof]; `step` copies into it what is
            elsewhere.
        observation: What the policy sees, [worlds, columns] (`columns`).
        columns: First column of every feature.
        reward, done, time_out: What `step` returns, [worlds].
        simulator, scene, sensor: The parts.
        lost: How often the simulation lost each world, int32 [worlds].
    """

    version = 2

    def __init__(
        self, name: str, settings: TaskSettings, *, num_envs: int, seed: int, device: str, test: bool = False,
        arm: Arm | None = None,
    ) -> None:  # fmt: skip
        """Grow the trees, allocate all memory and start the first episodes.

        Args:
            name: One of `settings.NAMES`.
            settings: See `TaskSettings`; the task's own target goes in (`TaskSettings.of`).
            num_envs: Number of worlds.
            seed: Seed of everything random.
            device: ``cpu`` or ``cuda:N``.
            test: Whether worlds are those of a test set and branches touch the line.
            arm: The arm; None takes the Jaco 2.

        Raises:
            InputError: As `make_task`, or no world has a place that keeps the rules of the scene.
        """
        if num_envs < 1:
            raise InputError("task", "num_envs", str(num_envs), "1 or more worlds")
        self.name, self.cfg, self.num_envs, self.device = name, settings.check().of(name), num_envs, device
        self.max_episode_length = settings.episode_steps
        self.step_seconds = 1.0 / settings.policy_rate
        self._device = wp.get_device(device)
        arm = jaco2() if arm is None else arm
        domain = "test" if test else "training"
        self.num_actions = arm.num_dofs
        self._build_worlds(arm, seed, domain)
        self._rules = self._make_rules(seed, domain)
        self._allocate()
        self.simulator.line_mask.fill_(int(test))
        self._graph: Callable[[], None] | None = None
        self._recorded: dict[Any, Launches] = {}
        self._begin()

    # ---- memory --------------------------------------------------------------------------------------------------

    def _build_worlds(self, arm: Arm, seed: int, domain: str) -> None:
        s = self.cfg.scene
        distinct = grow_trees(s, arm, self.num_envs, seed=seed, domain=domain)
        trees, index = share_trees(distinct, self.num_envs)
        contacts = self._contacts(distinct, all_on=domain == "test")
        names = names_of(s.effects)
        self.simulator = ArmSimulator(trees, arm, contacts=contacts, device=self._device, effects=names)
        give_effects(self.simulator, s.effects)
        self.scene = Scene(self.simulator, distinct, index, s, seed=seed, domain=domain)
        line = self.simulator.line
        target: Any = self.scene.target if s.target.strips > 1 else Axes(line.start, line.end)
        capsules: Any = self.simulator.capsules
        hand = self.simulator._arm.kernel[1].end_position
        points = int(seed_sequence(seed, domain).generate_state(5)[4] >> 1)
        self.sensor = Sensor(capsules, target, hand, self.cfg.sensor, seed=points, device=self._device)

    def _contacts(self, trees: list[Tree], *, all_on: bool) -> Contacts:
        """Return what touches what: in tests the arm touches itself, branches each other, and all the ground too.

        The ground is level with the lowest foot that a trunk can have.
        """
        scene = self.cfg.scene
        if not all_on:
            return Contacts(line_radius=scene.target.radius)
        ground = scene.height[0] - max(fork_height(tree) for tree in trees)
        return Contacts(line_radius=scene.target.radius, arm_arm=True, branch_branch=True, ground=ground, capacity=64)

    def _make_rules(self, seed: int, domain: str) -> Any:
        out, s = kernels.TaskRules(), self.cfg
        words = seed_sequence(seed, domain).generate_state(7)[5:]
        out.key, out.max_noise = wp.vec2ui(int(words[0]), int(words[1])), wp.vec2(*s.max_noise)
        out.longest = s.episode_steps
        for name in ("success_steps", "touch_force", "touch_noise", "action_delay", "observation_delay"):
            setattr(out, name, getattr(s, name))
        return out

    def _array(self, *shape: int, dtype: Any = wp.float32) -> wp.array:
        made: wp.array = wp.zeros(shape, dtype=dtype, device=self._device)
        return made

    def _allocate(self) -> None:
        n, dofs = self.num_envs, self.num_actions
        self.columns, width = columns_of(self.cfg, dofs)
        self._counters = kernels.Counters()
        for name in _COUNTERS:
            setattr(self._counters, name, self._array(n, dtype=wp.int32))
        for name in _MEASURES:
            setattr(self._counters, name, self._array(n))
        slots = self.cfg.observation_delay + 1
        self._warp = {
            "actions": self._array(n, dofs), "observation": self._array(n, width), "reward": self._array(n),
            "done": self._array(n, dtype=wp.bool), "time_out": self._array(n), "log": self._array(n, len(METRICS)),
            "sums": self._array(n, len(METRICS) + 1), "waiting": self._array(self.cfg.action_delay + 2, n, dofs),
        }  # fmt: skip
        if slots > 1:
            self._warp |= {"now": self._array(n, width), "kept": self._array(slots, n, width)}
        views = {name: wp.to_torch(array) for name, array in self._warp.items()}
        self.actions, self.observation, self.reward = (views[k] for k in ("actions", "observation", "reward"))
        self.done, self.time_out, self._sums = (views[k] for k in ("done", "time_out", "sums"))
        self._length: torch.Tensor = wp.to_torch(self._counters.length)
        self.lost: torch.Tensor = wp.to_torch(self._counters.lost)
        self._observations = TensorDict({"policy": self.observation}, batch_size=[n])
        log = {name: views["log"][:, k] for k, name in enumerate(METRICS)}
        self._extras: dict[str, Any] = {"time_outs": self.time_out, "log": log}
        self._bind()

    def _bind(self) -> None:
        """Let sensor and simulator write where the policy reads, or where observations wait for their latency."""
        sim = self.simulator
        self._seen = self._warp.get("now", self._warp["observation"])
        wanted = ("wbr", "zbr", "clr", "rob", "distances", "breach", "occlusion")
        self.sensor.bind(self._seen, {k: self.columns[k] for k in wanted if k in self.columns})
        first = [self.columns.get(name, -1) for name in ("q", "qd", "hand", "touch")]
        self._first: wp.array = wp.array(first, dtype=wp.int32, device=self._device)
        _, self._arm, _ = sim._arm.kernel
        limit = sim.arm.velocity_limit.astype(np.float32)
        self._speed_limit: wp.array = wp.array(limit, dtype=wp.float32, device=self._device)
        self._slot: wp.array = wp.array(sim.model.world_slot.astype(np.int32), device=self._device)
        self._slices = [self._slice(k + 1) for k in range(self.cfg.control_periods)]
        self._max_noise = wp.from_torch(self.sensor.max_noise)
        self._scores = [wp.from_torch(self.sensor.occlusion), wp.from_torch(self.sensor.breach)]

    def _slice(self, period: int) -> Launches:
        """Return the launch that sets the servos' targets for a control period of the policy step, from 1."""
        w, share = self._warp, period / self.cfg.control_periods
        inputs = [w["actions"], self._speed_limit, share, self._counters, w["waiting"], self._arm.target]
        return Launches([recorded(kernels.act, self.num_envs, inputs, self._device)])

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps since a world's episode began, int32 [worlds], the kernels' memory; assigning writes into it."""
        return self._length

    @episode_length_buf.setter
    def episode_length_buf(self, value: torch.Tensor) -> None:
        """Write steps since a world's episode began."""
        self._length.copy_(value)

    # ---- stepping ------------------------------------------------------------------------------------------------

    def _launch(self, kernel: Any, *inputs: Any) -> None:
        """Launch a kernel, one thread a world; what it is given never changes, so the launch is recorded once."""
        if kernel not in self._recorded:
            self._recorded[kernel] = Launches([recorded(kernel, self.num_envs, inputs, self._device)])
        self._recorded[kernel]()

    def _begin(self) -> None:
        """Start the first episode of every world.

        Raises:
            InputError: No world has a place that keeps the rules of the scene.
        """
        self.done.fill_(True)
        self._launch(kernels.begin, self._warp["done"], self._rules, self._counters, self._max_noise)
        self._restart()
        if not bool((self.scene.breach == 0.0).any()):
            best = float(self.scene.breach.min())
            raise InputError("scene", "line", f"no place within reach in {self.num_envs} worlds ({best:.2g} m off)",
                             "ranges in which branches, line and arm meet")  # fmt: skip
        self._sense()
        self.done.fill_(False)

    def _restart(self) -> None:
        """Place the worlds that are done anew and put them at rest; capsules of all worlds are then where they are."""
        self.scene.place(self._warp["done"], self._counters.episode)
        self.simulator.reset(self.done)

    def _sense(self) -> None:
        self.sensor.update()
        y = self._arm
        self._launch(kernels.feel, y.q, y.qd, y.end_rotation, y.force, self._rules, self._counters, self._first,
                     self._seen)  # fmt: skip
        if "kept" in self._warp:
            self._launch(kernels.deliver, self._seen, self._counters, self._warp["kept"], self._warp["observation"])

    def _advance(self) -> None:
        """Launch one policy step; nothing is allocated, copied to the host or waited for."""
        w, y, c = self._warp, self._arm, self._counters
        self._launch(kernels.judge, *self._scores, y.qd, self._rules, c, w["reward"])
        for act in self._slices:
            act()
            self.simulator.step(self.cfg.period_steps)
        self._launch(kernels.close, self.simulator.state.alive.entries(), self._slot, y.q, y.qd, self._rules, c,
                     w["waiting"], self._max_noise, w["done"], w["time_out"], w["log"], w["sums"])  # fmt: skip
        self._restart()
        self._sense()

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
            actions: Shares of the joints' speed limits, clipped to -1..1, [worlds, dof].

        Returns:
            Observations, rewards [worlds], dones (bool, [worlds]) and extras: ``time_outs`` [worlds] and ``log``, the
            metrics [worlds] of the episodes so far, which count where a world is done. All are overwritten by the next
            step.
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
        """Return the means of all metrics over the episodes that ended since the last call, and ``episodes``.

        The only look from the host at the device's sums; nothing but ``episodes`` is returned where none ended.
        """
        sums = self._sums.sum(0).cpu()
        self._sums.zero_()
        count = float(sums[-1])
        if count == 0.0:
            return {"episodes": 0.0}
        return {name: float(sums[k]) / count for k, name in enumerate(METRICS)} | {"episodes": count}

    # ---- resume --------------------------------------------------------------------------------------------------

    def _tensors(self) -> dict[str, torch.Tensor]:
        out = {f"task {name}": wp.to_torch(array) for name, array in self._warp.items()}
        out |= {f"count {name}": wp.to_torch(getattr(self._counters, name)) for name in _COUNTERS + _MEASURES}
        for name in ("occlusion", "breach", "distances", "tick", "max_noise"):
            out[f"sensor {name}"] = getattr(self.sensor, name)
        out |= {f"scene {name}": tensor for name, tensor in self.scene.tensors().items()}
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

    def watch(self) -> Overlaps:
        """Return what counts how arm, branches, line and ground pass through each other, from the present state on."""
        foot: Any = wp.from_torch(self.scene.root, dtype=wp.vec3)
        return Overlaps(self.simulator, foot)

    def scenes(self) -> dict[str, float]:
        """Return what the present scenes are like: branches at the target, and shares of them [%] by rule.

        Of scenes in which nothing is left out (`all_scenes`) those shares are what the task leaves out otherwise.
        """
        share = {f"{name} %": 100.0 * float(found.float().mean()) for name, found in self.scene.left_out().items()}
        kept = 100.0 * float((self.scene.breach == 0.0).float().mean())
        return {
            "branches at the target": float(self.scene.crowd[:, 3].mean()),
            "places that keep the rules %": kept,
        } | share

    def render(self, world: int) -> NDArray[np.uint8]:
        """Return a picture of one world, [height, width, 3]."""
        from .picture import world_picture

        return world_picture(self.simulator, self.scene, world)
