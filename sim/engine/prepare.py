"""Preparing a simulation: worlds of one tree, with effects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
import warp as wp

from ..base.console import bar
from ..base.errors import InputError
from ..base.types import Array
from ..trees.tree import Tree
from .model import Model
from .simulator import Simulator
from .stepping import Stepping

_RUBBING = "dry_friction"


def make_simulator(
    stepping: Stepping, tree: Tree, gravity: Array, worlds: int,
    effects: Mapping[str, Mapping[str, float]] | None = None, friction: Array | None = None,
) -> Simulator:  # fmt: skip
    """Return a simulator of ``worlds`` copies of the tree, with effects of these values in all of them.

    ``friction`` [N m or N], shape [links], is dry friction of the joints; the effect ``dry_friction`` gets it.

    Raises:
        InputError: There is no such device, the tree cannot move, or an effect that it cannot have; ``dry_friction``
            beside ``friction``.
    """
    rubs = friction is not None and bool(np.any(friction))
    if rubs and _RUBBING in (effects or {}):
        found = f"'{_RUBBING}' beside the joint friction of {tree.name}"
        raise InputError("--effect", "", found, "one of the two; --ignore friction leaves out the file's")
    try:
        device = wp.get_device(stepping.device)
    except (ValueError, RuntimeError):
        raise InputError("--device", "", repr(stepping.device), ", ".join(d.alias for d in wp.get_devices())) from None
    names = (*(effects or {}), *([_RUBBING] if rubs else []))
    with bar("preparing (the first run compiles kernels)", None):
        model = Model([tree] * worlds, gravity=gravity, device=device, precision=stepping.precision)
        simulator = Simulator(model, dt=stepping.dt, substeps=stepping.substeps, effects=names)
    for name, values in (effects or {}).items():
        for parameter, value in values.items():
            simulator.effects.fill(name, parameter, value)
    if rubs:
        torque = simulator.effects[_RUBBING]["torque_Nm"]
        torque.copy_(torch.as_tensor(friction, dtype=torque.dtype, device=torque.device).expand(torque.shape))
    return simulator
