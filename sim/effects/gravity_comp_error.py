"""Weight that is taken off wrongly: the gripper's off the sensor, or the branch's off its springs."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, rotate, sub, unrotate
from ...kernels.lanes.real import real, where_neg
from .registry import Effect, EffectParameter, Law, register


@wp.func
def gravity_comp_error(g: Any, p: Any):
    """F = F_s - c (dm (l gv - k R R0^T gv) + a h + b (z x h)): R of the held link turns from R0, h is the heading.

    c is 1 in contact, gv gravity, z up; k = min(tared, 1) and l = min(2 - tared, 1); a and b are what the tare of a
    tool that tilts leaves ahead and across.
    """
    turned = rotate(g.turn, unrotate(g.first, g.gravity))
    h = g.heading
    o = real(0.0, h.x)
    one = real(1.0, o)
    over = p.b - one
    left = where_neg(over, one, one - over)
    taken = where_neg(over, p.b, one)
    across = type(h)(o - h.y, h.x, h.z)
    return g.force - ((g.gravity * left - turned * taken) * p.a + h * p.c + across * p.d) * g.contact


@wp.func
def overloaded(j: Any, p: Any, r: Any):
    """tau = +e P: P is the pre-load that carries the weight, e what it carries too much."""
    return type(r)(j.preload * p.e, r.memory, r.stiffness, r.damping)


def _turning(name: str) -> EffectParameter:
    aside = name == "across_N"
    return EffectParameter(name, "N", lambda s: -s.force, lambda s: s.force, optional=True, aside=aside)


EFFECT = register(
    Effect(
        name="gravity_comp_error",
        plain="a weight that is taken off wrongly, the tool's off the sensor or the branch's off its springs",
        summary="the sensor's reading holds the weight of a mass dm, of which a share k was tared in the rest pose and"
        " turns with the held segment (beyond 1 the share 2 - k of the weight itself is left, so that at 2 what was"
        " tared turns alone), and what the tare of a tool that tilts leaves, ahead and across of where each pull faces;"
        " or the springs' pre-loads carry the share e of the branch's weight too much, so that it rests elsewhere than"
        " in its given pose",
        source="Kubus, Kroeger & Wahl 2008, IROS (gravity compensation of wrist force sensors)",
        signature="a force offset along gravity that changes as the gripper turns with the branch or the pull, or a"
        " branch that stands off along gravity before it is touched",
        mistaken_for=("force_bias", "steady_wind"),
        probe="the same push with the gripper turned",
        branch=Law(
            "force",
            (
                EffectParameter("mass_kg", "kg", lambda s: -s.force / s.gravity, lambda s: s.force / s.gravity),
                EffectParameter("tared", "1", 0.0, 2.0, tries=2, optional=True),
                _turning("ahead_N"),
                _turning("across_N"),
                EffectParameter("overload", "1", -0.75, 0.75, optional=True),
            ),
            gravity_comp_error,
            per_joint=False,
            strains=overloaded,
            settles=("overload",),
        ),
    )
)
