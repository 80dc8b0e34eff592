"""Evaluations that an interrupted reproduction has left, so that no run is tested twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from ....sim.base.json_file import read_object
from ...runs.schema import Kept, validated

#: What a file of an evaluation should be, as errors say it.
EVALUATION = "what bough evaluate wrote (without the file the run is tested again)"


class KeptRow(Kept):
    """A row of ``evaluation.json``; its columns are those of a task."""

    policy: str


class KeptEvaluation(Kept):
    """What every evaluation has."""

    rows: list[KeptRow]


def kept_rows(file: Path, about: Mapping[str, object], beside: Sequence[str]) -> list[dict[str, Any]] | None:
    """Return the rows of an evaluation, None where there is none, or one of other policies or settings.

    Args:
        file: The ``evaluation.json``.
        about: How the run is to be tested, by the keys of the file.
        beside: Policies that are to be tested beside it.

    Raises:
        InputError: The file is no evaluation.
    """
    if not file.exists():
        return None
    found = read_object(file, EVALUATION)
    if {name: found.get(name) for name in about} != about:
        return None
    validated(TypeAdapter(KeptEvaluation), found, file, allowed=EVALUATION)
    rows: list[dict[str, Any]] = found["rows"]
    return rows if [row["policy"] for row in rows][1:] == [*beside] else None
