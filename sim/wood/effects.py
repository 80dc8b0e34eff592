"""Effects that a measured branch was found to have, in trees of its wood."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from ..effects import effect_of
from ..engine.forest_effects import forest_laws
from .branch_file import BranchFile, EffectModel

if TYPE_CHECKING:
    from ..engine.simulator import Simulator

WoodEffects = tuple[tuple[str, str, float], ...]
"""Effect, parameter and value, in plain numbers: moments over the spring at their joint [rad], the rest in SI units."""


def wood_effects(file: BranchFile) -> tuple[WoodEffects, tuple[str, ...]]:
    """Return the effects of a branch that trees can have, and the labels of those that belong to its measurement.

    Gusts along a course that was read off recordings do.

    What acts at one joint of the branch is taken to act at every joint of a tree, in proportion to the joint's spring;
    of an effect at several joints the one nearest to the base is taken.
    """
    laws, left_out = forest_laws(), []
    out: list[tuple[str, str, float]] = []
    for found in sorted(file.effects, key=lambda e: e.joint or 0):
        read_off = {p.name: p.neutral for p in effect_of(found.name).law("branch").parameters if p.read_off}
        if found.name not in laws or any(found.parameters.get(key, off) != off for key, off in read_off.items()):
            left_out.append(found.label)
        elif found.name not in [name for name, _, _ in out]:
            kept = {key: v for key, v in found.parameters.items() if key not in read_off}
            out += [(found.name, key, _relative(file, found, key, v)) for key, v in kept.items()]
    return tuple(out), tuple(left_out)


def give_effects(simulator: Simulator, given: WoodEffects) -> None:
    """Write effects into all worlds of a simulator that was built with their names (`names_of`)."""
    for name, parameter, value in given:
        if _is_moment(name, parameter):
            tensor = simulator.effects[name][parameter]
            for world, tree in enumerate(simulator.model.trees):
                tensor[world, : tree.num_links] = torch.as_tensor(value * tree.stiffness).to(tensor)
        else:
            simulator.effects.fill(name, parameter, value)


def names_of(given: WoodEffects) -> tuple[str, ...]:
    """Return the names of effects, each once."""
    return tuple(dict.fromkeys(name for name, _, _ in given))


def _relative(file: BranchFile, found: EffectModel, parameter: str, value: float) -> float:
    """Return a value as `WoodEffects` has it."""
    if found.joint is None or not _is_moment(found.name, parameter):
        return value
    return value / file.segments[found.joint].stiffness_Nmprad


def _is_moment(name: str, parameter: str) -> bool:
    law = effect_of(name).branch
    return law is not None and any(p.name == parameter and p.unit == "N m" for p in law.parameters)


def sentence(given: WoodEffects) -> str:
    """Return what acts, for a person: ``plastic_set (share 0.3, yield_rad 0.05), steady_wind (...)``."""
    return ", ".join(f"{name} ({_numbers([g for g in given if g[0] == name])})" for name in names_of(given))


def _numbers(given: Sequence[tuple[str, str, float]]) -> str:
    over = {(n, p): " over its spring" for n, p, _ in given if _is_moment(n, p)}
    return ", ".join(f"{parameter}{over.get((name, parameter), '')} {value:.3g}" for name, parameter, value in given)
