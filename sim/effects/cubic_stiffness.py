"""A spring that stiffens or softens with its angle."""

from typing import Any

import warp as wp

from ...kernels.algebra import add, div, dot, mul, sub
from ...kernels.real import real, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def cubic_stiffness(j: Any, p: Any, r: Any):
    """tau = -kappa K |phi|^2 phi; its steepest tangent is 3 kappa K |phi|^2."""
    o = real(0.0, p.a)
    k = p.a * j.stiffness * dot(j.angle, j.angle)
    tangent = k * real(3.0, k)
    return type(r)(j.angle * (o - k), r.memory, where_neg(tangent, o, tangent), o)


_LAW = Law(
    "joint",
    (EffectParameter("cubic_radm2", "1/rad^2", lambda s: -1.0 / s.angle**2, lambda s: 20.0 / s.angle**2),),
    cubic_stiffness,
)

EFFECT = register(
    Effect(
        name="cubic_stiffness",
        summary="torque -K (phi + kappa |phi|^2 phi): the spring stiffens (kappa > 0) or softens with the angle",
        source="Duffing 1918; Kovacic & Brennan, The Duffing Equation (2011), chapter 2",
        signature="frequency and stiffness depend on amplitude, alike in both directions and in hold and release",
        mistaken_for=("bilinear_stiffness", "force_scale"),
        probe="the same push at a third and at three times the force",
        branch=_LAW,
        joint=_LAW,
    )
)
