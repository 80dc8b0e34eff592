"""Memory of the clouds that a sensor draws."""

from __future__ import annotations

import math
from typing import Any

import torch
import warp as wp

from ..kernels.points.cloud import NOWHERE, NUM_CLOUDS, TILE, cloud_types


class CloudMemory:
    """Clouds of a number of worlds, a row each, as kernels take them.

    They lie [row, cloud, axis, point] where a thread works in lanes, rows innermost where neighbouring threads are
    neighbouring worlds (on a GPU).

    Attributes:
        kernel: What kernels take (`kernels.points.cloud.cloud_types`).
        points: Clouds robot, target, branches [m], torch view [rows, 3, 3, points], coordinates before points.
            Neighbours in memory are neighbours in space.
        near: 1 for branch points of the zoomed cloud, torch view [rows, points].
    """

    def __init__(self, rows: int, points: int, *, width: int, inside: bool, device: Any) -> None:
        """Allocate.

        Args:
            rows: Worlds whose clouds there is room for.
            points: Points of a cloud, a multiple of 16.
            width: Points a lane vector.
            inside: Whether rows lie innermost.
            device: Warp device.
        """
        self._width, self._inside, self._device = width, inside, device
        groups = -(-(points // width) // width)
        bounds = (groups + -(-groups // width)) * width  # of chunks, then of groups of chunks, in whole lanes
        bounds = bounds if width > 1 else points // TILE
        self.points = self._zeros(rows, NUM_CLOUDS, 3, points)
        self.near = self._zeros(rows, points)
        self._bound = self._zeros(rows, NUM_CLOUDS, 6, bounds)
        self._bound[:, :, :3] = NOWHERE
        self._bound[:, :, 3:] = -NOWHERE
        self.kernel = cloud_types(width).Clouds()
        for name, memory in (("point", self.points), ("near", self.near), ("box", self._bound)):
            setattr(self.kernel, name, self._lanes(memory))
        self.kernel.flat, self.kernel.bound = wp.from_torch(self.points), wp.from_torch(self._bound)
        self.kernel.present = wp.zeros((rows, NUM_CLOUDS), dtype=int, device=device)

    def _zeros(self, rows: int, *shape: int) -> torch.Tensor:
        device = wp.device_to_torch(self._device)
        if not self._inside:
            return torch.zeros(rows, *shape, device=device)
        return torch.zeros(*shape, rows, device=device).movedim(-1, 0)

    def _lanes(self, memory: torch.Tensor) -> Any:
        """Return the memory seen as lane vectors along its last axis."""
        if self._width == 1:
            return wp.from_torch(memory)
        shape = (*memory.shape[:-1], memory.shape[-1] // self._width)
        Real = cloud_types(self._width).Real
        view: Any = wp.array(ptr=memory.data_ptr(), shape=shape, dtype=Real, device=self._device)
        view._memory = memory  # a view by pointer does not keep what it points to
        return view

    @property
    def nbytes(self) -> int:
        """Bytes of clouds and boxes."""
        return sum(4 * math.prod(t.shape) for t in (self.points, self.near, self._bound))
