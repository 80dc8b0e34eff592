"""A joint that breaks in part."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, begun, div, mul, norm, sub
from ...kernels.lanes.real import real, where_neg
from .registry import Effect, EffectParameter, Law, Setting, moment_parameter, register

#: Least time that the fibres take to part [s].
BREAKING = wp.constant(wp.float64(0.05))
#: Longest time of a break that is named [s]: what takes longer is a drift.
LONGEST = 0.6
#: How long before the recordings a moment may lie [s]: longer than a break takes.
BEFORE = 1.0
#: Least bend that tells a break by bending from one by the clock alone [rad].
LEAST = wp.constant(wp.float64(1.0e-6))


@wp.func
def grown(most: Any, limit: Any, width: Any):
    """x / (x + w) of the largest bend, x what it exceeds the limit by: the share of a break that bending has made.

    All of it without a limit and a width, and at once beyond the limit without a width.
    """
    o = real(0.0, most)
    least = real(LEAST, o)
    x = most - limit
    x = where_neg(x, o, x)
    return where_neg(least - limit - width, x / (x + width + least), real(1.0, o))


@wp.func
def partial_rupture(j: Any, p: Any, r: Any):
    """tau = +s g (K phi - c P) after the moment t0, rising over d; P is the preload that carries the weight.

    g grows with the largest bend so far (`grown`), which the joint remembers.
    """
    o = real(0.0, p.a)
    least = real(BREAKING, o)
    x = begun(j.time, p.b, where_neg(p.d - least, least, p.d))
    bend = norm(j.angle)
    most = where_neg(bend - r.memory.x, r.memory.x, bend)
    lost = p.a * x * grown(most, p.e, p.f)
    gone = j.angle * (lost * j.stiffness) - j.preload * (lost * p.c)
    return type(r)(gone, type(r.memory)(most, o, o), o, o)


def bent(s: Setting) -> list[tuple[float, ...]]:
    """Return breaks that bending alone makes: a share, its limit and its width, with the preload or without it."""
    before = s.start - BEFORE
    sizes = ((0.4, 0.5, 0.1), (0.8, 0.3, 0.5), (0.8, 0.6, 0.5))
    return [(share, before, load, float(BREAKING), limit * s.angle, width * s.angle)
            for share, limit, width in sizes for load in (0.0, 1.0)]  # fmt: skip


def _by_bending(name: str, most: float) -> EffectParameter:
    """Return a bend [rad], zero where the clock alone tells when it breaks, up to ``most`` times the largest seen."""
    return EffectParameter(name, "rad", 0.0, lambda s: most * s.angle, tries=lambda s: [0.0], optional=True)


EFFECT = register(
    Effect(
        name="partial_rupture",
        plain="a partial break (it has become softer for good)",
        summary="from a moment on the absolute clock on, the spring has lost a share s of its stiffness for good, and"
        " as much of the preload that carries the branch's weight, or the share c of that, so that the branch sags;"
        " little by little over a time d, 0.05 s at least; of that share so much as bending has broken, x / (x + w), x"
        " what the largest bend so far exceeds a limit by, where limit or w are not zero",
        source="Kachanov 1958 (damage as a share of the stiffness); Lemaitre, A Course on Damage Mechanics (1996), 1.2;"
        " damage of the largest strain: Mazars & Pijaudier-Cabot 1989, J. Eng. Mech. 115:345",
        signature="replicates before and after a moment differ; after it everything is softer, and may hang lower",
        mistaken_for=("plastic_set", "tip_mass"),
        probe="the first push again at the end",
        branch=Law(
            "joint",
            (
                EffectParameter("share", "1", 0.0, 0.95, typical=0.3, tries=1),
                moment_parameter(BEFORE),
                EffectParameter("preload", "1", 0.0, 1.0, tries=1, optional=True),
                EffectParameter(
                    "takes_s",
                    "s",
                    float(BREAKING),
                    LONGEST,
                    neutral=float(BREAKING),
                    scale="log",
                    tries=lambda s: [float(BREAKING)],
                    optional=True,
                ),
                _by_bending("limit_rad", 1.0),
                _by_bending("grows_rad", 2.0),
            ),
            partial_rupture,
            memory=1,
            persistent=True,
            settles=("share",),
            moment="moment_s",
            further=bent,
        ),
    )
)
