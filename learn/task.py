"""What training asks of a task, and where tasks are found by name."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol, get_type_hints

from ..sim.console import warn
from ..sim.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    import torch
    from numpy.typing import NDArray
    from tensordict import TensorDict

    from ..sim.posterior_stiffness import Wood
    from ..sim.wood_effects import WoodEffects

METRICS = ("return", "success", "occlusion_drop", "breach", "steps_clear")
"""What a task says of every finished episode: sum of rewards; 1 or 0; share of the starting occlusion that is gone;
share of steps inside the safety margin; steps without occlusion."""


class Task(Protocol):
    """An rsl-rl ``VecEnv`` with a name, a version and a state that can be kept.

    Worlds restart by themselves when their episode ends. Buffers may be written in place by the next step.

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

    def get_observations(self) -> TensorDict:
        """Return the observations, a group ``policy`` of shape [W, O]; after `restore` those of the snapshot."""

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Act, shape [W, A]; return observations, rewards [W], dones [W] and extras.

        Extras hold ``time_outs`` [W], 1 where an episode ended by its length alone, and ``log``, a tensor [W] for each
        of `METRICS`, which counts where a world is done.
        """

    def snapshot(self) -> dict[str, torch.Tensor]:
        """Return copies of everything that the future depends on, counters of random numbers included."""

    def restore(self, snapshot: dict[str, torch.Tensor]) -> None:
        """Go back to a snapshot of a task made with the same arguments."""

    def render(self, world: int) -> NDArray[np.uint8]:
        """Return a picture of one world, shape [H, Wd, 3]."""


@dataclass(frozen=True)
class TaskRegistry:
    """Tasks by name.

    Attributes:
        names: Names of the tasks.
        groups: Names of the observation groups, all of which can be left out but not together.
        presets: Settings by the name of a preset, frozen dataclasses with a field ``groups``: names of those left in.
        make: Called with name, settings, num_envs, seed, device and test (all contacts on); returns the task.
        of_wood: Called with settings, the wood of a measured branch and its effects; returns the settings of tasks
            whose trees are of it. None where tasks have no trees.
    """

    names: tuple[str, ...]
    groups: tuple[str, ...]
    presets: Mapping[str, Any]
    make: Callable[..., Task]
    of_wood: Callable[[Any, Wood, WoodEffects], Any] | None = None

    @property
    def settings(self) -> type:
        """Return the dataclass of the settings."""
        return type(self.presets["cpu"])

    def check_name(self, name: str) -> None:
        """Raise `InputError` for a task that does not exist."""
        if name not in self.names:
            raise InputError("task", "", name, ", ".join(self.names))

    def without(self, settings: Any, left_out: tuple[str, ...]) -> Any:
        """Return settings without some observation groups.

        Raises:
            InputError: There is no such group, or none is left.
        """
        for name in left_out:
            if name not in self.groups:
                raise InputError("train", "--without", name, ", ".join(self.groups))
        kept = tuple(g for g in settings.groups if g not in left_out)
        if not kept:
            raise InputError("train", "--without", "every group", "all groups but one at most")
        return replace(settings, groups=kept)

    def of_model(self, settings: Any, model: Path) -> Any:
        """Return settings whose trees are of the wood of a branch's ``model.yaml``, as those of ``bough forest`` are.

        Effects of the branch act in the trees; those of its measurement are left out, and a line of warning names them.

        Raises:
            InputError: The tasks have no trees, or the file is faulty or without sizes.
        """
        from ..sim.branch_file import read_branch_file
        from ..sim.posterior_stiffness import SpringPosterior
        from ..sim.wood_effects import wood_effects

        if self.of_wood is None:
            raise InputError("train", "--model", str(model), f"no model: {', '.join(self.names)} without trees")
        wood = SpringPosterior.from_model(model).wood()
        effects, left_out = wood_effects(read_branch_file(model))
        if left_out:
            warn(f"{model}: left out: {', '.join(left_out)}: of the measurement, not of the branch")
        return self.of_wood(settings, wood, effects)


def builtin_tasks() -> TaskRegistry:
    """Return bough's own tasks.

    Raises:
        InputError: rsl-rl is not installed.
    """
    require_rsl_rl()
    from .tasks import GROUPS, NAMES, PRESETS, make_task, of_wood

    return TaskRegistry(NAMES, GROUPS, PRESETS, make_task, of_wood)


def require_rsl_rl() -> None:
    """Raise `InputError` where the optional part that training needs is not installed."""
    try:
        import rsl_rl.env  # noqa: F401
    except ModuleNotFoundError as error:
        raise InputError("bough", "", f"no {error.name}", "pip install 'bough[train]'") from None


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


def plain(settings: Any) -> dict[str, Any]:
    """Return settings as JSON gives them back."""
    found: dict[str, Any] = json.loads(json.dumps(asdict(settings)))
    return found


def settings_from(kind: type, values: Mapping[str, Any], source: object) -> Any:
    """Return the settings that `plain` wrote; what is empty unless given may be missing, as in an older run.

    Raises:
        InputError: They are not of this kind, such as another version's.
    """
    names = {f.name for f in fields(kind)}
    needed = names - {f.name for f in fields(kind) if f.default == ()}
    if not needed <= set(values) <= names:
        odd = ", ".join(sorted((set(values) - names) | (needed - set(values))))
        raise InputError(str(source), odd, "settings of another version", "those of this version of bough")
    hints = get_type_hints(kind)
    return kind(**{name: _value(hints[name], value, source) for name, value in values.items()})


def _value(hint: Any, value: Any, source: object) -> Any:
    if isinstance(hint, type) and is_dataclass(hint) and isinstance(value, Mapping):
        return settings_from(hint, value, source)
    return _tuples(value)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
