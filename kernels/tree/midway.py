"""What replays of a branch take in the middle of their steps, so that their error is of second order.

A step of length h has rates at its ends and coordinates, like what acts, in its middle (leapfrog). What a ball joint's
rate w, the link's axes, will be there is told from the step before: w + g / 2, g = w - w_before. Of that rate are

    velocity products   all of them, and the forces of moving air
    the damper          -D w' + D g / 2, which is -D (w + w') / 2 to second order. Not about the segment's own axis,
                        about which it has hardly any inertia: there -D w', backward Euler's

Without any inertia a spring K that is explicit stays stable with -D w' + c D g for c < D / (D + h K) (Jury's criterion
for w' = c (w - w_before) - (K / D) x, x' = x + h w'), so no more than that is taken where D is below h K.

At a sample coordinates are taken half a step back, so that displacement and velocity are those of one moment. Joints of
one axis are left as they are.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.algebra import add, div, exponential, mul, sub
from ..lanes.real import fma, real, where_neg
from .articulated import SPHERICAL
from .layout import layout_of

__all__ = ["damper_midway", "look_again", "look_forward", "midway_types", "set_out_from", "to_sample", "to_step"]


@cache
def midway_types(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return the structs of `layout` and ``Midway``, of one width and precision."""
    t = layout_of(width, precision)
    Vec, Quat = t.Vec, t.Quat

    @wp.struct
    class Midway:
        """Rates before the last step and what it changed, and coordinates of the next step's middle."""

        before: wp.array2d(dtype=Vec)
        gain: wp.array2d(dtype=Vec)
        ahead: wp.array2d(dtype=Quat)

    return SimpleNamespace(**vars(t), Midway=Midway)


@wp.func
def set_out_from(e: int, m: Any, x: Any, mid: Any):
    """Begin a recording: nothing has changed in the step before."""
    for i in range(1, m.count[e] + 1):
        v = x.velocity[e, i]
        mid.before[e, i] = type(v)(v.x, v.y, v.z)


@wp.func
def look_forward(e: int, m: Any, x: Any, mid: Any):
    """Write the rates of ball joints as they will be in the middle of the step, and by how much they changed before."""
    for i in range(1, m.count[e] + 1):
        if m.kind[e, i] == SPHERICAL:
            v = x.velocity[e, i]
            g = v - mid.before[e, i]
            mid.gain[e, i] = g
            mid.before[e, i] = type(v)(v.x, v.y, v.z)
            x.velocity[e, i] = v + g * real(0.5, v.x)


@wp.func
def look_again(e: int, m: Any, x: Any, mid: Any):
    """Write the rates of ball joints as they are."""
    for i in range(1, m.count[e] + 1):
        if m.kind[e, i] == SPHERICAL:
            v = mid.before[e, i]
            x.velocity[e, i] = type(v)(v.x, v.y, v.z)


@wp.func
def damper_midway(e: int, i: int, m: Any, mid: Any, whole: Any, own: Any, stiffness: Any, h: wp.float64):
    """Effort at a joint that makes the damper ``whole`` act on the rate w, not on w + g / 2, and adds ``own`` g / 2.

    Of ``own`` no more than is stable beside a spring of ``stiffness``.
    """
    g = mid.gain[e, i]
    o = real(0.0, g.x)
    out = type(g)(o, o, o)
    if m.kind[e, i] == SPHERICAL:
        half = real(0.5, o)
        most = (whole * whole) / fma(real(h, o), stiffness, whole)
        taken = where_neg(most - own * half, most, own * half)
        bending = fma(half, whole, taken)
        out = type(g)(g.x * bending, g.y * bending, g.z * (whole * half))
    return out


@wp.func
def to_sample(e: int, m: Any, x: Any, mid: Any, h: wp.float64, stepped: bool):
    """Take the coordinates of ball joints half a step back, if any was taken, and remember them."""
    for i in range(1, m.count[e] + 1):
        q = x.coordinate[e, i]
        mid.ahead[e, i] = type(q)(q.w, q.x, q.y, q.z)
        if stepped and m.kind[e, i] == SPHERICAL:
            x.coordinate[e, i] = q * exponential(x.velocity[e, i] * real(h * wp.float64(-0.5), q.w), q)


@wp.func
def to_step(e: int, m: Any, x: Any, mid: Any):
    """Write the coordinates of the next step's middle again."""
    for i in range(1, m.count[e] + 1):
        q = mid.ahead[e, i]
        x.coordinate[e, i] = type(q)(q.w, q.x, q.y, q.z)
