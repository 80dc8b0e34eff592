"""Chapter 5 of the thesis again: tables 5.2 and 5.3 and figure 5.4, at any scale, beside the thesis's figures."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ...policies.evaluate import Row
from ...runs.folder import RunFolder
from ...runs.side_by_side import side_by_side
from ...tasks.registry import TaskRegistry
from ..common.trainings import check_runs, learn_all, minutes, runs_under, write
from . import embedding
from .findings import Findings
from .runs import TABLE_5_2, Options, Run, outcome

LEARNING, TESTING, EMBEDDING = "learning", "testing", "table 5.3"
Advance = Callable[[str, int], None]


def stages(options: Options) -> dict[str, int | None]:
    """Return the number of steps of every stage: iterations, test sets, measurements."""
    tests = sum(sets * (1 + len(options.policies(run))) for run, sets in options.runs.items())
    return {
        LEARNING: len(options.runs) * options.ppo.iterations,
        TESTING: tests,
        EMBEDDING: 2 * len(embedding.WORLDS),
    }


def find(out: Path, options: Options, registry: TaskRegistry, advance: Advance = lambda stage, count: None) -> Findings:
    """Train and test every run under ``out`` that is not there yet, and measure the embeddings.

    Raises:
        LostError: A loss left the finite; the message names the run.
    """
    found = Findings(options)
    folders = {run: RunFolder(runs_under(out) / run.name) for run in options.runs}
    for stage, work in ((LEARNING, _learn), (TESTING, _test), (EMBEDDING, _measure)):
        began = time.perf_counter()
        work(found, folders, registry, lambda count, stage=stage: advance(stage, count))  # type: ignore[misc]
        found.seconds[stage] = time.perf_counter() - began
    return found


_Folders = dict[Run, RunFolder]


def _learn(found: Findings, folders: _Folders, registry: TaskRegistry, advance: Callable[[int], None]) -> None:
    o = found.options
    learn_all([(folder, o.plan(run, registry)) for run, folder in folders.items()], registry, o.jobs, advance)
    found.minutes = {run: minutes(folder) for run, folder in folders.items()}
    found.metrics = {row.run: folders[row.run].metrics() for row in TABLE_5_2}
    found.config = folders[TABLE_5_2[-1].run].config()


def _test(found: Findings, folders: _Folders, registry: TaskRegistry, advance: Callable[[int], None]) -> None:
    o = found.options
    tests = [(folder, run) for run, folder in folders.items()]
    came = dict(side_by_side(partial(_tested, o, registry), tests, o.jobs, advance))
    found.rows = {run: came[run] for run in folders}


def _tested(
    options: Options, registry: TaskRegistry, item: tuple[RunFolder, Run], advance: Callable[[int], None]
) -> tuple[Run, dict[str, Row]]:
    folder, run = item
    return run, outcome(folder, options, run, registry, advance)


def _measure(found: Findings, folders: _Folders, registry: TaskRegistry, advance: Callable[[int], None]) -> None:
    plan = found.options.plan(TABLE_5_2[-1].run, registry)
    found.times = embedding.measure(
        plan.task, plan.settings, registry, seed=plan.seed, device=plan.device, advance=lambda: advance(1)
    )


def check(out: Path, options: Options, registry: TaskRegistry, *, resume: bool) -> None:
    """Check options and folder before anything is written.

    Raises:
        InputError: They cannot be used: runs are there that are not to be gone on with, or are others.
    """
    options.check()
    check_runs(out, {run.name: options.plan(run, registry) for run in options.runs}, registry, resume=resume)


def reproduce(
    out: Path, options: Options, registry: TaskRegistry, *, resume: bool = False,
    advance: Advance = lambda stage, count: None,
) -> str:  # fmt: skip
    """Reproduce the chapter into ``out``; return the headline.

    Args:
        out: Folder to write to; the training runs are in its folder ``runs`` and stay whatever happens.
        options: Size of the reproduction.
        registry: Where the task is found.
        resume: Whether runs that are there are gone on with, or taken as they are if they are done.
        advance: Called with the stage and the steps done since the last call.

    Raises:
        InputError: The options or the folder cannot be used; nothing is written then.
        LostError: A loss left the finite in a run.
    """
    from .report import content, tables

    check(out, options, registry, resume=resume)
    found = find(out, options, registry, advance)
    page = content(found)
    write(out, page, tables(found), options, found.seconds)
    return page.headline
