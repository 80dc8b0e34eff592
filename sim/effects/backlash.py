"""Play in a joint."""

from typing import Any

import warp as wp

from ...kernels.effects.held import held
from ...kernels.lanes.algebra import add, div, dot, mul, norm, sub
from ...kernels.lanes.real import fma, real, sqrt_
from .registry import TWIST_SHARE, Effect, EffectParameter, Law, register


@wp.func
def lacking(square: Any, gap: Any, e: Any):
    """2 x / (1 + x + sqrt((1 - x)^2 + 4 e x)), x = gap / sqrt(square): min(1, x), its corner rounded by e."""
    one = real(1.0, gap)
    x = gap / sqrt_(square + real(1.0e-20, gap))
    inside = one - x
    return (x + x) / (one + x + sqrt_(fma(inside, inside, real(4.0, gap) * e * x)))


@wp.func
def backlash(j: Any, p: Any, r: Any):
    """tau = +(1 - s) K phi min(1, g / |phi|), rounded: the spring has s K inside the gap and K beyond it."""
    o = real(0.0, p.a)
    share = lacking(dot(j.angle, j.angle), p.a, p.b) * (real(1.0, o) - p.c)
    return type(r)(j.angle * (j.stiffness * share), r.memory, o, o)


@wp.func
def backlash_ball(j: Any, p: Any, r: Any):
    """tau_k = +(1 - s) K phi_k ((1 - m) min(1, g / |phi|) + m min(1, g / |phi_k|)), rounded: one gap, or one an axis.

    Either is the gradient of an energy, so what is between gives none. Of the twist phi_z the part t counts, and of the
    torque about it as much, which leaves them one.
    """
    o = real(0.0, p.a)
    a = type(j.angle)(j.angle.x, j.angle.y, j.angle.z * p.e)
    own = p.b
    joint = (real(1.0, o) - own) * lacking(dot(a, a), p.a, p.c)
    torque = type(a)(
        a.x * fma(own, lacking(a.x * a.x, p.a, p.c), joint),
        a.y * fma(own, lacking(a.y * a.y, p.a, p.c), joint),
        a.z * p.e * fma(own, lacking(a.z * a.z, p.a, p.c), joint),
    )
    return type(r)(torque * (j.stiffness * (real(1.0, o) - p.d)), r.memory, o, o)


@wp.func
def backlash_holds(j: Any, p: Any, r: Any):
    """Up to K g (1 - s): what is lacking of the spring at the edge of the gap."""
    return held(r, j.stiffness * (real(1.0, p.a) - p.d), p.a)


_GAP = EffectParameter("gap_rad", "rad", lambda s: 0.005 * s.angle, lambda s: 0.8 * s.angle, scale="log")
_SEPARATE = EffectParameter("separate", "1", 0.0, 1.0, tries=1)
_ROUNDING = EffectParameter("rounding", "1", 0.0, 0.3, tries=1, optional=True)
_LEFT = EffectParameter("left", "1", 0.0, 0.8, tries=lambda s: [0.0], optional=True)

EFFECT = register(
    Effect(
        name="backlash",
        plain="play",
        summary="within an angle g of rest no spring, or the share s of it that is left there, beside the pre-load;"
        " beyond, -K (|phi| - (1 - s) g), the corner rounded where the edges of the gap are not hard; at a ball joint"
        " the gap is round, or square where each axis of the segment plays by itself, or between, and twist counts by a"
        " share t",
        source="Nordin & Gutman 2002, Automatica 38:1633, section 2 (dead zone)",
        signature="loose about rest and stiff beyond it; slow last swings",
        mistaken_for=("cubic_stiffness", "bilinear_stiffness"),
        probe="small pushes about rest beside large ones",
        branch=Law("joint", (_GAP, _SEPARATE, _ROUNDING, _LEFT, TWIST_SHARE), backlash_ball, holds=backlash_holds),
        joint=Law("joint", (_GAP, _ROUNDING, _LEFT), backlash),
    )
)
