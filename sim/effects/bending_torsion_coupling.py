"""A joint that twists when it is bent."""

from collections.abc import Sequence
from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, dot, mul, size, sub
from ...kernels.lanes.real import cos_root, fma, real, sin_ratio, sqrt_, where_neg
from .registry import Effect, EffectParameter, Law, Setting, axes_across, axis_parameter, register


@wp.func
def bending_torsion_coupling(j: Any, p: Any, r: Any):
    """tau = -K ((kappa + f'(u)) t n + (kappa u + f(u)) e_z), energy K t (kappa u + f(u)).

    u = phi . n is the bend about n = (cos psi, sin psi, 0) across the segment, t = phi . e_z the twist, and
    f = s u^2 / sqrt(1 + (s u)^4), whose f / u stays below 1, so that no bend lets the joint give way.
    """
    o, one, two = real(0.0, p.a), real(1.0, p.a), real(2.0, p.a)
    n = type(r.torque)(cos_root(p.b * p.b), sin_ratio(p.b * p.b) * p.b, o)
    u, t = dot(j.angle, n), j.angle.z
    x = p.c * u
    square = fma(x * x, x * x, one)
    root = sqrt_(square)
    curve, slope = x / root, two * x / (square * root)
    twist = (o - j.stiffness) * (p.a + slope) * t
    tangent = size(p.a) + size(slope) + two * size(p.c * t)
    torque = type(n)(n.x * twist, n.y * twist, (o - j.stiffness) * (p.a + curve) * u)
    return type(r)(torque, r.memory, j.stiffness * tangent, o)


#: Twist that comes with the square of the bend, whichever way it goes, as that of a crooked segment does.
_SQUARED = EffectParameter(
    "squared_prad", "1/rad", lambda s: -4.0 / s.angle, lambda s: 4.0 / s.angle, tries=lambda s: [0.0],
    reach=lambda s: 1.0 / s.angle, optional=True,
)  # fmt: skip


def _further(s: Setting) -> Sequence[tuple[float, ...]]:
    """Couplings with the square of the bend alone."""
    return [(0.0, axis, sign * 0.5 / s.angle) for sign in (1.0, -1.0) for axis in axes_across(circle=False, count=6)]


EFFECT = register(
    Effect(
        name="bending_torsion_coupling",
        plain="twist that comes with bending",
        summary="bending u about one axis across the segment and twist share a stiffness kappa K, alike both ways;"
        " twist may come with the square of the bend too, s u^2 / sqrt(1 + (s u)^4) beside kappa u",
        source="Librescu & Song, Thin-Walled Composite Beams (2006), section 4.6 (symmetric coupling); Hodges,"
        " Nonlinear Composite Beam Theory (2006), chapter 4 (of the square)",
        signature="a push in one plane moves the grasp point out of it, by the twist of a bent branch",
        mistaken_for=("anisotropic_stiffness",),
        probe="pushes across the plane of a bent branch, at two grasp points",
        branch=Law(
            "joint",
            (
                EffectParameter("coupling", "1", -0.95, 0.95, tries=2),
                axis_parameter(circle=False, tries=6),
                _SQUARED,
            ),
            bending_torsion_coupling,
            further=_further,
            strengths=("coupling", "squared_prad"),
            spatial=True,
        ),
    )
)
