"""A spring that stiffens or softens with its angle."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, dot, mul, sub
from ...kernels.lanes.real import real, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def cubic_stiffness(j: Any, p: Any, r: Any):
    """tau = -kappa K |phi|^2 phi; its steepest tangent is 3 kappa K |phi|^2."""
    o = real(0.0, p.a)
    k = p.a * j.stiffness * dot(j.angle, j.angle)
    tangent = k * real(3.0, k)
    return type(r)(j.angle * (o - k), r.memory, where_neg(tangent, o, tangent), o)


@wp.func
def cubic_ball(j: Any, p: Any, r: Any):
    """tau = -kappa K ((1 - m) |phi|^2 phi + m (phi_x^3, phi_y^3, phi_z^3)), m from 0 to 1."""
    o = real(0.0, p.a)
    k = p.a * j.stiffness
    a = j.angle
    own = p.b
    joint = (real(1.0, o) - own) * dot(a, a)
    torque = type(a)(
        a.x * (joint + own * a.x * a.x), a.y * (joint + own * a.y * a.y), a.z * (joint + own * a.z * a.z)
    )  # fmt: skip
    tangent = k * dot(a, a) * real(3.0, k)
    return type(r)(torque * (o - k), r.memory, where_neg(tangent, o, tangent), o)


_CUBIC = EffectParameter("cubic_radm2", "1/rad^2", lambda s: -1.0 / s.angle**2, lambda s: 20.0 / s.angle**2)

EFFECT = register(
    Effect(
        name="cubic_stiffness",
        plain="a spring that gets stiffer or softer the further it bends",
        summary="torque -K (phi + kappa |phi|^2 phi): the spring stiffens (kappa > 0) or softens with the angle; at a"
        " ball joint a share of it may act about each axis of the segment by itself, kappa phi_k^3",
        source="Duffing 1918; Kovacic & Brennan, The Duffing Equation (2011), chapter 2",
        signature="frequency and stiffness depend on amplitude, alike in both directions and in hold and release",
        mistaken_for=("bilinear_stiffness", "force_scale"),
        probe="the same push at a third and at three times the force",
        branch=Law("joint", (_CUBIC, EffectParameter("separate", "1", 0.0, 1.0, tries=2, optional=True)), cubic_ball),
        joint=Law("joint", (_CUBIC,), cubic_stiffness),
    )
)
