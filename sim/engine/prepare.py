"""Preparing a simulation: worlds of one tree, with effects."""

from __future__ import annotations

from collections.abc import Mapping

import warp as wp

from ..base.console import bar
from ..base.errors import InputError
from ..base.types import Array
from ..trees.tree import Tree
from .model import Model
from .simulator import Simulator
from .stepping import Stepping


def make_simulator(
    stepping: Stepping, tree: Tree, gravity: Array, worlds: int,
    effects: Mapping[str, Mapping[str, float]] | None = None,
) -> Simulator:  # fmt: skip
    """Return a simulator of ``worlds`` copies of the tree, with effects of these values in all of them.

    Raises:
        InputError: There is no such device, the tree cannot move, or an effect that it cannot have.
    """
    try:
        device = wp.get_device(stepping.device)
    except (ValueError, RuntimeError):
        raise InputError("--device", "", repr(stepping.device), ", ".join(d.alias for d in wp.get_devices())) from None
    with bar("preparing (the first run compiles kernels)", None):
        model = Model([tree] * worlds, gravity=gravity, device=device, precision=stepping.precision)
        simulator = Simulator(model, dt=stepping.dt, substeps=stepping.substeps, effects=tuple(effects or {}))
    for name, values in (effects or {}).items():
        for parameter, value in values.items():
            simulator.effects.fill(name, parameter, value)
    return simulator
