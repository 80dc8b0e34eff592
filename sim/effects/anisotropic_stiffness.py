"""A joint that is stiffer in one plane of bending."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, dot, mul, sub
from ...kernels.lanes.real import cos_root, real, sin_ratio, where_neg
from .registry import Effect, EffectParameter, Law, axis_parameter, register


@wp.func
def anisotropic_stiffness(j: Any, p: Any, r: Any):
    """tau = -rel K (phi . n) n with n = (cos psi, sin psi, 0) across the segment."""
    o = real(0.0, p.a)
    n = type(r.torque)(cos_root(p.b * p.b), sin_ratio(p.b * p.b) * p.b, o)
    k = p.a * j.stiffness
    return type(r)(n * (o - k * dot(j.angle, n)), r.memory, where_neg(k, o, k), o)


EFFECT = register(
    Effect(
        name="anisotropic_stiffness",
        plain="a joint that is stiffer in one plane than in another",
        summary="stiffness K (1 + rel) for bending about one axis across the segment, K about the others",
        source="Gere & Timoshenko, Mechanics of Materials (1997), section 6.4 (unsymmetric bending)",
        signature="pushes across the principal axes come back sideways; two frequencies in two planes",
        mistaken_for=("bilinear_stiffness", "bending_torsion_coupling"),
        probe="releases in three directions about the segment",
        branch=Law(
            "joint",
            (
                EffectParameter("relative", "1", -0.9, 3.0),
                axis_parameter(circle=False, tries=4),
            ),
            anisotropic_stiffness,
        ),
    )
)
