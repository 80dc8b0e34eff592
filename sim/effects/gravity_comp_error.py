"""A wrong weight of the gripper taken off the sensor."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, rotate, sub, unrotate
from .registry import Effect, EffectParameter, Law, register


@wp.func
def gravity_comp_error(g: Any, p: Any):
    """F = F_s - c dm (gv - k R R0^T gv): R of the held link turns from R0, and c is 1 in contact."""
    turned = rotate(g.turn, unrotate(g.first, g.gravity))
    return g.force - (g.gravity - turned * p.b) * (p.a * g.contact)


EFFECT = register(
    Effect(
        name="gravity_comp_error",
        plain="a weight that the force sensor reads as a force",
        summary="the sensor's reading holds the weight of a mass dm, of which a share k was tared in the rest pose and"
        " turns with the held segment",
        source="Kubus, Kroeger & Wahl 2008, IROS (gravity compensation of wrist force sensors)",
        signature="a force offset along gravity that changes as the gripper turns with the branch",
        mistaken_for=("force_bias", "steady_wind"),
        probe="the same push with the gripper turned",
        branch=Law(
            "force",
            (
                EffectParameter("mass_kg", "kg", lambda s: -s.force / s.gravity, lambda s: s.force / s.gravity),
                EffectParameter("tared", "1", 0.0, 1.0, 1.0, tries=2),
            ),
            gravity_comp_error,
            per_joint=False,
        ),
    )
)
