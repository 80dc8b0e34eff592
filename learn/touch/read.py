"""Reading recordings: folders of CSV files, folders of ROS bags, or both.

Columns of a CSV file, for joints 1, 2, ...; others are left alone:

    time_s; tau1_Nm, effort1_Nm or i1_A; dq1_rad_s or qd1_rad_s; and, where known, dq_cmd1_rad_s or qd_cmd1_rad_s
    (commanded), tau_expected1_Nm or i_target1_A (what the robot's own model expects), contact (1, 0, -1 unknown)

A file ``recordings.csv`` beside them may say ``file,link,direction,tolerance_s`` of each.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.files import read_text
from ...sim.base.types import Array
from ..cases.table import Table, numbers_of, read_table
from .recording import LEAST_ROWS, UNKNOWN, Recording, check_joints

INDEX = "recordings.csv"
INDEX_COLUMNS = ("file", "link", "direction", "tolerance_s")

_TORQUE = ("tau{}_Nm", "effort{}_Nm", "i{}_A")
_VELOCITY = ("dq{}_rad_s", "qd{}_rad_s")
_COMMAND = ("dq_cmd{}_rad_s", "qd_cmd{}_rad_s")
_EXPECTED = ("tau_expected{}_Nm", "i_target{}_A")
_EXAMPLE = "time_s,tau1_Nm,...,dq1_rad_s,...,dq_cmd1_rad_s,...,contact"


@dataclass(frozen=True)
class Note:
    """What an index says of a file."""

    link: str = ""
    direction: str = ""
    tolerance: float = 0.0


def read_recordings(folder: Path) -> list[Recording]:
    """Read all CSV files and bags in a folder and below it, in the order of their names.

    Raises:
        InputError: There is no such folder, nothing to read in it, or something that cannot be read; joints differ.
    """
    if not folder.is_dir():
        found = "a file" if folder.exists() else "no such folder"
        raise InputError(folder, "", found, "a folder of CSV files or ROS bags")
    files = [f for f in sorted(folder.rglob("*.csv")) if f.name != INDEX and f.parent.name != "meta"]
    bags = sorted(f for f in folder.rglob("*") if f.suffix in (".bag", ".mcap", ".db3") and f.is_file())
    if not files and not bags:
        raise InputError(folder, "", "neither CSV files nor ROS bags", f"files with columns {_EXAMPLE}, or *.bag")
    notes: dict[Path, dict[str, Note]] = {}
    out = []
    for file in files:
        known = notes.setdefault(file.parent, _read_index(file.parent / INDEX))
        out.append(read_csv(file, str(file.relative_to(folder)), known.get(file.name, Note())))
    if bags:
        from .bags import read_bags  # rosbags is an extra

        out += read_bags(folder, bags)
    check_joints(out, str(folder))
    return out


def _read_index(path: Path) -> dict[str, Note]:
    if not path.exists():
        return {}
    rows = csv.DictReader(read_text(path).splitlines())
    missing = [name for name in INDEX_COLUMNS if name not in (rows.fieldnames or [])]
    if missing:
        raise InputError(path, "line 1 (header)", f"no column {missing[0]}", ",".join(INDEX_COLUMNS))
    out = {}
    for number, row in enumerate(rows, start=2):
        try:
            tolerance = float(row["tolerance_s"])
        except (TypeError, ValueError):
            tolerance = -1.0
        if not 0.0 <= tolerance < np.inf:
            found = f"'{row['tolerance_s']}'"
            raise InputError(path, f"row {number}, column tolerance_s", found, "seconds, zero or more")
        out[row["file"]] = Note(row["link"], row["direction"], tolerance)
    return out


def read_csv(path: Path, name: str, note: Note) -> Recording:
    """Read one CSV file.

    Raises:
        InputError: A column that is needed is missing, a cell is no number, time does not increase, contact is none of
            1, 0, -1, or there are fewer than three rows.
    """
    table = read_table(path, _EXAMPLE)
    place = f"line {table.header_line} (header)"
    torque = _columns(table, _TORQUE)
    joints = len(torque)
    if not torque:
        raise InputError(path, place, "no joint torques", "columns tau1_Nm, ..., or effort1_Nm, ..., or i1_A, ...")
    velocity, command, expected = (_columns(table, forms) for forms in (_VELOCITY, _COMMAND, _EXPECTED))
    for names, what, needed in ((velocity, "speeds dq1_rad_s", True), (command, "commands dq_cmd1_rad_s", False),
                                (expected, "expected torques", False)):  # fmt: skip
        if len(names) != joints and (names or needed):
            raise InputError(path, place, f"{len(names)} {what}, ... beside {joints} torques", f"{joints} of them")
    if "time_s" not in table.header:
        raise InputError(path, place, "no column time_s", _EXAMPLE)
    if len(table.lines) < LEAST_ROWS:
        raise InputError(path, "", f"{len(table.lines)} rows", f"{LEAST_ROWS} or more")
    time = _numbers(table, ["time_s"])[:, 0]
    if not (np.diff(time) > 0).all():
        row = int(np.nonzero(np.diff(time) <= 0)[0][0]) + 1
        raise InputError(path, f"row {table.first_line + row}, column time_s", f"{time[row]:g} s after "
                         f"{time[row - 1]:g} s", "times that increase")  # fmt: skip
    executed = _numbers(table, velocity)
    return Recording(
        name, time, _numbers(table, torque), executed, _numbers(table, command) if command else executed,
        _numbers(table, expected) if expected else np.zeros_like(executed), _contact(table), note.link, note.direction,
        note.tolerance,
    )  # fmt: skip


def _columns(table: Table, forms: Sequence[str]) -> list[str]:
    """Return the columns of joints 1, 2, ... in the first form of their name that the file has."""
    for form in forms:
        pattern = re.compile(re.escape(form).replace(r"\{\}", r"(\d+)"))
        numbers = {int(m[1]) for name in table.header if (m := pattern.fullmatch(name))}
        if 1 in numbers:
            return [form.format(k) for k in range(1, len(numbers) + 1) if k in numbers]
    return []


def _numbers(table: Table, names: Sequence[str]) -> Array:
    return numbers_of(table, [table.header.index(name) for name in names], 0, len(table.lines))


def _contact(table: Table) -> np.ndarray:
    if "contact" not in table.header:
        return np.full(len(table.lines), UNKNOWN)
    values = _numbers(table, ["contact"])[:, 0]
    bad = np.nonzero(~np.isin(values, (1, 0, UNKNOWN)))[0]
    if len(bad):
        place = f"row {table.first_line + int(bad[0])}, column contact"
        raise InputError(table.path, place, f"{values[bad[0]]:g}", "1 (contact), 0 (free) or -1 (unknown)")
    return values.astype(np.int64)
