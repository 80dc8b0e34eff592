"""Hysteresis after Bouc and Wen."""

from dataclasses import replace
from typing import Any

import warp as wp

from ...kernels.effects.held import held
from ...kernels.lanes.algebra import add, div, dot, mul, norm, sub
from ...kernels.lanes.real import fma, real, sqrt_, where_neg
from .registry import TWIST_SHARE, Effect, EffectParameter, Law, kept_share, register


@wp.func
def sliding(zw: Any, size: Any, y: Any, n: Any, loading: Any):
    """The rate at which z yields, of exponents 1 and 2 mixed.

    (l max(0, z.w) + (1 - l) max(0, -z.w)) ((2 - n) / (|z| y) + (n - 1) / y^2)
    """
    one = real(1.0, y)
    work = where_neg(zw, zw * (loading - one), zw * loading)
    return work * ((one + one - n) / (size * y) + (n - one) / (y * y))


@wp.func
def left_over(x: Any):
    """1 + x, and a half at least: a slider that stiffens, l < 0, at most doubles z in a step."""
    half = real(0.5, x)
    beyond = x + half
    return where_neg(beyond, half, beyond + half)


@wp.func
def slid(j: Any, p: Any, yields: Any, z: Any):
    """dz/dt = w - z (l max(0, z.w) + (1 - l) max(0, -z.w)) |z|^(n-2) / y^n of a slider that yields at y; the new z.

    The share m yields about each axis by itself, with z_k w_k in the place of z.w and |z_k| of |z|. Of the rate of
    twist the part t counts. Implicit in the z that yields: with l = 1 it is y at a steady rate, whatever the step.
    """
    o = real(0.0, yields)
    one = real(1.0, yields)
    w = type(z)(j.rate.x, j.rate.y, j.rate.z * p.f)
    y = sqrt_(fma(yields, yields, real(1.0e-12, o)))
    tiny = real(1.0e-20, o)
    joint = sliding(dot(z, w), norm(z), y, p.c, p.d) * (one - p.e)
    gx = fma(p.e, sliding(z.x * w.x, sqrt_(fma(z.x, z.x, tiny)), y, p.c, p.d), joint)
    gy = fma(p.e, sliding(z.y * w.y, sqrt_(fma(z.y, z.y, tiny)), y, p.c, p.d), joint)
    gz = fma(p.e, sliding(z.z * w.z, sqrt_(fma(z.z, z.z, tiny)), y, p.c, p.d), joint)
    return type(z)(
        fma(w.x, j.step, z.x) / left_over(gx * j.step),
        fma(w.y, j.step, z.y) / left_over(gy * j.step),
        fma(w.z, j.step, z.z) / left_over(gz * j.step),
    )


@wp.func
def hysteresis_boucwen(j: Any, p: Any, r: Any):
    """tau = -a K z, with z that yields at b, see `slid`; of the torque about the twist the part t counts.

    Bouc and Wen's beta y^n is a half and gamma y^n is l - 1/2. t = 0 is Park's hysteresis of bending.
    """
    o = real(0.0, p.a)
    z = slid(j, p, p.b, r.memory)
    k = p.a * j.stiffness
    return type(r)(type(z)(z.x, z.y, z.z * p.f) * (o - k), z, k, o)


@wp.func
def hysteresis_of_two(j: Any, p: Any, r: Any):
    """tau = -a K z - h K u, of which z yields at b and u at i: two sliders side by side (Iwan), alike but for these."""
    o = real(0.0, p.a)
    z = slid(j, p, p.b, r.memory)
    u = slid(j, p, p.i, r.second)
    k = p.a * j.stiffness
    more = p.h * j.stiffness
    pull = z * (o - k) - u * more
    return type(r)(type(z)(pull.x, pull.y, pull.z * p.f), z, u, k + more, o)


@wp.func
def hysteresis_holds(j: Any, p: Any, r: Any):
    """Up to a K y: what the second spring gives where its slider is about to yield; of two sliders the first holds."""
    return held(r, p.a * j.stiffness, p.b)


_PARAMETERS = (
    EffectParameter("share", "1", 0.02, 3.0, scale="log", typical=0.3, tries=1),
    EffectParameter("yield_rad", "rad", lambda s: 0.02 * s.angle, lambda s: s.angle, scale="log"),
    EffectParameter("exponent", "1", 1.0, 2.0, neutral=2.0, tries=1, optional=True),
)
#: Of a spring far stiffer than a branch's joint only the slider is seen, which is friction.
_SHARE = replace(_PARAMETERS[0], high=10.0, becomes="dry_friction")
#: A slider that yields before a fiftieth of the angles seen rubs as friction does, see `dry_friction`.
_YIELD = replace(_PARAMETERS[1], below="dry_friction")
_LOADING, _STIFFENING = (
    EffectParameter("loading", "1", low, 1.0, neutral=1.0, tries=1, optional=True) for low in (0.0, -0.25)
)
_SECOND = (
    EffectParameter("second_share", "1", 0.0, 3.0, tries=lambda s: [0.0], optional=True),
    replace(_PARAMETERS[1], name="second_yield_rad", neutral=1.0, tries=1, optional=True),
)
_SEPARATE = EffectParameter("separate", "1", 0.0, 1.0, tries=2, optional=True)

EFFECT = register(
    Effect(
        name="hysteresis_boucwen",
        plain="hysteresis (it bends and comes back on different ways)",
        summary="a second spring of a K in series with a slider that yields gradually at the angle y, more abruptly the"
        " larger the exponent n; the share l yields on loading, the rest on the way back (beta y^n = 1/2, gamma y^n ="
        " l - 1/2); at a ball joint a share of it may yield about each axis of the segment by itself, and twist counts"
        " by a share t; in a branch there may be two such sliders, each with its own yield; it begins each recording"
        " with the share k of what the one before left",
        source="Bouc 1967; Wen 1976, ASCE EM 102:249; in space as Park, Wen & Ang 1986, EESD 14:543; several sliders"
        " side by side as Iwan 1966, J. Appl. Mech. 33:893",
        signature="loops of force over displacement that are as wide slow as fast; stiffer after each reversal",
        mistaken_for=("dry_friction", "viscoelastic_sls", "plastic_set"),
        alike=("plastic_set", "dry_friction"),
        probe="the same triangle of force at two speeds; a small loop inside a large one",
        branch=Law(
            "joint",
            (_SHARE, _YIELD, _PARAMETERS[2], _LOADING, _SEPARATE, TWIST_SHARE, kept_share(1.0), *_SECOND),
            hysteresis_of_two,
            memory=2,
            persistent=True,
            strengths=("share", "second_share"),
            holds=hysteresis_holds,
            keeps="kept",
            throughout=True,
        ),
        joint=Law("joint", (*_PARAMETERS, _STIFFENING), hysteresis_boucwen, memory=1),
    )
)
