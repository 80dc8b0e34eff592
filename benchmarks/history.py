"""What was measured, a file a run: `history/DATE_MACHINE_DEVICE.json`, never changed once it is there."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bough.sim.base.errors import InputError
from bough.sim.base.files import read_text
from bough.sim.base.strict_yaml import Strict
from measuring import MEASURED, Figure, Result
from pydantic import Field, ValidationError, model_validator

FOLDER = Path(__file__).resolve().parent / "history"


class Machine(Strict):
    """Where it was measured; None is what a page did not say."""

    cpu: str
    cores: int | None = Field(ge=1)
    lanes: int | None = Field(ge=1)
    gpu: str | None
    system: str | None


class Run(Strict):
    """One file: a run of one benchmark or several.

    Attributes:
        source: `measuring.MEASURED`, or from which page at which commit the figures were transcribed.
        date: Day, or day and minute of the start (UTC).
        machine: Where.
        versions: By name; of a transcribed run those that the page states.
        commit: Of bough; None where there was no git, or the page does not say.
        dirty: Whether the code differed from that commit.
        results: By name of the benchmark.
    """

    source: str = Field(pattern=rf"^({MEASURED}|transcribed from \S+ at commit [0-9a-f]{{7,40}})$")
    date: str = Field(pattern=r"^\d{4}-\d\d-\d\d(T\d\d:\d\dZ)?$")
    machine: Machine
    versions: dict[str, str]
    commit: str | None
    dirty: bool | None
    results: dict[str, Result] = Field(min_length=1)

    @model_validator(mode="after")
    def _whole(self) -> Run:
        here = self.machine
        if self.source == MEASURED and (
            None in (here.cores, here.lanes, here.system) or not {"python", "bough", "warp"} <= set(self.versions)
        ):
            raise ValueError("a measured run states cores, lanes, system and versions")
        return self


@dataclass(frozen=True)
class Last:
    """The newest result of one benchmark, and the run that it is from."""

    run: Run
    result: Result

    def get(self, case: str, what: str) -> Figure:
        """Return a figure; raises KeyError where there is none."""
        return {(f.case, f.what): f for f in self.result.figures}[case, what]

    def cases(self, what: str) -> list[str]:
        """List the cases that have a figure of a quantity, in the order they were measured in."""
        return [f.case for f in self.result.figures if f.what == what]


def read(path: Path) -> Run:
    """Read one file.

    Raises:
        InputError: It is missing, or not such a file.
    """
    try:
        return Run.model_validate_json(read_text(path))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(path, place, repr(first["input"])[:80], first["msg"]) from None


def runs(folder: Path = FOLDER) -> list[Run]:
    """Read all files, oldest first."""
    found = [(read(p), p.name) for p in sorted(folder.glob("*.json"))]
    return [run for run, _ in sorted(found, key=lambda pair: (pair[0].date, pair[1]))]


def last(name: str, every: Sequence[Run]) -> Last | None:
    """Return the newest result of a benchmark, None where it was never run."""
    found = [Last(run, run.results[name]) for run in every if name in run.results]
    return found[-1] if found else None


def new_path(date: str, machine: Machine, device: str, folder: Path = FOLDER) -> Path:
    """Name a file that is not there yet, by date, machine and device."""
    words = re.sub(r"\(r\)|\(tm\)|processor|cpu|@.*", " ", machine.cpu.lower())
    avx = "-avx512" if machine.lanes == 16 and "avx" not in words else ""
    stem = f"{date[:10]}_{'-'.join(re.findall(r'[a-z0-9]+', words))}{avx}_{device}"
    names = (f"{stem}{'' if k == 1 else f'-{k}'}.json" for k in range(1, 1000))
    return next(folder / name for name in names if not (folder / name).exists())
