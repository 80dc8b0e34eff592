"""Coulomb's friction at a joint."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import warp as wp

from ...kernels.effects.held import held
from ...kernels.lanes.algebra import add, div, growth, mul, norm, sub
from ...kernels.lanes.real import fma, real, where_neg
from .registry import Effect, EffectParameter, Law, Setting, kept_share, register

#: Least angle over which asperities bend before they slip in a branch [rad], so that friction at rest is a spring.
LEAST_BEND = wp.constant(wp.float64(1.0e-5))

#: Share of the torque in the middle of a step; with all of it a bend without inertia would not come to rest.
MIDDLE = wp.constant(wp.float64(0.8))

#: Least rate at which friction in a branch may change [rad/s], so that powers of a rate over it stay finite.
SLOWEST = wp.constant(wp.float64(1.0e-6))

#: Rate at a joint, over that at which friction changes, or its square, beyond which it has changed; powers stay finite.
FAST = wp.constant(wp.float64(1.0e6))


@wp.func
def friction(j: Any, torque: Any, y: Any, gradual: Any, middle: Any, r: Any):
    """tau = -T z / y, dz/dt = w - g |w| z / y where |z| < y, else z slides along at |z| = y: Coulomb's law that sticks.

    g = 0 is elastic and then slips, g = 1 is Dahl's law, in which z comes near y by e-folds. Implicit in the rate:
    within the step the bend z grows to s = (z + h w) / (1 + g h |w| / y), and tau = -T s / max(y, |s|) with the size of
    s at the present rate, a damper of T h / ((1 + g h |w| / y) max(y, |s|)). It gives all of T at a steady rate, and
    as the rate vanishes. That is the torque at the end of the step, too late by half of it: the share ``middle`` of the
    difference to the torque in its middle, T (s / max(y, |s|) - z / y), is added.
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
    early = turn * k + z * (k - torque / y)
    return type(r)(z * (o - k) + early * middle, z, o, k * j.step)


@wp.func
def changing(p: Any):
    """v, the rate at which friction changes, such that powers of a rate over it stay finite."""
    slowest = real(SLOWEST, p.a)
    return where_neg(p.e - slowest, slowest, p.e)


@wp.func
def slipping(j: Any, p: Any, size: Any, y: Any, x: Any, middle: Any, r: Any):
    """T (1 + s exp(-x)), T = ``size``: friction that is larger at rest (s > 0), or smaller and creeps there (s < 0).

    The exponential is 1 / (1 + x + x^2/2 + x^3/6 + x^4/24), within 0.012. What is missing at rest with x = |w| / v,
    -s (1 - exp(-x)) T, sticks nowhere: a damper of that over |w|, implicit in the rate.
    """
    o = real(0.0, p.a)
    one = real(1.0, o)
    slow = growth(x)
    fade = one / fma(x, slow, one)
    more = where_neg(p.d, o, p.d)
    creeps = where_neg(p.d, o - p.d, o)
    out = friction(j, size * (fma(more, fade, one) - creeps), y, p.c, middle, r)
    return type(r)(out.torque, out.memory, out.stiffness, fma(size * creeps / changing(p), slow * fade, out.damping))


@wp.func
def pressing(j: Any, p: Any):
    """T + mu |K phi - P|, never below zero: friction with what the spring carries, P the preload."""
    all_of_it = fma(p.g, norm(j.angle * j.stiffness - j.preload), p.a)
    return where_neg(all_of_it, real(0.0, p.a), all_of_it)


@wp.func
def dry_friction(j: Any, p: Any, r: Any):
    """Friction in a branch, of which the bend may be as small as float32 tells apart; its slope is mu K at most."""
    least = real(LEAST_BEND, p.a)
    y = where_neg(p.b - least, least, p.b)
    out = slipping(j, p, pressing(j, p), y, norm(j.ahead) / changing(p), real(MIDDLE, p.a), r)
    steep = where_neg(p.g, real(0.0, p.a) - p.g, p.g)  # on the way out or on the way back
    return type(r)(out.torque, out.memory, fma(steep, j.stiffness, out.stiffness), out.damping)


@wp.func
def dry_friction_holds(j: Any, p: Any, r: Any):
    """Up to what there is of it at rest, T (1 + s), bent as far as that takes."""
    least = real(LEAST_BEND, p.a)
    y = where_neg(p.b - least, least, p.b)
    return held(r, pressing(j, p) * (real(1.0, p.a) + p.d) / y, y)


@wp.func
def dry_friction_at_joint(j: Any, p: Any, r: Any):
    """Friction whose bend is small beside the motion, by radians or by mm, and grows at rest by s exp(-(w / v)^2).

    The square leaves what happens at speed to drag. T grows by mu |u| with the effort u of an actuator.
    """
    far = real(FAST, p.a)
    x = norm(j.rate) / changing(p)
    x = where_neg(p.d, x, x * x)
    return slipping(j, p, fma(p.f, norm(j.effort), p.a), p.b, where_neg(far - x, far, x), real(0.0, p.a), r)


_TORQUE = EffectParameter("torque_Nm", "N m", lambda s: 0.003 * s.torque, lambda s: s.torque, scale="log")
#: Friction that bends by much of the motion before it slips is the spring and slider of hysteresis. Of blind exams a
#: friction of Dahl's bends by a twenty-fifth, Bouc and Wen's sliders by a tenth and more.
_BEND = EffectParameter(
    "bend_rad", "rad", lambda s: min(1e-4, 2e-3 * s.angle), lambda s: max(1e-3, 0.06 * s.angle), 5e-4, "log",
    tries=1, typical=5e-4, optional=True, becomes="hysteresis_boucwen",
)  # fmt: skip
#: Bearings of a pendulum rub with less than a thousandth of what gravity pulls.
_TORQUE_AT_JOINT = EffectParameter(
    "torque_Nm", "N m", lambda s: 1e-5 * s.torque, lambda s: s.torque, scale="log", tries=4
)
_BEND_AT_JOINT = EffectParameter(
    "bend_rad", "rad", lambda s: 3e-4 * s.angle, lambda s: 0.03 * s.angle, neutral=5e-4, scale="log", tries=1,
    typical=lambda s: 1e-3 * s.angle, optional=True,
)  # fmt: skip
_GRADUAL = EffectParameter("gradual", "1", 0.0, 1.0, tries=1, optional=True)
#: Friction that grows as the joint comes to rest (Tustin), or gives way to any torque, however small.
_STRIBECK = EffectParameter("stribeck", "1", -1.0, 2.0, tries=lambda s: [0.0], optional=True)
_STRIBECK_RATE = EffectParameter(
    "stribeck_radps", "rad/s", lambda s: 0.01 * s.rate, lambda s: 0.5 * s.rate, neutral=1.0, scale="log", tries=1,
    optional=True,
)  # fmt: skip
#: What a joint does as it turns back is measured itself, and not from far away through springs. What changes with the
#: rate beyond a tenth of the highest one is drag.
_STRIBECK_AT_JOINT = replace(_STRIBECK_RATE, low=0.0, high=lambda s: 0.1 * s.rate, neutral=0.0, scale="linear")
#: What presses on what rubs may be what drives the joint, as in the teeth of a gear, or what the spring carries.
_LOAD = EffectParameter("load", "1", 0.0, 1.0, tries=lambda s: [0.0], optional=True)
#: A fit that begins with much of it does not find the way back to friction of one size.
_LOAD_IN_BRANCH = replace(_LOAD, low=-1.0, tries=None)


def _further(s: Setting) -> Sequence[tuple[float, ...]]:
    """Friction that vanishes at rest, and friction that the load makes."""
    torques, rates = [t * s.torque for t in (0.03, 0.2, 1.0)], [v * s.rate for v in (0.05, 0.4)]
    creeping = product(torques, [5e-4], [0.0], [-1.0], rates, [0.0], [0.0])
    loaded = product([0.01 * s.torque], [5e-4], [0.0], [0.0], [1.0], [0.0], [0.05, 0.25])
    return [*creeping, *loaded]


EFFECT = register(
    Effect(
        name="dry_friction",
        plain="dry friction",
        summary="a torque of constant size T against the rate; at rest what holds, up to T (it bends by y first,"
        " and from g = 0 to 1 comes ever more gradually to slip); it may be larger while it hardly moves,"
        " T (1 + s exp(-|w| / v)), of a measured joint T (1 + s exp(-(w / v)^2)), or smaller and creep there (s < 0);"
        " in a branch it may begin each recording with the share k of the bend that the one before left; T may grow"
        " with the load, in a branch by mu |K phi - P| with what the spring carries, P the preload, of a measured joint"
        " by mu |u| where an effort u drives it",
        source="Coulomb 1785; elastic before it slips, and gradual, as in Dahl 1968, Aerospace TOR-158; growing towards"
        " rest as in Tustin 1947, J. IEE 94:143, and Armstrong-Helouvry, Dupont & Canudas de Wit 1994, Automatica"
        " 30:1083; growing with the load as in Hamon, Gautier & Garrec 2010, IROS",
        signature="oscillations decay in a straight line and stop off centre; loops keep their width however slow",
        mistaken_for=("hysteresis_boucwen", "plastic_set", "quadratic_drag"),
        alike=("hysteresis_boucwen",),
        probe="releases from a large and a small deflection; a slow triangle of force both ways",
        branch=Law(
            "joint",
            (_TORQUE, _BEND, _GRADUAL, _STRIBECK, _STRIBECK_RATE, kept_share(0.0), _LOAD_IN_BRANCH),
            dry_friction,
            memory=1,
            persistent=True,
            keeps="kept",
            holds=dry_friction_holds,
            further=_further,
        ),
        joint=Law(
            "joint",
            (_TORQUE_AT_JOINT, _BEND_AT_JOINT, _GRADUAL, _STRIBECK, _STRIBECK_AT_JOINT, _LOAD),
            dry_friction_at_joint,
            memory=1,
        ),
    )
)
