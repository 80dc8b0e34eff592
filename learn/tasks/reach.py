"""An arm that reaches a target through branches that it cannot see, as an rsl-rl environment (thesis, chapter 4)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from ...sim.arms.arm import Arm
from ...sim.arms.registry import ARMS
from ...sim.arms.servo import with_servo
from ...sim.arms.simulator import ArmSimulator, Contacts
from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ...sim.pictures.tracer import View
from ...sim.scenes.reach_scene import PATTERNS, TARGETS, ReachPlaces, grow_reach_trees, joint_strength
from ...sim.scenes.scene import fork_height, seed_sequence
from ...sim.trees.tree import Tree
from ...sim.wood.effects import give_effects, names_of
from ..touch.model import TouchModel
from ..touch.sensor import TorqueSensor
from . import picture
from .assembled import AssembledTask, Pace
from .parts import Parts
from .reach_parts import reach_parts
from .reach_settings import ReachSettings
from .touch_flag import TouchFlag, read_classifier, read_told_by


class BranchTask(AssembledTask):
    """Worlds of an arm, a tree of its own each, and a target for the hand; what it is about is said by parts.

    ``own`` of the parts may have an array ``target``, vec3 [worlds]: it is where the hand is to go [m].

    Attributes:
        places: Where trees and targets are.
    """

    def __init__(
        self, settings: ReachSettings, parts: Parts | None = None, *, num_envs: int = 64, seed: int = 0,
        device: str = "cpu", test: bool = False, arm: Arm | None = None, first: int = 0,
    ) -> None:  # fmt: skip
        """Grow the trees, allocate all memory and start the first episodes.

        Args:
            settings: Trees, places, control and rates; policy and rewards too, where no parts are given.
            parts: What the task is made of; None takes chapter 4's.
            num_envs: Number of worlds.
            seed: Seed of everything random.
            device: ``cpu`` or ``cuda:N``.
            test: Whether worlds are those of a test set and all contacts are on.
            arm: The arm; None takes the one that the settings name.
            first: Number of the first world in its test set, which says its target and pattern.

        Raises:
            InputError: The settings, the parts, or the files that they name.
        """
        if num_envs < 1:
            raise InputError("task", "num_envs", str(num_envs), "1 or more worlds")
        self.cfg, self.num_envs, self.device = settings.check(), num_envs, device
        arm = with_servo(ARMS.of(self.cfg.arm, "task", "arm") if arm is None else arm, self.cfg.servo)
        parts = reach_parts(settings, arm.num_dofs, test=test) if parts is None else parts
        self.name, domain = parts.name, "test" if test else "training"
        told = self._read_classifier(arm.num_dofs) if settings.flag == "classifier" and "told" in parts.arrays else None
        self._build_worlds(arm, seed, domain, first)
        words = seed_sequence(seed, domain).generate_state(7)[5:]
        key = wp.vec2ui(int(words[0]), int(words[1]))
        given = {"target": self.places.target_array, "joint_broken": self._joint_broken()}
        shared = {name: array for name, array in given.items() if name in parts.arrays}
        self._assemble(parts, pace_of(settings), key, shared)
        self._touch = None if told is None else self._touch_flag(key, *told)
        self._begin()

    def _build_worlds(self, arm: Arm, seed: int, domain: str, first: int) -> None:
        s = self.cfg.scene
        trees = grow_reach_trees(s, arm, self.num_envs, seed=seed, domain=domain)
        self.simulator = ArmSimulator(trees, arm, contacts=self._contacts(trees, all_on=domain == "test"),
                                      device=self.device, effects=names_of(s.effects),
                                      breakable=s.strength > 0.0)  # fmt: skip
        give_effects(self.simulator, s.effects)
        for world, tree in enumerate(trees if self.simulator.rupture is not None else ()):
            bears = torch.as_tensor(joint_strength(tree, s.strength), dtype=torch.float32)
            self.simulator.rupture.strength[world, : tree.num_links] = bears  # type: ignore[union-attr]
        self.places = ReachPlaces(self.simulator, trees, s, seed=seed, domain=domain, first=first)

    def _joint_broken(self) -> wp.array:
        """Return which joints are broken, [worlds, links]; one that never is where wood has no strength."""
        rupture = self.simulator.rupture
        never: wp.array = wp.zeros((self.num_envs, 1), dtype=int, device=self.simulator.model.device)
        return never if rupture is None else rupture.broken_array

    def _contacts(self, trees: list[Tree], *, all_on: bool) -> Contacts:
        """Return what touches what: in tests the arm touches itself, branches each other, and all the ground too."""
        if not all_on:
            return Contacts(arm_line=False)
        ground = self.cfg.scene.height[0] - max(fork_height(tree) for tree in trees)
        return Contacts(arm_line=False, arm_arm=True, branch_branch=True, ground=ground)

    def _place(self, mask: wp.array, episode: wp.array) -> None:
        self.places.place(mask, episode)

    def _read_classifier(self, dofs: int) -> tuple[TouchModel, int, TorqueSensor]:
        s = self.cfg
        return *read_classifier(Path(s.classifier), dofs, s.control_rate), read_told_by(s.sensor, dofs)

    def _touch_flag(self, key: Any, model: TouchModel, every: int, sensor: TorqueSensor) -> TouchFlag:
        s = self.cfg
        return TouchFlag(self.simulator, model, sensor, clock=self._clock, key=key, periods=s.control_periods,
                         every=every, control_rate=s.control_rate, flag=self._own.told)  # fmt: skip

    def _take(self, period: int) -> None:
        if self._touch is not None:
            self._touch.take(period)

    def restore(self, snapshot: dict[str, torch.Tensor]) -> None:
        """Go back to a snapshot of a task made with the same arguments: what follows is the same to the bit.

        Raises:
            ValueError: The snapshot is of another task, or of one with another classifier of touch.
        """
        if self._touch is not None and not self._touch.same_model(snapshot):
            raise ValueError("another classifier of touch")
        super().restore(snapshot)

    def _tensors(self) -> dict[str, torch.Tensor]:
        touch = {} if self._touch is None else self._touch.tensors()
        places = {f"scene {name}": tensor for name, tensor in self.places.tensors().items()}
        wood = {} if self.simulator.rupture is None else self.simulator.rupture.tensors()
        return super()._tensors() | places | touch | {f"wood {name}": tensor for name, tensor in wood.items()}

    @property
    def foot(self) -> torch.Tensor:
        """Foot of every world's trunk, where the ground is [m], [worlds, 3]."""
        return self.places.root

    def targets(self) -> torch.Tensor:
        """Return the number of every world's target, int64 [worlds]: in tests the same one for five worlds of a set."""
        number = torch.arange(self.num_envs, device=self.places.pattern.device)
        return number // len(PATTERNS) % TARGETS if bool((self.places.pattern >= 0).all()) else number

    def strata(self) -> dict[str, torch.Tensor]:
        """Return which worlds have which occlusion pattern, bool [worlds] by name; nothing in training."""
        kinds = {f"turned by {turn:.0f}": self.places.pattern == k for k, turn in enumerate(PATTERNS)}
        return {name: mask for name, mask in kinds.items() if bool(mask.any())}

    def scenes(self) -> dict[str, float]:
        """Return what the present scenes are like: the share of places that keep the rules [%]."""
        return {"places that keep the rules %": 100.0 * float((self.places.breach == 0.0).float().mean())}

    def render(self, world: int) -> NDArray[np.uint8]:
        """Return a picture of one world with its forces, [height, width, 3]."""
        return picture.reach_picture(self.simulator, self.foot, self._target(world), self.cfg.within, world)

    def solids(self, world: int) -> tuple[Array, Array, Array, Array]:
        """Return one world as capsules: start, end [C, 3] and radius [C] in m, 0 for none, colour [C, 3] in sRGB."""
        return picture.reach_solids(self.simulator, self._target(world), self.cfg.within, world)

    def view(self, world: int) -> View:
        """Return where one world is looked at from."""
        return picture.reach_view(self.foot, self._target(world), world)

    def _target(self, world: int) -> Array:
        out: Array = self.places.target[world].cpu().numpy().astype(np.float64)
        return out


def pace_of(settings: ReachSettings) -> Pace:
    """Return how time passes in ``reach``: actions are changes of joint speeds."""
    s: Any = settings
    return Pace(
        s.policy_rate, s.control_periods, s.period_steps, s.episode_steps, s.action_delay, s.observation_delay,
        s.control, s.speed_step, s.reward_scale,
    )  # fmt: skip
