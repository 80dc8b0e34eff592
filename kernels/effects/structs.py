"""Structs that laws take and return, and the arrays of a replay's effects."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..tree.layout import layout_of

__all__ = ["PARAMETERS", "effect_types", "law_types"]

#: Parameters that a term may have.
PARAMETERS = 10


@cache
def law_types(width: int, precision: int) -> SimpleNamespace:
    """Return the structs that laws take and return, of one width and precision."""
    t = layout_of(width, precision)
    Real, Vec, Quat = t.Real, t.Vec, t.Quat

    @wp.struct
    class Parameters:
        """Parameters of a law, in the order of its registry entry."""

        a: Real
        b: Real
        c: Real
        d: Real
        e: Real
        f: Real
        g: Real
        h: Real
        i: Real
        j: Real

    @wp.struct
    class JointState:
        """What a law at a joint sees.

        ``preload`` is the present torque of the pre-load that carries the weight, ``effort`` that of an actuator. By
        ``rate`` the angle has come here in the last ``step``; ``ahead`` is the rate in the middle of the next one where
        that is told (`tree.midway`), or else the same.
        """

        angle: Vec
        rate: Vec
        preload: Vec
        effort: Vec
        stiffness: Real
        time: Real
        step: Real
        ahead: Vec

    @wp.struct
    class Response:
        """What a law answers: effort, damper and memory."""

        torque: Vec
        memory: Vec
        stiffness: Real
        damping: Real

    @wp.struct
    class Responses:
        """What all laws answer together; ``follows``: of their stiffness what pulls back at rest as well."""

        torque: Vec
        stiffness: Real
        damping: Real
        follows: Real

    @wp.struct
    class LongResponse:
        """A response with two memories."""

        torque: Vec
        memory: Vec
        second: Vec
        stiffness: Real
        damping: Real

    return SimpleNamespace(Parameters=Parameters, JointState=JointState, Response=Response, Responses=Responses,
                           LongResponse=LongResponse, **vars(_outer_law_types(Real, Vec, Quat)))  # fmt: skip


def _outer_law_types(Real: Any, Vec: Any, Quat: Any) -> SimpleNamespace:
    """Structs of laws at links and of the sensor."""

    @wp.struct
    class LinkState:
        """What a law at a link sees; ``course`` is the pressure of gusts over their rms, where a course is known."""

        velocity: Vec
        arm: Vec
        turn: Quat
        area: Real
        crown: Real
        time: Real
        course: Vec

    @wp.struct
    class Wrench:
        """Force and moment."""

        force: Vec
        moment: Vec

    @wp.struct
    class ForceState:
        """What a law of the force sensor sees."""

        force: Vec
        contact: Real
        turn: Quat
        first: Quat
        gravity: Vec
        opened: Vec
        heading: Vec
        time: Real

    return SimpleNamespace(LinkState=LinkState, Wrench=Wrench, ForceState=ForceState)


@cache
def effect_types(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return the structs of `kernels.tree.layout`, those of laws, and ``Effects``, of one width and precision."""
    t = layout_of(width, precision)
    Real, Vec, Quat = t.Real, t.Vec, t.Quat

    @wp.struct
    class Effects:
        """Arrays of a replay's effects, those of `midway.Midway` among them; ``bent``: where a law at a joint acts."""

        parameter: wp.array2d(dtype=Real)
        memory: wp.array2d(dtype=Vec)
        damping: wp.array2d(dtype=Real)
        effort: wp.array2d(dtype=Vec)
        hold: wp.array2d(dtype=Vec)
        wind: wp.array2d(dtype=Vec)
        swirl: wp.array2d(dtype=Vec)
        course: wp.array2d(dtype=Vec)
        before: wp.array2d(dtype=Vec)
        gain: wp.array2d(dtype=Vec)
        ahead: wp.array2d(dtype=Quat)
        active: wp.array2d(dtype=int)
        bent: wp.array2d(dtype=int)
        area: wp.array2d(dtype=Real)
        centre: wp.array2d(dtype=Vec)
        end: wp.array2d(dtype=Vec)
        crown: wp.array2d(dtype=Real)
        leaf: wp.array2d(dtype=int)
        settle: wp.array(dtype=Real)
        lag: wp.array2d(dtype=int)
        tip: int
        stride: int

    return SimpleNamespace(**vars(t), **vars(law_types(width, precision)), Effects=Effects)
