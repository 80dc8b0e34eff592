"""Joints that break: where a spring's torque passes what the wood bears, spring and damper are gone from then on."""

from functools import cache
from typing import Any

import warp as wp

from .real import SOURCE

__all__ = ["rupture_kernels"]

#: Share of its damper that a broken joint keeps: bark and fibres still hold the branch, and it comes to rest.
FIBRES = wp.constant(0.02)


@cache
def rupture_kernels(width: int = 1) -> Any:
    """Return ``rupture`` and ``heal`` for a lane width (float32), launched over [slots, places without the world's].

    ``slot_link`` names the link at a slot's place, -1 where there is none.
    """
    W = width

    @wp.kernel(enable_backward=False, module="unique")
    def rupture(
        slot_world: wp.array(dtype=int), slot_link: wp.array2d(dtype=int), coordinate_in: wp.array4d(dtype=wp.float32),
        strength_in: wp.array2d(dtype=wp.float32), stiffness_out: wp.array4d(dtype=wp.float32),
        damping_out: wp.array4d(dtype=wp.float32), broken_out: wp.array2d(dtype=int),
    ):  # fmt: skip
        """K |2 atan2(|v|, |w|)| > strength  =>  K <- 0, D <- FIBRES D, of a spherical joint's quaternion (w, v)."""
        tag = SOURCE  # noqa: F841
        slot, place = wp.tid()
        i = place + 1
        w = slot_world[slot]
        e = slot // W
        k = slot % W
        link = slot_link[slot, i]
        if w >= 0 and link >= 0:
            v = wp.vec3(coordinate_in[e, i, 1, k], coordinate_in[e, i, 2, k], coordinate_in[e, i, 3, k])
            angle = 2.0 * wp.atan2(wp.length(v), wp.abs(coordinate_in[e, i, 0, k]))
            if stiffness_out[e, i, 0, k] * angle > strength_in[w, link]:
                stiffness_out[e, i, 0, k] = 0.0
                damping_out[e, i, 0, k] = FIBRES * damping_out[e, i, 0, k]
                broken_out[w, link] = 1

    @wp.kernel(enable_backward=False, module="unique")
    def heal(
        mask: wp.array(dtype=wp.bool), slot_world: wp.array(dtype=int), slot_link: wp.array2d(dtype=int),
        stiffness_in: wp.array4d(dtype=wp.float32), damping_in: wp.array4d(dtype=wp.float32),
        stiffness_out: wp.array4d(dtype=wp.float32), damping_out: wp.array4d(dtype=wp.float32),
        broken_out: wp.array2d(dtype=int),
    ):  # fmt: skip
        """Give the broken joints of the masked worlds their spring and damper back."""
        tag = SOURCE  # noqa: F841
        slot, place = wp.tid()
        i = place + 1
        w = slot_world[slot]
        e = slot // W
        k = slot % W
        link = slot_link[slot, i]
        if w >= 0 and link >= 0:
            if mask[w] and broken_out[w, link] == 1:
                stiffness_out[e, i, 0, k] = stiffness_in[e, i, 0, k]
                damping_out[e, i, 0, k] = damping_in[e, i, 0, k]
                broken_out[w, link] = 0

    return rupture, heal
