"""One world of a task as a Gymnasium environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from .vector import METADATA, TaskVectorEnv


class TaskEnv(gymnasium.Env):
    """One world of a task; for learning take `TaskVectorEnv`, in which thousands cost little more.

    Args:
        task: Name of the task.
        options: As of `TaskVectorEnv`, without num_envs and arrays.

    Attributes:
        worlds: The one world.
    """

    metadata = METADATA

    def __init__(self, task: str, **options: Any) -> None:
        self.worlds = TaskVectorEnv(task, 1, **options)
        self.metadata = {k: v for k, v in self.worlds.metadata.items() if k != "autoreset_mode"}
        self.render_mode = self.worlds.render_mode
        self.observation_space = self.worlds.single_observation_space
        self.action_space = self.worlds.single_action_space
        self._over = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode; return the observation [O] and nothing more. Seeds are as in `TaskVectorEnv.reset`."""
        super().reset(seed=seed)
        begun = self._over and seed is None  # the world has started anew by itself
        observation = self.worlds.observation() if begun else self.worlds.reset(seed=seed)[0]
        self._over = False
        return np.asarray(observation[0]), {}

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Act, [A]; return observation [O], reward, whether terminated, whether truncated, and measures at an end."""
        observation, reward, ended, cut, infos = self.worlds.step(np.asarray(action)[None])
        self._over = bool(ended[0] or cut[0])
        seen = infos["final_obs"][0] if self._over else observation[0]
        measures = {k: float(v[0]) for k, v in infos["final_info"].items() if k[0] != "_"} if self._over else {}
        return np.asarray(seen), float(reward[0]), bool(ended[0]), bool(cut[0]), measures

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture, [H, Wd, 3], in mode ``rgb_array``."""
        pictures = self.worlds.render()
        return None if pictures is None else pictures[0]
