"""Wind that blows all the time."""

from typing import Any

import warp as wp

from ...kernels.algebra import add, div, mul, sub
from .registry import Effect, EffectParameter, Law, register


@wp.func
def steady_wind(b: Any, p: Any):
    """F = q A with the pressure q (x, y, z) on the projected area A."""
    return type(b.velocity)(p.a, p.b, p.c) * b.area


EFFECT = register(
    Effect(
        name="steady_wind",
        summary="a force q A on every segment of projected area A, q constant; the branch rests displaced by it",
        source="Vogel, Life in Moving Fluids (1994), chapter 5 (drag as dynamic pressure times area)",
        signature="displacement is off in one direction before, during and after contact",
        mistaken_for=("force_bias", "gravity_comp_error"),
        probe="rows with the gripper open, long enough for the branch to rest",
        branch=Law(
            "link",
            tuple(
                EffectParameter(
                    f"pressure_{c}_Pa", "Pa", lambda s: -3.0 * s.force / s.area, lambda s: 3.0 * s.force / s.area
                )
                for c in "xyz"
            ),
            steady_wind,
            per_joint=False,
            settles=True,
        ),
    )
)
