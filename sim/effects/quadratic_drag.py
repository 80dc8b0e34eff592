"""Drag that grows with the square of the speed."""

from typing import Any

import warp as wp

from ...kernels.algebra import add, div, dot, mul, sub
from ...kernels.real import real, sqrt_
from .registry import Effect, EffectParameter, Law, register


@wp.func
def drag_on_link(b: Any, p: Any):
    """F = -c A |v| v at the centre of the projected area A."""
    o = real(0.0, p.a)
    return b.velocity * (o - p.a * b.area * sqrt_(dot(b.velocity, b.velocity)))


@wp.func
def drag_at_joint(j: Any, p: Any, r: Any):
    """tau = -c |w| w, a damper of c |w|."""
    return type(r)(r.torque, r.memory, real(0.0, p.a), p.a * sqrt_(dot(j.rate, j.rate)))


EFFECT = register(
    Effect(
        name="quadratic_drag",
        summary="a force -c A |v| v on every segment of projected area A; at a measured joint a torque -c |w| w",
        source="Rayleigh 1876; Batchelor, An Introduction to Fluid Dynamics (1967), section 5.11",
        signature="large swings decay faster than small ones: 1 / amplitude grows linearly in time",
        mistaken_for=("dry_friction", "viscoelastic_sls"),
        probe="free swings from a large and a small deflection",
        branch=Law(
            "link",
            (
                EffectParameter(
                    "coefficient_kgpm3",
                    "kg/m^3",
                    lambda s: 0.005 * s.force / (s.area * s.speed**2),
                    lambda s: 10.0 * s.force / (s.area * s.speed**2),
                    scale="log",
                ),
            ),
            drag_on_link,
            per_joint=False,
        ),
        joint=Law(
            "joint",
            (
                EffectParameter(
                    "coefficient_Nms2",
                    "N m s^2/rad^2",
                    lambda s: 1e-4 * s.torque / s.rate**2,
                    lambda s: 3.0 * s.torque / s.rate**2,
                    scale="log",
                ),
            ),
            drag_at_joint,
        ),
    )
)
