"""The folder of a probing: every file whole or absent, so that what is there says how far it has come.

    settings.json       what was asked for; --resume must ask for the same
    branch.yaml         the branch's structure
    zero.json           where the grasp point is at rest, how stiff a gentle pull found the branch, how gentle pulls are
    plan_K.json         pull K: which one, why, and its courses
    pull_K_J.csv        recording J of it, every tick; *.cut-N.csv is one that was cut short
    case/               all whole recordings, as `bough diagnose` reads them
    round_K.json        what was found after pull K
    diagnosis/          the diagnosis with posterior and report, once it is settled or spent
    result.json         how it ended

A file is written beside its place, synced and renamed. A kill at any point loses nothing that is there, and the next
step is the first whose file is missing.
"""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, FiniteFloat, TypeAdapter

from ...sim.base.errors import InputError
from ...sim.base.json_file import read_object
from ...sim.base.types import Array
from ..cases.case import BRANCH_COLUMNS, BranchCase
from ..recordings.folder import Content, write_case
from ..runs.schema import Count, Kept, validated
from .hand import Ways
from .raw import samples_of
from .rounds import Finding
from .structure import Structure


class Zero(Kept):
    """What ``zero.json`` says of the branch at rest."""

    rest_m: Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
    stiffness_scale: Annotated[FiniteFloat, Field(gt=0)]
    share: Annotated[FiniteFloat, Field(gt=0, le=1)] = 1.0


class Plan(Kept):
    """What ``plan_K.json`` says of a pull."""

    pull: str
    words: str
    recordings: Count
    why: str


class Folder:
    """The files of one probing.

    Attributes:
        path: Where.
    """

    def __init__(self, path: Path) -> None:
        """Take a folder; nothing is written yet."""
        self.path = path

    def begin(self, asked: dict[str, Any], resume: bool) -> None:
        """Begin, or go on with what was begun and asked for in the same way.

        Raises:
            InputError: Something is there without ``resume``, or it was asked for otherwise.
        """
        there = self._read("settings.json")
        if there is None:
            if self.path.is_dir() and any(self.path.iterdir()):
                allowed = "a new or empty one: no recording is overwritten"
                raise InputError(self.path, "--out", "a folder with files", allowed)
            self.path.mkdir(parents=True, exist_ok=True)
            self._write("settings.json", asked)
        elif not resume:
            raise InputError(self.path, "--out", "a probing", "--resume to go on with it, or another folder")
        elif there != json.loads(json.dumps(asked)):
            other = sorted(key for key in asked if there.get(key) != json.loads(json.dumps(asked[key])))
            raise InputError(self.path, "--resume", f"another {', '.join(other)}", "what it was begun with")

    @property
    def zero(self) -> dict[str, Any] | None:
        """Rest place of the grasp point, scale of the springs and share of the force, None where not known yet."""
        return self._read("zero.json", TypeAdapter(Zero))

    @zero.setter
    def zero(self, value: dict[str, Any]) -> None:
        """Keep them."""
        self._write("zero.json", value)

    def plan(self, number: int) -> dict[str, Any] | None:
        """Return the plan of a pull, None where there is none."""
        return self._read(f"plan_{number}.json", TypeAdapter(Plan))

    def set_plan(self, number: int, plan: dict[str, Any]) -> None:
        """Write the plan of a pull."""
        self._write(f"plan_{number}.json", plan)

    def recording(self, number: int, part: int) -> Path:
        """Return the file of a recording of a pull."""
        return self.path / f"pull_{number}_{part}.csv"

    def findings(self) -> list[Finding]:
        """Return what all rounds found so far, in order."""
        out: list[Finding] = []
        for number in range(1, 1000):
            if self.plan(number) is None:
                break
            found = self.finding(number)
            if found is not None:
                out.append(found)
        return out

    def finding(self, number: int) -> Finding | None:
        """Return what a round found, None where it has not been."""
        name = f"round_{number}.json"
        found = self._read(name)
        return None if found is None else Finding.of_json(found, self.path / name)

    def set_finding(self, number: int, finding: Finding) -> None:
        """Write what a round found."""
        self._write(f"round_{number}.json", finding.as_json())

    def set_result(self, result: dict[str, Any]) -> None:
        """Write how it ended."""
        self._write("result.json", result)

    def make_case(self, structure: Structure, ways: Ways, pulls: int) -> BranchCase:
        """Write the case of all whole recordings of so many pulls, and return it as loaded."""
        zero = self.zero
        assert zero is not None
        rows: list[Array] = []
        items: list[dict[str, Any]] = []
        for number in range(1, pulls + 1):
            plan = self.plan(number)
            assert plan is not None
            for part in range(1, plan["recordings"] + 1):
                table, quiet, begin = samples_of(
                    self.recording(number, part), np.array(zero["rest_m"]), ways.rate, ways.samples
                )
                items.append({"file": f"traj_{len(items) + 1:02d}.csv", "profile": plan["pull"],
                              "t_start_s": begin, "replicate_of": None, "no_contact": quiet})  # fmt: skip
                rows.append(table)
        return self._case(structure, ways, rows, _later(items, ways))

    def _case(self, structure: Structure, ways: Ways, rows: list[Array], items: list[dict[str, Any]]) -> BranchCase:
        meta = structure.meta | {
            "name": structure.branch.name, "sample_rate_hz": ways.rate, "n_samples": ways.samples,
            "trajectories": items,
        }  # fmt: skip
        content = Content(meta, [(BRANCH_COLUMNS[:7], r) for r in rows])
        notes = ["force: that of the hand on the branch, as its sensor or the joint torques tell it",
                 "motion: of the tag at the grasp point, or of the hand while it holds",
                 "samples: linear between the ticks"]  # fmt: skip
        case = write_case(self.path / "case", content, notes, "What bough probe assumed:")
        assert isinstance(case, BranchCase)
        return case

    def _read(self, name: str, needs: TypeAdapter[Any] | None = None) -> dict[str, Any] | None:
        """Return the fields of a file, None where there is none; raise `InputError` for what it lacks of ``needs``."""
        file, allowed = self.path / name, "what bough probe wrote"
        if not file.exists():
            return None
        found = read_object(file, allowed)
        if needs is not None:
            validated(needs, found, file, allowed=allowed)
        return found

    def _write(self, name: str, content: dict[str, Any]) -> None:
        """Write a file whole: beside its place, synced, renamed."""
        handle, fresh = tempfile.mkstemp(prefix=f".{name}-", dir=self.path)
        os.fchmod(handle, 0o644)  # as all other files of a result
        with os.fdopen(handle, "w") as file:
            file.write(json.dumps(content, indent=1))
            file.flush()
            os.fsync(file.fileno())
        os.replace(fresh, self.path / name)


def _later(items: list[dict[str, Any]], ways: Ways) -> list[dict[str, Any]]:
    """Put recordings one after the other where the service's clock began anew in between."""
    end = -np.inf
    for item in items:
        if item["t_start_s"] < end:
            item["t_start_s"] = end + 20.0
        end = item["t_start_s"] + ways.duration
    return items
