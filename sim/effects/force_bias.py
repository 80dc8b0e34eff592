"""A sensor with an offset."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, sub
from .registry import Effect, EffectParameter, Law, register


@wp.func
def force_bias(g: Any, p: Any):
    """F = F_s - c (b + w o_j); c is 1 in contact, where the sensor is read, o_j what it reads of an open gripper."""
    return g.force - (type(g.force)(p.a, p.b, p.c) + g.opened * p.d) * g.contact


def _bias(name: str, unit: str) -> EffectParameter:
    return EffectParameter(name, unit, lambda s: -s.force, lambda s: s.force, aside="_y_" in name)


#: Share of the open gripper's reading that is an offset of its recording, as of a sensor that is tared before each.
_OPENED = EffectParameter("opened", "1", -0.25, 1.25, reach=1.0, optional=True, of_each=True)


EFFECT = register(
    Effect(
        name="force_bias",
        plain="a constant error of the force sensor",
        summary="the sensor reads b more than the force that acts, in world axes; an open gripper's force is known,"
        " and of what it reads in each recording the share opened is part of b",
        source="definition; BIPM, International Vocabulary of Metrology (2012), 2.18",
        signature="a constant force is missing while the gripper holds, which the sensor reads of an open one too",
        mistaken_for=("steady_wind", "gravity_comp_error"),
        probe="rows with the gripper open; holds in opposite directions",
        branch=Law("force", (*(_bias(f"force_{c}_N", "N") for c in "xyz"), _OPENED), force_bias, per_joint=False),
        joint=Law("force", (_bias("effort_N", "N m or N"),), force_bias),
    )
)
