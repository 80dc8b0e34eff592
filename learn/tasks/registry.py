"""Tasks by name, and their settings as a run folder keeps them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, get_type_hints

from pydantic import TypeAdapter

from ...sim.base.console import warn
from ...sim.base.errors import InputError
from ...sim.base.plugins import Registry
from ..runs.schema import validated
from .names import CLEARING, REACHING
from .ppo_settings import PRESETS, PPOSettings, Preset, preset_of
from .task import Task, require_rsl_rl

if TYPE_CHECKING:
    from pathlib import Path

    from ...sim.wood.effects import WoodEffects
    from ...sim.wood.posterior import Wood
    from .parts import Column


MEMORY = (128,)
"""Units of the memory of recurrent policies."""


@dataclass(frozen=True)
class TaskKind:
    """Tasks that share their settings.

    Attributes:
        names: Names of the tasks.
        groups: Names of the observation groups, all of which can be left out but not together.
        presets: Settings by the name of a preset, frozen dataclasses with a field ``groups``: names of those left in.
        make: Called with name, settings, num_envs, seed, device and test (all contacts on); returns the task.
        table: Columns of the table of a test.
        ppo: Numbers of PPO by the name of a preset.
        test_worlds: Worlds of a test set.
        policies: Kinds of policies that differ in what they see and are rewarded for; the settings have a field
            ``policy`` then.
        recurrent: Those of them whose networks have a memory, of `MEMORY` units.
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
    table: tuple[Column, ...]
    ppo: Mapping[Preset, PPOSettings] = field(default_factory=lambda: PRESETS)
    test_worlds: int = 512
    policies: tuple[str, ...] = ()
    recurrent: tuple[str, ...] = ()
    of_wood: Callable[[Any, Wood, WoodEffects], Any] | None = None
    columns: Callable[[Any], dict[str, int]] | None = None
    all_scenes: Callable[[Any], Any] | None = None

    def sized(self, preset: Preset) -> Any:
        """Return the settings of a preset.

        Raises:
            InputError: The tasks do not come in this size.
        """
        if preset not in self.presets or preset not in self.ppo:
            raise InputError("train", "--preset", preset, ", ".join(p for p in self.presets if p in self.ppo))
        return self.presets[preset]

    def preset_for(self, device: str) -> Preset:
        """Return the preset that a device bears, of those that there are."""
        wanted = preset_of(device)
        return wanted if wanted in self.presets and wanted in self.ppo else "cpu"

    @property
    def settings(self) -> type:
        """Return the dataclass of the settings."""
        return type(self.presets["cpu"])

    def ppo_for(self, settings: Any, preset: Preset) -> PPOSettings:
        """Return a preset's numbers of PPO for the kind of policy that settings name.

        Raises:
            InputError: The tasks do not come in this size.
        """
        self.sized(preset)
        ppo = self.ppo[preset]
        return replace(ppo, memory=MEMORY) if getattr(settings, "policy", None) in self.recurrent else ppo

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

    def of_policy(self, settings: Any, policy: str | None) -> Any:
        """Return the settings of a kind of policy; None keeps the one that they have.

        Raises:
            InputError: There is no such kind.
        """
        if policy is None:
            return settings
        if policy not in self.policies:
            raise InputError("train", "--policy", policy, ", ".join(self.policies) or f"none: {', '.join(self.names)}")
        return replace(settings, policy=policy)

    def changed(self, settings: Any, changes: tuple[str, ...], command: str) -> Any:
        """Return the settings with some fields set, each ``name=value``; the task checks them when it is made.

        Raises:
            InputError: There is no such field, or the value is not one for it.
        """
        if not changes:
            return settings
        plainly = plain(settings)
        places = _simple_fields(plainly)
        for change in changes:
            name, _, value = change.partition("=")
            if name not in places:
                raise InputError(command, "--set", change, f"name=value of {', '.join(sorted(places))}")
            places[name][name] = _read_value(value, places[name][name])
        return settings_from(self.settings, plainly, f"{command} --set")

    def of_arm(self, settings: Any, model: Path) -> Any:
        """Return settings whose arm has the servos of an arm's ``model.yaml``.

        Backlash is left out, and a line of warning says so: the simulator's servos have none.

        Raises:
            InputError: The tasks have no servos to set, or the file is faulty or of another arm.
        """
        from ...sim.arms.registry import ARMS
        from ...sim.arms.servo import read_arm_file

        if not hasattr(settings, "servo"):
            raise InputError("train", "--arm-model", str(model), f"none: {', '.join(self.names)} sets no servos")
        file = read_arm_file(model, ARMS.of(settings.arm, "train", "--set arm"), settings.arm)
        if file.backlash:
            warn(f"{model}: left out: backlash of {', '.join(file.backlash)}, which the simulator's servos do not have")
        return replace(settings, servo=file.servo)

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


@dataclass(frozen=True)
class TaskRegistry:
    """Tasks by name.

    Attributes:
        kinds: Kinds that are there.
        known: Tasks of bough and of installed packages, beside them.
    """

    kinds: tuple[TaskKind, ...] = ()
    known: Registry[TaskKind] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all tasks."""
        return tuple(name for kind in self.kinds for name in kind.names) + (self.known.names if self.known else ())

    def of(self, name: str, source: object = "task", place: str = "") -> TaskKind:
        """Return the kind of a task.

        Raises:
            InputError: There is no such task (the error names ``source`` and ``place``), or its package is broken.
        """
        for kind in self.kinds:
            if name in kind.names:
                return kind
        if self.known is not None and name in self.known.names:
            return self.known.of(name)
        raise InputError(str(source), place, name, ", ".join(self.names))

    def make(self, name: str, settings: Any, **options: Any) -> Task:
        """Make a task (`TaskKind.make`)."""
        return self.of(name).make(name, settings, **options)


def _clearing() -> TaskKind:
    from . import settings as clear
    from .clearing import make_task
    from .measures import CLEARING_COLUMNS

    return TaskKind(
        CLEARING, clear.GROUPS, clear.PRESETS, make_task, CLEARING_COLUMNS, of_wood=clear.of_wood,
        columns=lambda settings: clear.columns_of(settings, _dofs(settings))[0], all_scenes=clear.all_scenes,
    )  # fmt: skip


def _reaching() -> TaskKind:
    from . import reach_settings as reach
    from .clearing import make_reach
    from .measures import REACH_COLUMNS
    from .settings import of_wood

    return TaskKind(
        REACHING, reach.GROUPS, reach.PRESETS, make_reach, REACH_COLUMNS, reach.PPO, reach.TEST_WORLDS,
        reach.POLICIES, reach.RECURRENT, of_wood, lambda settings: reach.columns_of(settings, _dofs(settings))[0],
    )  # fmt: skip


def _dofs(settings: Any) -> int:
    """Return the joints of the arm of some settings."""
    from ...sim.arms.registry import ARMS

    return ARMS.of(settings.arm).num_dofs


def _check(kind: TaskKind, name: str) -> None:
    """Raise `InputError` for a package's kind without the task that its entry point is called after."""
    if name not in kind.names:
        raise InputError("TaskKind", "names", ", ".join(kind.names), f"names with {name}, as the entry point is called")
    if "cpu" not in kind.presets or "cpu" not in kind.ppo:
        raise InputError("TaskKind", "presets", ", ".join(kind.presets), "one called cpu")


#: Entry points of the group ``bough_tasks`` name a `TaskKind`, or a function that returns one.
TASKS = Registry(
    "bough_tasks", "task", TaskKind, dict.fromkeys(CLEARING, _clearing) | dict.fromkeys(REACHING, _reaching),
    check=_check,
)  # fmt: skip


def known_tasks() -> TaskRegistry:
    """Return bough's tasks and those of installed packages.

    Raises:
        InputError: rsl-rl is not installed.
    """
    require_rsl_rl()
    return TaskRegistry(known=TASKS)


def _simple_fields(plainly: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return where the single values among settings are, by name; those of the scene are inside it."""
    inside = (plainly, plainly.get("scene", {}))
    return {name: at for at in reversed(inside) for name, v in at.items() if isinstance(v, str | int | float)}


def _read_value(text: str, kept: Any) -> Any:
    """Return a value of the same type as the one kept, or the text, which is then refused."""
    try:
        return text if isinstance(kept, str) else float(text) if isinstance(kept, float) else json.loads(text)
    except ValueError:
        return text


def plain(settings: Any) -> dict[str, Any]:
    """Return settings as JSON gives them back."""
    found: dict[str, Any] = json.loads(json.dumps(asdict(settings)))
    return found


_EMPTY: tuple[object, ...] = ((), "", 0.0)


def settings_from(kind: type, values: Mapping[str, Any], source: object) -> Any:
    """Return the settings that `plain` wrote; what is empty or zero unless given, or came `LATER`, may be missing.

    Raises:
        InputError: They are not of this kind, such as another version's.
    """
    _check_names(kind, values, source)
    return validated(TypeAdapter(kind), values, source)


def _check_names(kind: type, values: Mapping[str, Any], source: object) -> None:
    """Raise `InputError` for names that settings, or settings inside them, do not have or lack."""
    names = {f.name for f in fields(kind)}
    needed = names - {f.name for f in fields(kind) if f.default in _EMPTY or f.metadata.get("later")}
    if not needed <= set(values) <= names:
        odd = ", ".join(sorted((set(values) - names) | (needed - set(values))))
        raise InputError(str(source), odd, "settings of another version", "those of this version of bough")
    for name, hint in get_type_hints(kind).items():
        if isinstance(hint, type) and is_dataclass(hint) and isinstance(values.get(name), Mapping):
            _check_names(hint, values[name], source)
