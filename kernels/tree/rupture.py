"""Joints that break: where a spring's torque passes what the wood bears, it is gone from then on.

    K |q| > strength  =>  K <- 0, preload <- 0, D <- FIBRES D

with q the turn from where the spring is relaxed: log of the quaternion of a spherical joint, angle of a revolute one,
way of a prismatic one. The pre-load goes too: it is what the grown wood holds its weight with.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.real import SOURCE
from .articulated import SPHERICAL

__all__ = ["Springs", "rupture_kernels"]

#: Share of its damper that a broken joint keeps: bark and fibres still hold the branch, and it comes to rest.
FIBRES = wp.constant(0.02)


@wp.struct
class Springs:
    """What holds the joints: fields of `layout`'s Model as entries [groups, places + 1, components, lanes]."""

    stiffness: wp.array4d(dtype=wp.float32)
    damping: wp.array4d(dtype=wp.float32)
    preload: wp.array4d(dtype=wp.float32)


@wp.func
def deflection(kind: int, coordinate: wp.array4d(dtype=wp.float32), e: int, i: int, k: int):
    """|q| of a joint [rad or m]; 0 of a fixed joint, whose coordinate never changes."""
    v = wp.vec3(coordinate[e, i, 1, k], coordinate[e, i, 2, k], coordinate[e, i, 3, k])
    if kind == SPHERICAL:
        return 2.0 * wp.atan2(wp.length(v), wp.abs(coordinate[e, i, 0, k]))
    return wp.abs(v[0])


@wp.func
def copy_spring(e: int, i: int, k: int, spring_in: Springs, spring_out: Springs):
    """spring_out <- spring_in at one joint."""
    spring_out.stiffness[e, i, 0, k] = spring_in.stiffness[e, i, 0, k]
    spring_out.damping[e, i, 0, k] = spring_in.damping[e, i, 0, k]
    for c in range(3):
        spring_out.preload[e, i, c, k] = spring_in.preload[e, i, c, k]


@wp.func
def break_spring(e: int, i: int, k: int, spring_out: Springs):
    """K <- 0, preload <- 0, D <- FIBRES D at one joint."""
    spring_out.stiffness[e, i, 0, k] = 0.0
    spring_out.damping[e, i, 0, k] = FIBRES * spring_out.damping[e, i, 0, k]
    for c in range(3):
        spring_out.preload[e, i, c, k] = 0.0


@cache
def rupture_kernels(width: int = 1) -> Any:
    """Return ``rupture``, ``heal`` and ``note`` for a lane width (float32), launched over [slots, places].

    ``slot_link`` [slots, places + 1] names the link at a slot's place, -1 where there is none.
    """
    return SimpleNamespace(rupture=_rupture_kernel(width), heal=_heal_kernel(width), note=_note_kernel(width))


def _rupture_kernel(W: int) -> Any:
    """Kernel that breaks joints whose springs pass their strength."""

    @wp.kernel(enable_backward=False, module="unique")
    def rupture(
        slot_world: wp.array(dtype=int), slot_link: wp.array2d(dtype=int), kind: wp.array2d(dtype=int),
        coordinate_in: wp.array4d(dtype=wp.float32), strength_in: wp.array2d(dtype=wp.float32), spring_out: Springs,
        broken_out: wp.array2d(dtype=int),
    ):  # fmt: skip
        """Break the joint at a slot's place where K |q| exceeds its strength [N m, or N of a slide]."""
        tag = SOURCE  # noqa: F841
        slot, place = wp.tid()
        i = place + 1
        e = slot // W
        k = slot % W
        w = slot_world[slot]
        link = slot_link[slot, i]
        if w >= 0 and link >= 0:
            torque = spring_out.stiffness[e, i, 0, k] * deflection(kind[e, i], coordinate_in, e, i, k)
            if torque > strength_in[w, link]:
                break_spring(e, i, k, spring_out)
                broken_out[w, link] = 1

    return rupture


def _heal_kernel(W: int) -> Any:
    """Kernel that gives the broken joints of the masked worlds back what held them."""

    @wp.kernel(enable_backward=False, module="unique")
    def heal(
        mask: wp.array(dtype=wp.bool), slot_world: wp.array(dtype=int), slot_link: wp.array2d(dtype=int),
        whole_in: Springs, spring_out: Springs, broken_out: wp.array2d(dtype=int),
    ):  # fmt: skip
        """Copy K, D and preload from ``whole_in`` to the joint at a slot's place, if it is broken and masked."""
        tag = SOURCE  # noqa: F841
        slot, place = wp.tid()
        i = place + 1
        w = slot_world[slot]
        link = slot_link[slot, i]
        if w >= 0 and link >= 0:
            if mask[w] and broken_out[w, link] == 1:
                copy_spring(slot // W, i, slot % W, whole_in, spring_out)
                broken_out[w, link] = 0

    return heal


def _note_kernel(W: int) -> Any:
    """Kernel that takes down what holds the joints that are whole."""

    @wp.kernel(enable_backward=False, module="unique")
    def note(
        slot_world: wp.array(dtype=int), slot_link: wp.array2d(dtype=int), spring_in: Springs,
        broken_in: wp.array2d(dtype=int), whole_out: Springs,
    ):  # fmt: skip
        """Copy K, D and preload of the joint at a slot's place to ``whole_out``, unless it is broken."""
        tag = SOURCE  # noqa: F841
        slot, place = wp.tid()
        i = place + 1
        w = slot_world[slot]
        link = slot_link[slot, i]
        if w >= 0 and link >= 0:
            if broken_in[w, link] == 0:
                copy_spring(slot // W, i, slot % W, spring_in, whole_out)

    return note
