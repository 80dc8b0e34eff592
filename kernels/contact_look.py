"""Where all capsules are: ends of the axes of arm and branches in world axes, for whoever samples or draws them."""

from functools import cache
from typing import Any

import warp as wp

from .algebra import add, rotate, sub
from .arm import arm_types
from .articulated import place_links, place_root
from .contact import contact_types, lane_vec
from .observe import locate_joints
from .real import SOURCE

__all__ = ["capsule_kernel"]


@cache
def capsule_kernel(width: int, dof: int) -> Any:
    """Return the kernel that writes capsules [worlds, arm's + branches']: x = x_joint + R (middle -+ half)."""
    t = contact_types(width, 32)
    Model, State, Scratch, Shapes, Touch = t.Model, t.State, t.Scratch, t.Shapes, t.Touch
    ArmWork = arm_types(dof).ArmWork
    W = width

    @wp.kernel(enable_backward=False, module="unique")
    def capsules(
        m: Model, x_in: State, k_in: ArmWork, shapes: Shapes, touch_out: Touch, slot_world: wp.array(dtype=int),
        s_out: Scratch, first: int, row: int, start_out: wp.array2d(dtype=wp.vec3), end_out: wp.array2d(dtype=wp.vec3),
    ):  # fmt: skip
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        place_root(e, r, m, s_out)
        place_links(e, r, m, x_in, s_out)
        locate_joints(e, r, m, s_out, touch_out.at, touch_out.velocity)
        arms = k_in.start.shape[1]
        for c in range(shapes.count[e]):
            i = shapes.link[e, c]
            middle = touch_out.at[r, i] + rotate(s_out.pose[r, i], shapes.middle[e, c])
            half = rotate(s_out.pose[r, i], shapes.half[e, c])
            for k in range(W):
                w = slot_world[e * W + k]
                own = shapes.slot_capsule[e * W + k, c]
                if w >= 0 and own >= 0:
                    start_out[w, arms + own] = lane_vec(middle, k) - lane_vec(half, k)
                    end_out[w, arms + own] = lane_vec(middle, k) + lane_vec(half, k)
        for k in range(W):
            w = slot_world[e * W + k]
            if w >= 0:
                for c in range(arms):
                    start_out[w, c] = k_in.start[w, c]
                    end_out[w, c] = k_in.end[w, c]

    return capsules
