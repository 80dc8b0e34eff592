"""Wood that creeps: the standard linear solid."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, sub
from ...kernels.lanes.real import real, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def viscoelastic_sls(j: Any, p: Any, r: Any):
    """tau = -a K z,  dz/dt = w - z / T: a spring a K in series with a damper a K T, beside the joint's spring.

    Trapezoidal rule in z, which is known in the middle of steps as the joint's angle is. Without a relaxation time
    (T = 0, where the effect is off) z stays zero.
    """
    o = real(0.0, p.a)
    one = real(1.0, o)
    T = p.b + where_neg(p.b - real(1.0e-9, o), one, o)
    half = real(0.5, o) * j.step / T
    z = (r.memory * (one - half) + j.rate * j.step) * (one / (one + half))
    k = p.a * j.stiffness
    return type(r)(z * (o - k), z, k, o)


_LAW = Law(
    "joint",
    (
        EffectParameter("share", "1", 0.02, 3.0, scale="log", typical=0.3, tries=1),
        EffectParameter("relaxation_s", "s", lambda s: 2.0 * s.dt, lambda s: s.duration, scale="log"),
    ),
    viscoelastic_sls,
    memory=1,
)

EFFECT = register(
    Effect(
        name="viscoelastic_sls",
        plain="creep (it goes on giving way while it is held)",
        summary="a spring a K in series with a damper, beside the joint's spring: the joint creeps under a held force",
        source="Zener 1948; Findley, Lai & Onaran, Creep and Relaxation (1976), section 5.4",
        signature="displacement goes on growing in a hold and comes back slowly after the release",
        mistaken_for=("hysteresis_boucwen", "dry_friction"),
        probe="a long hold and a long wait after it; the same push fast and slow",
        branch=_LAW,
        joint=_LAW,
    )
)
