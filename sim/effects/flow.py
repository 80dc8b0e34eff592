"""What laws of moving air and moving segments share."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, dot, mul, sub
from ...kernels.lanes.real import fma, real
from .registry import EffectParameter

#: Largest pressure of wind on wood [Pa]: 0.6 v^2 at 70 m/s, a hurricane of category 5 (Simpson 1974, Weatherwise 27).
STORM = 3000.0
#: Share of the area that hangs at the tip, as a crown's leaves do, in the place of along the wood.
CROWN = EffectParameter("crown", "1", 0.0, 1.0, tries=lambda s: [0.0], optional=True)
#: How little a wind outruns the wood: one over the speed of the air, so that a segment that moves feels another wind. A
#: slower one than three times the fastest grasp point is drag: a faint wind of next to no speed is c |v| v.
SLOWNESS = EffectParameter("slowness_spm", "s/m", 0.0, lambda s: 0.3 / s.speed, tries=lambda s: [0.0], optional=True)
#: Share of a flow that counts only as far as it is across a segment (cross-flow principle).
ACROSS = EffectParameter("across", "1", 0.0, 1.0, tries=2, optional=True)


@wp.func
def felt(b: Any, k: Any):
    """Area of a point of a link [m^2] where the share k of the whole hangs at the tip."""
    return fma(k, b.crown - b.area, b.area)


@wp.func
def across(v: Any, d: Any, m: Any):
    """v - m (v.d) d / d.d: what flows along a segment d does not count, in the share m."""
    o = real(0.0, m)
    return v - d * (m * dot(v, d) / fma(dot(d, d), real(1.0, o), real(1.0e-20, o)))
