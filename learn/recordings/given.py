"""What a user says of a recording, and the texts in it that have a form of their own."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ...sim.base.errors import InputError, shortened

#: What errors name beside the flag: nothing, since several commands have it.
SOURCE = ""


@dataclass(frozen=True)
class Given:
    """What was said of measured tables; None or empty where nothing was. The fields are flags.

    Texts with units (``24mm``) are read by `units.measure`; ``rows``, ``no_contact`` and ``repeats`` by this module.
    """

    header: int | None = None
    time: str | None = None
    time_unit: str | None = None
    rate: float | None = None
    resample: float | None = None
    rows: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    force: tuple[str, ...] = ()
    torque: tuple[str, ...] = ()
    free: bool = False
    force_unit: str | None = None
    force_zero: str | None = None
    position: tuple[str, ...] = ()
    angle: tuple[str, ...] = ()
    position_unit: str | None = None
    position_zero: str | None = None
    velocity: tuple[str, ...] = ()
    velocity_unit: str | None = None
    flip: str | None = None
    at: tuple[str, ...] = ()
    pull_angle: str | None = None
    length: tuple[str, ...] = ()
    diameter: tuple[str, ...] = ()
    mass: tuple[str, ...] = ()
    density: float | None = None
    rises: tuple[str, ...] = ()
    azimuth: tuple[str, ...] = ()
    segments: int | None = None
    hangs: bool = False
    inertia: float | None = None
    no_contact: tuple[str, ...] = ()
    repeats: tuple[str, ...] = ()
    starts: tuple[float, ...] = ()
    noise: float | None = None
    base: tuple[float, ...] = ()
    name: str | None = None
    mjcf: Path | None = None
    unknown: tuple[str, ...] = ()


def rows_of(text: str) -> tuple[int, int]:
    """Return the half-open range that ``--rows A:B`` states.

    Raises:
        InputError: It is none.
    """
    match = re.fullmatch(r"(\d+):(\d+)", text)
    if match is None or int(match[1]) >= int(match[2]):
        raise InputError(SOURCE, "--rows", shortened(text), "A:B, rows of numbers from A on and before B, from 0")
    return int(match[1]), int(match[2])


def quiet_of(texts: tuple[str, ...], recording: int) -> list[list[float]]:
    """Return the intervals without contact [s] that ``--no-contact [K:]A:B`` state of a recording, counted from 1.

    Raises:
        InputError: One is no interval.
    """
    out = []
    for text in texts:
        parts = text.split(":")
        try:
            numbers = [float(p) for p in parts]
        except ValueError:
            numbers = []
        if len(numbers) not in (2, 3) or not 0 <= numbers[-2] <= numbers[-1]:
            allowed = "A:B in seconds from the start of every recording, or K:A:B of recording K alone"
            raise InputError(SOURCE, "--no-contact", shortened(text), allowed)
        if len(numbers) == 2 or numbers[0] == recording:
            out.append(numbers[-2:])
    return out


def repeats_of(texts: tuple[str, ...], count: int) -> dict[int, int]:
    """Return which recording repeats which, counted from 1, as ``--repeats K:OF`` states.

    Raises:
        InputError: One is no pair of two recordings.
    """
    out = {}
    for text in texts:
        match = re.fullmatch(r"(\d+):(\d+)", text)
        pair = (int(match[1]), int(match[2])) if match else (0, 0)
        if not (1 <= pair[0] <= count and 1 <= pair[1] <= count and pair[0] != pair[1]):
            allowed = f"K:OF, two different recordings, 1 to {count}"
            raise InputError(SOURCE, "--repeats", shortened(text), allowed)
        out[pair[0]] = pair[1]
    return out
