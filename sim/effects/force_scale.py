"""A sensor with a wrong gain."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, growth, mul, norm, size, sub
from ...kernels.lanes.real import fma, real, sqrt_, where_neg
from .registry import Effect, EffectParameter, Law, register

#: Least square of the slope of a curved sensor: one that bends back has no force for a reading.
LEAST_BENT = wp.constant(wp.float64(0.01))


@wp.func
def force_scale(g: Any, p: Any):
    """F_k = F_s,k / s_k, s_y = s y, s_z = s z, s_x = s / (y z): s is the mean of the three, of their logarithms.

    While the sensor warms, s is s exp(c exp(-t / w)), t on the absolute clock: log s and c are linear in log F, so that
    what they make up for in each other is a straight valley. The exponentials are those of `growth`. A curved sensor
    reads F (1 + q |F|) for F: of a reading of size r, |F| = 2 r / (1 + sqrt(1 + 4 q r)).
    """
    one = real(1.0, p.a)
    x = g.time / p.e
    y = p.d / fma(x, growth(x), one)
    more = size(y)
    gain = fma(more, growth(more), one)
    s = p.a * where_neg(y, one / gain, gain)
    read = type(g.force)(g.force.x * p.b * p.c / s, g.force.y * (one / (s * p.b)), g.force.z * (one / (s * p.c)))
    bent = fma(p.f * real(4.0, one), norm(read), one)
    least = real(LEAST_BENT, one)
    return read * (real(2.0, one) / (one + sqrt_(where_neg(bent - least, least, bent))))


@wp.func
def effort_scale(g: Any, p: Any):
    """F = F_s / s."""
    return g.force * (real(1.0, p.a) / p.a)


_SCALE = EffectParameter("scale", "1", 0.5, 2.0, 1.0, "log")
_OF_AXES = tuple(
    EffectParameter(f"relative_{axis}", "1", 0.4, 2.5, 1.0, "log", optional=True, aside=axis == "y") for axis in "yz"
)
#: How much more a sensor that is still cold reads than a warm one, as a logarithm, and how long it warms.
_WARMING = (
    EffectParameter("cold", "1", -0.9, 0.9, optional=True),
    EffectParameter(
        "warms_s",
        "s",
        lambda s: 0.05 * s.end,
        lambda s: 2.0 * s.end,
        neutral=1.0,
        scale="log",
        typical=lambda s: 0.3 * s.end,
        tries=lambda s: [0.3 * s.end],
        optional=True,
    ),
)
#: How a sensor's reading curves with the force, by up to four times the largest one recorded, either way alike: a prior
#: is about the middle of its box. Below minus a quarter the largest readings have no root, see `LEAST_BENT`.
_CURVED = EffectParameter(
    "curved_pN", "1/N", lambda s: -4.0 / s.force, lambda s: 4.0 / s.force, reach=lambda s: 0.3 / s.force, optional=True
)  # fmt: skip

EFFECT = register(
    Effect(
        name="force_scale",
        plain="a wrong scale of the force sensor",
        summary="the sensor reads s times the force that acts; a branch's in world axes y and z relative_y s and"
        " relative_z s times, so that s is the geometric mean of the three gains; while it warms, by e-folds of warms_s"
        " from zero of the clock, s is that of the warm sensor and a cold one reads exp(cold) times as much; and it may"
        " be curved: F (1 + q |F|) is read in the place of F",
        source="definition; BIPM, International Vocabulary of Metrology (2012), 2.18; gains of axes: Voyles, Morrow &"
        " Khosla 1997, J. Dyn. Syst. Meas. Control 119:229; drift of sensitivity: Doebelin, Measurement Systems"
        " (2004), chapter 3",
        signature="all stiffnesses and dampers look s times too large against the mass and weight: swings are off",
        mistaken_for=("tip_mass", "cubic_stiffness"),
        probe="free swings after a release beside slow pushes",
        branch=Law("force", (_SCALE, *_OF_AXES, *_WARMING, _CURVED), force_scale, per_joint=False),
        joint=Law("force", (_SCALE,), effort_scale),
    )
)
