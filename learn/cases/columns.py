"""Named columns out of a trajectory's CSV file, every number checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.strict_yaml import nearest
from ...sim.base.types import Array
from .table import Table, decimals_of, numbers_of, read_table

MIN_ROWS = 3
#: Steps between values, relative to their median, that are round-off of a file's numbers.
FUZZ = 1e-4
#: Least share of samples that stay as they are, and least number of levels that they stay on, if these are a sensor's.
STAYS, LEVELS = 0.1, 8


@dataclass(frozen=True)
class Columns:
    """Some columns of a CSV file, rows cut to the range in use.

    Attributes:
        path: The file.
        names: Names of the columns read, length C.
        values: Their numbers, shape [T, C].
        first_line: Line of the first row in the file, as an editor counts.
        first_row: The first row in use, counted from 0 as ``rows`` in meta.yaml counts.
        decimals: Printed decimals of every column, the most of any row, length C.
    """

    path: Path
    names: tuple[str, ...]
    values: Array
    first_line: int
    first_row: int
    decimals: tuple[int, ...]

    def place(self, row: int, column: str) -> str:
        """Name a cell: ``row`` counts from 0 among the rows in use, the text gives the line in the file."""
        return f"row {self.first_line + row}, column {column}"


def read_columns(
    path: Path, names: tuple[str, ...], *, exact: bool, rows: tuple[int, int] | None = None, clocks: int = 1,
    optional: tuple[str, ...] = (), header: int = 1,
) -> Columns:  # fmt: skip
    """Read named columns of a CSV file with one header line; `table` says which files are read.

    Args:
        path: CSV file.
        names: Columns wanted, the clock first.
        exact: Refuse columns that are not in ``names``.
        rows: Half-open range of data rows in use, counted from 0; None takes all. Rows outside it are not looked at.
        clocks: How many of the first columns make the clock; the decimals of these alone are counted.
        optional: Columns of ``names`` that may be missing, all or none of them.
        header: Line of the header, see `read_table`.

    Raises:
        InputError: A column is missing, there twice or one too many; a row has a wrong number of cells; a cell is
            empty, not a number or not finite; ``rows`` lie outside the file; fewer than three rows.
    """
    table = read_table(path, ",".join(names), header)
    if optional and not set(optional) & set(table.header):
        names = tuple(name for name in names if name not in optional)
    _check_header(table, names, exact, clocks)
    start, stop = _check_rows(path, rows, len(table.lines))
    use = [table.header.index(name) for name in names]
    values = numbers_of(table, use, start, stop)
    decimals = tuple(max(decimals_of(table.number(table.cells(row)[i])) for row in range(start, stop))
                     for i in use[:clocks])  # fmt: skip
    return Columns(path, names, values, table.first_line + start, start, decimals)


def resolution(signals: Sequence[Array]) -> float:
    """Return what recordings [T] of one channel were rounded to: the smallest step between different values of one.

    Values that were put on another clock by lines lie between the levels of their sensor wherever it moved. Where a
    good part of the samples stays as it is, and stays on levels an even step apart, that step is taken.
    """
    gaps = [_gaps(s) for s in signals]
    fine = _smallest(gaps)
    stays = [s[1:][np.abs(np.diff(s)) <= FUZZ**2 * np.ptp(s)] for s in signals]
    levels = [_gaps(s) for s in stays]
    few = sum(map(len, stays)) < STAYS * sum(map(len, signals)) or sum(map(len, levels)) < LEVELS
    if few or _even(gaps, fine):
        return fine
    step = _smallest(levels)
    return step if _even(levels, step) else fine


def _gaps(values: Array) -> Array:
    """Return the steps between different values; last digits of one value written otherwise are none."""
    gaps = np.diff(np.unique(values))
    return gaps[gaps > FUZZ * np.median(gaps)] if len(gaps) else gaps


def _smallest(gaps: Sequence[Array]) -> float:
    return min((float(g.min()) for g in gaps if len(g)), default=0.0)


def _even(gaps: Sequence[Array], step: float) -> bool:
    """Return whether neighbouring values are whole steps apart, within a tenth of one, and half of them by ten at most.

    Only these are looked at: numbers are printed with so many digits.
    """
    steps = np.concatenate(gaps) / step if step > 0.0 else np.zeros(0)
    near = steps[steps < 10.5]
    return 2 * len(near) >= len(steps) and bool((np.abs(near - np.round(near)) < 0.1).all())


def _check_header(table: Table, names: tuple[str, ...], exact: bool, clocks: int) -> None:
    place, header = f"line {table.header_line} (header)", table.header
    listed = ",".join(names)
    for name in names:
        if header.count(name) > 1:
            raise InputError(table.path, place, f"column {name} {header.count(name)} times", "each column once")
    missing = [name for name in names if name not in header]
    extra = [name for name in header if name not in names]
    if exact and extra:
        found = f"column '{extra[0]}'" if missing or len(header) > len(names) else f"columns {','.join(header)}"
        mend = "; other names and further columns: columns and time_column in meta.yaml"
        raise InputError(table.path, place, found, f"{nearest(extra[0], missing or names)}; {listed}{mend}")
    if missing and missing[0] in names[:clocks]:
        allowed = f"a clock of this name, or time_column in meta.yaml; the file has {nearest('time', header)}"
        raise InputError(table.path, place, f"no column {missing[0]}", allowed)
    if missing:
        allowed = listed if exact else f"a column of this name; the file has {nearest(missing[0], header)}"
        raise InputError(table.path, place, f"no column {missing[0]}", allowed)


def _check_rows(path: Path, rows: tuple[int, int] | None, available: int) -> tuple[int, int]:
    start, stop = rows or (0, available)
    if not 0 <= start < stop <= available and rows is not None:
        raise InputError(path, "rows", f"[{start}, {stop}]", f"start < stop within the {available} rows of the file")
    if stop - start < MIN_ROWS:
        raise InputError(path, "", f"{stop - start} rows of numbers", f"at least {MIN_ROWS}")
    return start, stop
