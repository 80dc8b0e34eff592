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
def growing(u: Any, c: Any):
    """g(u) = (1 - c^2) u + 2 c u^2 for u >= 0, u / (1 - 4 c u) below; g = u for c = 0."""
    o, one = real(0.0, u), real(1.0, u)
    below = where_neg(u, u, o)
    softer = u / fma(o - real(4.0, u) * c, below, one)
    return where_neg(u, softer, u * fma(c + c, u, fma(o - c, c, one)))


@wp.func
def cubic_ball(j: Any, p: Any, r: Any):
    """tau = -K ((1 - m) g(kappa |phi|^2) phi + m (g(kappa phi_x^2) phi_x, ...)), g of `growing` with c as given.

    With c from 0 to 1 that is every cubic beside every quintic that stiffens, and every cubic that softens beside
    those that end at what a spring of -1 / (4 c) K would add. The steepest tangent of those that stiffen is
    K (3 (1 - c^2) v + 10 c v^2) at v = kappa |phi|^2.
    """
    o = real(0.0, p.a)
    a = j.angle
    x, y, z = p.a * a.x * a.x, p.a * a.y * a.y, p.a * a.z * a.z
    whole = x + y + z
    joint = (real(1.0, o) - p.b) * growing(whole, p.c)
    torque = type(a)(
        a.x * fma(p.b, growing(x, p.c), joint), a.y * fma(p.b, growing(y, p.c), joint),
        a.z * fma(p.b, growing(z, p.c), joint),
    )  # fmt: skip
    cubic, quintic = fma(o - p.c, p.c, real(1.0, o)), p.c + p.c
    tangent = j.stiffness * whole * fma(real(5.0, o) * quintic, whole, real(3.0, o) * cubic)
    return type(r)(torque * (o - j.stiffness), r.memory, where_neg(whole, o, tangent), o)


_CUBIC = EffectParameter("cubic_radm2", "1/rad^2", lambda s: -1.0 / s.angle**2, lambda s: 20.0 / s.angle**2)

#: A softening that ends allows for more of it at first than a cubic that goes on, and a joint may turn by a fraction of
#: the angle that it would if it turned alone.
_CUBIC_OF_BRANCH = replace(_CUBIC, low=lambda s: -40.0 / s.angle**2, reach=lambda s: 12.0 / s.angle**2)

EFFECT = register(
    Effect(
        name="cubic_stiffness",
        plain="a spring that gets stiffer or softer the further it bends",
        summary="torque -K (phi + kappa |phi|^2 phi): the spring stiffens (kappa > 0) or softens with the angle; at a"
        " ball joint a share of it may act about each axis of the segment by itself, kappa phi_k^3; a quintic may stand"
        " for the cubic that stiffens, (1 - c^2) kappa |phi|^2 phi + 2 c kappa^2 |phi|^4 phi, and one that softens may"
        " end, kappa |phi|^2 phi / (1 + 4 c |kappa| |phi|^2)",
        source="Duffing 1918; Kovacic & Brennan, The Duffing Equation (2011), chapter 2",
        signature="frequency and stiffness depend on amplitude, alike in both directions and in hold and release",
        mistaken_for=("bilinear_stiffness", "force_scale"),
        probe="the same push at a third and at three times the force",
        branch=Law(
            "joint",
            (
                _CUBIC_OF_BRANCH,
                EffectParameter("separate", "1", 0.0, 1.0, tries=2, optional=True),
                EffectParameter("curved", "1", 0.0, 1.0, tries=lambda s: [0.0], optional=True),
            ),
            cubic_ball,
            throughout=True,
        ),
        joint=Law("joint", (_CUBIC,), cubic_stiffness),
    )
)
