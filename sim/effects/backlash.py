"""Play in a joint."""

from typing import Any

import warp as wp

from ...kernels.algebra import add, div, dot, mul, sub
from ...kernels.real import fma, real, sqrt_, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def backlash(j: Any, p: Any, r: Any):
    """tau = +K phi min(1, g / |phi|): the spring is left -K (phi - g phi / |phi|) outside the gap, 0 inside."""
    o = real(0.0, p.a)
    one = real(1.0, o)
    size = sqrt_(fma(dot(j.angle, j.angle), one, real(1.0e-20, o)))
    share = p.a / size
    share = where_neg(one - share, one, share)
    return type(r)(j.angle * (j.stiffness * share), r.memory, o, o)


_LAW = Law(
    "joint",
    (EffectParameter("gap_rad", "rad", lambda s: 0.005 * s.angle, lambda s: 0.8 * s.angle, scale="log"),),
    backlash,
)

EFFECT = register(
    Effect(
        name="backlash",
        summary="no spring within an angle g of rest, where the pre-load alone holds the joint; beyond, -K (|phi| - g)",
        source="Nordin & Gutman 2002, Automatica 38:1633, section 2 (dead zone)",
        signature="loose about rest and stiff beyond it; slow last swings",
        mistaken_for=("cubic_stiffness", "bilinear_stiffness"),
        probe="small pushes about rest beside large ones",
        branch=_LAW,
        joint=_LAW,
    )
)
