"""Where all capsules are: ends of the axes of arm and branches in world axes, for whoever samples or draws them."""

from functools import cache
from typing import Any

import warp as wp

from ..lanes.algebra import add, rotate, sub, vec3_of
from ..lanes.real import SOURCE
from ..tree.articulated import place_links, place_root
from ..tree.observe import locate_joints
from .arm import arm_lanes, arm_types, end_pose, entry_vec, place_group
from .law import contact_types

__all__ = ["capsule_kernel"]


@cache
def capsule_kernel(width: int, dof: int) -> Any:
    """Return the kernel of capsules [worlds, arm's + branches'], x_joint + R (middle -+ half), and end-effectors."""
    t = contact_types(width, 32)
    Model, State, Scratch, Shapes, Touch = t.Model, t.State, t.Scratch, t.Shapes, t.Touch
    Arm, ArmState, ArmLanes = arm_types(dof).Arm, arm_types(dof).ArmState, arm_lanes(width)
    W = width

    @wp.kernel(enable_backward=False, module="unique")
    def capsules(
        m: Model, x_in: State, a: Arm, y_in_out: ArmState, shapes: Shapes, touch_out: Touch, g_out: ArmLanes,
        slot_world: wp.array(dtype=int), s_out: Scratch, first: int, row: int, start_out: wp.array2d(dtype=wp.vec3),
        end_out: wp.array2d(dtype=wp.vec3),
    ):  # fmt: skip
        """Write the ends of a group's capsules [m], world axes, and the poses of its arms' end-effectors."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        place_root(e, r, m, s_out)
        place_links(e, r, m, x_in, s_out)
        locate_joints(e, r, m, s_out, touch_out.at, touch_out.velocity)
        place_group(e, r, W, slot_world, a, y_in_out, g_out)
        arms = a.shape_link.shape[0]
        for c in range(shapes.count[e]):
            i = shapes.link[e, c]
            middle = touch_out.at[r, i] + rotate(s_out.pose[r, i], shapes.middle[e, c])
            half = rotate(s_out.pose[r, i], shapes.half[e, c])
            for k in range(W):
                w = slot_world[e * W + k]
                own = shapes.slot_capsule[e * W + k, c]
                if w >= 0 and own >= 0:
                    start_out[w, arms + own] = vec3_of(middle, k) - vec3_of(half, k)
                    end_out[w, arms + own] = vec3_of(middle, k) + vec3_of(half, k)
        for k in range(W):
            w = slot_world[e * W + k]
            if w >= 0:
                end_pose(w, r, k, a, y_in_out, g_out)
                for c in range(arms):
                    start_out[w, c] = entry_vec(g_out.start_entry, r, c, k)
                    end_out[w, c] = entry_vec(g_out.end_entry, r, c, k)

    return capsules
