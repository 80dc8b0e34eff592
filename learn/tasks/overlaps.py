"""How often, and how deep, arm, branches, line and ground pass through each other while a policy acts."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp

from ...kernels.tasks import overlap as kernels
from ...sim.arms.simulator import ArmSimulator

LEAST = 2e-3
"""Depth from which bodies overlap [m]: a contact's spring gives 1.3 mm at 80 N."""


class Overlaps:
    """Counts overlaps of a simulator's worlds, step by step; nothing is copied to the host before `rows`."""

    def __init__(self, simulator: ArmSimulator, foot: wp.array) -> None:
        """Note what is apart as the worlds are now; that alone can come to overlap.

        Args:
            simulator: The worlds; their capsules are read as they are at every `measure`.
            foot: Foot of every trunk, where the ground is, vec3 [worlds], in m.
        """
        self._device, capsules = simulator.model.device, simulator.capsules
        constants = simulator._arm.constants
        bodies = kernels.Bodies()
        for name in ("start", "end", "radius"):
            setattr(bodies, name, getattr(capsules, name))
        bodies.line_start, bodies.line_end = simulator.line.start, simulator.line.end
        bodies.line_radius, bodies.foot = simulator.line.radius, foot
        bodies.link, bodies.pair = constants.shape_link, constants.pair
        self._bodies: Any = bodies
        worlds, count = capsules.radius.shape
        self._apart: wp.array = wp.zeros((worlds, count, count), dtype=wp.bool, device=self._device)
        self._steps: wp.array = wp.zeros((worlds, len(kernels.KINDS)), dtype=wp.int32, device=self._device)
        self._depth: wp.array = wp.zeros((worlds, len(kernels.KINDS)), dtype=wp.float32, device=self._device)
        self._seen = torch.zeros(worlds, dtype=torch.int64, device=wp.device_to_torch(self._device))
        wp.launch(kernels.note_apart, self._apart.shape, [bodies, self._apart], device=self._device)

    def measure(self, mask: torch.Tensor) -> None:
        """Look at the masked worlds (bool, [worlds]) as they are now."""
        self._seen += mask
        inputs = [self._bodies, self._apart, wp.from_torch(mask), LEAST, self._steps, self._depth]
        wp.launch(kernels.measure_overlaps, len(mask), inputs, device=self._device)

    def rows(self) -> dict[str, dict[str, float]]:
        """Return by kind the share of steps with an overlap deeper than `LEAST` [%] and the deepest of all [mm]."""
        seen = max(int(self._seen.sum()), 1)
        share = 100.0 * wp.to_torch(self._steps).sum(0).double().cpu() / seen
        deepest = 1000.0 * wp.to_torch(self._depth).amax(0).double().cpu()
        return {
            kind: {"steps %": float(share[k]), "deepest mm": float(deepest[k])} for k, kind in enumerate(kernels.KINDS)
        }
