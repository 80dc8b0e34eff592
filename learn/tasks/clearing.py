"""Tasks of clearing branches from a target with the whole arm: ``powerline``, ``exposure``, ``inspection``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .settings import TaskSettings, check_name
from .task import require_rsl_rl

if TYPE_CHECKING:
    from .powerline import Powerline


def make_task(
    name: str, settings: TaskSettings, *, num_envs: int, seed: int, device: str, test: bool = False
) -> Powerline:
    """Make a task's worlds.

    Args:
        name: ``powerline``, ``exposure`` or ``inspection``.
        settings: Its settings.
        num_envs: Number of worlds.
        seed: Seed of everything random. Tests draw other numbers from the same seed than training.
        device: ``cpu`` or ``cuda:N``.
        test: Whether all contacts are on and worlds are those of a test set.

    Raises:
        InputError: There is no such task or observation group, no world, a line out of reach, or rsl-rl is missing.
    """
    check_name(name)
    settings.check()
    require_rsl_rl()
    from .powerline import Powerline

    return Powerline(name, settings, num_envs=num_envs, seed=seed, device=device, test=test)
