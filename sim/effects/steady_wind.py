"""Wind that blows all the time."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, changed, div, mul, norm, size, sub
from ...kernels.lanes.real import real, sqrt_, where_neg
from .flow import ACROSS, CROWN, SLOWNESS, STORM, across, felt
from .registry import Effect, EffectParameter, Law, Setting, moment_parameter, register

#: The change of a wind that all but dies down: it was ten times as strong.
CALMER = -9.0
#: Least, typical and longest time that a wind takes to set in or to die down [s].
GROWING, TYPICAL, LONGEST = wp.constant(wp.float64(0.05)), 0.5, 3.0


@wp.func
def pressed(q: Any, most: Any, b: Any, m: Any, s: Any, k: Any):
    """F = A |u| u, u = w - m (w.d) d, w = sqrt(|q|) n - sqrt(Q) s v, n = q / |q|: a pressure q on a segment along d.

    Air that flows along a rod hardly moves it: with m = 1 what flows across it alone counts, squared (cross-flow
    principle); with m = 0 the force is A q however the segment lies. A velocity v of the segment counts as far as air
    of the largest pressure Q, which flows at 1 / s, is slow. The share k of the area hangs at the tip.
    """
    w = q * (real(1.0, m) / sqrt_(norm(q))) - b.velocity * (s * sqrt_(most))
    u = across(w, b.arm, m)
    return u * (felt(b, k) * norm(u))


@wp.func
def steady_wind(b: Any, p: Any):
    """F of the pressure q (x, y, z) (1 - c (1 - x)), m of it across the segment, in air that flows at 1 / s.

    x rises from 0 to 1 at a moment (`changed`), over `GROWING` at least: with c = 1 the wind sets in then, with c far
    below zero it dies down.
    """
    q, one, least = type(b.velocity)(p.a, p.b, p.c), real(1.0, p.g), real(GROWING, p.i)
    factor = changed(p.g, b.time, p.h, where_neg(p.i - least, least, p.i))
    first = size(one - p.g)
    return pressed(q * factor, norm(q) * where_neg(one - first, first, one), b, p.d, p.e, p.f)


def changing(s: Setting) -> list[tuple[float, ...]]:
    """Return winds that set in, or die down, at some moments of every recording, of a pressure yet to be found."""
    return [(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, change, moment, TYPICAL)
            for change in (1.0, CALMER) for moment in s.moments[::3]]  # fmt: skip


EFFECT = register(
    Effect(
        name="steady_wind",
        plain="a steady wind",
        summary="a force q A on every segment of projected area A, q constant; the share m of the air counts only as"
        " far as it flows across the segment, a segment that moves feels another wind as far as the air is slow, and"
        " the share crown of the area may hang at the tip; the branch rests displaced by it; before a moment on the"
        " absolute clock it may be 1 - c times as strong, so that it sets in or dies down then, over a time d",
        source="Vogel, Life in Moving Fluids (1994), chapter 5 (drag as dynamic pressure times area); Hoerner,"
        " Fluid-Dynamic Drag (1965), 3-11 (cross-flow principle)",
        signature="displacement is off in one direction before, during and after contact",
        mistaken_for=("force_bias", "gravity_comp_error"),
        probe="rows with the gripper open, long enough for the branch to rest",
        branch=Law(
            "link",
            (
                *(
                    EffectParameter(
                        f"pressure_{c}_Pa",
                        "Pa",
                        lambda s: -3.0 * s.force / s.area,
                        lambda s: 3.0 * s.force / s.area,
                        plausible=(-STORM, STORM),
                        aside=c == "y",
                    )
                    for c in "xyz"
                ),
                ACROSS,
                SLOWNESS,
                CROWN,
                EffectParameter("changes", "1", CALMER, 2.0, tries=lambda s: [0.0], reach=1.0, optional=True),
                moment_parameter(LONGEST, neutral=0.0),
                EffectParameter(
                    "takes_s",
                    "s",
                    float(GROWING),
                    LONGEST,
                    TYPICAL,
                    "log",
                    TYPICAL,
                    tries=lambda s: [TYPICAL],
                    optional=True,
                ),
            ),
            steady_wind,
            per_joint=False,
            further=changing,
            moment="moment_s",
            settles=("pressure_x_Pa", "pressure_y_Pa", "pressure_z_Pa"),
        ),
    )
)
