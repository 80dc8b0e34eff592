"""The last states of worlds that were frozen: kept on the device, written for each, read again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import warp as wp

from ...kernels.tree.last_states import keep_kernels
from ..base.archive import read_arrays
from ..base.errors import InputError
from ..base.types import Array, IntArray
from ..trees.tree import Tree

if TYPE_CHECKING:
    from .arrays import LaneArray
    from .model import Model
    from .state import State

#: States kept of every world.
KEPT = 100
FORMAT = "bough-fault/1"
_TREE = [item.name for item in fields(Tree) if item.name not in ("name", "link_name")]


class LastStates:
    """A ring of the states before the last steps, in device memory; a frozen world's stays as it is.

    It takes 7 numbers a link, state and world: 1.1 MiB for 100 states of 10 worlds of 40 links in float32.
    """

    def __init__(self, model: Model, state: State, about: Callable[[int], dict[str, Any]], count: int = KEPT) -> None:
        """Allocate the ring.

        Args:
            model: The worlds.
            state: What moves of them.
            about: Returns what else a world's steps depend on, arrays and numbers by name.
            count: States of every world.
        """
        m = model
        kind: Any = wp.float64 if m.precision == 64 else wp.float32
        self._model, self._state, self._about, self._size = model, state, about, count
        shape = (count * m.groups, m.places + 1)
        self._coordinate, self._velocity = (
            wp.zeros((*shape, n, m.width), dtype=kind, device=m.device) for n in (4, 3)
        )  # fmt: skip
        self._tick = wp.full((shape[0], m.width), -1, dtype=int, device=m.device)
        self._written = wp.zeros(m.groups, dtype=int, device=m.device)
        self._kernels = keep_kernels(m.precision)

    @property
    def nbytes(self) -> int:
        """Bytes of the ring."""
        arrays = (self._coordinate, self._velocity, self._tick)
        return sum(int(a.size) * wp.types.type_size_in_bytes(a.dtype) for a in arrays)

    def note(self) -> None:
        """Keep the present state of the worlds that are alive; nothing of it goes by the host."""
        s, m = self._state, self._model
        given = [s.alive.entries(), s.coordinate.entries(), s.velocity.entries()]
        inputs = [self._size, m.groups, self._written, s._tick, *given, self._tick, self._coordinate, self._velocity]
        wp.launch(self._kernels.keep, dim=(m.groups, m.places + 1), inputs=inputs, device=m.device)
        wp.launch(self._kernels.turn, dim=m.groups, inputs=[self._written], device=m.device)

    def write(self, folder: Path) -> list[Path]:
        """Write a file for each frozen world into an existing folder; return them."""
        out = []
        for world, link, tick in self._state.faults():
            out.append(folder / f"world_{world:04d}.npz")
            np.savez_compressed(out[-1], **self._record(world, link, tick))
        return out

    def _record(self, world: int, link: str, tick: int) -> dict[str, Any]:
        """Return all that a world's last states and its model are made of."""
        m = self._model
        tree, (a, b) = m.trees[world], m.first_link[world : world + 2]
        group, lane = divmod(int(m.world_slot[world]), m.width)
        place = torch.as_tensor(m.link_place[a:b])
        ticks = wp.to_torch(self._tick).cpu().reshape(self._size, m.groups, -1)[:, group, lane]
        order = torch.argsort(ticks)[int((ticks < 0).sum()) :]

        def last(ring: wp.array) -> Array:
            """Return the world's own entries of a ring, oldest first, [states, links, components]."""
            kept: torch.Tensor = wp.to_torch(ring).cpu()
            return np.asarray(kept.reshape(self._size, m.groups, *kept.shape[1:])[order, group][:, place, :, lane])

        return {
            "format": FORMAT, "world": world, "name": tree.name, "link_name": np.array(tree.link_name), "link": link,
            "fault_tick": tick, "tick": ticks[order].numpy(), "coordinate": last(self._coordinate),
            "velocity": last(self._velocity), "precision": m.precision, "gravity": m.gravity,
            **{f"tree {name}": getattr(tree, name) for name in _TREE},
            **{f"array {name}": of_world(m, array, world) for name, array in m.arrays.items()}, **self._about(world),
        }  # fmt: skip


def of_world(model: Model, array: LaneArray, world: int) -> Array:
    """Return a world's part of an array over a model's places, on the host, shape [links, components]."""
    a, b = model.first_link[world : world + 2]
    group, lane = divmod(int(model.world_slot[world]), model.width)
    return np.asarray(array.torch.cpu()[group, lane, torch.as_tensor(model.link_place[a:b])])


@dataclass(frozen=True)
class Fault:
    """The last states of a frozen world, as `LastStates.write` leaves them.

    Attributes:
        tree: What moved.
        link: Name of the link whose joint left the bound or the finite.
        fault_tick: Substeps until then.
        tick: Substeps until each state, shape [N].
        coordinate, velocity: The states in the kernels' coordinates, shapes [N, links, 4] and [N, links, 3].
        arrays: Everything else by its name in the file.
    """

    tree: Tree
    link: str
    fault_tick: int
    tick: IntArray
    coordinate: Array
    velocity: Array
    arrays: dict[str, Any]

    @staticmethod
    def read(path: Path) -> Fault:
        """Read a file.

        Raises:
            InputError: It is missing, or nothing that `LastStates.write` has written.
        """
        allowed = "a file that bough simulate --dump-faults wrote"
        found: dict[str, Any] = read_arrays(path, allowed)
        if str(found.get("format", "")) != FORMAT:
            raise InputError(path, "format", repr(str(found.get("format", "none"))), FORMAT)
        try:
            return Fault._of(found)
        except (KeyError, TypeError, ValueError, IndexError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(path, "", f"entries that do not fit ({str(error)[:60]})", allowed) from None

    @staticmethod
    def _of(found: dict[str, Any]) -> Fault:
        names = [str(name) for name in found["link_name"]]
        tree = Tree(name=str(found["name"]), link_name=names, **{n: found[f"tree {n}"] for n in _TREE}).validate()
        count, links = len(found["tick"]), tree.num_links
        for name, shape in (("coordinate", (count, links, 4)), ("velocity", (count, links, 3))):
            if found[name].shape != shape or count == 0:
                raise ValueError(f"{name} of shape {found[name].shape}, not {shape}")
        return Fault(
            tree, str(found["link"]), int(found["fault_tick"]), found["tick"], found["coordinate"], found["velocity"],
            found,
        )  # fmt: skip
