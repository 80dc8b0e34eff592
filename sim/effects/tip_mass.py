"""A mass at the tip that the given masses lack."""

from .registry import Effect, EffectParameter, Law, register


def _aside(axis: str) -> EffectParameter:
    return EffectParameter(f"aside_{axis}_m", "m", lambda s: -0.3 * s.length, lambda s: 0.3 * s.length, optional=True)


EFFECT = register(
    Effect(
        name="tip_mass",
        plain="a mass at the tip",
        summary="a mass at the upper end of the last segment, or spread evenly over the last share b of it, or beside"
        " that by aside_x and aside_y across the segment, in its own axes, held in the rest pose by the pre-loads",
        source="Featherstone, Rigid Body Dynamics Algorithms (2008), 2.13 (inertia of a point mass; a rod: m l^2 / 12)",
        signature="slower swings with the same stiffness in slow pushes",
        mistaken_for=("partial_rupture", "force_scale", "time_delay"),
        probe="free swings after a release beside slow pushes",
        branch=Law(
            "tip_mass",
            (
                EffectParameter("mass_kg", "kg", lambda s: 0.01 * s.mass, lambda s: 2.0 * s.mass, scale="log"),
                _aside("x"),
                _aside("y"),
                EffectParameter("spread", "1", 0.0, 1.0, tries=lambda s: [0.0], optional=True),
            ),
            per_joint=False,
        ),
    )
)
