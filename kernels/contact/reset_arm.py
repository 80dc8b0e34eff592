"""Put the arms of chosen worlds back to where they start."""

from functools import cache
from typing import Any

import warp as wp

from ..lanes.real import SOURCE
from .arm import arm_types
from .law import ContactRule

__all__ = ["reset_arm_kernel"]


@cache
def reset_arm_kernel(dof: int) -> Any:
    """Return the kernel: q <- start, all else of the arm <- 0 in the masked worlds; contacts without room are kept."""
    t = arm_types(dof)
    ArmState, ArmWork, Row = t.ArmState, t.ArmWork, t.Row

    @wp.kernel(enable_backward=False, module="unique")
    def reset_arm(
        mask: wp.array(dtype=wp.bool), start_in: wp.array2d(dtype=wp.float32), y_out: ArmState, k_out: ArmWork,
        rule: ContactRule,
    ):  # fmt: skip
        """Put the arm of a masked world where it starts, at rest; forces and contacts <- 0."""
        tag = SOURCE  # noqa: F841
        w = wp.tid()
        if mask[w]:
            for j in range(dof):
                y_out.q[w, j] = start_in[w, j]
                y_out.qd[w, j] = 0.0
                y_out.torque[w, j] = 0.0
                y_out.target[w, j] = 0.0
                y_out.obeyed[w, j] = 0.0
                for slot in range(y_out.waiting.shape[0]):
                    y_out.waiting[slot, w, j] = 0.0
                y_out.force[w, j] = wp.vec3(0.0, 0.0, 0.0)
                rule.arm_peak[w, j] = 0.0
            for c in range(rule.branch_force.shape[1]):
                rule.branch_force[w, c] = wp.vec3(0.0, 0.0, 0.0)
            k_out.held[w] = Row()
            y_out.lost[w] = 0
            y_out.beat[w] = 0
            rule.count[w] = 0
            rule.forgotten[w] += rule.overflow[w]
            rule.overflow[w] = 0
            rule.depth[w] = 0.0

    return reset_arm
