"""Hysteresis after Bouc and Wen."""

from typing import Any

import warp as wp

from ...kernels.algebra import add, div, dot, mul, sub
from ...kernels.real import fma, real, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def hysteresis_boucwen(j: Any, p: Any, r: Any):
    """tau = -a K z,  dz/dt = w - z max(0, z.w) / y^2: exponent 2, beta = gamma; z saturates at y.

    One implicit step keeps |z| below y at any rate.
    """
    o = real(0.0, p.a)
    gain = dot(r.memory, j.rate)
    gain = where_neg(gain, o, gain)
    y = fma(p.b, p.b, real(1.0e-12, o))
    z = (r.memory + j.rate * j.step) * (real(1.0, o) / fma(gain / y, j.step, real(1.0, o)))
    k = p.a * j.stiffness
    return type(r)(z * (o - k), z, k, o)


_LAW = Law(
    "joint",
    (
        EffectParameter("share", "1", 0.02, 3.0, scale="log", typical=0.3, tries=1),
        EffectParameter("yield_rad", "rad", lambda s: 0.02 * s.angle, lambda s: s.angle, scale="log"),
    ),
    hysteresis_boucwen,
    memory=1,
)

EFFECT = register(
    Effect(
        name="hysteresis_boucwen",
        summary="a second spring of a K in series with a slider that yields gradually at the angle y",
        source="Bouc 1967; Wen 1976, ASCE EM 102:249; in space as Park, Wen & Ang 1986, EESD 14:543",
        signature="loops of force over displacement that are as wide slow as fast; stiffer after each reversal",
        mistaken_for=("dry_friction", "viscoelastic_sls", "plastic_set"),
        probe="the same triangle of force at two speeds; a small loop inside a large one",
        branch=_LAW,
        joint=_LAW,
    )
)
