"""A law's numbers held against its units: in other units of time and energy it must be the same law."""

from __future__ import annotations

import numpy as np

from ...sim.effects import Law
from .bench import SETTING, closed_path, effort_along, values_in

#: How many old seconds and joules the new ones are; lengths stay. No product of small powers of the two is 1.
SLOWER, STRONGER = 2.0, 5.0
#: Powers of joule and second in a unit; metres and radians count as 1.
POWERS = {"1": (0, 0), "m": (0, 0), "rad": (0, 0), "N": (1, 0), "J": (1, 0), "Pa": (1, 0), "s": (0, 1), "Hz": (0, -1),
          "kg": (1, 2), "W": (1, -1)}  # fmt: skip
#: Share by which the answer may differ: a law may hold a constant with a unit, such as the 0.05 s that a rupture takes.
ASTRAY = 0.25
SAMPLES = 2_000


def scale_of(unit: str) -> float | None:
    """Return how many times larger a quantity's number is in the new units, None for a unit that is not known.

    A unit is written as in the registry: ``N m s/rad^3``, ``rad/(N m)``, ``1``.
    """
    above, _, below = unit.split(" or ")[0].partition("/")
    scale = 1.0
    for side, sign in ((above, 1), (below.strip("()"), -1)):
        for word in side.split():
            name, _, power = word.partition("^")
            if name not in POWERS or not (power or "1").lstrip("-").isdigit():
                return None
            joules, seconds = (sign * int(power or 1) * p for p in POWERS[name])
            scale *= STRONGER**joules * SLOWER**seconds
    return scale


def astray(law: Law, axes: int) -> float:
    """Return by how much a law's effort differs where all quantities are told in the new units, as a share of it.

    The law is of kind ``joint`` or ``link``, and its units are known.
    """
    where, rate = closed_path(SETTING.angle, axes, SAMPLES)
    values = values_in(law)
    scales = [scale_of(p.unit) or 1.0 for p in law.parameters]
    told = [v * s for v, s in zip(values, scales, strict=True)]
    plain, other = effort_along(law, values, where, rate), effort_along(law, told, where, rate, SLOWER, STRONGER)
    rms = float(np.sqrt(np.mean(plain**2)))
    return float(np.sqrt(np.mean((other / STRONGER - plain) ** 2))) / rms if rms > 0.0 else 0.0
