"""The training runs of a chapter: checked, trained side by side, told about in tables and a page."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ....sim.base.errors import InputError
from ....sim.base.files import output_folder
from ....sim.base.host import describe
from ....version import __version__
from ...policies import train_report
from ...policies.train import LostError, Plan, plan_of, train, warn_of_differences
from ...reports.page import ReportContent, ReportTable, write_report
from ...runs.folder import RunFolder
from ...runs.side_by_side import side_by_side
from ...tasks.registry import TaskRegistry

Advance = Callable[[int], None]


def runs_under(out: Path) -> Path:
    """Return the folder of all runs."""
    return out / "runs"


def check_runs(out: Path, plans: Mapping[str, Plan], registry: TaskRegistry, *, resume: bool) -> None:
    """Check that runs of these names and plans may be made in a folder, or gone on with.

    Raises:
        InputError: They may not: ``out`` is a file, or runs are there that are not to be gone on with, or are others.
    """
    if out.exists() and not out.is_dir():
        raise InputError(out, "--out", "a file", "a folder, or a path where one can be made")
    folders = {name: RunFolder(runs_under(out) / name) for name in plans}
    there = {name: folder for name, folder in folders.items() if folder.exists}
    if there and not resume:
        raise InputError(out, "--out", f"{len(there)} runs", "--resume to go on with them, or another folder")
    for name, folder in there.items():
        check_kept(folder, plans[name], registry)


def check_kept(folder: RunFolder, plan: Plan, registry: TaskRegistry) -> None:
    """Check that a run that is there is the one wanted, or a shorter one that can go on.

    Raises:
        InputError: It is another.
    """
    kept = plan_of(folder, registry)
    if kept.ppo.iterations > plan.ppo.iterations:
        allowed = f"{kept.ppo.iterations} or more, or another --out"
        raise InputError(folder.path, "--iterations", str(plan.ppo.iterations), allowed)
    ppo = replace(plan.ppo, iterations=kept.ppo.iterations)
    if kept != replace(plan, ppo=ppo, device=kept.device):
        raise InputError(folder.path, "", "a run with other options", "the options it was begun with, or another --out")
    warn_of_differences(folder, plan)


def learn(folder: RunFolder, plan: Plan, registry: TaskRegistry, advance: Advance) -> None:
    """Train a run, go on with it, or leave it as it is if it is done.

    Raises:
        LostError: A loss is no longer finite; the newest checkpoint is from before.
    """
    newest = folder.newest()
    if newest is not None and newest.number >= plan.ppo.iterations:
        advance(plan.ppo.iterations)
    else:
        train(plan, folder.path, registry, resume=True, progress=advance)
        train_report.write(folder)


def learn_all(runs: Sequence[tuple[RunFolder, Plan]], registry: TaskRegistry, jobs: int, advance: Advance) -> None:
    """Train runs, `jobs` at a time, go on with them, or leave them as they are.

    Raises:
        LostError: A loss left the finite; the message names the run.
    """
    deque(side_by_side(partial(_learnt, registry), runs, jobs, advance), maxlen=0)


def _learnt(registry: TaskRegistry, run: tuple[RunFolder, Plan], advance: Advance) -> None:
    folder, plan = run
    try:
        learn(folder, plan, registry, advance)
    except LostError as error:
        raise LostError(f"{folder.path.name}: {error}") from None


def minutes(folder: RunFolder) -> float:
    """Return the time that a run spent in its iterations [min]; building the worlds comes on top."""
    rows = folder.metrics()
    return sum((row["collect_seconds"] or 0.0) + (row["learn_seconds"] or 0.0) for row in rows) / 60.0


def write(
    out: Path, page: ReportContent, tables: Mapping[str, ReportTable], options: Any, seconds: Mapping[str, float]
) -> None:
    """Write a chapter's page and its tables, with options, seconds of every stage and machine, into a folder."""
    kept = {"version": __version__, "machine": describe(), "options": vars(options), "seconds": seconds,
            "tables": {name: vars(table) for name, table in tables.items()}}  # fmt: skip
    with output_folder(out) as work:
        (work / "tables.json").write_text(json.dumps(kept, indent=2, allow_nan=False) + "\n")
        write_report(work, page)
