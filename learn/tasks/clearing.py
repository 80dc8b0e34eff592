"""Making tasks: clearing branches with the whole arm (``powerline``, ``exposure``, ``inspection``), and ``reach``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...sim.base.errors import InputError
from ...sim.base.host import check_memory
from .settings import TaskSettings, check_name
from .task import require_rsl_rl

if TYPE_CHECKING:
    from .powerline import Powerline
    from .reach import BranchTask
    from .reach_settings import ReachSettings


WORLD_BYTES = 100_000
"""Bytes of memory a world takes at least: 6144 of preset gpu took 145 kB each."""


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

    Returns:
        The worlds: ``step(actions [worlds, joints])`` gives observations (``policy``: [worlds, numbers]), reward
        [worlds], done [worlds] and extras.

    Raises:
        InputError: There is no such task or observation group, no world, a line out of reach, or rsl-rl is missing.
    """
    check_name(name)
    settings = settings or TaskSettings()
    settings.check()
    require_rsl_rl()
    _check_memory(num_envs, device)
    from .powerline import Powerline

    return Powerline(name, settings, num_envs=num_envs, seed=seed, device=device, test=test)


def make_reach(
    name: str = "reach", settings: ReachSettings | None = None, *, num_envs: int = 64, seed: int = 0,
    device: str = "cpu", test: bool = False,
) -> BranchTask:  # fmt: skip
    """Make the worlds of ``reach``: an rsl-rl ``VecEnv`` whose tensors never leave the device.

    Args:
        name: ``reach``.
        settings: Its settings; None takes the preset ``cpu``.
        num_envs: Number of worlds.
        seed: Seed of everything random. Tests draw other numbers from the same seed than training.
        device: ``cpu`` or ``cuda:N``.
        test: Whether all contacts are on and worlds are those of a test set: fixed targets, five occlusion patterns.

    Raises:
        InputError: Settings that cannot be, no world, or rsl-rl is missing.
    """
    from .names import REACHING
    from .reach_settings import ReachSettings

    if name not in REACHING:
        raise InputError("task", "", name, ", ".join(REACHING))
    settings = (settings or ReachSettings()).check()
    require_rsl_rl()
    _check_memory(num_envs, device)
    from .reach import BranchTask

    return BranchTask(settings, num_envs=num_envs, seed=seed, device=device, test=test)


def _check_memory(num_envs: int, device: str) -> None:
    import warp as wp

    found = wp.get_device(device)
    there = found.total_memory if found.is_cuda else None
    check_memory("--num-envs", f"{num_envs} worlds", float(num_envs) * WORLD_BYTES, there)
