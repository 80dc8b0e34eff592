"""Coulomb's friction at a joint."""

from typing import Any

import warp as wp

from ...kernels.effects.held import held
from ...kernels.lanes.algebra import add, div, mul, norm, sub
from ...kernels.lanes.real import fma, real, where_neg
from .registry import Effect, EffectParameter, Law, register

#: Least angle over which asperities bend before they slip in a branch [rad].
BEND = wp.constant(wp.float64(5.0e-4))


@wp.func
def friction(j: Any, torque: Any, y: Any, gradual: Any, r: Any):
    """tau = -T z / y, dz/dt = w - g |w| z / y where |z| < y, else z slides along at |z| = y: Coulomb's law that sticks.

    g = 0 is elastic and then slips, g = 1 is Dahl's law, in which z comes near y by e-folds. Implicit in the rate:
    within the step the bend z grows to s = (z + h w) / (1 + g h |w| / y), and tau = -T s / max(y, |s|) with the size of
    s at the present rate, a damper of T h / ((1 + g h |w| / y) max(y, |s|)). It gives all of T at a steady rate, and
    as the rate vanishes.
    """
    o = real(0.0, y)
    one = real(1.0, o)
    turn = j.rate * j.step
    slow = one / fma(gradual / y, norm(turn), one)
    z = (r.memory + turn) * slow
    far = norm(z)
    share = y / far
    z = z * where_neg(y - far, share, one)
    far = norm(z + turn) * slow
    k = torque * slow / where_neg(far - y, y, far)
    return type(r)(z * (o - k), z, o, k * j.step)


@wp.func
def dry_friction(j: Any, p: Any, r: Any):
    """Friction that bends by 0.5 mrad at least."""
    least = real(BEND, p.a)
    return friction(j, p.a, where_neg(p.b - least, least, p.b), p.c, r)


@wp.func
def dry_friction_holds(j: Any, p: Any, r: Any):
    """Up to T, bent as far as that takes."""
    least = real(BEND, p.a)
    return held(r, p.a, where_neg(p.b - least, least, p.b))


@wp.func
def dry_friction_at_joint(j: Any, p: Any, r: Any):
    """Friction whose bend is small beside the motion, whatever that is: a joint may turn by radians or slide by mm."""
    return friction(j, p.a, p.b, p.c, r)


_TORQUE = EffectParameter("torque_Nm", "N m", lambda s: 0.003 * s.torque, lambda s: s.torque, scale="log")
_BEND = EffectParameter("bend_rad", "rad", 0.0, lambda s: 0.03 * s.angle, tries=1, optional=True)
#: Bearings of a pendulum rub with less than a thousandth of what gravity pulls.
_TORQUE_AT_JOINT = EffectParameter(
    "torque_Nm", "N m", lambda s: 1e-5 * s.torque, lambda s: s.torque, scale="log", tries=4
)
_BEND_AT_JOINT = EffectParameter(
    "bend_rad", "rad", lambda s: 3e-4 * s.angle, lambda s: 0.03 * s.angle, neutral=5e-4, scale="log", tries=1,
    typical=lambda s: 1e-3 * s.angle, optional=True,
)  # fmt: skip
_GRADUAL = EffectParameter("gradual", "1", 0.0, 1.0, tries=1, optional=True)

EFFECT = register(
    Effect(
        name="dry_friction",
        plain="dry friction",
        summary="a torque of constant size T against the rate; at rest what holds, up to T (it bends by y first, in"
        " a branch 0.5 mrad at least, and from g = 0 to 1 comes ever more gradually to slip)",
        source="Coulomb 1785; elastic before it slips, and gradual, as in Dahl 1968, Aerospace TOR-158",
        signature="oscillations decay in a straight line and stop off centre; loops keep their width however slow",
        mistaken_for=("hysteresis_boucwen", "plastic_set", "quadratic_drag"),
        probe="releases from a large and a small deflection; a slow triangle of force both ways",
        branch=Law("joint", (_TORQUE, _BEND, _GRADUAL), dry_friction, memory=1, holds=dry_friction_holds),
        joint=Law("joint", (_TORQUE_AT_JOINT, _BEND_AT_JOINT, _GRADUAL), dry_friction_at_joint, memory=1),
    )
)
