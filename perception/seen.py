"""The sensor of one robot: its branches are points that a camera has seen, everything else is `Sensor`."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp

from ..kernels.points.given import given_kernel
from ..sim.base.errors import InputError
from ..sim.base.thread_pool import recorded
from ..sim.base.types import Array
from .sensor import STAGES, Capsules, Sensor, SensorSettings, Target

_AFTER = STAGES.index("noise") + 1


class SeenSensor(Sensor):
    """Draws robot and target as `Sensor` does, takes the branches as they were seen, and scores with its kernels.

    ``capsules`` are the arm's alone. `occlusion` and `breach`, the scores of points without noise, mean nothing here:
    what a camera has seen has its noise already.
    """

    def __init__(
        self, capsules: Capsules, target: Target, ee_position: wp.array, settings: SensorSettings, *, seed: int = 0
    ) -> None:
        """Allocate; no branch is seen yet.

        Args:
            capsules: The arm's capsules, on a CPU.
            target: The region to be cleared.
            ee_position: End-effector, vec3 [worlds], in m.
            settings: How to draw and score.
            seed: Seed of the points, any integer of 31 bits.
        """
        super().__init__(capsules, target, ee_position, settings, seed=seed, threads=1)
        shape = (self.num_worlds, 3, settings.points)
        self._given: Any = wp.zeros(shape, dtype=wp.float32, device=self.device)
        self._present: Any = wp.zeros(self.num_worlds, dtype=int, device=self.device)
        self._points, self._seen = wp.to_torch(self._given), wp.to_torch(self._present)

    def see(self, world: int, branches: Array) -> None:
        """Take points of a world's branches [m], [``settings.points``, 3], or none, [0, 3].

        Raises:
            InputError: Another number of points, or one that is not finite.
        """
        if branches.shape not in ((0, 3), (self.settings.points, 3)) or not np.isfinite(branches).all():
            found = f"{list(branches.shape)}, finite: {bool(np.isfinite(branches).all())}"
            raise InputError("sensor", "branches", found, f"[{self.settings.points}, 3] or [0, 3], finite")
        self._seen[world] = int(len(branches) > 0)
        if len(branches):
            self._points[world] = torch.from_numpy(np.ascontiguousarray(branches.T, dtype=np.float32))

    def _commands(self, first: int, count: int, row: int) -> list[Any]:
        inputs = [self._given, self._present, self._target, self.settings.zoom, first, row, self._clouds.kernel]
        given = recorded(given_kernel(self.width), (count,), inputs, self.device)
        launches = super()._commands(first, count, row)
        return [*launches[:_AFTER], given, *launches[_AFTER:]]


def resampled(points: Array, count: int, rng: np.random.Generator) -> Array:
    """Return so many of some points [N, 3]: drawn without repetition where there are more, all where there are as many.

    Of fewer all are taken and some of them again; none stay none.
    """
    there = len(points)
    if there in (0, count):
        return points
    if there > count:
        return np.asarray(points[rng.choice(there, count, replace=False)])
    return np.asarray(points[np.concatenate([np.arange(there), rng.integers(0, there, count - there)])])
