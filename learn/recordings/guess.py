"""What a column means, guessed from its name: quantity, axis, unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from .units import UNITS, Kind, unit_of


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


#: Words that name a quantity, in the languages of the files that were seen.
WORDS: dict[Kind, frozenset[str]] = {
    "time": _words("t time zeit timestamp stamp clock sec secs seconds elapsed temps tiempo tempo uhrzeit"),
    "force": _words("f fx fy fz force forces kraft load loadcell zugkraft zug last tension fuerza wrench fsr"),
    "torque": _words("tau torque moment drehmoment effort mx my mz"),
    "velocity": _words("v vx vy vz vel velocity speed dq qd geschwindigkeit"),
    "position": _words("x y z pos position disp displacement weg travel extension stroke deflection auslenkung "
                       "verschiebung push pull pulled distance tape tip tcp"),
    "angle": _words("angle winkel q theta phi inclination inclinometer incl tilt rotation neigung joint"),
}  # fmt: skip
#: Words of columns that describe the specimen or count the rows; they are not taken for a measurement.
_ASIDE = _words("height diameter length radius width mass id index sample trial row no number nr temp temperature "
                "target desired cmd command commanded")  # fmt: skip


@dataclass(frozen=True)
class Meaning:
    """What a column's name says.

    Attributes:
        kind: The quantity.
        axis: ``x``, ``y``, ``z``, or empty for a magnitude.
        unit: Its unit, or None where the name states none.
    """

    kind: Kind
    axis: str
    unit: str | None


def split_unit(name: str) -> tuple[list[str], list[str]]:
    """Return the words of a column's name, and texts in it that may be a unit, most certain first."""
    bracket = re.search(r"[\[(<]\s*([^\])>]+?)\s*[\])>]", name)
    rest = re.sub(r"[\[(<].*?[\])>]", " ", name)
    after = re.search(r"(?:/|\s+in\s+|,\s*)\s*(\S+)\s*$", rest) if bracket is None else None
    if after is not None:
        rest = rest[: after.start()]
    words = [w for w in re.split(r"[^A-Za-zµμ°]+", re.sub(r"(?<=[a-z])(?=[A-Z][a-z])", " ", rest)) if w]
    units = [bracket[1]] if bracket else [after[1]] if after else []
    if not units and len(words) > 1:
        units = ["/".join(words[-2:]) if words[-1] == "s" and len(words) > 2 else words[-1]]
    return words, units


def meaning(name: str) -> Meaning | None:
    """Return what a column's name says, None where it says nothing or describes the specimen."""
    words, units = split_unit(name)
    low = [w.lower() for w in words]
    if set(low) & _ASIDE:
        return None
    for kind, known in WORDS.items():
        here = [w for w in low if w in known]
        if kind == "position":  # x, y and z are axes of whatever else the name says
            here = [w for w in here if w not in "xyz"] or [w for w in here if not _others(low)]
        if not here:
            continue
        unit = next((u for u in (unit_of(text, kind) for text in units) if u), None)
        if unit is None and units and any(unit_of(units[0], other) for other in UNITS if other != kind):
            continue  # "push_N" is a force, "force_mm" is none
        return Meaning(kind, _axis(low), unit)
    return next((Meaning(kind, _axis(low), unit) for kind in WORDS for text in units if (unit := unit_of(text, kind))),
                None)  # fmt: skip


def _others(words: Sequence[str]) -> bool:
    return any(w in WORDS[kind] for w in words for kind in WORDS if kind != "position")


def _axis(words: Sequence[str]) -> str:
    """Return the axis that a name ends in: fx, force.x, x."""
    for word in reversed(words):
        if word in ("x", "y", "z"):
            return word
        if len(word) == 2 and word[1] in "xyz" and word[0] in "fvm":
            return word[1]
    return ""


def columns_like(header: Sequence[str], kind: Kind) -> list[tuple[str, ...]]:
    """Return the columns, or triples and pairs of columns for the axes, whose names say that they hold a quantity."""
    found = [(name, m) for name in header if (m := meaning(name)) and m.kind == kind]
    single = [(name,) for name, m in found if not m.axis]
    by_axis = {axis: [name for name, m in found if m.axis == axis] for axis in "xyz"}
    axes = [names for names in by_axis.values() if names]
    if len(axes) >= 2 and all(len(names) == 1 for names in axes):
        return [*single, tuple(names[0] for names in axes)]
    return [*single, *((name,) for names in axes for name in names)]
