"""Hysteresis after Bouc and Wen."""

from typing import Any

import warp as wp

from ...kernels.algebra import add, div, dot, mul, norm, sub
from ...kernels.real import fma, real, sqrt_, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def sliding(zw: Any, size: Any, y: Any, n: Any):
    """max(0, z.w) ((2 - n) / (|z| y) + (n - 1) / y^2): the rate at which z yields, of exponents 1 and 2 mixed."""
    o = real(0.0, y)
    one = real(1.0, o)
    work = where_neg(zw, o, zw)
    return work * ((one + one - n) / (size * y) + (n - one) / (y * y))


@wp.func
def hysteresis_boucwen(j: Any, p: Any, r: Any):
    """tau = -a K z,  dz/dt = w - z max(0, z.w) |z|^(n-2) / y^n: beta = gamma; z saturates at y.

    The share m yields about each axis by itself, dz_k/dt = w_k - z_k max(0, z_k w_k) |z_k|^(n-2) / y^n. Implicit
    in the z that yields: at a steady rate it is y whatever the step.
    """
    o = real(0.0, p.a)
    one = real(1.0, o)
    z = r.memory
    y = sqrt_(fma(p.b, p.b, real(1.0e-12, o)))
    tiny = real(1.0e-20, o)
    joint = sliding(dot(z, j.rate), norm(z), y, p.c) * (one - p.d)
    gx = fma(p.d, sliding(z.x * j.rate.x, sqrt_(fma(z.x, z.x, tiny)), y, p.c), joint)
    gy = fma(p.d, sliding(z.y * j.rate.y, sqrt_(fma(z.y, z.y, tiny)), y, p.c), joint)
    gz = fma(p.d, sliding(z.z * j.rate.z, sqrt_(fma(z.z, z.z, tiny)), y, p.c), joint)
    z = type(z)(
        fma(j.rate.x, j.step, z.x) / fma(gx, j.step, one),
        fma(j.rate.y, j.step, z.y) / fma(gy, j.step, one),
        fma(j.rate.z, j.step, z.z) / fma(gz, j.step, one),
    )
    k = p.a * j.stiffness
    return type(r)(z * (o - k), z, k, o)


_PARAMETERS = (
    EffectParameter("share", "1", 0.02, 3.0, scale="log", typical=0.3, tries=1),
    EffectParameter("yield_rad", "rad", lambda s: 0.02 * s.angle, lambda s: s.angle, scale="log"),
    EffectParameter("exponent", "1", 1.0, 2.0, neutral=2.0, tries=1, optional=True),
)
_SEPARATE = EffectParameter("separate", "1", 0.0, 1.0, tries=2, optional=True)

EFFECT = register(
    Effect(
        name="hysteresis_boucwen",
        summary="a second spring of a K in series with a slider that yields gradually at the angle y, more abruptly the"
        " larger the exponent n; at a ball joint a share of it may yield about each axis of the segment by itself",
        source="Bouc 1967; Wen 1976, ASCE EM 102:249; in space as Park, Wen & Ang 1986, EESD 14:543",
        signature="loops of force over displacement that are as wide slow as fast; stiffer after each reversal",
        mistaken_for=("dry_friction", "viscoelastic_sls", "plastic_set"),
        probe="the same triangle of force at two speeds; a small loop inside a large one",
        branch=Law("joint", (*_PARAMETERS, _SEPARATE), hysteresis_boucwen, memory=1),
        joint=Law("joint", _PARAMETERS, hysteresis_boucwen, memory=1),
    )
)
