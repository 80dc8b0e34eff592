"""Wood that creeps: the standard linear solid."""

from dataclasses import replace
from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, sub
from ...kernels.lanes.real import real, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def creep(j: Any, share: Any, relaxation: Any, z: Any):
    """tau = -a K z,  dz/dt = w - z / T: a spring a K in series with a damper a K T; the new z.

    Trapezoidal rule in z, which is known in the middle of steps as the joint's angle is. Without a relaxation time
    (T = 0, where the effect is off) z stays zero.
    """
    o = real(0.0, share)
    one = real(1.0, o)
    T = relaxation + where_neg(relaxation - real(1.0e-9, o), one, o)
    half = real(0.5, o) * j.step / T
    return (z * (one - half) + j.rate * j.step) * (one / (one + half))


@wp.func
def viscoelastic_sls(j: Any, p: Any, r: Any):
    """One Maxwell element beside the joint's spring."""
    o = real(0.0, p.a)
    z = creep(j, p.a, p.b, r.memory)
    k = p.a * j.stiffness
    return type(r)(z * (o - k), z, k, o)


@wp.func
def viscoelastic_of_two(j: Any, p: Any, r: Any):
    """Two Maxwell elements beside the joint's spring."""
    o = real(0.0, p.a)
    first = creep(j, p.a, p.b, r.memory)
    second = creep(j, p.c, p.d, r.second)
    k = p.a * j.stiffness
    more = p.c * j.stiffness
    return type(r)(first * (o - k) - second * more, first, second, k + more, o)


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
        " in a branch there may be two such, each with its own relaxation time",
        source="Zener 1948; Wiechert 1893 (several Maxwell elements); Findley, Lai & Onaran, Creep and Relaxation"
        " (1976), section 5.4",
        signature="displacement goes on growing in a hold and comes back slowly after the release",
        mistaken_for=("hysteresis_boucwen", "dry_friction"),
        probe="a long hold and a long wait after it; the same push fast and slow",
        branch=Law(
            "joint",
            (replace(_SHARE, high=10.0), _RELAXATION, _SECOND_SHARE, _SECOND),
            viscoelastic_of_two,
            memory=2,
            strengths=("share", "second_share"),
        ),
        joint=Law("joint", (_SHARE, _RELAXATION), viscoelastic_sls, memory=1),
    )
)
