"""A joint that breaks in part."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, sub
from ...kernels.lanes.real import real, where_neg
from .registry import Effect, EffectParameter, Law, register

#: Least time that the fibres take to part [s].
BREAKING = wp.constant(wp.float64(0.05))
#: Longest time of a break that is named [s]: what takes longer is a drift.
LONGEST = 0.6


@wp.func
def partial_rupture(j: Any, p: Any, r: Any):
    """tau = +s (K phi - c P) after the moment t0, rising over d; P is the preload that carries the weight."""
    o = real(0.0, p.a)
    one = real(1.0, o)
    least = real(BREAKING, o)
    x = (j.time - p.b) / where_neg(p.d - least, least, p.d)
    x = where_neg(x, o, x)
    x = where_neg(one - x, one, x)
    gone = j.angle * (p.a * x * j.stiffness) - j.preload * (p.a * x * p.c)
    return type(r)(gone, r.memory, o, o)


EFFECT = register(
    Effect(
        name="partial_rupture",
        plain="a partial break (it is softer from one moment on)",
        summary="from a moment on the absolute clock on, the spring has lost a share s of its stiffness for good, and"
        " as much of the preload that carries the branch's weight, or the share c of that, so that the branch sags;"
        " little by little over a time d, 0.05 s at least",
        source="Kachanov 1958 (damage as a share of the stiffness); Lemaitre, A Course on Damage Mechanics (1996), 1.2",
        signature="replicates before and after a moment differ; after it everything is softer, and may hang lower",
        mistaken_for=("plastic_set", "tip_mass"),
        probe="the first push again at the end",
        branch=Law(
            "joint",
            (
                EffectParameter("share", "1", 0.02, 0.95, scale="log", typical=0.3, tries=1),
                EffectParameter(
                    "moment_s",
                    "s",
                    lambda s: s.start,
                    lambda s: s.end,
                    tries=lambda s: s.moments,
                    reach=lambda s: 0.25 * s.duration,
                ),
                EffectParameter("preload", "1", 0.0, 1.0, tries=1, optional=True),
                EffectParameter(
                    "takes_s",
                    "s",
                    0.05,
                    LONGEST,
                    neutral=0.05,
                    scale="log",
                    tries=lambda s: [0.05],
                    optional=True,
                ),
            ),
            partial_rupture,
            settles=("share",),
            moment="moment_s",
        ),
    )
)
