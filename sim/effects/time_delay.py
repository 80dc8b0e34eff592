"""A force sensor that is late."""

from .registry import Effect, EffectParameter, Law, register

_LAW = Law(
    "time_delay",
    (EffectParameter("lag_s", "s", lambda s: -4.0 * s.dt, lambda s: 4.0 * s.dt),),
    per_joint=False,
)

EFFECT = register(
    Effect(
        name="time_delay",
        plain="a delay of the force sensor",
        summary="the force is recorded lag seconds after it acted, linear between samples; at most five samples",
        source="definition; Ljung, System Identification (1999), section 4.2 (dead time)",
        signature="misfit where the force changes fast: at the release and in sweeps",
        mistaken_for=("tip_mass", "viscoelastic_sls"),
        probe="steps and fast sweeps",
        branch=_LAW,
        joint=_LAW,
    )
)
