"""A joint that twists when it is bent."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, dot, mul, sub
from ...kernels.lanes.real import cos_root, real, sin_ratio, where_neg
from .registry import Effect, EffectParameter, Law, axis_parameter, register


@wp.func
def bending_torsion_coupling(j: Any, p: Any, r: Any):
    """tau = -kappa K ((phi . n) e_z + (phi . e_z) n) with n = (cos psi, sin psi, 0) across the segment."""
    o = real(0.0, p.a)
    n = type(r.torque)(cos_root(p.b * p.b), sin_ratio(p.b * p.b) * p.b, o)
    k = p.a * j.stiffness
    bend = o - k * dot(j.angle, n)
    twist = o - k * j.angle.z
    torque = type(n)(n.x * twist, n.y * twist, bend)
    return type(r)(torque, r.memory, where_neg(k, o - k, k), o)


EFFECT = register(
    Effect(
        name="bending_torsion_coupling",
        plain="twist that comes with bending",
        summary="bending about one axis across the segment and twist share a stiffness kappa K, alike both ways",
        source="Librescu & Song, Thin-Walled Composite Beams (2006), section 4.6 (symmetric coupling)",
        signature="a push in one plane moves the grasp point out of it, by the twist of a bent branch",
        mistaken_for=("anisotropic_stiffness",),
        probe="pushes across the plane of a bent branch, at two grasp points",
        branch=Law(
            "joint",
            (
                EffectParameter("coupling", "1", -0.95, 0.95, tries=2),
                axis_parameter(circle=False, tries=6),
            ),
            bending_torsion_coupling,
        ),
    )
)
