"""Units as people write them, in flags (``24mm``) and in headers (``push_mm``, ``Kraft [N]``)."""

from __future__ import annotations

import re
from typing import Literal

from ...sim.base.errors import InputError, shortened

Kind = Literal["time", "force", "position", "velocity", "angle", "torque", "mass"]

_POUND = 0.45359237  # kg; a pound-force is its weight at standard gravity
_G = 9.80665  # m/s^2, standard gravity: the definition of a kilogram-force

#: SI units per unit. A hanging scale that reads kg shows a force: its weight at standard gravity.
UNITS: dict[Kind, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "force": {"N": 1.0, "mN": 1e-3, "cN": 1e-2, "kN": 1e3, "kgf": _G, "gf": 1e-3 * _G, "lbf": _POUND * _G,
              "kg": _G, "g": 1e-3 * _G, "lb": _POUND * _G},
    "position": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": 0.017453292519943295},
    "torque": {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2, "Nmm": 1e-3, "kNm": 1e3, "lbfft": _POUND * _G * 0.3048},
    "mass": {"kg": 1.0, "g": 1e-3, "lb": _POUND},
}  # fmt: skip

#: Other spellings, as lower case without blanks, dots and carets.
_ALIASES = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "sek": "s", "sekunden": "s", "msec": "ms", "millis": "ms",
    "milliseconds": "ms", "usec": "us", "µs": "us", "μs": "us", "micros": "us", "nsec": "ns", "nanosec": "ns",
    "nanos": "ns", "nanoseconds": "ns", "minutes": "min", "newton": "N", "newtons": "N", "kp": "kgf", "lbs": "lb",
    "kilogram": "kg", "grams": "g", "gram": "g", "pounds": "lb", "metre": "m", "meter": "m", "metres": "m",
    "meters": "m", "millimeter": "mm", "millimetre": "mm", "centimeter": "cm", "centimetre": "cm", "µm": "um",
    "μm": "um", "inch": "in", "inches": "in", "feet": "ft", "mps": "m/s", "ms-1": "m/s", "mmps": "mm/s",
    "cmps": "cm/s", "°": "deg", "degree": "deg", "degrees": "deg", "grad": "deg", "radian": "rad", "radians": "rad",
    "n*m": "Nm", "ncm": "Ncm", "nmm": "Nmm", "mnm": "mNm", "knm": "kNm", "newtonmeter": "Nm", "lbf*ft": "lbfft",
    "ftlbf": "lbfft",
}  # fmt: skip
_NUMBER = re.compile(r"\s*([-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?)\s*(\S*)\s*")


def unit_of(text: str, kind: Kind) -> str | None:
    """Return a kind's unit in its one spelling, None where the text is no unit of it."""
    units = UNITS[kind]
    plain = re.sub(r"[\s.^·⋅]", "", text)
    for name in (plain, _ALIASES.get(plain.lower(), ""), plain.lower(), plain.capitalize()):
        if name in units:
            return name
    return next((u for u in units if u.lower() == plain.lower()), None)


def checked_unit(text: str, kind: Kind, source: str, flag: str) -> str:
    """Return a kind's unit that a flag states.

    Raises:
        InputError: It is none of them.
    """
    unit = unit_of(text, kind)
    if unit is None:
        raise InputError(source, flag, shortened(text), ", ".join(UNITS[kind]))
    return unit


def measure(text: str, kind: Kind, source: str, flag: str) -> float:
    """Return a number with its unit (``24mm``) in SI units; a bare number is in the SI unit, an angle in degrees.

    Raises:
        InputError: It is no number, or its unit is none of the kind's.
    """
    units = UNITS[kind]
    bare = "deg" if kind == "angle" else next(iter(units))
    match = _NUMBER.fullmatch(text)
    unit = unit_of(match[2] or bare, kind) if match else None
    if match is None or unit is None:
        example = {"position": "1.2 or 24mm", "mass": "0.35 or 350g", "angle": "30 or 0.5rad"}.get(kind, f"2.5{bare}")
        raise InputError(source, flag, shortened(text), f"a number in {bare}, or with its unit: {example}")
    return float(match[1].replace(",", ".")) * units[unit]
