"""Writing a case folder from arrays: meta.yaml, a CSV file for each recording, assumptions.txt; whole or not at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...sim.base.errors import InputError
from ...sim.base.files import output_folder
from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase, load_case

ASSUMPTIONS = "assumptions.txt"
#: Between recordings whose start is not known [s].
APART = 10.0


@dataclass(frozen=True)
class Content:
    """What a case folder will hold.

    Attributes:
        meta: Of ``meta.yaml``.
        tables: Header and rows [T, C] of every recording, in the order of ``meta["trajectories"]``.
        copied: Files that go into the folder as they are.
    """

    meta: dict[str, Any]
    tables: list[tuple[Sequence[str], Array]]
    copied: tuple[Path, ...] = ()


def write_case(out: Path, content: Content, notes: Sequence[str], head: str) -> BranchCase | JointCase:
    """Write a case folder, read it back as `load_case` does, and return it.

    Numbers have twelve digits. ``head`` is the first line of `ASSUMPTIONS`, where ``notes`` follow.

    Raises:
        InputError: ``out`` cannot be written, or what was measured makes no case.
    """
    with output_folder(out) as work:
        for item, (header, rows) in zip(content.meta["trajectories"], content.tables, strict=True):
            np.savetxt(work / item["file"], rows, fmt="%.12g", delimiter=",", header=",".join(header), comments="")
        for path in content.copied:
            (work / path.name).write_bytes(path.read_bytes())
        text = yaml.safe_dump(content.meta, sort_keys=False, allow_unicode=True)
        (work / "meta.yaml").write_text(text, encoding="utf-8")
        (work / ASSUMPTIONS).write_text("\n".join([head, *(f"- {n}" for n in notes)]) + "\n", encoding="utf-8")
        try:
            load_case(work)
        except InputError as error:  # it names a folder that is gone by now
            source = error.source.replace(str(work), str(out))
            raise InputError(source, error.place, error.found, error.allowed) from None
    return load_case(out)


def rate_of(step: float) -> float:
    """Return the sampling rate [Hz] of a step [s], a whole number where it is one but for rounding."""
    rate = 1.0 / step
    return float(round(rate)) if abs(rate - round(rate)) < 1e-6 * rate else rate


def starts_of(stated: Sequence[float], lengths: Sequence[float]) -> list[float]:
    """Return when recordings start [s]: as stated, or one after the other with a pause.

    Raises:
        InputError: There is not one start for each recording.
    """
    if stated and len(stated) != len(lengths):
        raise InputError("", "--starts", f"{len(stated)} starts for {len(lengths)} recordings", "one for each")
    if stated:
        return [float(s) for s in stated]
    return [float(s) for s in np.concatenate([[0.0], np.cumsum([length + APART for length in lengths])])[:-1]]
