"""Clearing branches from a target with the whole arm, as an rsl-rl environment in device memory (thesis 5.3-5.5)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from ...perception.sensor import Sensor
from ...sim.arms.arm import Arm
from ...sim.arms.registry import ARMS
from ...sim.arms.servo import with_servo
from ...sim.arms.simulator import ArmSimulator, Contacts
from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ...sim.pictures.tracer import View
from ...sim.scenes.scene import Axes, Scene, fork_height, grow_trees, seed_sequence, share_trees
from ...sim.trees.tree import Tree
from ...sim.wood.effects import give_effects, names_of
from . import picture
from .assembled import AssembledTask, Pace
from .clearing_parts import clearing_parts
from .settings import TaskSettings

SENSED = ("wbr", "zbr", "clr", "rob", "distances", "breach", "occlusion")
"""Features that the sensor writes."""


def pace_of(settings: TaskSettings) -> Pace:
    """Return how time passes in a clearing task: actions are speeds, and servos are led from one to the next."""
    return Pace(
        settings.policy_rate, settings.control_periods, settings.period_steps, settings.episode_steps,
        settings.action_delay, settings.observation_delay,
    )  # fmt: skip


class Powerline(AssembledTask):
    """Worlds of one tree, one target and one arm each, that restart by themselves.

    Attributes:
        scene, sensor: Where trees and targets are; clouds of points and scores.
    """

    def __init__(
        self, name: str, settings: TaskSettings, *, num_envs: int, seed: int, device: str, test: bool = False,
        arm: Arm | None = None,
    ) -> None:  # fmt: skip
        """Grow the trees, allocate all memory and start the first episodes.

        Args:
            name: One of `names.CLEARING`.
            settings: See `TaskSettings`; the task's own target goes in (`TaskSettings.of`).
            num_envs: Number of worlds.
            seed: Seed of everything random.
            device: ``cpu`` or ``cuda:N``.
            test: Whether worlds are those of a test set and branches touch the line.
            arm: The arm; None takes the one that the settings name.

        Raises:
            InputError: As `make_task`, or no world has a place that keeps the rules of the scene.
        """
        if num_envs < 1:
            raise InputError("task", "num_envs", str(num_envs), "1 or more worlds")
        self.name, self.cfg, self.num_envs, self.device = name, settings.check().of(name), num_envs, device
        arm = with_servo(ARMS.of(self.cfg.arm, "task", "arm") if arm is None else arm, self.cfg.servo)
        domain = "test" if test else "training"
        self._build_worlds(arm, seed, domain)
        words = seed_sequence(seed, domain).generate_state(7)[5:]
        self._assemble(clearing_parts(name, self.cfg, arm.num_dofs), pace_of(self.cfg),
                       wp.vec2ui(int(words[0]), int(words[1])),
                       self._scores())  # fmt: skip
        self.sensor.bind(self._seen, {f: self.columns[f] for f in SENSED if f in self.columns})
        self.simulator.line_mask.fill_(int(test))
        self._begin()

    def _scores(self) -> dict[str, wp.array]:
        """Return what the sensor has scored, as the kernels' memory."""
        out: dict[str, Any] = {n: wp.from_torch(getattr(self.sensor, n)) for n in ("occlusion", "breach", "max_noise")}
        return out

    def _build_worlds(self, arm: Arm, seed: int, domain: str) -> None:
        s = self.cfg.scene
        distinct = grow_trees(s, arm, self.num_envs, seed=seed, domain=domain)
        trees, index = share_trees(distinct, self.num_envs)
        contacts = self._contacts(distinct, all_on=domain == "test")
        names = names_of(s.effects)
        self.simulator = ArmSimulator(trees, arm, contacts=contacts, device=self.device, effects=names)
        give_effects(self.simulator, s.effects)
        self.scene = Scene(self.simulator, distinct, index, s, seed=seed, domain=domain)
        line = self.simulator.line
        target: Any = self.scene.target if s.target.strips > 1 else Axes(line.start, line.end)
        capsules: Any = self.simulator.capsules
        hand = self.simulator._arm.kernel[1].end_position
        points = int(seed_sequence(seed, domain).generate_state(5)[4] >> 1)
        self.sensor = Sensor(capsules, target, hand, self.cfg.sensor, seed=points, device=self.device)

    def _contacts(self, trees: list[Tree], *, all_on: bool) -> Contacts:
        """Return what touches what: in tests the arm touches itself, branches each other, and all the ground too.

        The ground is level with the lowest foot that a trunk can have.
        """
        scene = self.cfg.scene
        if not all_on:
            return Contacts(line_radius=scene.target.radius)
        ground = scene.height[0] - max(fork_height(tree) for tree in trees)
        return Contacts(line_radius=scene.target.radius, arm_arm=True, branch_branch=True, ground=ground)

    def _place(self, mask: wp.array, episode: wp.array) -> None:
        self.scene.place(mask, episode)

    def _look(self) -> None:
        self.sensor.update()

    def _begin(self) -> None:
        """Start the first episode of every world.

        Raises:
            InputError: No world has a place that keeps the rules of the scene.
        """
        super()._begin()
        if not bool((self.scene.breach == 0.0).any()):
            best = float(self.scene.breach.min())
            raise InputError("scene", "line", f"no place within reach in {self.num_envs} worlds ({best:.2g} m off)",
                             "ranges in which branches, line and arm meet")  # fmt: skip

    def _tensors(self) -> dict[str, torch.Tensor]:
        out = super()._tensors()
        for name in ("occlusion", "breach", "distances", "tick", "max_noise"):
            out[f"sensor {name}"] = getattr(self.sensor, name)
        return out | {f"scene {name}": tensor for name, tensor in self.scene.tensors().items()}

    @property
    def foot(self) -> torch.Tensor:
        """Foot of every world's trunk, where the ground is [m], [worlds, 3]."""
        return self.scene.root

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
        return picture.world_picture(self.simulator, self.scene, world)

    def solids(self, world: int) -> tuple[Array, Array, Array, Array]:
        """Return one world as capsules: start, end [C, 3] and radius [C] in m, 0 for none, colour [C, 3] in sRGB."""
        return picture.solids(self.simulator, self.scene, world)

    def view(self, world: int) -> View:
        """Return where one world is looked at from."""
        return picture.view_of(self.simulator, self.scene, world)
