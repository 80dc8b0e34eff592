"""A joint that is stiffer in one plane of bending."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, dot, mul, sub
from ...kernels.lanes.real import cos_root, real, sin_ratio, where_neg
from .registry import Effect, EffectParameter, Law, axis_parameter, register


@wp.func
def anisotropic_stiffness(j: Any, p: Any, r: Any):
    """tau = -rel K (phi . n) n - t K phi_z z with n = (cos psi, sin psi, 0) across the segment, z along it."""
    o = real(0.0, p.a)
    n = type(r.torque)(cos_root(p.b * p.b), sin_ratio(p.b * p.b) * p.b, o)
    k = p.a * j.stiffness
    t = p.c * j.stiffness
    torque = n * (o - k * dot(j.angle, n)) - type(n)(o, o, t * j.angle.z)
    return type(r)(torque, r.memory, where_neg(k, o, k) + where_neg(t, o, t), o)


EFFECT = register(
    Effect(
        name="anisotropic_stiffness",
        plain="a joint that is stiffer in one plane than in another",
        summary="stiffness K (1 + rel) for bending about one axis across the segment, K about the other, and K (1 + t)"
        " for twist",
        source="Gere & Timoshenko, Mechanics of Materials (1997), section 6.4 (unsymmetric bending); wood: Bodig"
        " & Jayne, Mechanics of Wood and Wood Composites (1982), chapter 3",
        signature="pushes across the principal axes come back sideways; two frequencies in two planes",
        mistaken_for=("bilinear_stiffness", "bending_torsion_coupling"),
        alike=("bilinear_stiffness",),
        probe="releases in three directions about the segment",
        branch=Law(
            "joint",
            (
                EffectParameter("relative", "1", -0.9, 9.0, reach=1.0),
                axis_parameter(circle=False, tries=4),
                EffectParameter("twist", "1", -0.9, 2.0, tries=lambda s: [0.0], optional=True),
            ),
            anisotropic_stiffness,
            strengths=("relative", "twist"),
            throughout=True,
            spatial=True,
        ),
    )
)
