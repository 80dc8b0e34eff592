"""Put chosen worlds back to a stored state; the others are not touched."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.real import SOURCE

__all__ = ["reset_kernels"]


@cache
def reset_kernels(precision: int = 32) -> SimpleNamespace:
    """Return ``restore`` (one field of every link) and ``revive`` (guard flags) for a precision."""
    Scalar: Any = wp.float64 if precision == 64 else wp.float32

    @wp.kernel(enable_backward=False, module="unique")
    def restore(
        mask: wp.array(dtype=wp.bool),
        slot_world: wp.array(dtype=int),
        stored_in: wp.array4d(dtype=Scalar),
        field_out: wp.array4d(dtype=Scalar),
    ):
        """field <- stored in every link, component and lane of the masked worlds."""
        tag = SOURCE  # noqa: F841
        g, i = wp.tid()
        lanes = field_out.shape[3]
        for k in range(lanes):
            world = slot_world[g * lanes + k]
            if world >= 0:
                if mask[world]:
                    for c in range(field_out.shape[2]):
                        field_out[g, i, c, k] = stored_in[g, i, c, k]

    @wp.kernel(enable_backward=False, module="unique")
    def revive(
        mask: wp.array(dtype=wp.bool),
        slot_world: wp.array(dtype=int),
        alive_out: wp.array4d(dtype=Scalar),
        fault_link_out: wp.array(dtype=int),
        fault_tick_out: wp.array(dtype=int),
    ):
        """alive <- 1 and no fault in the masked worlds."""
        tag = SOURCE  # noqa: F841
        slot = wp.tid()
        lanes = alive_out.shape[3]
        world = slot_world[slot]
        if world >= 0:
            if mask[world]:
                alive_out[slot // lanes, 0, 0, slot % lanes] = Scalar(1.0)
                fault_link_out[slot] = 0
                fault_tick_out[slot] = -1

    return SimpleNamespace(restore=restore, revive=revive)
