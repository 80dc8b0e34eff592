"""Tasks of clearing branches from a target with the whole arm: ``powerline``, ``exposure``, ``inspection``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .settings import TaskSettings, check_name
from .task import require_rsl_rl

if TYPE_CHECKING:
    from .powerline import Powerline


def make_task(
    name: str, settings: TaskSettings | None = None, *, num_envs: int = 64, seed: int = 0, device: str = "cpu",
    test: bool = False,
) -> Powerline:  # fmt: skip
    """Make a task's worlds: an rsl-rl ``VecEnv`` whose tensors never leave the device.

    Args:
        name: ``powerline``, ``exposure`` or ``inspection``.
        settings: Its settings; None takes the preset ``cpu``.
        num_envs: Number of worlds.
        seed: Seed of everything random. Tests draw other numbers from the same seed than training.
        device: ``cpu`` or ``cuda:N``.
        test: Whether all contacts are on and worlds are those of a test set.

    Raises:
        InputError: There is no such task or observation group, no world, a line out of reach, or rsl-rl is missing.
    """
    check_name(name)
    settings = settings or TaskSettings()
    settings.check()
    require_rsl_rl()
    from .powerline import Powerline

    return Powerline(name, settings, num_envs=num_envs, seed=seed, device=device, test=test)
