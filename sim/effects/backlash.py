"""Play in a joint."""

from typing import Any

import warp as wp

from ...kernels.algebra import add, div, dot, mul, norm, sub
from ...kernels.real import fma, real, sqrt_, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def backlash(j: Any, p: Any, r: Any):
    """tau = +K phi min(1, g / |phi|): the spring is left -K (phi - g phi / |phi|) outside the gap, 0 inside."""
    o = real(0.0, p.a)
    one = real(1.0, o)
    share = p.a / norm(j.angle)
    share = where_neg(one - share, one, share)
    return type(r)(j.angle * (j.stiffness * share), r.memory, o, o)


@wp.func
def backlash_ball(j: Any, p: Any, r: Any):
    """tau_k = +K phi_k min(1, g / r_k) with r_k^2 = (1 - m) |phi|^2 + m phi_k^2: one gap, or one about each axis."""
    o = real(0.0, p.a)
    a = j.angle
    joint = (real(1.0, o) - p.b) * dot(a, a) + real(1.0e-20, o)
    torque = type(a)(
        a.x * inside(joint + p.b * a.x * a.x, p.a),
        a.y * inside(joint + p.b * a.y * a.y, p.a),
        a.z * inside(joint + p.b * a.z * a.z, p.a),
    )
    return type(r)(torque * j.stiffness, r.memory, o, o)


@wp.func
def inside(square: Any, gap: Any):
    """min(1, gap / sqrt(square))."""
    one = real(1.0, gap)
    share = gap / sqrt_(fma(square, one, real(0.0, gap)))
    return where_neg(one - share, one, share)


_GAP = EffectParameter("gap_rad", "rad", lambda s: 0.005 * s.angle, lambda s: 0.8 * s.angle, scale="log")

EFFECT = register(
    Effect(
        name="backlash",
        summary="no spring within an angle g of rest, where the pre-load alone holds the joint; beyond, -K (|phi| - g);"
        " at a ball joint the gap is round, or square where each axis of the segment plays by itself, or between",
        source="Nordin & Gutman 2002, Automatica 38:1633, section 2 (dead zone)",
        signature="loose about rest and stiff beyond it; slow last swings",
        mistaken_for=("cubic_stiffness", "bilinear_stiffness"),
        probe="small pushes about rest beside large ones",
        branch=Law("joint", (_GAP, EffectParameter("separate", "1", 0.0, 1.0, tries=1)), backlash_ball),
        joint=Law("joint", (_GAP,), backlash),
    )
)
