"""A gripper that slides along the segment."""

from .registry import Effect, EffectParameter, Law, register

EFFECT = register(
    Effect(
        name="grasp_slip",
        summary="beyond a least force along the segment the grip slides at a rate of mobility times the excess, inside"
        " the segment's ends; it holds the marked point again in the next recording",
        source="Bingham 1922 (yield, then viscous flow); displacement is that of the marked point",
        signature="misfit grows within a push along the segment and is gone with the gripper open",
        mistaken_for=("viscoelastic_sls", "plastic_set"),
        probe="pushes across the segment beside pushes along it",
        branch=Law(
            "grasp_slip",
            (
                EffectParameter(
                    "mobility_mpNs",
                    "m/(N s)",
                    lambda s: 0.01 * s.length / (s.force * s.duration),
                    lambda s: 10.0 * s.length / (s.force * s.duration),
                    scale="log",
                ),
                EffectParameter("least_N", "N", lambda s: 0.02 * s.force, lambda s: s.force, scale="log"),
            ),
            per_joint=False,
            memory=True,
        ),
    )
)
