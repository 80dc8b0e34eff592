"""What training asks of a task, and the seeds of its worlds."""

from __future__ import annotations

import hashlib
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol

from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint

if TYPE_CHECKING:
    import numpy as np
    import torch
    from numpy.typing import NDArray
    from tensordict import TensorDict


class Task(Protocol):
    """An rsl-rl ``VecEnv`` with a name, a version and a state that can be kept.

    Worlds restart by themselves when their episode ends. Buffers may be written in place by the next step. A task may
    have more methods. For tests: ``scenes()``, which returns numbers about the present worlds by name, ``watch()``,
    which returns a `Watch`, ``strata()``, which returns kinds of worlds by name, bool [W] each, and ``targets()``,
    which returns which worlds of all test sets are about the same, int [W]. A task under a constraint has
    ``cost_limit``, what the mean cost of a step may be, and ``cost`` [W] in the extras of a step. For Gymnasium:
    ``restart()``, which begins new episodes in all worlds, and ``keep_final()``, which returns the memory in which the
    last observations of episodes are kept from then on, [W, O].

    Attributes:
        name: Name in the registry.
        version: Raised whenever observations, actions or rewards change their meaning.
        num_envs: Worlds W.
        num_actions: Actions A, each of -1 to 1.
        max_episode_length: Policy steps of an episode.
        episode_length_buf: Steps since a world's episode began, shape [W]; may be written in place.
        step_seconds: Simulated time of a policy step [s].
        device: Where its tensors are.
        cfg: Its settings.
        metrics: What it says of every finished episode; ``return`` and ``success`` (1 or 0) are among it.
    """

    name: str
    version: int
    num_envs: int
    num_actions: int
    max_episode_length: int | torch.Tensor
    episode_length_buf: torch.Tensor
    step_seconds: float
    device: torch.device | str
    cfg: Any
    metrics: tuple[str, ...]

    def get_observations(self) -> TensorDict:
        """Return the observations, a group ``policy`` of shape [W, O]; after `restore` those of the snapshot."""

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Act, shape [W, A]; return observations, rewards [W], dones [W] and extras.

        Extras hold ``time_outs`` [W], 1 where an episode ended by its length alone, and ``log``, a tensor [W] for each
        of ``metrics``, which counts where a world is done.
        """

    def snapshot(self) -> dict[str, torch.Tensor]:
        """Return copies of everything that the future depends on, counters of random numbers included."""

    def restore(self, snapshot: dict[str, torch.Tensor]) -> None:
        """Go back to a snapshot of a task made with the same arguments."""

    def render(self, world: int) -> NDArray[np.uint8]:
        """Return a picture of one world, shape [H, Wd, 3]."""


class Watch(Protocol):
    """Counts what passes through what in a task's worlds, if the task has a ``watch()`` that returns one."""

    def measure(self, mask: torch.Tensor) -> None:
        """Look at the masked worlds (bool, [W]) as they are now."""

    def rows(self) -> dict[str, dict[str, float]]:
        """Return by what overlaps: ``steps %``, share of the steps looked at, and ``deepest mm``."""


def require_rsl_rl() -> None:
    """Raise `InputError` where the optional part that training needs is not installed."""
    for name in ("rsl_rl", "tensordict"):
        if find_spec(name) is None:
            raise InputError("bough", "", f"no {name}", install_hint("train"))


def task_seed(seed: int, rank: int) -> int:
    """Return the seed of the worlds that a process trains on, an even number of 31 bits."""
    return 2 * _hashed("train", seed, rank)


def unseen_seed(seed: int, index: int) -> int:
    """Return the seed of a test set: an odd number of 31 bits, so never one that anything is trained with."""
    return 2 * _hashed("test", seed, index) + 1


def policy_seed(seed: int, rank: int) -> int:
    """Return the seed of a process's policy: first parameters, actions, order of the samples."""
    return _hashed("policy", seed, rank)


def _hashed(*parts: object) -> int:
    return int.from_bytes(hashlib.sha256(repr(parts).encode()).digest()[:4], "big") >> 2
