"""What a task is declared as: reward terms, observation groups, measures, end conditions, reset rules, columns."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from ...sim.base.errors import InputError

if TYPE_CHECKING:
    import torch


RESERVED = {"iteration", "steps", "episodes", "reward", "cost", "multiplier"}
"""Columns of ``metrics.csv`` that are no measures."""


def first_columns(features: Iterable[tuple[str, int]]) -> tuple[dict[str, int], int]:
    """Return the first column of every feature, given with its number of columns, and the number of columns."""
    first, out = 0, {}
    for name, size in features:
        out[name] = first
        first += size
    return out, first


@dataclass(frozen=True)
class Column:
    """A column of the table of a test.

    Attributes:
        name: What the table calls it.
        measure: Measure that it is the mean of.
        scale: What that is times.
        of_successes: Whether only episodes count that succeeded.
        interval: Whether it is a share of episodes [%], told with Wilson's interval.
    """

    name: str
    measure: str
    scale: float = 1.0
    of_successes: bool = False
    interval: bool = False

    def value(self, measures: Mapping[str, torch.Tensor]) -> float:
        """Return the mean over episodes, measures [W] each; NaN where none counts or the task does not measure it."""
        if self.measure not in measures:
            return math.nan
        values = measures[self.measure].float()
        if self.of_successes:
            values = values[measures["success"] > 0]
        return self.scale * float(values.mean()) if len(values) else math.nan


@dataclass(frozen=True)
class Reward:
    """A term of the reward; a ``factor`` multiplies what the terms before it have come to."""

    function: Any
    factor: bool = False


@dataclass(frozen=True)
class Group:
    """An observation group.

    Attributes:
        name: Its name.
        features: Names of its features and how many columns each has, in their order.
        function: Device function that writes it, (world, first column, view, own, observation); None where a task's
            sensor does.
    """

    name: str
    features: tuple[tuple[str, int], ...]
    function: Any = None


@dataclass(frozen=True)
class Parts:
    """A task as its parts: device functions of (world, view, own), see `kernels.tasks.parts`.

    Attributes:
        name: Name of the task.
        version: Raised whenever observations, actions or rewards change their meaning.
        own: Struct of what the task remembers, arrays [worlds], and of its numbers.
        numbers: Values of those fields that are no arrays.
        rewards: Terms of the reward, in their order.
        groups: Observation groups, in the order of their columns.
        measures: What is said of every finished episode, by name; ``return`` and ``success`` must be among them.
        cost: What a policy step costs, of which a trainer holds the mean at ``cost_limit``; None for no constraint.
        cost_limit: That limit.
        notes: Called with every judged state, before it counts to the episode's age.
        samples: Called after every control period.
        ends: Conditions that end an episode for good.
        cuts: Conditions that end it as the step limit does: what would have come is guessed from the value.
        resets: Called where a new episode begins.
        columns: Of the table of a test.
    """

    name: str
    version: int
    own: Any
    rewards: tuple[Reward, ...]
    groups: tuple[Group, ...]
    measures: Mapping[str, Any]
    numbers: Mapping[str, Any] = field(default_factory=dict)
    cost: Any = None
    cost_limit: float = 0.0
    notes: tuple[Any, ...] = ()
    samples: tuple[Any, ...] = ()
    ends: tuple[Any, ...] = ()
    cuts: tuple[Any, ...] = ()
    resets: tuple[Any, ...] = ()
    columns: tuple[Column, ...] = ()

    def check(self) -> Parts:
        """Return self if a task can be made of it.

        Raises:
            InputError: No group, no reward, a measure that is missing, that a column asks for or that has a
                reserved name, a number not given.
        """
        for part, there in (("groups", self.groups), ("rewards", self.rewards)):
            if not there:
                raise InputError(self.name, part, "none", "one or more")
        asked = {"return", "success", *(c.measure for c in self.columns)}
        for name in sorted(asked - set(self.measures)):
            raise InputError(self.name, "measures", f"no {name}", ", ".join(self.measures))
        for name in sorted(set(self.measures) & RESERVED):
            raise InputError(self.name, "measures", name, f"another name than {', '.join(sorted(RESERVED))}")
        plain = {name for name, kind in self.own.vars.items() if not _is_array(kind)}
        if plain != set(self.numbers):
            odd = ", ".join(sorted(plain ^ set(self.numbers)))
            raise InputError(self.name, "numbers", odd, f"one for each of {', '.join(sorted(plain))}")
        return self

    @property
    def arrays(self) -> dict[str, Any]:
        """Types of the arrays of ``own``, by name."""
        return {name: kind.type.dtype for name, kind in self.own.vars.items() if _is_array(kind)}

    def price(self) -> Any:
        """Return the kernel of the costs (`kernels.tasks.parts.price_kernel`)."""
        from ...kernels.tasks.parts import price_kernel

        return price_kernel(self.own, self.cost)

    def columns_of_features(self) -> tuple[dict[str, int], int]:
        """Return the first column of every feature, and the number of columns."""
        return first_columns(feature for group in self.groups for feature in group.features)

    def kernels(self) -> SimpleNamespace:
        """Return the kernels of all phases (`kernels.tasks.parts.phase_kernels`)."""
        from ...kernels.tasks.parts import phase_kernels

        first, _ = self.columns_of_features()
        groups = [(g.function, first[g.features[0][0]]) for g in self.groups if g.function is not None]
        rewards = [(term.function, term.factor) for term in self.rewards]
        lists = {name: list(getattr(self, name)) for name in ("notes", "samples", "ends", "cuts", "resets")}
        said = [(f.key, first) for f, first in groups], [(f.key, factor) for f, factor in rewards]
        keys = {name: [f.key for f in functions] for name, functions in lists.items()}
        digest = hashlib.sha256(repr((said, keys, [f.key for f in self.measures.values()])).encode()).hexdigest()
        measures = list(self.measures.values())
        parts = (self.name, digest, self.own, *rewards, *groups, *measures, *map(tuple, lists.values()))
        if parts not in _KERNELS:
            _KERNELS[parts] = phase_kernels(f"{self.name}_{digest[:8]}", self.own, rewards=rewards, groups=groups,
                                            measures=measures, **lists)  # fmt: skip
        return _KERNELS[parts]


#: Kernels that were made, by the parts themselves: tasks of the same parts share them, and are compiled once.
_KERNELS: dict[tuple[Any, ...], SimpleNamespace] = {}


def _is_array(kind: Any) -> bool:
    import warp as wp

    return bool(wp.types.is_array(kind.type))
