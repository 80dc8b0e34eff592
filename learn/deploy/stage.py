"""A twin that holds the scene of a task: an unseen test world, begun anew on request, with the truth about it."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ...sim.cameras.described import Scene, arm_world, packed
from ..robot.backend import Sample
from ..runs.folder import CONFIG, RunFolder
from ..tasks.assembled import AssembledTask
from ..tasks.powerline import Powerline
from ..tasks.reach import BranchTask
from ..tasks.task import unseen_seed
from ..touch.record import carrying_torque
from .plan import CLEARS, REACHES, Plan, plan_of

_STEPS = 240  # a second
_MOST = 24  # steps at once: a loop that stood for longer loses time instead of hurrying after it
_LINE = 256  # points of a line that is told
_STEP_PERIODS = 4  # physics steps of a control period


def make_world(plan: Plan, seed: int, number: int) -> AssembledTask:
    """Make one unseen world of a task, all contacts on: the first of test set ``number`` of `bough evaluate`.

    In ``reach`` its target and its pattern are those of world ``number`` of a set, so that they differ.

    Args:
        plan: The task.
        seed: Seed of the test sets.
        number: Of the world, from 0.

    Raises:
        InputError: No place keeps the rules of the scene.
    """
    own = unseen_seed(seed, number)
    if plan.name == CLEARS:
        return Powerline(plan.name, plan.settings, num_envs=1, seed=own, device="cpu", test=True, arm=plan.arm)
    settings = plan.settings
    return BranchTask(settings, num_envs=1, seed=own, device="cpu", test=True, arm=plan.arm, first=number)


class Stage:
    """One world of a task in real time (`learn.robot.backend.Backend`), on the CPU.

    An episode is counted from the first speed that the arm is asked for; it is judged by the task's own kernels, in the
    state that a policy step of the task begins with, and is over after as many steps as the task has. The arm goes on
    then, but nothing counts any more.

    Attributes:
        num_dofs: Number of joints.
        number: Of the episode.
    """

    def __init__(self, plan: Plan, seed: int, number: int = 0) -> None:
        """Make the first world.

        Args:
            plan: The task.
            seed: Seed of the worlds (`make_world`).
            number: Of the first episode.

        Raises:
            InputError: As `make_world`.
        """
        self.num_dofs, self._plan, self._seed = plan.arm.num_dofs, plan, seed
        self._lock = threading.Lock()
        self._until: float | None = None
        self._next: tuple[int, AssembledTask] | None = None
        self._set_up(number, self._made(number))

    def _made(self, number: int) -> AssembledTask:
        task = make_world(self._plan, self._seed, number)
        with torch.no_grad():
            for count in range(1, _STEP_PERIODS + 1):  # launches are prepared now, so that no tick waits for it
                task.simulator.step(count)
            task.simulator.reset()
        return task

    def _set_up(self, number: int, task: AssembledTask) -> None:
        self.number, self.task = number, task
        self._steps, self._running, self._over = 0, False, False
        self._measures: dict[str, float] = {}

    # ---- the arm -----------------------------------------------------------------------------------------------------

    def read(self, now: float) -> Sample:
        """Bring the world to ``now`` [s] and measure.

        Raises:
            RuntimeError: The world was lost.
        """
        with self._lock:
            until = now if self._until is None else self._until
            steps = int((now - until) * _STEPS + 1e-6)
            self._until = until + steps / _STEPS if steps <= _MOST else now
            self._advance(min(steps, _MOST))
            sim = self.task.simulator
            if sim.faults():
                raise RuntimeError("the simulated world left the finite")
            q, qd, torque, at, turn = (
                x[0].numpy().astype(np.float64) for x in (sim.q, sim.qd, sim.torque, sim.end_position, sim.end_rotation)
            )
        return Sample(now, q, qd, torque - carrying_torque(self._plan.arm, q), at, turn)

    def send(self, velocity: Array) -> None:
        """Ask the servos for joint speeds [rad/s], [D]."""
        with self._lock:
            self._running = self._running or bool(velocity.any())
            self.task.simulator.target[0] = torch.from_numpy(velocity.astype(np.float32))

    def close(self) -> None:
        """Let the world stand as it is."""

    def _advance(self, steps: int) -> None:
        """Step the physics; where an episode runs, sample and judge it as the task does while it is trained."""
        while steps > 0:
            part = min(steps, _STEP_PERIODS - self._steps % _STEP_PERIODS)
            counted = self._running and not self._over
            if counted and self._steps % (_STEP_PERIODS * self._plan.pace.control_periods) == 0:
                self.task.judge()
            self.task.simulator.step(part)
            steps -= part
            if counted:
                self._steps += part
                self._count()

    def _count(self) -> None:
        periods = self._plan.pace.control_periods
        if self._steps % _STEP_PERIODS:
            return
        period = (self._steps // _STEP_PERIODS - 1) % periods
        self.task.sample(period)
        if period == periods - 1:
            self.task.end_step()
            self._measures = {name: float(value[0]) for name, value in self.task.measured().items()}
            self._over = bool(self.task.done[0])
            self.task.simulator.look()
            self.task.sense()

    # ---- what only a twin has ----------------------------------------------------------------------------------------

    def begin(self, number: int) -> None:
        """Put the arm at rest at home in another world; from any thread. Waits until that world is made.

        Raises:
            InputError: As `make_world`.
        """
        made = self._made(number)
        with self._lock:
            self._set_up(number, made)

    def scene(self) -> bytes:
        """Return the world as it is, for cameras in another process (`sim.cameras.described`)."""
        with self._lock:
            self.task.simulator.look()
            sim, age = self.task.simulator, 0.0 if self._until is None else time.monotonic() - self._until
            hand, turn = (x[0].numpy().astype(np.float64) for x in (sim.end_position, sim.end_rotation))
            ground = min(0.0, float(self.task.foot[0, 2]))
            return packed(Scene(arm_world(sim, 0, ground), age, hand, turn))

    def truth(self) -> dict[str, Array]:
        """Return all that is true of the world now, by name; arrays, from any thread.

        - ``number`` of the episode, ``seconds`` counted of it, ``over``: whether it has had all its steps;
        - ``measure NAME``: the task's measures so far, ``success`` among them; none before the first policy step;
        - ``force`` [D, 3]: net contact force on every link [N]; ``felt``: norm of all, a mean of three control periods;
        - ``start``, ``end`` [C, 3], ``radius`` [C]: capsules [m], those of the arm first, ``arm`` of them; ``level``
          [C]: branching level of wood;
        - ``target`` [3]: where the hand is to go [m], or ``line`` [N, 3]: points along the line's axis, end to end, and
          ``line_radius``; ``root`` [3]: the trunk's foot;
        - ``branches`` [P, 3]: points on branches as the task would show them to a policy, with their noise;
          ``occlusion`` and ``breach`` as it scores them.
        """
        with self._lock:
            self.task.simulator.look()
            out = {f"measure {name}": np.array(value) for name, value in self._measures.items()}
            out |= {"number": np.array(self.number), "seconds": np.array(self._steps / _STEPS),
                    "over": np.array(self._over)}  # fmt: skip
            return out | self._bodies() | (self._clearing() if self._plan.name == CLEARS else self._reaching())

    def _bodies(self) -> dict[str, Array]:
        sim, task = self.task.simulator, self.task
        c, tree = sim.capsules, sim.model.trees[0]
        out = {name: _row(getattr(c, name)) for name in ("start", "end", "radius")}
        level = np.zeros(len(out["radius"]))
        level[c.num_arm : c.num_arm + len(tree.shape_link)] = tree.level[tree.shape_link]
        force = sim.arm_force[0].numpy()
        out |= {"arm": np.array(c.num_arm), "level": level, "force": force.copy(), "felt": np.array(self._felt(force)),
                "root": task.foot[0].numpy().copy()}  # fmt: skip
        return out

    def _felt(self, force: Array) -> float:
        if "felt" in self.task.parts.arrays:
            return float(self.task.own("felt")[0])
        return math.sqrt(float(np.square(force).sum()))

    def _clearing(self) -> dict[str, Array]:
        task: Any = self.task
        points, _ = task.sensor.clouds()
        start, end = task.simulator.line_start[0].numpy(), task.simulator.line_end[0].numpy()
        along = np.linspace(0.0, 1.0, _LINE)[:, None]
        out = {"branches": points[0, 2].T.numpy().copy(), "line": (start + along * (end - start)).astype(np.float32),
               "line_radius": np.array(task.simulator.line.radius)}  # fmt: skip
        return out | {name: getattr(task.sensor, name).numpy().copy() for name in ("occlusion", "breach")}

    def _reaching(self) -> dict[str, Array]:
        task: Any = self.task
        return {"target": task.places.target[0].numpy().copy()}


def _row(array: Any) -> Array:
    return np.array(wp.to_torch(array)[0].numpy())


def scene_plan(scene: str, command: str) -> Plan:
    """Return the plan of a scene: ``powerline`` or ``reach`` of the preset ``cpu``, or that of a run, by its folder.

    Args:
        scene: The scene.
        command: What errors name.

    Raises:
        InputError: There is neither such a task nor such a run, or its task is none that an arm can be given.
    """
    from ..tasks.registry import known_tasks, settings_from

    registry = known_tasks()
    if scene in (CLEARS, REACHES):
        return plan_of(scene, registry.of(scene).presets["cpu"], f"{command} --scene")
    if not Path(scene).is_dir():
        raise InputError(command, "--scene", scene, f"{CLEARS}, {REACHES}, or the folder of a run")
    folder = RunFolder(Path(scene))
    config, source = folder.config(), folder.path / CONFIG
    name = config["task"]["name"]
    settings = settings_from(registry.of(name).settings, config["task"]["settings"], source)
    return plan_of(name, settings, source)
