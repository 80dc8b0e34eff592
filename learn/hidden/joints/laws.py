"""Thirty laws of joints: how each is drawn, what the registry calls it, and on which rigs it can be seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import outside
from .friction import Bristle, Coulomb, Drag
from .hysteresis import BoucWen, Relays, Stops, Yielding
from .rig import Law
from .springs import Curved, DeadZone, Maxwell, OneSided

Random = np.random.Generator


@dataclass(frozen=True)
class Scale:
    """What a joint does without a hidden law: its spring [N m/rad], inertia [kg m^2], and largest angle, rate, torque.

    Attributes:
        stiffness: [N m/rad].
        inertia: [kg m^2].
        angle, rate, torque: [rad, rad/s, N m].
        seconds: Length of a recording [s].
    """

    stiffness: float
    inertia: float
    angle: float
    rate: float
    torque: float
    seconds: float

    @property
    def period(self) -> float:
        """Time of a typical swing [s]."""
        return 2.0 * np.pi * self.angle / self.rate


#: Draws a law at a joint: (random numbers, scale, joint) -> law of strength one.
Draw = Callable[[Random, Scale, int], Law]


@dataclass(frozen=True)
class Entry:
    """A law of the exam.

    Attributes:
        name: What the registry calls it; None for a law on no list, or a sensor's fault that `sensors` makes.
        draw: How it is drawn; None for a fault of the effort's sensor.
        rigs: Kinds of rigs on which it shows.
        strengths: Least and largest strength.
        truth: The registry's parameter that it shares and its value, from strength and scale; None where forms differ.
    """

    name: str | None
    draw: Draw | None
    rigs: tuple[str, ...]
    strengths: tuple[float, float]
    truth: Callable[[Law | None, float, Scale], dict[str, float]] | None = None


DRIVEN, FREE, HARD = ("spring", "sprung", "links"), ("swing",), ("axis", "arm")
ANY = (*DRIVEN, *FREE, *HARD)


def _speed(rng: Random, s: Scale) -> float:
    return float(rng.uniform(0.05, 0.2) * s.rate)


def _bend(rng: Random, s: Scale, low: float, high: float) -> float:
    return float(rng.uniform(low, high) * s.angle)


def _yields(rng: Random, s: Scale) -> float:
    return float(rng.uniform(0.08, 0.5) * s.angle)


def _time(rng: Random, s: Scale) -> float:
    return float(np.exp(rng.uniform(np.log(0.2), np.log(3.0))) * s.period)


def _torque(law: Law | None, strength: float, s: Scale) -> dict[str, float]:
    return {"torque_Nm": strength * s.torque}


#: Strengths of friction, and of what else is relative to the largest torque.
RUB = (0.003, 0.6)

ON_LIST: dict[str, Entry] = {
    "coulomb": Entry("dry_friction", lambda r, s, j: Coulomb(j, s.torque, s.rate), ANY, RUB, _torque),
    "stribeck": Entry(
        "dry_friction", lambda r, s, j: Coulomb(j, s.torque, _speed(r, s), float(r.uniform(0.2, 0.8))), ANY, RUB
    ),
    "lopsided": Entry(
        "dry_friction",
        lambda r, s, j: Coulomb(j, s.torque, s.rate, lopsided=float(r.uniform(0.1, 0.35))),
        (*DRIVEN, *HARD),
        RUB,
        _torque,
    ),
    "loaded": Entry(
        "dry_friction",
        lambda r, s, j: Coulomb(j, s.torque, s.rate, load=float(r.uniform(0.2, 0.6))),
        HARD,
        RUB,
    ),
    "lugre": Entry(
        "dry_friction",
        lambda r, s, j: Bristle(
            j, s.torque, _bend(r, s, 0.002, 0.02), _speed(r, s), float(r.uniform(0.1, 0.6)), 1e-3 * s.period
        ),
        ANY,
        RUB,
    ),
    "dahl": Entry("dry_friction", lambda r, s, j: Bristle(j, s.torque, _bend(r, s, 0.003, 0.03)), ANY, RUB, _torque),
    "bouc_wen": Entry(
        "hysteresis_boucwen",
        lambda r, s, j: BoucWen(
            j, s.stiffness, _yields(r, s), float(r.choice([1.0, 1.5, 2.0])), float(r.uniform(0.4, 0.7))
        ),
        DRIVEN,
        (0.02, 2.5),
    ),
    "stops": Entry(
        "hysteresis_boucwen",
        lambda r, s, j: Stops(j, s.stiffness, tuple(_yields(r, s) for _ in range(6))),
        DRIVEN,
        (0.02, 2.5),
    ),
    "relays": Entry(
        "hysteresis_boucwen", lambda r, s, j: Relays(j, s.stiffness * s.angle, s.angle), DRIVEN, (0.02, 1.5)
    ),
    "yielding": Entry(
        "plastic_set",
        lambda r, s, j: Yielding(
            j, s.stiffness, float(r.uniform(0.3, 0.6) * s.angle), float(r.choice([0.0, 0.0, 1.0]))
        ),
        DRIVEN,
        (0.03, 0.9),
    ),
    "duffing": Entry(
        "cubic_stiffness",
        lambda r, s, j: Curved(j, s.stiffness, s.angle),
        DRIVEN,
        (0.02, 3.0),
        lambda law, strength, s: {"cubic_radm2": strength / s.angle**2},
    ),
    "softening": Entry("cubic_stiffness", lambda r, s, j: Curved(j, s.stiffness, s.angle, "tanh"), DRIVEN, (0.05, 2.0)),
    "one_sided": Entry(
        "bilinear_stiffness",
        lambda r, s, j: OneSided(j, s.stiffness, float(r.choice([-1.0, 1.0]))),
        DRIVEN,
        (0.03, 2.5),
    ),
    "dead_zone": Entry(
        "backlash",
        lambda r, s, j: DeadZone(j, s.stiffness, s.angle),
        DRIVEN,
        (0.01, 0.7),
        lambda law, strength, s: {"gap_rad": strength * s.angle},
    ),
    "soft_zone": Entry(
        "backlash",
        lambda r, s, j: DeadZone(j, s.stiffness, s.angle, float(r.uniform(0.1, 0.3))),
        DRIVEN,
        (0.01, 0.7),
    ),
    "maxwell": Entry(
        "viscoelastic_sls",
        lambda r, s, j: Maxwell(j, s.stiffness, (_time(r, s),)),
        DRIVEN,
        (0.02, 2.5),
        lambda law, strength, s: {"relaxation_s": law.times[0]} if isinstance(law, Maxwell) else {},
    ),
    "wiechert": Entry(
        "viscoelastic_sls",
        lambda r, s, j: Maxwell(j, s.stiffness, (_time(r, s), _time(r, s))),
        DRIVEN,
        (0.02, 2.5),
    ),
    "rayleigh": Entry(
        "quadratic_drag",
        lambda r, s, j: Drag(j, s.torque, s.rate),
        (*DRIVEN, *FREE, *HARD),
        RUB,
        lambda law, strength, s: {"coefficient_Nms2": strength * s.torque / s.rate**2},
    ),
    "late": Entry("time_delay", None, ("spring", "links"), (0.3, 3.0)),
    "scaled": Entry(
        "force_scale", None, ("spring", "links"), (0.03, 0.6), lambda law, strength, s: {"scale": 1.0 + strength}
    ),
}

OUTSIDE: dict[str, Entry] = {
    "cogging": Entry(
        None,
        lambda r, s, j: outside.Ripple(j, s.torque, float(r.integers(7, 20)), float(r.uniform(0, 6.28))),
        HARD,
        RUB,
    ),
    "eccentric": Entry(
        None, lambda r, s, j: outside.Ripple(j, s.torque, 1.0, float(r.uniform(1.0, 2.0))), ("axis",), RUB
    ),
    "detent": Entry(
        None,
        lambda r, s, j: outside.Detent(
            j, s.torque, float(r.uniform(-0.4, 0.4) * s.angle), float(r.uniform(0.08, 0.2) * s.angle)
        ),
        ("spring", "sprung", "axis"),
        RUB,
    ),
    "saturated": Entry(None, lambda r, s, j: outside.Saturated(j, s.torque), ("spring", "links", *HARD), (0.05, 0.9)),
    "winding": Entry(None, lambda r, s, j: outside.Lagging(j, 0.3 * s.period), HARD, (0.02, 1.5)),
    "belt": Entry(
        None,
        lambda r, s, j: outside.Resonant(j, s.inertia, float(r.uniform(1.3, 2.5) * 2 * np.pi / s.period)),
        ("spring", "sprung", "axis"),
        (0.02, 2.0),
    ),
    "warming": Entry(
        None,
        lambda r, s, j: outside.Warming(j, s.torque, s.rate, float(r.uniform(0.15, 0.35) * s.seconds)),
        ("axis", "swing", "sprung"),
        (0.01, 3.0),
    ),
    "rubbing_spot": Entry(
        None,
        lambda r, s, j: outside.RubbingSpot(
            j, s.torque, float(r.uniform(0.2, 0.6) * s.angle), float(r.uniform(0.1, 0.2) * s.angle)
        ),
        HARD,
        (0.02, 2.0),
    ),
    "worn_teeth": Entry(
        None,
        lambda r, s, j: outside.WornTeeth(j, s.torque, float(r.uniform(0.3, 0.7) * s.angle), float(r.uniform(0, 1))),
        HARD,
        (0.02, 2.0),
    ),
    "diode": Entry(
        None,
        lambda r, s, j: outside.Diode(
            j, s.stiffness, float(r.uniform(0.2, 0.5) * s.angle), float(r.uniform(0.1, 0.4) * s.period)
        ),
        ("spring", "sprung"),
        (0.05, 5.0),
    ),
}
LAWS = {**ON_LIST, **OUTSIDE}
