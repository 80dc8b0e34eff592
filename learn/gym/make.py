"""Making Gymnasium environments, and their registration."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint
from ..tasks.registry import TASKS

if TYPE_CHECKING:
    from .vector import TaskVectorEnv


def make_gym(task: str, num_envs: int = 64, **options: Any) -> TaskVectorEnv:
    """Make a task's worlds as a Gymnasium vector environment.

    Args:
        task: Name of the task, bough's own or of an installed package.
        num_envs: Worlds.
        options: As of `learn.gym.vector.TaskVectorEnv`: settings, seed, device, test, arrays, render_mode.

    Returns:
        ``step(actions [num_envs, joints])`` gives observations [num_envs, numbers], rewards, ends and cuts [num_envs].

    Raises:
        InputError: gymnasium or rsl-rl is not installed, there is no such task, or its settings cannot be.
    """
    require_gymnasium()
    from .vector import TaskVectorEnv

    return TaskVectorEnv(task, num_envs, **options)


def register() -> None:
    """Register all tasks, those of installed packages too, with Gymnasium as ``bough/NAME-v0``.

    Raises:
        InputError: gymnasium is not installed.
    """
    require_gymnasium()
    import gymnasium

    for name in TASKS.names:
        gymnasium.register(
            id=f"bough/{name}-v0", entry_point="bough.learn.gym.single:TaskEnv",
            vector_entry_point="bough.learn.gym.vector:TaskVectorEnv", kwargs={"task": name},
        )  # fmt: skip


def require_gymnasium() -> None:
    """Raise `InputError` where Gymnasium is not installed."""
    if find_spec("gymnasium") is None:
        raise InputError("bough", "", "no gymnasium", install_hint("gym"))
