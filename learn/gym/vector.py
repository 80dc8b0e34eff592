"""A task's worlds as a Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ...sim.base.errors import InputError, check_seed
from ..tasks.registry import known_tasks
from ..tasks.task import Task, task_seed, unseen_seed

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"]}
"""What an environment says of itself before it is made."""
Arrays = Literal["numpy", "torch"]
Mask = NDArray[np.bool_] | torch.Tensor
Numbers = NDArray[np.float32] | torch.Tensor


class TaskVectorEnv(VectorEnv):
    """A task's worlds, W of them, which restart by themselves in the step that ends their episode.

    Observations [W, O] and actions [W, A], -1 to 1, are float32; rewards are [W]. An episode that the step limit ends
    is truncated, any other terminated. ``infos`` holds ``final_obs`` (what the policy would have seen had the episode
    gone on) and ``final_info`` (the task's measures of the episode) where one has ended.

    Attributes:
        task: The task itself, an rsl-rl ``VecEnv`` on its device.
    """

    metadata = METADATA | {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self, task: str, num_envs: int = 1, *, settings: Any = None, set: Sequence[str] = (), seed: int = 0,
        device: str = "cpu", test: bool = False, arrays: Arrays = "numpy", render_mode: str | None = None,
    ) -> None:  # fmt: skip
        """Make the worlds.

        Args:
            task: Name of the task.
            num_envs: Worlds W.
            settings: Its settings; the device's preset if None.
            set: Settings that are others, ``name=value`` each, as of ``bough train --set``.
            seed: Seed of everything random: that of ``bough train --seed``, or of ``bough evaluate --seed`` in a test.
            device: ``cpu`` or ``cuda:N``.
            test: Whether worlds are those of a test set, with all contacts on.
            arrays: ``numpy`` (copies on the host) or ``torch`` (the task's own memory, which the next step overwrites).
            render_mode: ``rgb_array`` or None.

        Raises:
            InputError: There is no such task or option, its settings cannot be, or it has no final observations.
        """
        if arrays not in ("numpy", "torch"):
            raise InputError("gym", "arrays", repr(arrays), "numpy or torch")
        if render_mode not in (None, "rgb_array"):
            raise InputError("gym", "render_mode", repr(render_mode), "rgb_array or None")
        kind = known_tasks().of(task)
        settings = kind.presets[kind.preset_for(device)] if settings is None else settings
        self._settings, self._make = kind.changed(settings, tuple(set), "gym"), kind.make
        self._name, self._device, self._test, self._arrays = task, device, test, arrays
        self.num_envs, self.render_mode = num_envs, render_mode
        self._build(seed)
        self._spaces()
        about = {"render_fps": 1.0 / self.task.step_seconds, "task_version": self.task.version}
        self.metadata = type(self).metadata | about

    def _build(self, seed: int) -> None:
        """Make the worlds of a seed, and remember how they start."""
        check_seed("gym", seed)
        own = unseen_seed(seed, 0) if self._test else task_seed(seed, 0)
        self.task: Task = self._make(
            self._name, self._settings, num_envs=self.num_envs, seed=own, device=self._device, test=self._test
        )
        if not (hasattr(self.task, "restart") and hasattr(self.task, "keep_final")):
            raise InputError("gym", self._name, "a task without restart and keep_final", "tasks that are made of parts")
        self._final: torch.Tensor = self.task.keep_final()
        self._seed, self._begun, self._start = seed, False, self.task.snapshot()

    def _spaces(self) -> None:
        columns = self.task.get_observations()["policy"].shape[1]
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (columns,), np.float32)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (self.task.num_actions,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Numbers, dict[str, Any]]:
        """Begin episodes in all worlds; return observations [W, O] and nothing more.

        With a seed the worlds are those of that seed from their start, as if newly made; another seed grows other
        trees. Without one the first call returns the worlds as they were made, and every other begins new episodes.
        """
        super().reset(seed=seed)
        if seed is not None and seed != self._seed:
            self._build(seed)
        elif seed is not None:
            self.task.restore(self._start)
        elif self._begun:
            self.task.restart()  # type: ignore[attr-defined]
        self._begun = True
        return self.observation(), {}

    def observation(self) -> Numbers:
        """Return the present observations, [W, O]."""
        return self._given(self.task.get_observations()["policy"])

    def step(self, actions: Numbers) -> tuple[Numbers, Numbers, Mask, Mask, dict[str, Any]]:
        """Act for one policy step; actions [W, A] are an array or a tensor.

        Returns:
            Observations [W, O], rewards [W], terminations and truncations (bool, [W]) and infos.
        """
        wanted = torch.as_tensor(actions, dtype=torch.float32, device=self._device)
        with torch.inference_mode():
            _, rewards, dones, extras = self.task.step(wanted)
            over, cut = dones > 0, extras["time_outs"] > 0
            ends = self._given(over & ~cut), self._given(over & cut)
        infos = self._infos(over, extras["log"])
        return self.observation(), self._given(rewards), *ends, infos

    def _given(self, tensor: torch.Tensor) -> Any:
        """Return a tensor as the user wants it: itself, or a copy on the host."""
        return tensor if self._arrays == "torch" else tensor.numpy(force=True).copy()

    def _infos(self, over: torch.Tensor, log: dict[str, torch.Tensor]) -> dict[str, Any]:
        """Return what is known of the episodes that are over, in Gymnasium's form; tensors are of all worlds."""
        if self._arrays == "torch":
            return {"final_obs": self._final, "_final_obs": over, "final_info": dict(log), "_final_info": over}
        mask = over.numpy(force=True).copy()
        if not mask.any():
            return {}
        last, final = self._given(self._final), np.full(self.num_envs, None, dtype=object)
        for world in np.flatnonzero(mask):
            final[world] = last[world]
        info = {name: np.where(mask, self._given(value), 0.0).astype(np.float32) for name, value in log.items()}
        info |= {f"_{name}": mask for name in log}
        return {"final_obs": final, "_final_obs": mask, "final_info": info, "_final_info": mask}

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture of every world, [H, Wd, 3] each, in mode ``rgb_array``."""
        if self.render_mode is None:
            return None
        return tuple(self.task.render(world) for world in range(self.num_envs))
