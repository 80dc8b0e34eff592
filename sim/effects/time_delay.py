"""A sensor that is late: of force, or of motion."""

import math

from .registry import Effect, EffectParameter, Law, Setting, register

#: Longest delay of a branch's sensors [s], as cameras and their networks have; and as many samples, least and most.
LONGEST, LEAST_SAMPLES, MOST_SAMPLES = 0.75, 4.0, 64.0


def _longest(s: Setting) -> float:
    return min(max(LONGEST, LEAST_SAMPLES * s.dt), MOST_SAMPLES * s.dt)


def _delays(s: Setting) -> list[float]:
    """No delay, and delays both ways from one and a half samples on, each twice the one before."""
    count = 1 + int(math.log2(0.9 * _longest(s) / (1.5 * s.dt)))
    late = [1.5 * s.dt * 2.0**k for k in range(count)]
    return [*(-x for x in reversed(late)), 0.0, *late]


_LAG = EffectParameter("lag_s", "s", lambda s: -_longest(s), _longest, tries=_delays)
_LAG_AT_JOINT = EffectParameter("lag_s", "s", lambda s: -4.0 * s.dt, lambda s: 4.0 * s.dt)
#: Of a branch's tracker; of its force sensor where it is negative.
_SLOW = EffectParameter(
    "slow_s", "s", lambda s: -_longest(s), _longest, tries=lambda s: [0.0, 2.0 * s.dt, -2.0 * s.dt], optional=True
)

EFFECT = register(
    Effect(
        name="time_delay",
        plain="a delay of a sensor",
        summary="the force is recorded lag seconds after it acted (before, where the motion is late), linear between"
        " samples; a branch's tracker follows with a first-order lag of slow seconds, or its force sensor does"
        " (slow < 0)",
        source="definition; Ljung, System Identification (1999), section 4.2 (dead time); Doebelin, Measurement Systems"
        " (2004), chapter 3 (first-order instrument)",
        signature="misfit where the force changes fast: at the release and in sweeps",
        mistaken_for=("tip_mass", "viscoelastic_sls"),
        probe="steps and fast sweeps",
        branch=Law("time_delay", (_LAG, _SLOW), per_joint=False, memory=2, strengths=("lag_s", "slow_s")),
        joint=Law("time_delay", (_LAG_AT_JOINT,), per_joint=False),
    )
)
