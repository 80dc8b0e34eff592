"""Play in a joint."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import warp as wp

from ...kernels.effects.held import held
from ...kernels.lanes.algebra import add, div, dot, mul, norm, sub
from ...kernels.lanes.real import cos_root, fma, real, sin_ratio, sqrt_
from .registry import TWIST_SHARE, Effect, EffectParameter, Law, Setting, axes_across, axis_parameter, register


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

    The axes are one at an angle psi across the segment, the one across both, and the segment. Of what is across the
    first the share 1 - w counts, of the twist the share t (1 - w), and of the torques about them as much. Where each
    axis has its gap, the first one's goes from -g (1 - u) to g (1 + u). All are gradients of an energy, so what is
    between gives none.
    """
    o = real(0.0, p.a)
    one = real(1.0, o)
    c, s, across = cos_root(p.f * p.f), sin_ratio(p.f * p.f) * p.f, one - p.g
    x, y, z = fma(c, j.angle.x, s * j.angle.y), (c * j.angle.y - s * j.angle.x) * across, j.angle.z * p.e * across
    own, shift = p.b, p.a * p.h
    joint = (one - own) * lacking(fma(x, x, fma(y, y, z * z)), p.a, p.c)
    off = x - shift
    middle = shift * lacking(shift * shift, p.a, p.c)
    first = fma(own, fma(off, lacking(off * off, p.a, p.c), middle), joint * x)
    second = y * fma(own, lacking(y * y, p.a, p.c), joint) * across
    third = z * fma(own, lacking(z * z, p.a, p.c), joint) * p.e * across
    torque = type(j.angle)(c * first - s * second, fma(s, first, c * second), third)
    return type(r)(torque * (j.stiffness * (one - p.d)), r.memory, o, o)


@wp.func
def backlash_holds(j: Any, p: Any, r: Any):
    """Up to K g (1 - s): what is lacking of the spring at the edge of the gap."""
    return held(r, j.stiffness * (real(1.0, p.a) - p.d), p.a)


def _further(s: Setting) -> Sequence[tuple[float, ...]]:
    """Plays about one axis alone."""
    axes = axes_across(circle=False, count=4)
    return [(share * s.angle, 1.0, 0.02, 0.0, 1.0, axis, 1.0, 0.0) for share in (0.1, 0.4) for axis in axes]


_GAP = EffectParameter("gap_rad", "rad", lambda s: 0.005 * s.angle, lambda s: 0.8 * s.angle, scale="log")
_SEPARATE = EffectParameter("separate", "1", 0.0, 1.0, tries=1)
_ROUNDING = EffectParameter("rounding", "1", 0.0, 0.3, tries=1, optional=True)
_LEFT = EffectParameter("left", "1", 0.0, 0.8, tries=lambda s: [0.0], optional=True)
_AXIS = replace(axis_parameter(circle=False, tries=1), optional=True)
_SINGLE = EffectParameter("single", "1", 0.0, 1.0, tries=lambda s: [0.0], optional=True)
#: With more of it a stop that one side alone touches would pass for a play.
_UNEVEN = EffectParameter("uneven", "1", -0.4, 0.4, optional=True)

EFFECT = register(
    Effect(
        name="backlash",
        plain="play",
        summary="within an angle g of rest no spring, or the share s of it that is left there, beside the pre-load;"
        " beyond, -K (|phi| - (1 - s) g), the corner rounded where the edges of the gap are not hard; at a ball joint"
        " the gap is round, or square where axes play by themselves, one at an angle across the segment, or between;"
        " twist counts by a share t, it may play about that axis alone, and further to one side than to the other",
        source="Nordin & Gutman 2002, Automatica 38:1633, section 2 (dead zone)",
        signature="loose about rest and stiff beyond it; slow last swings",
        mistaken_for=("cubic_stiffness", "bilinear_stiffness"),
        probe="small pushes about rest beside large ones",
        branch=Law(
            "joint",
            (_GAP, _SEPARATE, _ROUNDING, _LEFT, TWIST_SHARE, _AXIS, _SINGLE, _UNEVEN),
            backlash_ball,
            holds=backlash_holds,
            further=_further,
        ),
        joint=Law("joint", (_GAP, _ROUNDING, _LEFT), backlash),
    )
)
