"""A spring that stiffens or softens with its angle."""

from dataclasses import replace
from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, dot, mul, sub
from ...kernels.lanes.real import fma, real, where_neg
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
    """tau = -K ((1 - m) g(|phi|^2) phi + m (g(phi_x^2) phi_x, ...)),  g(u) = (1 - q^2) kappa u + 2 q (kappa u)^2.

    m from 0 to 1; with q from 0 to 1 that is every cubic beside every quintic that stiffens. Its steepest tangent is
    K (3 (1 - q^2) kappa u + 10 q (kappa u)^2) at u = |phi|^2.
    """
    o = real(0.0, p.a)
    one = real(1.0, o)
    a = j.angle
    cubic, quintic = fma(o - p.c, p.c, one), p.c + p.c
    x, y, z = p.a * a.x * a.x, p.a * a.y * a.y, p.a * a.z * a.z
    whole = x + y + z
    joint = (one - p.b) * whole * fma(quintic, whole, cubic)
    torque = type(a)(
        a.x * fma(p.b * x, fma(quintic, x, cubic), joint), a.y * fma(p.b * y, fma(quintic, y, cubic), joint),
        a.z * fma(p.b * z, fma(quintic, z, cubic), joint),
    )  # fmt: skip
    tangent = j.stiffness * whole * fma(real(5.0, o) * quintic, whole, real(3.0, o) * cubic)
    return type(r)(torque * (o - j.stiffness), r.memory, where_neg(tangent, o, tangent), o)


_CUBIC = EffectParameter("cubic_radm2", "1/rad^2", lambda s: -1.0 / s.angle**2, lambda s: 20.0 / s.angle**2)

#: A quintic that ends the softening allows for more of it than a cubic that goes on, and a joint may turn by a fraction
#: of the angle that it would if it turned alone.
_CUBIC_OF_BRANCH = replace(_CUBIC, low=lambda s: -40.0 / s.angle**2, reach=lambda s: 12.0 / s.angle**2)

EFFECT = register(
    Effect(
        name="cubic_stiffness",
        plain="a spring that gets stiffer or softer the further it bends",
        summary="torque -K (phi + kappa |phi|^2 phi): the spring stiffens (kappa > 0) or softens with the angle; at a"
        " ball joint a share of it may act about each axis of the segment by itself, kappa phi_k^3, and a quintic may"
        " end the softening or stand for the cubic, (1 - q^2) kappa |phi|^2 phi + 2 q kappa^2 |phi|^4 phi",
        source="Duffing 1918; Kovacic & Brennan, The Duffing Equation (2011), chapter 2",
        signature="frequency and stiffness depend on amplitude, alike in both directions and in hold and release",
        mistaken_for=("bilinear_stiffness", "force_scale"),
        probe="the same push at a third and at three times the force",
        branch=Law(
            "joint",
            (
                _CUBIC_OF_BRANCH,
                EffectParameter("separate", "1", 0.0, 1.0, tries=2, optional=True),
                EffectParameter("quintic", "1", 0.0, 1.0, tries=lambda s: [0.0], optional=True),
            ),
            cubic_ball,
            throughout=True,
        ),
        joint=Law("joint", (_CUBIC,), cubic_stiffness),
    )
)
