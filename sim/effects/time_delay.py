"""A sensor that is late: of force, or of motion."""

from .registry import Effect, EffectParameter, Law, register

_LAG = EffectParameter("lag_s", "s", lambda s: -4.0 * s.dt, lambda s: 4.0 * s.dt)
#: Of a branch's tracker; twice as long as a delay may be, as filters of trackers are.
_SLOW = EffectParameter("slow_s", "s", 0.0, lambda s: 8.0 * s.dt, tries=lambda s: [0.0, 2.0 * s.dt], optional=True)

EFFECT = register(
    Effect(
        name="time_delay",
        plain="a delay of a sensor",
        summary="the force is recorded lag seconds after it acted (before, where the motion is late), linear between"
        " samples, at most five of them; a branch's tracker follows with a first-order lag of slow seconds",
        source="definition; Ljung, System Identification (1999), section 4.2 (dead time); Doebelin, Measurement Systems"
        " (2004), chapter 3 (first-order instrument)",
        signature="misfit where the force changes fast: at the release and in sweeps",
        mistaken_for=("tip_mass", "viscoelastic_sls"),
        probe="steps and fast sweeps",
        branch=Law("time_delay", (_LAG, _SLOW), per_joint=False, memory=2, strengths=("lag_s", "slow_s")),
        joint=Law("time_delay", (_LAG,), per_joint=False),
    )
)
