"""Drag that grows with the square of the speed.

In air a rod has c = rho C / 2 = 0.6 kg/m^3 of its projected area, with a coefficient C of about one (Hoerner 1965,
3-9); other shapes have 0.3 to 2. Leaves and twigs count as wood here, and their projected area may be a hundred times
that of the wood. So nature has 0.2 to 100 kg/m^3; water would have 500.
"""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, dot, mul, rotate, size, sub, unrotate
from ...kernels.lanes.real import fma, real, sqrt_
from .flow import ACROSS, CROWN, across, felt
from .registry import Effect, EffectParameter, Law, register


@wp.func
def drag_on_link(b: Any, p: Any):
    """F = -c A (|u| + l) u, u = v - m (v.d) d: the share m of what moves along the segment d does not count.

    Of it the share s is felt along each axis of the segment by itself, as by the faces of a box: -c A |u_k| u_k. The
    share k of the area hangs at the tip.
    """
    o = real(0.0, p.a)
    u = across(b.velocity, b.arm, p.b)
    own = unrotate(b.turn, u)
    faces = type(u)(own.x * size(own.x), own.y * size(own.y), own.z * size(own.z))
    whole = u * fma(real(1.0, o) - p.c, sqrt_(dot(u, u)), p.e)
    return (whole + rotate(b.turn, faces) * p.c) * (o - p.a * felt(b, p.d))


@wp.func
def drag_at_joint(j: Any, p: Any, r: Any):
    """tau = -c |w| w, a damper of c |w|."""
    return type(r)(r.torque, r.memory, real(0.0, p.a), p.a * sqrt_(dot(j.rate, j.rate)))


#: Speed below which the drag is linear: with a fifth of the largest one it goes with the power 1.6 to 1.8 of the
#: speed, as of leaves that give way. With more of it the drag is a damper.
_LINEAR = EffectParameter("linear_mps", "m/s", 0.0, lambda s: 0.5 * s.speed, tries=lambda s: [0.0], optional=True)

EFFECT = register(
    Effect(
        name="quadratic_drag",
        plain="air drag",
        summary="a force -c |v| v per projected area all along every segment; the share m of the motion counts only as"
        " far as it is across the segment, a share of the force may act along each axis of the segment by itself, and"
        " the share crown of the area may hang at the tip, and |v| + l may stand for |v|; at a measured joint a torque"
        " -c |w| w",
        source="Rayleigh 1876; Batchelor, An Introduction to Fluid Dynamics (1967), section 5.11; Hoerner,"
        " Fluid-Dynamic Drag (1965), 3-11 (cross-flow principle); powers below two: Vogel 1984, Am. Zool. 24:37",
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
                    plausible=(0.2, 100.0),
                ),
                ACROSS,
                EffectParameter("separate", "1", 0.0, 1.0, tries=1, optional=True),
                CROWN,
                _LINEAR,
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
