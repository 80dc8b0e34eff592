"""Tasks by name, and their settings as a run folder keeps them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, get_type_hints

from pydantic import TypeAdapter

from ...sim.base.console import warn
from ...sim.base.errors import InputError
from ..runs.schema import validated
from .task import Task, require_rsl_rl

if TYPE_CHECKING:
    from pathlib import Path

    from ...sim.wood.effects import WoodEffects
    from ...sim.wood.posterior import Wood


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
        columns: Called with settings; returns the first column of every feature of the observations. None where that is
            not known.
        all_scenes: Called with settings; returns those of tasks that leave no scene out. None where none is left out.
    """

    names: tuple[str, ...]
    groups: tuple[str, ...]
    presets: Mapping[str, Any]
    make: Callable[..., Task]
    of_wood: Callable[[Any, Wood, WoodEffects], Any] | None = None
    columns: Callable[[Any], dict[str, int]] | None = None
    all_scenes: Callable[[Any], Any] | None = None

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
        from ...sim.wood.branch_file import read_branch_file
        from ...sim.wood.effects import wood_effects
        from ...sim.wood.posterior import SpringPosterior

        if self.of_wood is None:
            raise InputError("train", "--model", str(model), f"no model: {', '.join(self.names)} without trees")
        file = read_branch_file(model)
        wood = SpringPosterior.from_branch(file, model).wood()
        effects, left_out = wood_effects(file)
        if left_out:
            warn(f"{model}: left out: {', '.join(left_out)}: of the measurement, not of the branch")
        return self.of_wood(settings, wood, effects)


def builtin_tasks() -> TaskRegistry:
    """Return bough's own tasks.

    Raises:
        InputError: rsl-rl is not installed.
    """
    require_rsl_rl()
    from ...sim.arms.jaco2 import jaco2
    from .clearing import make_task
    from .settings import GROUPS, NAMES, PRESETS, all_scenes, columns_of, of_wood

    dofs = jaco2().num_dofs
    return TaskRegistry(
        NAMES, GROUPS, PRESETS, make_task, of_wood, lambda settings: columns_of(settings, dofs)[0], all_scenes
    )


def plain(settings: Any) -> dict[str, Any]:
    """Return settings as JSON gives them back."""
    found: dict[str, Any] = json.loads(json.dumps(asdict(settings)))
    return found


def settings_from(kind: type, values: Mapping[str, Any], source: object) -> Any:
    """Return the settings that `plain` wrote; what is empty unless given may be missing, as in an older run.

    Raises:
        InputError: They are not of this kind, such as another version's.
    """
    _check_names(kind, values, source)
    return validated(TypeAdapter(kind), values, source)


def _check_names(kind: type, values: Mapping[str, Any], source: object) -> None:
    """Raise `InputError` for names that settings, or settings inside them, do not have or lack."""
    names = {f.name for f in fields(kind)}
    needed = names - {f.name for f in fields(kind) if f.default == ()}
    if not needed <= set(values) <= names:
        odd = ", ".join(sorted((set(values) - names) | (needed - set(values))))
        raise InputError(str(source), odd, "settings of another version", "those of this version of bough")
    for name, hint in get_type_hints(kind).items():
        if isinstance(hint, type) and is_dataclass(hint) and isinstance(values.get(name), Mapping):
            _check_names(hint, values[name], source)
