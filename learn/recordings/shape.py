"""A branch's segments from what a tape measure, a caliper and a scale say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from .given import SOURCE, Given
from .questions import Asker, Question
from .units import measure

#: Density of living wood with its water [kg/m^3], where neither mass nor density is known: between 600 and 1200.
GREEN_WOOD = 900.0
#: Densities believed, and those that are likely [kg/m^3]: dry twigs; leaves and fruit hang on the wood.
DENSITIES, LIKELY = (50.0, 2500.0), (300.0, 1500.0)
NAMES = ("trunk", "limb", "branch", "twig")


@dataclass(frozen=True)
class Shape:
    """R straight, tapered segments, base first.

    Attributes:
        length: Lengths [m], shape [R].
        radius: Radii at both ends [m], shape [R, 2].
        mass: Masses [kg], shape [R].
        density: Density of the wood [kg/m^3].
        elevation: Angles above the horizontal plane [degrees], shape [R].
        azimuth: Angles about z from x [degrees], shape [R].
    """

    length: Array
    radius: Array
    mass: Array
    density: float
    elevation: Array
    azimuth: Array

    def segments(self) -> list[dict[str, Any]]:
        """Return the ``segments`` of a ``meta.yaml``."""
        count = len(self.length)
        names = NAMES[-count:] if count <= 4 else [f"segment{i + 1}" for i in range(count)]
        rows = zip(names, self.length, self.radius, self.elevation, self.azimuth, self.mass, strict=True)
        return [{"name": n, "length_m": float(le), "radius_base_m": float(r[0]), "radius_tip_m": float(r[1]),
                 "elevation_deg": float(e), "azimuth_deg": float(a), "mass_kg": float(m)}
                for n, le, r, e, a, m in rows]  # fmt: skip

    def place(self, at: float) -> tuple[str, float]:
        """Return the segment at a distance from the base along the branch [m], and the distance from its lower end.

        Raises:
            InputError: The branch is shorter.
        """
        ends = np.cumsum(self.length)
        if not 0.0 < at <= ends[-1] * (1 + 1e-9):
            raise InputError(
                SOURCE, "--at", f"{at:g} m on a branch of {ends[-1]:g} m", "a place on it, from its base on"
            )
        i = min(int(np.searchsorted(ends, at * (1 - 1e-12))), len(ends) - 1)
        low = float(ends[i] - self.length[i])
        return str(self.segments()[i]["name"]), min(at - low, float(self.length[i]))

    def inertia(self) -> float:
        """Return the inertia of a branch of one segment about its base [kg m^2]: a solid cone cut off, as a thin rod.

        The integral of density pi r(x)^2 x^2 over its length; r^2 / 4 across is left out.
        """
        x = (np.arange(1000) + 0.5) / 1000
        area = (self.radius[0, 0] + (self.radius[0, 1] - self.radius[0, 0]) * x) ** 2
        return float(self.mass[0] * self.length[0] ** 2 * (area * x * x).sum() / area.sum())


def shape_of(given: Given, ask: Asker) -> Shape:
    """Return the branch as measured.

    Raises:
        InputError: Length, diameter or direction is missing or has the wrong number of values; a density comes out that
            no wood has.
    """
    length = _lengths(given, ask)
    radius = _radii(given, ask, length)
    volume = np.pi * length * (radius[:, 0] ** 2 + radius[:, 0] * radius[:, 1] + radius[:, 1] ** 2) / 3
    mass, density = _masses(given, ask, volume)
    elevation = _angles(given.rises, len(length), ask, "--rises", "How many degrees does the branch rise above the "
                        "horizontal (negative: it hangs)?")  # fmt: skip
    azimuth = _angles(given.azimuth or ("0",), len(length), ask, "--azimuth", "")
    if (np.abs(elevation) > 90).any():
        raise InputError(SOURCE, "--rises", f"{np.abs(elevation).max():g} degrees", "-90 (hangs) to 90 (upright)")
    if 0 < np.abs(elevation).max() < 1.6:
        ask.warnings.append(f"--rises {np.abs(elevation).max():g} degrees is nearly level; radians are written 0.9rad")
    return Shape(length, radius, mass, density, elevation, azimuth)


def _values(texts: tuple[str, ...], ask: Asker, flag: str, text: str, allowed: str) -> Array:
    def parse(line: str) -> tuple[str, ...]:
        """Split an answer into lengths with units; raise `InputError` where one is none."""
        parts = tuple(line.split())
        for part in parts or ("",):
            measure(part, "position", SOURCE, flag)
        return parts

    found = f"no {flag.removeprefix('--')} of the branch"
    texts = texts or ask(Question(flag, text, found, allowed), parse)
    values = np.array([measure(t, "position", SOURCE, flag) for t in texts])
    if (values <= 0).any():
        raise InputError(SOURCE, flag, f"{values.min():g} m", allowed)
    return values


def _lengths(given: Given, ask: Asker) -> Array:
    allowed = "the whole length, or one for each segment, base first, such as 1.2 or 120cm"
    values = _values(given.length, ask, "--length", "How long is the branch?", allowed)
    count = given.segments or len(values)
    if count < 1 or len(values) not in (1, count):
        raise InputError(SOURCE, "--length", f"{len(values)} values for {count} segments", allowed)
    if values.max() > 30:
        raise InputError(SOURCE, "--length", f"{values.max():g} m", "30 m or less; with its unit: 120cm")
    return values if len(values) == count else np.full(count, values[0] / count)


def _radii(given: Given, ask: Asker, length: Array) -> Array:
    """Return the radii of both ends of the segments [m], shape [R, 2]."""
    count = len(length)
    allowed = "one; two, at base and tip; one for each end of the segments, base first; such as 24mm 15mm"
    values = _values(given.diameter, ask, "--diameter", "How thick is the branch (diameter at base and tip)?", allowed)
    if values.max() >= 0.5 * length.sum():
        raise InputError(SOURCE, "--diameter", f"{values.max():g} m on {length.sum():g} m of length",
                         "less than half the length; with its unit: 24mm")  # fmt: skip
    if values.max() > 1.0 or values.max() < 5e-4:
        raise InputError(SOURCE, "--diameter", f"{values.max():g} m", "0.5 mm to 1 m; with its unit: 24mm")
    r = values / 2
    if len(r) == 2 * count:
        return r.reshape(count, 2)
    if len(r) <= 2:
        ends = r[0] + (r[-1] - r[0]) * np.concatenate([[0.0], np.cumsum(length)]) / length.sum()
    elif len(r) == count + 1:
        ends = r
    else:
        raise InputError(SOURCE, "--diameter", f"{len(r)} values for {count} segments", allowed)
    return np.stack([ends[:-1], ends[1:]], axis=-1)


def _masses(given: Given, ask: Asker, volume: Array) -> tuple[Array, float]:
    """Return masses [kg] and density [kg/m^3], of which one follows from the other."""
    count = len(volume)
    if not given.mass:
        density = GREEN_WOOD if given.density is None else given.density
        if given.density is None:
            ask.notes.append(f"mass: {1e3 * density * volume.sum():.4g} g, of green wood of {density:g} kg/m^3 (--mass "
                             "or --density)")  # fmt: skip
        _check_density(density, ask, "--density", "")
        return density * volume, density
    values = np.array([measure(t, "mass", SOURCE, "--mass") for t in given.mass])
    if len(values) not in (1, count) or (values <= 0).any():
        raise InputError(SOURCE, "--mass", ", ".join(given.mass), f"the whole mass, or {count}: one for each segment")
    mass = values if len(values) == count else values[0] * volume / volume.sum()
    density = float(mass.sum() / volume.sum())
    what = f" from a mass of {mass.sum():g} kg and a volume of {1e6 * volume.sum():.4g} cm^3"
    _check_density(density, ask, "--mass", what)
    return mass, density if given.density is None else given.density


def _check_density(density: float, ask: Asker, flag: str, what: str) -> None:
    low, high = DENSITIES
    found = f"a density of {density:.4g} kg/m^3{what}"
    if not low <= density <= high:
        allowed = (
            f"{low:g} to {high:g} kg/m^3; mass with its unit: 350g; --diameter (not the radius) and --length as well"
        )
        raise InputError(SOURCE, flag, found, allowed)
    if not LIKELY[0] <= density <= LIKELY[1]:
        ask.warnings.append(f"{flag}: {found}; wood with its water has 600 to 1200")


def _angles(texts: tuple[str, ...], count: int, ask: Asker, flag: str, text: str) -> Array:
    """Return one angle for each segment [degrees]."""
    allowed = f"degrees, one for the whole branch or {count}, one for each segment"
    question = Question(flag, text, "no direction of the branch", f"{allowed}: 0 is level, 90 upright, -90 hangs")

    def parse(line: str) -> tuple[str, ...]:
        """Split an answer into angles with units; raise `InputError` where one is none."""
        parts = tuple(line.split()) or ("",)
        for part in parts:
            measure(part, "angle", SOURCE, flag)
        return parts

    texts = texts or ask(question, parse)
    values = np.array([_degrees(t, flag) for t in texts])
    if len(values) not in (1, count):
        raise InputError(SOURCE, flag, f"{len(values)} values", allowed)
    return values if len(values) == count else np.full(count, values[0])


def _degrees(text: str, flag: str) -> float:
    try:
        return float(text)  # as it stands: through radians it would lose its last digit
    except ValueError:
        return float(np.degrees(measure(text, "angle", SOURCE, flag)))
