"""A sensor with a wrong gain."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, sub
from ...kernels.lanes.real import real
from .registry import Effect, EffectParameter, Law, register


@wp.func
def force_scale(g: Any, p: Any):
    """F = F_s / s."""
    return g.force * (real(1.0, p.a) / p.a)


_SCALE = (EffectParameter("scale", "1", 0.5, 2.0, 1.0, "log"),)

EFFECT = register(
    Effect(
        name="force_scale",
        plain="a wrong scale of the force sensor",
        summary="the sensor reads s times the force that acts",
        source="definition; BIPM, International Vocabulary of Metrology (2012), 2.18",
        signature="all stiffnesses and dampers look s times too large against the mass and weight: swings are off",
        mistaken_for=("tip_mass", "cubic_stiffness"),
        probe="free swings after a release beside slow pushes",
        branch=Law("force", _SCALE, force_scale, per_joint=False),
        joint=Law("force", _SCALE, force_scale),
    )
)
