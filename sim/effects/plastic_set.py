"""A joint that yields and stays bent."""

from dataclasses import replace
from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, norm, size, sub
from ...kernels.lanes.real import fma, real, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def beyond(x: Any, limit: Any):
    """What x exceeds a limit by, with the sign of x; none within it."""
    o = x - x
    over = size(x) - limit
    over = where_neg(over, o, over)
    return where_neg(x, o - over, over)


@wp.func
def plastic_set(j: Any, p: Any, r: Any):
    """tau = +s K b; b follows phi: b += max(0, |d| - y - h |c|) along d = phi - (1 - h) b; c_k sums what b_k went.

    The radial return of plasticity with linear hardening H, phi_p = s b, s = K / (K + H). The share i of H is isotropic
    (h = i (1 - s)), the rest kinematic; both count in s, so that the first push looks the same whatever i. The share m
    of the return is about each axis by itself, max(0, |d_k| - y - h c_k). What flows goes at the rate of that excess
    over T (Perzyna's overstress), implicit: of a step's return the part dt / (dt + T).
    """
    o = real(0.0, p.a)
    one = real(1.0, o)
    h = p.c * (one - p.a)
    d = j.angle - r.memory * (one - h)
    c = r.second
    reach = norm(d)
    joint = beyond(reach, p.b + h * norm(c)) / reach * (one - p.d)
    on = where_neg(o - p.a, one, o) * (j.step / (j.step + p.e))
    moved = type(d)(
        on * fma(joint, d.x, p.d * beyond(d.x, fma(h, c.x, p.b))),
        on * fma(joint, d.y, p.d * beyond(d.y, fma(h, c.y, p.b))),
        on * fma(joint, d.z, p.d * beyond(d.z, fma(h, c.z, p.b))),
    )
    b = r.memory + moved
    gone = c + type(d)(size(moved.x), size(moved.y), size(moved.z))
    return type(r)(b * (p.a * j.stiffness), b, gone, o, o)


_PARAMETERS = (
    EffectParameter("share", "1", 0.02, 0.95, scale="log", typical=0.3, tries=1),
    EffectParameter("yield_rad", "rad", lambda s: 0.05 * s.angle, lambda s: s.angle, scale="log"),
    EffectParameter("isotropic", "1", 0.0, 1.0, tries=1, optional=True),
)
#: A set that flows from the smallest turn on is a dashpot beside the hardening's spring: a creep.
_YIELD = replace(_PARAMETERS[1], below="viscoelastic_sls")
_SEPARATE = EffectParameter("separate", "1", 0.0, 1.0, tries=2, optional=True)
_FLOW = EffectParameter("flow_s", "s", 0.0, lambda s: s.duration, tries=lambda s: [0.0], optional=True)

EFFECT = register(
    Effect(
        name="plastic_set",
        plain="bending that stays",
        summary="beyond an angle y from where it last came to rest a share s of the turn stays, for good; what has"
        " stayed moves y (kinematic hardening) or, in the share i, widens it (isotropic); at a ball joint a share of it"
        " may act about each axis of the segment by itself, and a branch's may come at once or flow, by e-folds of"
        " flow seconds",
        source="Simo & Hughes, Computational Inelasticity (1998), box 1.5 (linear isotropic and kinematic hardening);"
        " flow by the overstress: Perzyna 1966, Adv. Appl. Mech. 9:243",
        signature="the branch rests elsewhere after a large push, and later small pushes are as before",
        mistaken_for=("hysteresis_boucwen", "dry_friction", "partial_rupture", "viscoelastic_sls"),
        probe="a small push, a large one, the same small push again, with the gripper open in between",
        # with kinematic hardening: one elastic slider, Bouc and Wen's of a large exponent, or one more of Iwan's
        alike=("hysteresis_boucwen",),
        branch=Law(
            "joint", (_PARAMETERS[0], _YIELD, _PARAMETERS[2], _SEPARATE, _FLOW), plastic_set, memory=2, persistent=True
        ),
        joint=Law("joint", _PARAMETERS, plastic_set, memory=2),
    )
)
