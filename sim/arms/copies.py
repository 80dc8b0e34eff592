"""Copies of all worlds of a simulator, in which other things can be tried from the present state on."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.tree.copies import copy_links
from ..base.errors import InputError
from ..base.thread_pool import Launches, recorded
from ..base.types import IntArray
from ..engine.arrays import LaneArray
from .simulator import ArmSimulator

#: What the rule of contact holds of every world that lasts from one step to the next.
_LASTING = ("friction", "line_start", "line_end", "line_mask", "arm_peak", "overflow")


class WorldCopies:
    """Every world of a simulator several times in a second one, for control that plans in the simulation itself.

    Copies of world w are the worlds w * count to w * count + count - 1 of `simulator`. `take` brings them to where
    the source is now: state, parameters, effects with their memories and clocks, servos, broken joints. What is then
    done to them moves nothing in the source. `take` allocates nothing, copies nothing to the host and waits for
    nothing.

    Attributes:
        source: Where worlds are copied from.
        simulator: The copies.
        count: Copies of every world.
    """

    def __init__(self, source: ArmSimulator, count: int) -> None:
        """Make the copies, as their worlds are now.

        Args:
            source: Worlds to copy. What of it can be set when it is made, branches that touch among it, is the copies'.
            count: Copies of every world.

        Raises:
            InputError: The count is below one.
        """
        if count < 1:
            raise InputError("copies", "count", f"{count}", "1 or more of every world")
        self.source, self.count, m = source, count, source.model
        self.simulator = ArmSimulator(
            [tree for tree in m.trees for _ in range(count)], source.arm, contacts=source.contacts, dt=source.dt,
            substeps=source.substeps, gravity=m.gravity.tolist(), device=m.device, threads=source._launcher.threads,
            breakable=source.rupture is not None, effects=tuple(source.effects),
        )  # fmt: skip
        self._launches = Launches([self._copy(*fields) for fields in self._lane_arrays()])
        self._views: list[tuple[torch.Tensor, torch.Tensor]] = []
        for mine, theirs, dim in self._world_arrays():
            self.carry(mine, theirs, dim)
        self.take()

    def carry(self, mine: torch.Tensor, theirs: torch.Tensor, dim: int) -> None:
        """Have `take` copy what worlds have to their copies; the tensors are alike but for the worlds' dimension."""
        self._views.append((mine.unflatten(dim, (-1, self.count)), theirs.unsqueeze(dim + 1)))

    def take(self) -> None:
        """Bring all copies to the present state of their worlds."""
        if self.source._stale:
            self.source.refresh()
        self._launches()
        for mine, theirs in self._views:
            mine.copy_(theirs)

    def _lane_arrays(self) -> Iterator[tuple[LaneArray, LaneArray, tuple[wp.array, wp.array], int]]:
        """Yield what lies in vector lanes: of the copies, of the source, where from, and rows of links."""
        mine, theirs = self.simulator, self.source
        places, worlds = self._maps()
        for name in theirs.model.arrays:
            yield mine.model.arrays[name], theirs.model.arrays[name], places, 1
        for name in ("coordinate", "velocity"):
            yield getattr(mine.state, name), getattr(theirs.state, name), places, 1
        for name in ("_damping", "_limit"):
            yield getattr(mine, name), getattr(theirs, name), places, 1
        yield mine.state.alive, theirs.state.alive, worlds, 1
        if theirs.effects:
            rows = theirs.effects.memory.kernel.shape[1] // (theirs.model.places + 1)
            yield mine.effects.memory, theirs.effects.memory, places, rows
            yield mine.effects.clock, theirs.effects.clock, worlds, 1

    def _copy(self, mine: LaneArray, theirs: LaneArray, maps: tuple[wp.array, wp.array], rows: int) -> Any:
        inputs = [*maps, rows, theirs.entries(), mine.entries()]
        return recorded(copy_links, maps[0].shape, inputs, self.simulator.model.device)

    def _maps(self) -> tuple[tuple[wp.array, wp.array], tuple[wp.array, wp.array]]:
        """Return the source's slot and place of every place of every slot of the copies, and of every slot alone."""
        mine, theirs = self.simulator.model, self.source.model
        slot, place = np.full((2, mine.groups * mine.width, mine.places + 1), -1)
        at = mine.world_slot, np.zeros(mine.num_worlds, np.int64)
        slot[at], place[at] = np.repeat(theirs.world_slot, self.count), 0
        link = self._links_of_copies()
        at = mine.link_slot, mine.link_place
        slot[at], place[at] = theirs.link_slot[link], theirs.link_place[link]

        def there(values: IntArray) -> wp.array:
            """Return integers as an int32 array on the simulator's device."""
            return wp.array(np.ascontiguousarray(values, np.int32), dtype=int, device=mine.device)

        return (there(slot), there(place)), (there(slot[:, :1]), there(place[:, :1]))

    def _links_of_copies(self) -> IntArray:
        """Return the number in the source of every link of the copies."""
        first = self.source.model.first_link
        ranges = [np.arange(a, b) for a, b in pairwise(first) for _ in range(self.count)]
        return np.concatenate(ranges)

    def _world_arrays(self) -> Iterator[tuple[torch.Tensor, torch.Tensor, int]]:
        """Yield what has a row a world: of the copies, of the source, and which dimension the worlds are."""
        mine, theirs = self.simulator, self.source
        for name in theirs._arm.state_names:
            yield *(wp.to_torch(getattr(s._arm.kernel[1], name)) for s in (mine, theirs)), int(name == "waiting")
        yield *(wp.to_torch(s._arm.kernel[2].held) for s in (mine, theirs)), 0
        for name in _LASTING:
            yield getattr(mine._touch, name), getattr(theirs._touch, name), 0
        for name, parameters in theirs.effects.items():
            for key, values in parameters.items():
                yield mine.effects[name][key], values, 0
        if theirs.rupture is not None and mine.rupture is not None:
            for name in ("strength", "broken"):
                yield getattr(mine.rupture, name), getattr(theirs.rupture, name), 0
