"""Measured tables on one uniform clock, and what a refusal of the case reader means in flags."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.files import read_text
from ...sim.base.types import Array
from ..cases.clock import Clock, Timed, check_clock, resampled, timed
from ..cases.columns import Columns, read_columns
from ..cases.table import Table, read_table
from .choose import Chosen
from .given import SOURCE, Given, rows_of
from .questions import Asker
from .units import UNITS, unit_of

#: Lines among which a header is looked for.
_PREAMBLE = 200
EXAMPLE = "time_s,force_N,position_mm"


@dataclass(frozen=True)
class Part:
    """Rows of a file that are one recording.

    Attributes:
        path: The file.
        rows: Half-open range of rows of numbers, None for all.
        header: Line of the file's header.
    """

    path: Path
    rows: tuple[int, int] | None
    header: int

    @property
    def label(self) -> str:
        """The file's name, with its rows where they are cut."""
        return self.path.name if self.rows is None else f"{self.path.name} rows {self.rows[0]}:{self.rows[1]}"


def tables_of(files: Sequence[Path], given: Given, ask: Asker) -> list[Table]:
    """Read files; above the header there may be lines of a testing machine.

    The header is the first line that has as many cells as the last line of the file, unless ``--header`` says another.

    Raises:
        InputError: A file cannot be read, or has no such line.
    """
    out = []
    for path in files:
        lines = read_text(path).rstrip().splitlines()
        number = given.header or _header_line(lines)
        if not 1 <= number <= max(1, len(lines)):
            raise InputError(path, "--header", f"line {number}", f"1 to {len(lines)}, the lines of the file")
        if number > 1 and given.header is None:
            ask.notes.append(f"header: line {number} of {path.name} (--header)")
        out.append(read_table(path, EXAMPLE, number))
    return out


def _header_line(lines: Sequence[str]) -> int:
    """Return the line of the header: 1 where the first line has as many cells as the last, or begins a comment."""
    if not lines or lines[0].lstrip("\ufeff ").startswith(("#", "sep=")):
        return 1
    separator = next((s for s in (";", "\t", ",") if s in lines[-1]), None)
    if separator is None:
        return 1
    counts = [len(next(csv.reader([line], delimiter=separator), [])) for line in [*lines[:_PREAMBLE], lines[-1]]]
    return counts.index(counts[-1]) + 1 if counts[-1] in counts[:-1] else 1


def units_row(table: Table) -> dict[str, str]:
    """Return what a line of units below the header says, by column; empty where the first row holds numbers."""
    cells = table.cells(0) if table.lines else []
    if len(cells) != len(table.header) or any(_is_number(table.number(cell)) for cell in cells):
        return {}
    bare = [cell.strip("[]()<> ") for cell in cells]
    known = [any(unit_of(text, kind) for kind in UNITS) for text in bare if text]
    return dict(zip(table.header, bare, strict=True)) if known and any(known) else {}


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def parts_of(tables: Sequence[Table], given: Given) -> list[Part]:
    """Return the recordings in files: each whole, or the rows that ``--rows`` and ``--only`` leave.

    Raises:
        InputError: The flags do not fit the files.
    """
    ranges = [rows_of(text) for text in given.rows]
    if ranges and len(tables) > 1 and len(ranges) not in (1, len(tables)):
        raise InputError(SOURCE, "--rows", f"{len(ranges)} ranges for {len(tables)} files", "one, or one for each file")
    if ranges and given.only:
        raise InputError(SOURCE, "--only", "--rows as well", "one of them")
    if len(tables) == 1 and ranges:
        return [Part(tables[0].path, r, tables[0].header_line) for r in ranges]
    chosen = [ranges[i] if len(ranges) > 1 else ranges[0] if ranges else None for i in range(len(tables))]
    return [Part(t.path, r or _only(t, given.only) or _below_units(t), t.header_line)
            for t, r in zip(tables, chosen, strict=True)]  # fmt: skip


def _below_units(table: Table) -> tuple[int, int] | None:
    return (1, len(table.lines)) if units_row(table) else None


def _only(table: Table, conditions: tuple[str, ...]) -> tuple[int, int] | None:
    """Return the rows in which columns have the texts that ``--only`` states."""
    if not conditions:
        return None
    keep = np.ones(len(table.lines), dtype=bool)
    for text in conditions:
        name, equals, value = text.partition("=")
        if not equals or name not in table.header:
            raise InputError(SOURCE, "--only", repr(text), f"COLUMN=TEXT, a column of {', '.join(table.header)}")
        at = table.header.index(name)
        keep &= [table.cells(row)[at : at + 1] == [value] for row in range(len(table.lines))]
    rows = np.flatnonzero(keep)
    if not len(rows):
        raise InputError(table.path, "--only", f"no row with {' and '.join(conditions)}", "a text that the column has")
    if rows[-1] - rows[0] + 1 != len(rows):
        found = f"rows {rows[0]} to {rows[-1]} with others between them"
        raise InputError(table.path, "--only", found, "rows one after the other, or their ranges as --rows")
    return int(rows[0]), int(rows[-1]) + 1


def read_parts(parts: Sequence[Part], chosen: Chosen, given: Given, ask: Asker) -> tuple[list[Timed], float]:
    """Read recordings onto one uniform clock that starts at zero; return them and the clock's step [s].

    A clock with jitter is put on a grid by linear interpolation, and a note says so.

    Raises:
        InputError: As `read_columns`, `timed`, `check_clock` and `resampled`, with flags in the place of keys.
    """
    with in_flags():
        read = [_read(part, chosen, given) for part in parts]
    steps = [_step(r) for r in read] if given.resample is None else [None]
    known = [s for s in steps if s is not None]
    uniform = len(known) == len(read)
    if uniform and max(abs(s - known[0]) * len(r.t) for s, r in zip(known, read, strict=True)) < 0.5 * known[0]:
        return read, known[0]
    rate = given.resample or _rate(max(float(np.median(np.diff(r.t))) for r in read))
    with in_flags():
        out = [resampled(r, rate) for r in read]
    spread = np.concatenate([np.diff(r.t) for r in read])
    ask.notes.append(f"clock: steps of {spread.min():.4g} to {spread.max():.4g} s were put on a grid of {rate:g} Hz by "
                     "linear interpolation (--resample)")  # fmt: skip
    return out, 1.0 / rate


def _step(read: Timed) -> float | None:
    """Return the step of a uniform clock [s], None where it is not."""
    try:
        return check_clock(read)
    except InputError:
        return None


def _rate(step: float) -> float:
    rate = 1.0 / step
    return float(round(rate)) if rate >= 2.0 else rate


def _read(part: Part, chosen: Chosen, given: Given) -> Timed:
    names, clock = chosen.columns, chosen.clock
    if clock is None:
        columns = read_columns(part.path, names, exact=False, rows=part.rows, clocks=0, header=part.header)
        return _steady(columns, float(given.rate or 1.0))
    columns = read_columns(part.path, (*clock.columns, *names), exact=False, rows=part.rows, header=part.header)
    read = timed(columns, Clock(clock.columns, clock.scale if clock.stated else None))
    return replace(read, t=read.t - read.t[0])


def _steady(columns: Columns, rate: float) -> Timed:
    t = np.arange(len(columns.values)) / rate
    return Timed(columns, t, columns.values, 1e-9 / rate, moved=True)


def column(read: Timed, name: str) -> Array:
    """Return the numbers of a column, shape [T]."""
    out: Array = read.values[:, read.others.index(name)]
    return out


_KEYS: tuple[tuple[str, Callable[[re.Match[str]], str]], ...] = (
    (r"rows: \[(\d+), (\d+)\](?: in meta\.yaml| of this trajectory there)?", lambda m: f"--rows {m[1]}:{m[2]}"),
    (r"resample_hz: (\S+) in meta\.yaml", lambda m: f"--resample {m[1]}"),
    (r"the unit in meta\.yaml: time_scale: (\S+?)(?=$|[;,])", lambda m: f"--time-unit {_unit_at(float(m[1]))}"),
    (r"time_scale: 1(?= if)", lambda m: "--time-unit s"),
    (r"no date or time of day", lambda m: "no date or time of day; or --rate HZ in place of a clock"),
)  # fmt: skip


def _unit_at(scale: float) -> str:
    return next(name for name, value in UNITS["time"].items() if abs(value - scale) < 1e-3 * scale)


@contextmanager
def in_flags() -> Iterator[None]:
    """Say in flags what the reader of cases says in keys of meta.yaml."""
    try:
        yield
    except InputError as error:
        allowed = error.allowed
        for pattern, flag in _KEYS:
            allowed = re.sub(pattern, flag, allowed)
        raise InputError(error.source, error.place, error.found, allowed) from None


def check_rate(given: Given) -> None:
    """Refuse rates that are none.

    Raises:
        InputError: A rate is zero, negative or beyond a megahertz.
    """
    for flag, rate in (("--rate", given.rate), ("--resample", given.resample)):
        if rate is not None and not 0 < rate <= 1e6:
            raise InputError(SOURCE, flag, f"{rate:g}", "samples a second, above 0, at most 1e6")
