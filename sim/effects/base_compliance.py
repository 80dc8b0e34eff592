"""A trunk that gives way."""

from dataclasses import replace

from .registry import Effect, EffectParameter, Law, axis_parameter, register

EFFECT = register(
    Effect(
        name="base_compliance",
        plain="a base that gives way",
        summary="one more ball joint below the base: a spring of 1 / compliance, a damper of relaxation times"
        " it, and the inertia of what turns on it, of which a share counts for its twist; it may be stiffer,"
        " (1 + relative) / compliance, for bending about one level axis",
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
                    lambda s: 0.003 / s.stiffness,
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
            ),
            per_joint=False,
        ),
    )
)
