"""A joint that twists when it is bent."""

import math
from collections.abc import Sequence
from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, dot, mul, sub
from ...kernels.lanes.real import cos_root, fma, real, sin_ratio, sqrt_, where_neg
from .registry import Effect, EffectParameter, Law, Setting, axis_parameter, register


@wp.func
def bending_torsion_coupling(j: Any, p: Any, r: Any):
    """tau = -K (b (phi . n) n + t phi_z e_z + kappa sqrt((1 + b) (1 + t)) ((phi . n) e_z + phi_z n)).

    n = (cos psi, sin psi, 0) is across the segment, e_z along it. The spring stays positive for |kappa| < 1.
    """
    o = real(0.0, p.a)
    one = real(1.0, o)
    n = type(r.torque)(cos_root(p.b * p.b), sin_ratio(p.b * p.b) * p.b, o)
    k = p.a * j.stiffness * sqrt_((one + p.c) * (one + p.d))
    about, twist = dot(j.angle, n), j.angle.z
    across = o - fma(k, twist, p.c * j.stiffness * about)
    torque = type(n)(n.x * across, n.y * across, o - fma(k, about, p.d * j.stiffness * twist))
    steep = where_neg(k, o - k, k) + j.stiffness * (where_neg(p.c, o, p.c) + where_neg(p.d, o, p.d))
    return type(r)(torque, r.memory, steep, o)


#: Of wood with a grain that runs around the branch the stiff axis slants between bending and twist, so that each is
#: stiffer as well.
_BENDING, _TWIST = (
    EffectParameter(name, "1", -0.9, high, tries=lambda s: [0.0], reach=1.0, optional=True)
    for name, high in (("bending", 9.0), ("twist", 4.0))
)


def _slanting(s: Setting) -> Sequence[tuple[float, ...]]:
    """A stiff axis at 45 degrees between bending and twist."""
    return [(kappa, k * math.pi / 6, 1.0, 1.0) for kappa in (-0.5, 0.5) for k in range(6)]


EFFECT = register(
    Effect(
        name="bending_torsion_coupling",
        plain="twist that comes with bending",
        summary="bending about one axis across the segment and twist share a stiffness kappa K sqrt((1 + b) (1 + t)),"
        " alike both ways; either may be stiffer or softer as well, K (1 + b) and K (1 + t), as where a stiff axis"
        " slants between them",
        source="Librescu & Song, Thin-Walled Composite Beams (2006), section 4.6 (symmetric coupling); grain that"
        " spirals: Bodig & Jayne, Mechanics of Wood and Wood Composites (1982), chapter 3 (off-axis stiffness)",
        signature="a push in one plane moves the grasp point out of it, by the twist of a bent branch",
        mistaken_for=("anisotropic_stiffness", "bilinear_stiffness"),
        probe="pushes across the plane of a bent branch, at two grasp points",
        branch=Law(
            "joint",
            (
                EffectParameter("coupling", "1", -0.95, 0.95, tries=2),
                axis_parameter(circle=False, tries=6),
                _BENDING,
                _TWIST,
            ),
            bending_torsion_coupling,
            strengths=("coupling",),
            further=_slanting,
        ),
    )
)
