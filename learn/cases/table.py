"""CSV files as programs write them: separators, quotes, decimal commas, comments, and lines that Excel adds.

Read are cells between commas, semicolons, tabs or blanks, as the header has them; cells in quotes; decimal commas where
cells are not separated by commas; lines before the header that begin with ``#``, and a header that does (NumPy writes
one); Excel's first line ``sep=;``. What is left to guess is refused.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.files import read_text
from ...sim.base.types import Array

#: Between the cells of lines that had quotes or blanks.
_UNIT = "\x1f"
_STATED = ";,\t|"


@dataclass(frozen=True)
class Table:
    """The lines of a CSV file.

    Attributes:
        path: The file.
        header: Names of the columns.
        header_line: Line of the header in the file, as an editor counts.
        lines: The rows below it, not yet split.
        first_line: Line of the first row in the file.
        separator: What stands between cells.
    """

    path: Path
    header: tuple[str, ...]
    header_line: int
    lines: list[str]
    first_line: int
    separator: str

    def cells(self, row: int) -> list[str]:
        """Return the cells of a row, counted from 0."""
        return [cell.strip() for cell in self.lines[row].split(self.separator)]

    def number(self, text: str) -> str:
        """Return a cell's number with a decimal point."""
        return text if self.separator == "," else text.replace(",", ".")


def read_table(path: Path, example: str, header: int = 1) -> Table:
    """Read the lines of a CSV file.

    Args:
        path: CSV file, UTF-8 or UTF-16 with a byte-order mark.
        example: The header that an empty file should have had.
        header: Line of the header, where lines that are no comments stand before it.

    Raises:
        InputError: The file cannot be read or is empty; there is no header.
    """
    lines = read_text(path).removeprefix("\ufeff").rstrip().splitlines()
    first = lines[0] if lines else ""
    stated = first[4:] if first.startswith("sep=") and first[4:] in tuple(_STATED) else ""
    at = max(1 if stated else 0, header - 1)
    while at < len(lines) and (not lines[at].strip() or lines[at].lstrip().startswith("#")):
        at += 1
    if not lines or (at == len(lines) and not lines[-1].lstrip().startswith("#")):
        raise InputError(path, "", "an empty file", f"a header line {example} and rows of numbers")
    if at == len(lines) or _numbers(lines[at], stated):
        at -= 1  # NumPy's savetxt puts a # before the header
        if at < 0 or not lines[at].lstrip().startswith("#"):
            allowed = f"a header line with the names of the columns, such as {example}"
            raise InputError(path, f"line {at + 2} (header)", "numbers", allowed)
    head = lines[at].lstrip().removeprefix("#").strip()
    separator = stated or next((s for s in (";", "\t", ",") if s in head), _UNIT)
    body = lines[at + 1 :]
    if separator == _UNIT or '"' in head or any('"' in line for line in body):
        head, *body = (_plain(line, separator) for line in [head, *body])
        separator = _UNIT
    names = tuple(cell.strip() for cell in head.split(separator))
    return Table(path, names, at + 1, body, at + 2, separator)


def _plain(line: str, separator: str) -> str:
    """Return a line with its cells, quoted or between blanks, between `_UNIT`."""
    if separator == _UNIT and '"' not in line:
        return _UNIT.join(line.split())
    try:
        cells = next(csv.reader([line], delimiter=" " if separator == _UNIT else separator), [])
    except csv.Error:  # a cell without end
        return line
    return _UNIT.join(cells)


def _numbers(line: str, stated: str) -> bool:
    """Whether a line holds a number, which no header does."""
    separator = stated or next((s for s in (";", "\t", ",") if s in line), None)
    cells = [cell.strip().strip('"') for cell in line.split(separator)]
    return any(not _problem(cell.replace(",", ".")) for cell in cells)


def numbers_of(table: Table, use: list[int], start: int, stop: int) -> Array:
    """Return the numbers of some columns in rows ``start`` to ``stop``, shape [T, C].

    Raises:
        InputError: A row has a wrong number of cells; a cell is empty, not a number or not finite; decimal commas and
            points are mixed.
    """
    lines = table.lines[start:stop]
    width = len(table.header) - 1
    values = None
    if all(line.count(table.separator) == width and line.strip() for line in lines):
        pointed = _pointed(table, use, start, stop)
        try:
            values = np.loadtxt(pointed, delimiter=table.separator, ndmin=2, comments=None, usecols=use)
        except ValueError:
            values = None
    if values is None or not np.isfinite(values).all():
        raise _bad_cell(table, use, start, stop)
    return values


def _pointed(table: Table, use: list[int], start: int, stop: int) -> list[str]:
    """Return rows with decimal points in the cells of the columns in use."""
    lines = table.lines[start:stop]
    if table.separator == "," or not any("," in line for line in lines):
        return lines
    out = []
    with_comma, with_point = "", (0, 0, "")
    for row in range(start, stop):
        cells = table.cells(row)
        for i in use:
            with_comma = with_comma or (cells[i] if "," in cells[i] else "")
            with_point = with_point if with_point[2] or "." not in cells[i] else (row, i, cells[i])
            cells[i] = table.number(cells[i])
        out.append(table.separator.join(cells))
    if with_comma and with_point[2]:
        place = f"row {table.first_line + with_point[0]}, column {table.header[with_point[1]]}"
        found = f"'{with_point[2]}' in a file that also has '{with_comma}'"
        raise InputError(table.path, place, found, "decimal points or decimal commas, and nothing between thousands")
    return out


def _bad_cell(table: Table, use: list[int], start: int, stop: int) -> InputError:
    """Find the first row that is no row of numbers."""
    width = len(table.header)
    for row in range(start, stop):
        cells, number = table.cells(row), table.first_line + row
        if len(cells) != width:
            return InputError(table.path, f"row {number}", *_wrong_width(table, row, stop))
        for i in use:
            problem = _problem(table.number(cells[i]))
            if problem:
                return InputError(table.path, f"row {number}, column {table.header[i]}",
                                  *_explained(table, i, row, use[0], start, stop))  # fmt: skip
    return InputError(table.path, "", "rows that are not numbers", "rows of numbers")


def _wrong_width(table: Table, row: int, stop: int) -> tuple[str, str]:
    """Say what is wrong with a row of too many or too few cells, and what mends it."""
    width = len(table.header)
    found = "an empty row" if not table.lines[row].strip() else f"{len(table.cells(row))} cells"
    allowed = f"{width} cells as in the header"
    if table.separator == "," and len(table.cells(row)) > width:
        allowed += " (with decimal commas: semicolons between the cells)"
    if row >= 3 and all(len(table.cells(r)) < width for r in range(row, stop)):
        found += ", and so to the end"
        allowed += f"; columns of equal length, or rows: [0, {row}] in meta.yaml, which is where all of them go on"
    return found, allowed


def _explained(table: Table, column: int, row: int, clock: int, start: int, stop: int) -> tuple[str, str]:
    """Say what is wrong with a cell that is no number, and what mends it; ``clock`` is the clock's column."""
    text = table.cells(row)[column]
    found = f"'{text}'" if text else "an empty cell"
    if not text and all(not "".join(table.cells(r)[column : column + 1]) for r in range(row, stop)):
        cut = f"rows: [{start}, {row}] in meta.yaml, which is where all of them go on"
        allowed = f"columns of equal length, or {cut}" if row - start >= 3 else "a column of numbers"
        return f"{found}, and so to the end", allowed
    if not text:
        return found, "a finite number in every row: columns that are sampled at the same times"
    if column == clock and ":" in text:
        return found, "seconds as a finite number, no date or time of day"
    if row == 0 and len(table.lines) > 1 and not _problem(table.number((table.cells(1) + [""] * column)[column])):
        return found, f"a finite number; rows: [1, {len(table.lines)}] in meta.yaml leaves out a line of units"
    return found, "a finite number"


def _problem(text: str) -> str:
    try:
        value = float(text)
    except ValueError:
        return f"'{text}'" if text else "an empty cell"
    # Python's float knows 1_000, the CSV reader does not.
    return "" if math.isfinite(value) and "_" not in text else f"'{text}'"


def decimals_of(text: str) -> int:
    """Count the decimals of a printed number; an exponent shifts them."""
    mantissa, _, exponent = text.strip().lower().partition("e")
    return len(mantissa.partition(".")[2]) - int(exponent or 0)
