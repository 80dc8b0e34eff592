"""Whether numbers can be what they are said to be: the units people mix up, and the flags that mend it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from .choose import Quantity
from .given import SOURCE
from .questions import Asker
from .shape import Shape
from .units import UNITS

#: Largest travel of a grasp point that is believed where the branch's length is not known [m].
FAR = 5.0
#: Steps of a clock that people use [s]: from 100 kHz to one in ten minutes; slower than `SLOW` is odd.
STEPS = (1e-5, 600.0)
SLOW = 5.0
#: Force that is believed, and that a hand or a robot makes [N].
FORCES = (1e5, 5e3)
#: Young's modulus of a branch taken as a clamped beam [Pa]: what is likely, and what is believed. Green wood has 2 to
#: 15 GPa; a soft joint at the base makes it look softer, a pull against the grain of the model stiffer.
LIKELY, BELIEVED = (1e8, 5e10), (2e6, 2e12)
#: Correlation of force and motion below which one of them has the other sign.
OPPOSITE = -0.3


def check_clock_unit(step: float, quantity: Quantity | None, ask: Asker) -> None:
    """Refuse or doubt a clock whose step [s] nobody samples with.

    Raises:
        InputError: The step is none of `STEPS`.
    """
    if quantity is None:
        return
    found = f"a sample every {step:.4g} s in column {quantity.columns[0]} [{quantity.unit}]"
    if step > SLOW:
        ask.warnings.append(f"{found}; milliseconds are --time-unit ms")
    if not STEPS[0] <= step <= STEPS[1]:
        raise InputError(SOURCE, "--time-unit", found, f"{STEPS[0]:g} to {STEPS[1]:g} s: {', '.join(UNITS['time'])}")


def check_motion(quantity: Quantity, values: Array, reach: float | None, ask: Asker) -> None:
    """Refuse or doubt a motion, in SI units, that its unit makes too large or too small.

    Args:
        quantity: Its columns and unit.
        values: Motion from its zero [m or rad].
        reach: Length of the branch [m] where it is known.
        ask: Who keeps warnings.

    Raises:
        InputError: The motion is larger than the branch, or than `FAR`.
    """
    most, what = float(np.abs(values).max()), f"column {quantity.columns[0]} [{quantity.unit}]"
    said = "" if quantity.stated else ", which is the unit only because none is stated"
    if quantity.kind == "angle":
        if quantity.unit == "rad" and most > 2 * np.pi:
            found = f"{most:.4g} rad in {what}, {most / (2 * np.pi):.3g} turns{said}"
            if not quantity.stated:
                raise InputError(SOURCE, quantity.flag, found, "deg for degrees, rad if it does turn so far")
            ask.warnings.append(f"{found}; degrees are --position-unit deg")
        if quantity.unit == "deg" and most < np.radians(0.1):
            ask.warnings.append(f"only {np.degrees(most):.3g} degrees in {what}; radians are --position-unit rad")
        return
    limit = FAR if reach is None else 2.0 * reach
    if most > limit:
        against = f"{FAR:g} m at most" if reach is None else f"twice the branch's length, {limit:.3g} m, at most"
        allowed = f"{against}; its unit, such as mm, and --position-zero start where it is not from rest"
        raise InputError(SOURCE, quantity.flag, f"a motion of {most:.4g} m in {what}{said}", allowed)
    if most < 2e-4:
        ask.warnings.append(
            f"the motion is only {1e3 * most:.3g} mm in {what}{said}: --position-unit says it otherwise"
        )


def check_effort(quantity: Quantity, values: Array, ask: Asker) -> None:
    """Refuse or doubt forces or torques, in SI units, that are too large, or nothing.

    Raises:
        InputError: The force is beyond what cases hold.
    """
    most, what = float(np.abs(values).max()), f"column {quantity.columns[0]} [{quantity.unit}]"
    if quantity.kind == "force" and most > FORCES[0]:
        raise InputError(
            SOURCE, quantity.flag, f"{most:.4g} N in {what}", f"{FORCES[0]:g} N at most; its unit, such as mN"
        )
    if quantity.kind == "force" and most > FORCES[1]:
        ask.warnings.append(f"{most:.4g} N in {what} is more than a person pulls: {quantity.flag} says it otherwise")
    if not quantity.stated:
        others = "kgf, lbf, kN" if quantity.kind == "force" else "Nmm, Ncm"
        ask.warnings.append(f"no unit is stated for {quantity.columns[0]}: taken as {quantity.unit}; {others} and "
                            f"others by {quantity.flag}")  # fmt: skip


def check_sign(
    effort: Sequence[Array], motion: Sequence[Array], flip: str | None, *, tables: bool = True, kind: str = "force"
) -> None:
    """Refuse an effort against the motion that it causes, unless ``--flip`` says how they are meant.

    It points the other way, and takes work out of what it moves. A drive that swings a load faster than the load would
    swing by itself does the first alone. Of tables the motion may be turned, too.

    Args:
        effort: Forces or torques of each recording, shape [T, C].
        motion: Where they go, shape [T, C].
        flip: What the user said.
        tables: Whether they are columns of tables.
        kind: ``force`` or ``torque``.

    Raises:
        InputError: They go opposite ways.
    """
    f, x = (np.concatenate([part.ravel() for part in parts]) for parts in (effort, motion))
    size = float(np.sqrt((x @ x) * (f @ f)))
    if flip is not None or size == 0.0 or float(x @ f) / size >= OPPOSITE or _work(effort, motion) > 0.0:
        return
    other = "--flip motion, " if tables else ""
    whose = "the branch's pull on the hand" if kind == "force" else "what the load does to the drive"
    allowed = f"--flip force (what is read is {whose}), {other}or --flip none to keep both"
    raise InputError(SOURCE, "--flip", f"a {kind} that points against the motion that it causes", allowed)


def _work(effort: Sequence[Array], motion: Sequence[Array]) -> float:
    """Return the work that efforts [T, C] do along motions [T, C]."""
    return sum(float((0.5 * (f[1:] + f[:-1]) * np.diff(x, axis=0)).sum()) for f, x in zip(effort, motion, strict=True))


def check_stiffness(force: Array, motion: Array, at: float, shape: Shape, ask: Asker, units: str) -> None:
    """Say which Young's modulus a pull comes to; refuse one that shows a wrong unit.

    A beam of radius r, clamped at its base and pulled at a distance a, gives way by F a^3 / (3 E I), I = pi r^4 / 4.

    Args:
        force: Force along the pull [N], shape [T].
        motion: Displacement along it [m], shape [T].
        at: Distance of the pull from the base [m].
        shape: The branch; the mean of its radii up to there counts.
        ask: Who keeps notes and warnings.
        units: Flags that state the units of force and motion.

    Raises:
        InputError: The modulus is none of `BELIEVED`.
    """
    f, x = force - force.mean(), motion - motion.mean()
    if not (x * x).sum():
        return
    stiffness = float((x * f).sum() / (x * x).sum())
    radius = float(shape.radius.mean())
    modulus = stiffness * at**3 / (3 * np.pi * radius**4 / 4)
    said = f"{stiffness:.4g} N/m at {at:g} m from the base; as a clamped beam, Young's modulus {modulus / 1e9:.3g} GPa"
    flags = f"{units}, --at, --length or --diameter (not the radius)"
    if modulus > 0 and not BELIEVED[0] <= modulus <= BELIEVED[1]:
        raise InputError(SOURCE, "", said, f"near the 2 to 15 GPa of green wood: a unit is wrong; {flags}")
    ask.notes.append(f"stiffness: {said} (green wood has 2 to 15)")
    if modulus > 0 and not LIKELY[0] <= modulus <= LIKELY[1]:
        ask.warnings.append(f"{said}, far from the 2 to 15 GPa of green wood: see to {flags}")
