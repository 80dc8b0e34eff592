"""Wood that creeps: the standard linear solid."""

from dataclasses import replace
from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, sub
from ...kernels.lanes.real import real, where_neg
from .registry import Effect, EffectParameter, Law, kept_share, register


@wp.func
def half_a_step(j: Any, relaxation: Any):
    """Half of a step over the relaxation time T; T is one where it is zero, as where the effect is off."""
    o = real(0.0, relaxation)
    T = relaxation + where_neg(relaxation - real(1.0e-9, o), real(1.0, o), o)
    return real(0.5, o) * j.step / T


@wp.func
def creep(j: Any, relaxation: Any, z: Any):
    """tau = -a K z,  dz/dt = w - z / T: a spring a K in series with a damper a K T; the new z.

    Trapezoidal rule in z, which is known in the middle of steps as the joint's angle is.
    """
    one = real(1.0, relaxation)
    half = half_a_step(j, relaxation)
    return (z * (one - half) + j.rate * j.step) * (one / (one + half))


@wp.func
def viscoelastic_sls(j: Any, p: Any, r: Any):
    """One Maxwell element beside the joint's spring."""
    o = real(0.0, p.a)
    z = creep(j, p.b, r.memory)
    k = p.a * j.stiffness
    return type(r)(z * (o - k), z, k, o)


@wp.func
def flowed(j: Any, relaxation: Any, b: Any):
    """db/dt = (phi - b) / T: how far the damper of an element has flowed; the new b.

    Trapezoidal rule, phi known in the middle of steps; b is phi after a step of 2 T, as there are between recordings.
    """
    one = real(1.0, relaxation)
    half = half_a_step(j, relaxation)
    half = where_neg(one - half, one, half)
    return (b * (one - half) + j.angle * (half + half)) * (one / (one + half))


@wp.func
def viscoelastic_of_two(j: Any, p: Any, r: Any):
    """tau = -a K (phi - b) - c K (phi - d): two Maxwell elements beside the spring, whose dampers have flowed by b, d.

    Both are taken in the middle of a step.
    """
    o = real(0.0, p.a)
    half = real(0.5, o)
    first = flowed(j, p.b, r.memory)
    second = flowed(j, p.d, r.second)
    k = p.a * j.stiffness
    more = p.c * j.stiffness
    gone = (first + r.memory) * (half * k) + (second + r.second) * (half * more)
    return type(r)(gone - j.angle * (k + more), first, second, k + more, o)


_SHARE = EffectParameter("share", "1", 0.02, 3.0, scale="log", typical=0.3, tries=1)
_RELAXATION = EffectParameter("relaxation_s", "s", lambda s: 2.0 * s.dt, lambda s: s.duration, scale="log")
_SECOND_SHARE = EffectParameter("second_share", "1", 0.0, 3.0, tries=lambda s: [0.0], optional=True)
_SECOND = EffectParameter(
    "second_relaxation_s", "s", lambda s: 2.0 * s.dt, lambda s: s.duration, neutral=1.0, scale="log", tries=1,
    optional=True,
)  # fmt: skip

EFFECT = register(
    Effect(
        name="viscoelastic_sls",
        plain="creep (it goes on giving way while it is held)",
        summary="a spring a K in series with a damper, beside the joint's spring: the joint creeps under a held force;"
        " in a branch there may be two such, each with its own relaxation time, and the next recording begins with the"
        " share k of what they flowed, less what comes back in the time between",
        source="Zener 1948; Wiechert 1893 (several Maxwell elements); Findley, Lai & Onaran, Creep and Relaxation"
        " (1976), section 5.4",
        signature="displacement goes on growing in a hold and comes back slowly after the release",
        mistaken_for=("hysteresis_boucwen", "dry_friction"),
        probe="a long hold and a long wait after it; the same push fast and slow",
        branch=Law(
            "joint",
            (
                replace(_SHARE, high=30.0),
                replace(_RELAXATION, high=lambda s: 5.0 * s.duration),
                replace(_SECOND_SHARE, high=30.0),
                _SECOND,
                kept_share(0.0),
            ),
            viscoelastic_of_two,
            memory=2,
            persistent=True,
            strengths=("share", "second_share"),
            keeps="kept",
            follows=True,
            throughout=True,
        ),
        joint=Law("joint", (_SHARE, _RELAXATION), viscoelastic_sls, memory=1),
    )
)
