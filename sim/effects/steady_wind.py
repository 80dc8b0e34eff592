"""Wind that blows all the time."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, norm, sub
from ...kernels.lanes.real import real, sqrt_
from .flow import ACROSS, CROWN, SLOWNESS, STORM, across, felt
from .registry import Effect, EffectParameter, Law, register


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
    """F of the pressure q (x, y, z), m of it across the segment, in air that flows at 1 / s."""
    q = type(b.velocity)(p.a, p.b, p.c)
    return pressed(q, norm(q), b, p.d, p.e, p.f)


EFFECT = register(
    Effect(
        name="steady_wind",
        plain="a steady wind",
        summary="a force q A on every segment of projected area A, q constant; the share m of the air counts only as"
        " far as it flows across the segment, a segment that moves feels another wind as far as the air is slow, and"
        " the share crown of the area may hang at the tip; the branch rests displaced by it",
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
                    )
                    for c in "xyz"
                ),
                ACROSS,
                SLOWNESS,
                CROWN,
            ),
            steady_wind,
            per_joint=False,
            settles=("pressure_x_Pa", "pressure_y_Pa", "pressure_z_Pa"),
        ),
    )
)
