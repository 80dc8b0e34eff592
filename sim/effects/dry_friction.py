"""Coulomb's friction at a joint."""

from typing import Any

import warp as wp

from ...kernels.algebra import add, div, dot, mul, sub
from ...kernels.real import fma, real, sqrt_
from .registry import Effect, EffectParameter, Law, register

#: Speed [rad/s or m/s] over which the friction changes sign; below it the joint creeps instead of sticking.
CREEP = wp.constant(wp.float64(0.01))


@wp.func
def dry_friction(j: Any, p: Any, r: Any):
    """tau = -T w / sqrt(|w|^2 + c^2), all of it implicit: a damper of T / sqrt(|w|^2 + c^2)."""
    c = real(CREEP, p.a)
    return type(r)(r.torque, r.memory, real(0.0, p.a), p.a / sqrt_(fma(c, c, dot(j.rate, j.rate))))


_LAW = Law(
    "joint",
    (EffectParameter("torque_Nm", "N m", lambda s: 0.003 * s.torque, lambda s: s.torque, scale="log"),),
    dry_friction,
)

EFFECT = register(
    Effect(
        name="dry_friction",
        summary="a torque of constant size T against the rate; below 0.01 rad/s it falls to zero in proportion",
        source="Coulomb 1785; smoothed as in Makris & Constantinou 1991, EERC 91/18",
        signature="oscillations decay in a straight line and stop off centre; loops keep their width however slow",
        mistaken_for=("hysteresis_boucwen", "plastic_set", "quadratic_drag"),
        probe="releases from a large and a small deflection; a slow triangle of force both ways",
        branch=_LAW,
        joint=_LAW,
    )
)
