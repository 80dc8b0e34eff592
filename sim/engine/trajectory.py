"""Recording where all bodies of all worlds are, step by step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.console import bar, warn
from ..base.types import Array, IntArray
from ..trees.tree import Tree
from .simulator import Simulator

CAPSULES = ("capsule_body", "capsule_start", "capsule_end", "capsule_radius", "capsule_level")
"""Names of the arrays of a file that say what its bodies look like."""


@dataclass(frozen=True)
class Trajectory:
    """Motion of B bodies in W worlds at T = steps + 1 times, the first of which is the start.

    Attributes:
        time: Times [s], shape [T], from 0.
        body_name: Names of the bodies, length B, in the order of the file; the world is left out.
        body_pos: Body frame origins (MuJoCo's ``xpos``) [m], shape [T, W, B, 3], float32 or float64.
        body_quat: Body orientations w, x, y, z (MuJoCo's ``xquat`` up to its sign), shape [T, W, B, 4].
        frozen_time: When a world left the finite and was frozen [s], shape [W]; NaN where it moved to the end.
    """

    time: Array
    body_name: list[str]
    body_pos: NDArray[Any]
    body_quat: NDArray[Any]
    frozen_time: Array

    def save(self, path: str | Path, tree: Tree, **further: Array) -> None:
        """Write all arrays, what the bodies of their tree look like, and further ones by name, as ``.npz``."""
        looks = capsules_of(tree, self.body_name)
        fields: dict[str, Any] = {**vars(self), "body_name": np.array(self.body_name), **looks, **further}
        np.savez(path, **fields)


def capsules_of(tree: Tree, body_name: Sequence[str]) -> dict[str, Any]:
    """Return the S capsules of a tree's bodies as a file holds them, by `CAPSULES`.

    That is: number of the body, ends of the axis in the body's frame [m] (twice [S, 3]), radius at both [m] ([S, 2]),
    branching order.
    """
    number = {name: i for i, name in enumerate(body_name)}
    body = np.array([number.get(tree.link_name[link], -1) for link in tree.shape_link], dtype=np.int64)
    kept = body >= 0
    parts = (body, tree.shape_start, tree.shape_end, tree.shape_radius, tree.level[tree.shape_link])
    return {name: part[kept] for name, part in zip(CAPSULES, parts, strict=True)}


def own_bodies(tree: Tree) -> IntArray:
    """Return the links that are bodies of their own, in order.

    The others are the massless links ``<body>:<joint>``, which the importer puts before a body with several joints.
    """
    keep: list[int] = []
    i = tree.num_links - 1
    while i >= 0:
        keep.append(i)
        prefix = tree.link_name[i] + ":"
        while i > 0 and tree.parent[i] == i - 1 and tree.mass[i - 1] == 0 and tree.link_name[i - 1].startswith(prefix):
            i -= 1
        i -= 1
    return np.array(keep[::-1], dtype=np.int64)


def record(
    simulator: Simulator, steps: int, *, drive: Callable[[float], None] | None = None, text: str = "simulating"
) -> Trajectory:
    """Step all worlds, which share one tree, and note the frames of its bodies after every step.

    Args:
        simulator: The worlds, at their start.
        steps: Number of steps of ``simulator.dt``.
        drive: Called before every step with the time at its middle [s], to write the load of that step.
        text: What the progress bar says.
    """
    model, tree = simulator.model, simulator.model.trees[0]
    bodies = own_bodies(tree)
    shape = (steps + 1, model.num_worlds, len(bodies))
    kind = np.dtype(np.float64 if model.precision == 64 else np.float32)
    pos, quat = np.empty((*shape, 3), kind), np.empty((*shape, 4), kind)

    def look(k: int) -> None:
        """Note positions [m] and quaternions of the bodies after k steps."""
        position, rotation = simulator.observe()
        pos[k], quat[k] = position.cpu().numpy()[:, bodies], rotation.cpu().numpy()[:, bodies]

    look(0)
    with bar(text, steps) as advance:
        for k in range(steps):
            if drive is not None:
                drive((k + 0.5) * simulator.dt)
            simulator.step()
            look(k + 1)
            advance(1)
    time: Array = simulator.dt * np.arange(steps + 1, dtype=np.float64)
    return Trajectory(time, [tree.link_name[i] for i in bodies], pos, quat, _frozen(simulator))


def _frozen(simulator: Simulator) -> Array:
    """Return when each world was frozen [s], NaN where it was not, shape [W]; warn of the first few, a line each."""
    out = np.full(simulator.model.num_worlds, np.nan)
    faults = simulator.state.faults()
    for n, (world, link, tick) in enumerate(faults):
        out[world] = tick * simulator.dt / simulator.substeps
        if n < 5:
            warn(f"world {world} was frozen at {out[world]:.6g} s: link {link} left the finite or turned too fast")
    if len(faults) > 5:
        warn(f"{len(faults) - 5} more worlds were frozen; frozen_time in trajectory.npz says when")
    return out
