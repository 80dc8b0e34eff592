"""A sensor with an offset."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, changed, div, mul, sub
from ...kernels.lanes.real import real
from .registry import Effect, EffectParameter, Law, Setting, moment_parameter, register

#: Time that a jump of the offset takes [s], and how long before the recordings it may be.
JUMP, BEFORE = wp.constant(wp.float64(0.05)), 1.0


@wp.func
def force_bias(g: Any, p: Any):
    """F = F_s - c (b (1 - e (1 - x)) + w o_j), c is 1 in contact, where the sensor is read.

    o_j is what it reads of an open gripper; x rises from 0 to 1 at a moment (`changed`): with e = 1 b sets in then.
    """
    share = changed(p.e, g.time, p.f, real(JUMP, p.f))
    return g.force - (type(g.force)(p.a, p.b, p.c) * share + g.opened * p.d) * g.contact


@wp.func
def effort_bias(g: Any, p: Any):
    """F = F_s - c b."""
    return g.force - type(g.force)(p.a, p.b, p.c) * g.contact


def jumps(s: Setting) -> list[tuple[float, ...]]:
    """Return offsets that set in at some moments of every recording, of a size yet to be found."""
    return [(0.0, 0.0, 0.0, 0.0, 1.0, moment) for moment in s.moments[::3]]


def _bias(name: str, unit: str) -> EffectParameter:
    return EffectParameter(name, unit, lambda s: -s.force, lambda s: s.force, aside="_y_" in name)


#: Share of the open gripper's reading that is an offset of its recording, as of a sensor that is tared before each.
_OPENED = EffectParameter("opened", "1", -0.25, 1.25, reach=1.0, optional=True, of_each=True)
#: By how much of itself the offset was less before it jumped: by all of it where it sets in then.
_CHANGES = EffectParameter("changes", "1", -2.0, 2.0, tries=lambda s: [0.0], reach=1.0, optional=True)


EFFECT = register(
    Effect(
        name="force_bias",
        plain="a constant error of the force sensor",
        summary="the sensor reads b more than the force that acts, in world axes; an open gripper's force is known,"
        " and of what it reads in each recording the share opened is part of b; before a moment on the absolute clock b"
        " may be 1 - e times as large, so that it sets in or jumps then",
        source="definition; BIPM, International Vocabulary of Metrology (2012), 2.18",
        signature="a constant force is missing while the gripper holds, which the sensor reads of an open one too",
        mistaken_for=("steady_wind", "gravity_comp_error"),
        probe="rows with the gripper open; holds in opposite directions",
        branch=Law(
            "force",
            (*(_bias(f"force_{c}_N", "N") for c in "xyz"), _OPENED, _CHANGES, moment_parameter(BEFORE, neutral=0.0)),
            force_bias,
            per_joint=False,
            strengths=("force_x_N", "force_y_N", "force_z_N", "opened"),
            further=jumps,
            moment="moment_s",
        ),
        joint=Law("force", (_bias("effort_N", "N m or N"),), effort_bias),
    )
)
