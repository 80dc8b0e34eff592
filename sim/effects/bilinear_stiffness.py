"""A spring of different stiffness for the two directions."""

import math
from collections.abc import Sequence
from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, dot, mul, sub
from ...kernels.lanes.real import cos_root, fma, real, sin_ratio, sqrt_, where_neg
from .registry import Effect, EffectParameter, Law, Setting, axes_across, axis_parameter, register

#: Share of its stiffness that a spring may lose.
LARGEST = wp.constant(wp.float64(0.9))


@wp.func
def ramp(x: Any, w: Any):
    """(x + sqrt(x^2 + w^2) - w) / 2: 0 for x well below zero, x above, zero at zero."""
    return (x + sqrt_(fma(x, x, w * w)) - w) * real(0.5, x)


@wp.func
def bilinear_stiffness(j: Any, p: Any, r: Any):
    """tau = -K ((rel + back) (ramp(x - s) - ramp(-s)) - back x) n, x = phi . n, n = (cos psi, sin psi, 0).

    That is K (1 + rel) for x > s and K (1 - back) below, back = min(split rel, LARGEST). The corner lies at s, |d| from
    rest: s = d for rel < 0, -d for rel > 0, so that beyond it the spring is softer for d > 0 and stiffer for d < 0.
    """
    o = real(0.0, p.a)
    n = type(r.torque)(cos_root(p.b * p.b), sin_ratio(p.b * p.b) * p.b, o)
    s = where_neg(p.a, p.d, o - p.d)
    back = p.e * p.a
    most = real(LARGEST, o)
    back = where_neg(most - back, most, back)
    x = dot(j.angle, n)
    bent = (p.a + back) * (ramp(x - s, p.c) - ramp(o - s, p.c)) - back * x
    stiffer = where_neg(p.a, o - back, p.a)
    return type(r)(n * (o - j.stiffness * bent), r.memory, j.stiffness * stiffer, o)


@wp.func
def bilinear_joint(j: Any, p: Any, r: Any):
    """tau = -rel K ramp(q), its corner as wide as beseems a joint that may turn by radians or slide by mm."""
    o = real(0.0, p.a)
    k = p.a * j.stiffness
    return type(r)(type(r.torque)(o - k * ramp(j.angle.x, p.b), o, o), r.memory, where_neg(k, o, k), o)


def other_side(values: Sequence[float]) -> tuple[Sequence[float], float]:
    """Return the same spring about its axis told from its other side: K (1 + rel) there, K (1 - split rel) here.

    Across that axis the one has K both ways and the other K (1 + rel).
    """
    relative, axis, corner, off, split = values
    turned = axis + math.pi if axis < math.pi else axis - math.pi
    back = min(split * relative, float(LARGEST))
    return (-(relative + back) / (1.0 + relative), turned, corner, off, 0.0), 1.0 + relative


_REL = EffectParameter("relative", "1", -float(LARGEST), 3.0)
_CORNER = EffectParameter(
    "corner_rad", "rad", lambda s: 1e-3 * s.angle, lambda s: s.angle, neutral=0.005, scale="log", tries=2, optional=True
)
#: In a branch.
_WIDTH = EffectParameter(
    "corner_rad", "rad", 1e-4, lambda s: max(0.05, 0.5 * s.angle), 0.005, "log", 0.005, tries=lambda s: [0.005],
    optional=True,
)  # fmt: skip
#: How far the spring goes on from rest as it is at rest before it softens, or below zero before it stiffens. A cord
#: that is slack at rest nearly passes for the latter (`learn.gap.decide`). One that softens far from rest is hardly
#: told from one that is softer about an axis both ways.
_OFF = EffectParameter(
    "off_rad", "rad", lambda s: -0.7 * s.angle, lambda s: 0.7 * s.angle, tries=lambda s: [0.0], optional=True,
    becomes="anisotropic_stiffness", becomes_from=0.625,
)  # fmt: skip
#: Wood that carries tension one way and compression the other has both changed, about a mean that is K across.
_SPLIT = EffectParameter("split", "1", 0.0, 1.0, tries=lambda s: [0.0], optional=True)


def _further(s: Setting) -> Sequence[tuple[float, ...]]:
    """Springs that stiffen from an angle on."""
    axes = axes_across(circle=True, count=8)
    return [(2.0, axis, 0.005, -share * s.angle, 0.0) for share in (0.1, 0.4) for axis in axes]


EFFECT = register(
    Effect(
        name="bilinear_stiffness",
        plain="a spring that is stiffer one way than the other",
        summary="stiffness K (1 + rel) where the joint bends one way about an axis across the segment, K the other way;"
        " the change is gradual over a corner, which in a branch may lie at an angle d from rest, from where on the"
        " spring softens, or stiffens, and the other way the stiffness may be K (1 - split rel)",
        source="Shaw & Holmes 1983, J. Sound Vib. 90:129; corner rounded",
        signature="pushes to the two sides differ in stiffness; releases swing with unequal half periods",
        mistaken_for=("cubic_stiffness", "anisotropic_stiffness", "backlash"),
        alike=("anisotropic_stiffness",),  # about its axis: what splits both ways
        probe="the same push and release in opposite directions, in two planes",
        branch=Law(
            "joint",
            (_REL, axis_parameter(circle=True, tries=8), _WIDTH, _OFF, _SPLIT),
            bilinear_stiffness,
            mirror=other_side,
            further=_further,
            strengths=("relative",),
        ),
        joint=Law("joint", (_REL, _CORNER), bilinear_joint),
    )
)
