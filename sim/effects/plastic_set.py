"""A joint that yields and stays bent."""

from typing import Any

import warp as wp

from ...kernels.algebra import add, div, dot, mul, sub
from ...kernels.real import fma, real, sqrt_, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def plastic_set(j: Any, p: Any, r: Any):
    """tau = +s K b, where b follows phi at the distance y: b += max(0, |phi - b| - y) along phi - b.

    The radial return of plasticity with linear kinematic hardening H: b = phi_p / s with s = K / (K + H).
    """
    o = real(0.0, p.a)
    d = j.angle - r.memory
    size = sqrt_(fma(dot(d, d), real(1.0, o), real(1.0e-20, o)))
    over = size - p.b
    over = where_neg(over, o, over)
    on = where_neg(o - p.a, over, o)
    b = r.memory + d * (on / size)
    return type(r)(b * (p.a * j.stiffness), b, o, o)


_PARAMETERS = (
    EffectParameter("share", "1", 0.02, 0.95, scale="log", typical=0.3, tries=1),
    EffectParameter("yield_rad", "rad", lambda s: 0.05 * s.angle, lambda s: s.angle, scale="log"),
)

EFFECT = register(
    Effect(
        name="plastic_set",
        summary="beyond an angle y from where it last came to rest a share s of the turn stays; it stays for good",
        source="Simo & Hughes, Computational Inelasticity (1998), box 1.5 (linear kinematic hardening)",
        signature="the branch rests elsewhere after a large push, and later small pushes are as before",
        mistaken_for=("hysteresis_boucwen", "dry_friction", "partial_rupture"),
        probe="a small push, a large one, the same small push again, with the gripper open in between",
        branch=Law("joint", _PARAMETERS, plastic_set, memory=True, persistent=True),
        joint=Law("joint", _PARAMETERS, plastic_set, memory=True),
    )
)
