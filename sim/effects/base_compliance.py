"""A trunk that gives way."""

from collections.abc import Sequence
from dataclasses import replace

from .registry import Effect, EffectParameter, Law, Setting, axis_parameter, register

#: Least compliance of a trunk that turns or slides, as a share of that which all motion seen would need.
LEAST = 0.003


def _give(s: Setting) -> float:
    """Compliance of a slide by which the grasp point would move as it was seen to [m/N], s being the first joint's."""
    return s.angle * s.torque / s.force**2


def _further(s: Setting) -> Sequence[tuple[float, ...]]:
    """Trunks that slide and hardly turn."""
    inertia = 3.0 * s.mass * s.length**2
    return [(LEAST / s.stiffness, inertia, 0.02, 1.0, 0.0, 0.0, share * _give(s), 0.02) for share in (0.05, 0.2, 0.6)]


EFFECT = register(
    Effect(
        name="base_compliance",
        plain="a base that gives way",
        summary="one more ball joint below the base: a spring of 1 / compliance, a damper of relaxation times"
        " it, and the inertia of what turns on it, of which a share counts for its twist; it may be stiffer,"
        " (1 + relative) / compliance, for bending about one level axis; and it may slide, alike along all axes, on a"
        " spring of 1 / slide and a damper of slide_relaxation times it",
        source="James, Haritos & Ades 2006, Am. J. Bot. 93:1522 (the trunk as a spring below the branch)",
        signature="the grasp point moves as if the base turned: more along the branch than its own joints allow",
        mistaken_for=("cubic_stiffness", "force_scale", "anisotropic_stiffness", "bending_torsion_coupling"),
        probe="pushes along the branch, and at two grasp points",
        branch=Law(
            "base_compliance",
            (
                EffectParameter(
                    "compliance_radpNm",
                    "rad/(N m)",
                    lambda s: LEAST / s.stiffness,
                    lambda s: 3.0 / s.stiffness,
                    scale="log",
                ),
                EffectParameter(
                    "inertia_kgm2",
                    "kg m^2",
                    lambda s: 0.01 * s.mass * s.length**2,
                    lambda s: 300.0 * s.mass * s.length**2,
                    scale="log",
                    tries=1,
                ),
                EffectParameter("relaxation_s", "s", 1.5e-3, 1.0, 0.02, "log", 0.02, tries=1),
                EffectParameter("twist", "1", 0.02, 1.0, neutral=1.0, tries=1, optional=True),
                EffectParameter("relative", "1", -0.9, 4.0, tries=lambda s: [0.0], optional=True),
                replace(axis_parameter(circle=False, tries=1), optional=True),
                EffectParameter(
                    "slide_mpN",
                    "m/N",
                    lambda s: LEAST * _give(s),
                    lambda s: 3.0 * _give(s),
                    scale="log",
                    tries=lambda s: [LEAST * _give(s)],
                    optional=True,
                ),
                EffectParameter(
                    "slide_relaxation_s", "s", 1.5e-3, 1.0, 0.02, "log", 0.02, tries=lambda s: [0.02], optional=True
                ),
            ),
            further=_further,
            per_joint=False,
        ),
    )
)
