"""Numbers out of a trajectory's CSV file, every one of them checked, and its clock."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.files import read_text
from ...sim.base.host import check_memory
from ...sim.base.strict_yaml import nearest
from ...sim.base.types import Array

MIN_ROWS = 3


@dataclass(frozen=True)
class Columns:
    """Some columns of a CSV file, rows cut to the range in use.

    Attributes:
        path: The file.
        names: Names of the columns read, length C.
        values: Their numbers, shape [T, C].
        first_line: Line of the first row in the file, as an editor counts.
        decimals: Printed decimals of the first column (the clock).
    """

    path: Path
    names: tuple[str, ...]
    values: Array
    first_line: int
    decimals: int

    def place(self, row: int, column: str) -> str:
        """Name a cell: ``row`` counts from 0 among the rows in use, the text gives the line in the file."""
        return f"row {self.first_line + row}, column {column}"


def read_columns(path: Path, names: tuple[str, ...], *, exact: bool, rows: tuple[int, int] | None = None) -> Columns:
    """Read named columns of a comma-separated file with one header line.

    Args:
        path: CSV file, UTF-8.
        names: Columns wanted, the clock first.
        exact: Refuse columns that are not in ``names``.
        rows: Half-open range of data rows in use, counted from 0; None takes all. Rows outside it are not looked at.

    Raises:
        InputError: A column is missing, there twice or one too many; a row has a wrong number of cells; a cell is
            empty, not a number or not finite; ``rows`` lie outside the file; fewer than three rows.
    """
    lines = read_text(path).removeprefix("\ufeff").rstrip().splitlines()
    if not lines:
        raise InputError(path, "", "an empty file", f"a header line {','.join(names)} and rows of numbers")
    header = [cell.strip() for cell in lines[0].split(",")]
    _check_header(path, header, names, exact)
    start, stop = _check_rows(path, rows, len(lines) - 1)
    body, first_line = lines[1 + start : 1 + stop], 2 + start
    use = [header.index(name) for name in names]
    try:
        plain = all(line.count(",") == len(header) - 1 and line.strip() for line in body)
        values = np.loadtxt(body, delimiter=",", usecols=use, ndmin=2, comments=None) if plain else None
    except ValueError:
        values = None
    if values is None or not np.isfinite(values).all():
        raise _bad_cell(path, body, header, use, first_line)
    decimals = max(_decimals(line.split(",")[use[0]]) for line in body)
    return Columns(path, names, values, first_line, decimals)


def check_clock(columns: Columns, sample_rate: float | None = None) -> float:
    """Return the time step [s] of a uniform clock.

    A printed time is rounded: two of them may differ from the true step by one unit in their last decimal. A clock
    printed so coarsely that this exceeds a fifth of the step cannot show a lost sample and is refused as well.

    Args:
        columns: Columns with the clock first [s].
        sample_rate: Stated rate [Hz] that the clock must have, if known.

    Raises:
        InputError: Time stands still or runs backwards, a step differs from the others, or all differ from the rate.
    """
    t, name = columns.values[:, 0], columns.names[0]
    steps = _increasing(columns)
    typical, mean = float(np.median(steps)), float(t[-1] - t[0]) / (len(t) - 1)
    slack = min(1.01 * 10.0**-columns.decimals, 0.2 * typical) + 1e-3 * typical + 4 * np.spacing(np.abs(t).max())
    step = mean if abs(mean - typical) <= slack else typical
    wrong = np.abs(steps - step) > slack
    if wrong.any():
        i = int(np.argmax(wrong))
        found = f"a step of {steps[i]:.9g} s"
        remedy = "" if sample_rate else ", or resample_hz in meta.yaml"
        allowed = f"{typical:.9g} s as elsewhere (uniform sampling, times with enough decimals){remedy}"
        raise InputError(columns.path, columns.place(i + 1, name), found, allowed)
    if sample_rate is not None and abs((t[-1] - t[0]) * sample_rate - (len(t) - 1)) > slack * sample_rate:
        found = f"a sample every {mean:.9g} s ({1 / mean:.6g} Hz)"
        raise InputError(columns.path, f"column {name}", found, f"sample_rate_hz of meta.yaml, {sample_rate:.6g} Hz")
    return mean


#: A step this many times as long as the usual one is a gap, not jitter.
GAP = 4.0


def resampled(columns: Columns, rate: float) -> Columns:
    """Return columns whose clock has jitter on a uniform grid from the first time on, linear between the samples.

    Args:
        columns: Columns with the clock first [s].
        rate: Samples a second of the grid [Hz].

    Raises:
        InputError: Time stands still or runs backwards; a step is `GAP` times the usual one or longer; the grid has
            fewer than `MIN_ROWS` samples, or more than fit into memory.
    """
    t, name = columns.values[:, 0], columns.names[0]
    steps = _increasing(columns)
    typical = float(np.median(steps))
    if steps.max() >= GAP * typical:
        i = int(np.argmax(steps))
        allowed = f"less than {GAP:g} steps of {typical:.9g} s between neighbours, cut by rows otherwise"
        raise InputError(columns.path, columns.place(i + 1, name), f"a step of {steps[i]:.9g} s", allowed)
    samples = (t[-1] - t[0]) * rate
    # the grid, a column more at a time, and the arrays that a trajectory is made of
    needed = 8.0 * samples * (3 * len(columns.names) + 1)
    check_memory(str(columns.path), f"{samples:.3g} samples at resample_hz {rate:g}", needed)
    count = int(np.floor(samples * (1 + 1e-12))) + 1
    if count < MIN_ROWS:
        raise InputError(columns.path, "", f"{count} samples at resample_hz {rate:g}", f"at least {MIN_ROWS}")
    grid = t[0] + np.arange(count) / rate
    return replace(columns, values=np.stack([np.interp(grid, t, c) for c in columns.values.T], axis=-1), decimals=12)


def _increasing(columns: Columns) -> Array:
    """Return the steps of the clock [s], all above zero."""
    t = columns.values[:, 0]
    steps: Array = np.diff(t)
    if (steps <= 0).any():
        i = int(np.argmax(steps <= 0))
        found = f"time {t[i + 1]:.9g} s after {t[i]:.9g} s"
        place = columns.place(i + 1, columns.names[0])
        raise InputError(columns.path, place, found, "times that increase from row to row")
    return steps


def _check_header(path: Path, header: list[str], names: tuple[str, ...], exact: bool) -> None:
    place = "line 1 (header)"
    listed = ",".join(names)
    for name in names:
        if header.count(name) > 1:
            raise InputError(path, place, f"column {name} {header.count(name)} times", "each column once")
    missing = [name for name in names if name not in header]
    extra = [name for name in header if name not in names]
    if exact and extra:
        found = f"column '{extra[0]}'" if missing or len(header) > len(names) else f"columns {','.join(header)}"
        raise InputError(path, place, found, f"{nearest(extra[0], missing or names)}; comma-separated {listed}")
    if missing:
        allowed = listed if exact else f"a column of this name; the file has {nearest(missing[0], header)}"
        raise InputError(path, place, f"no column {missing[0]}", allowed)


def _check_rows(path: Path, rows: tuple[int, int] | None, available: int) -> tuple[int, int]:
    start, stop = rows or (0, available)
    if not 0 <= start < stop <= available and rows is not None:
        raise InputError(path, "rows", f"[{start}, {stop}]", f"start < stop within the {available} rows of the file")
    if stop - start < MIN_ROWS:
        raise InputError(path, "", f"{stop - start} rows of numbers", f"at least {MIN_ROWS}")
    return start, stop


def _bad_cell(path: Path, body: list[str], header: list[str], use: list[int], first_line: int) -> InputError:
    """Find the first row that is no row of numbers."""
    for number, line in enumerate(body, start=first_line):
        cells = line.split(",")
        if len(cells) != len(header):
            found = "an empty row" if not line.strip() else f"{len(cells)} cells"
            return InputError(path, f"row {number}", found, f"{len(header)} cells as in the header")
        for i in use:
            problem = _cell_problem(cells[i].strip())
            if problem:
                return InputError(path, f"row {number}, column {header[i]}", problem, "a finite number")
    return InputError(path, "", "rows that are not numbers", "rows of numbers")


def _cell_problem(text: str) -> str:
    try:
        value = float(text)
    except ValueError:
        return f"'{text}'" if text else "an empty cell"
    # Python's float knows 1_000, the CSV reader does not.
    return "" if math.isfinite(value) and "_" not in text else f"'{text}'"


def _decimals(text: str) -> int:
    """Count the decimals of a printed number; an exponent shifts them."""
    mantissa, _, exponent = text.strip().lower().partition("e")
    return len(mantissa.partition(".")[2]) - int(exponent or 0)
