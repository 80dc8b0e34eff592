"""Wind that blows all the time."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, norm, sub
from ...kernels.lanes.real import real
from .flow import ACROSS, STORM, across
from .registry import Effect, EffectParameter, Law, register


@wp.func
def pressed(q: Any, b: Any, m: Any):
    """F = A |q| |u| u, u = n - m (n.d) d, n = q / |q|: the force of a pressure q on a segment along d.

    Air that flows along a rod hardly moves it: with m = 1 what flows across it alone counts, squared (cross-flow
    principle); with m = 0 the force is A q however the segment lies.
    """
    size = norm(q)
    u = across(q * (real(1.0, m) / size), b.arm, m)
    return u * (size * b.area * norm(u))


@wp.func
def steady_wind(b: Any, p: Any):
    """F of the pressure q (x, y, z), m of it across the segment."""
    return pressed(type(b.velocity)(p.a, p.b, p.c), b, p.d)


EFFECT = register(
    Effect(
        name="steady_wind",
        plain="a steady wind",
        summary="a force q A on every segment of projected area A, q constant; the share m of the air counts only as"
        " far as it flows across the segment; the branch rests displaced by it",
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
            ),
            steady_wind,
            per_joint=False,
            settles=("pressure_x_Pa", "pressure_y_Pa", "pressure_z_Pa"),
        ),
    )
)
