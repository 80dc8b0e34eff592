"""Chapter 4 of the thesis again: figures 4.4 and B.1 to B.8 that need no robot, at any scale, beside the thesis's."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ...policies.compare import Episodes
from ...policies.mpc import require_mppi
from ...runs.folder import RunFolder
from ...runs.side_by_side import side_by_side
from ...tasks.registry import TaskRegistry
from ...touch.crossval import FOLDS
from ...touch.forest import require_sklearn
from ..common.trainings import check_runs, learn_all, minutes, runs_under, write
from . import touch
from .findings import Findings
from .runs import COMPARED, MPC, MPC_TREE, Changes, Options, Run, tested

LEARNING, TESTING, TOUCH = "learning", "testing", "figure B.7"
Advance = Callable[[str, int], None]
_Folders = dict[Run, RunFolder]
_Count = Callable[[int], None]


def stages(options: Options, registry: TaskRegistry) -> dict[str, int | None]:
    """Return the number of steps of every stage: iterations, test sets, rounds and models of touch."""
    out: dict[str, int | None] = {
        LEARNING: len(options.runs) * options.ppo(registry).iterations,
        TESTING: options.sets * sum(1 + len(options.beside(run, c)) for run in options.runs for c in run.tests),
    }
    return out | ({TOUCH: options.rounds + FOLDS * len(touch.KINDS)} if options.rounds else {})


def find(out: Path, options: Options, registry: TaskRegistry, advance: Advance = lambda stage, count: None) -> Findings:
    """Train and test every run under ``out`` that is not there yet, and the classifiers of contact.

    Raises:
        LostError: A loss left the finite; the message names the run.
    """
    found = Findings(options)
    folders = {run: RunFolder(runs_under(out) / run.name) for run in options.runs}

    def tell(_found: Findings, _folders: _Folders, _registry: TaskRegistry, count: _Count) -> None:
        """Train and test the classifiers of contact, if there are rounds of them."""
        if options.rounds:
            found.touch = touch.told(out / "touch", options.rounds, options.seed, count)

    for stage, work in ((LEARNING, _learn), (TESTING, _test), (TOUCH, tell)):
        began = time.perf_counter()
        work(found, folders, registry, lambda count, stage=stage: advance(stage, count))  # type: ignore[misc]
        found.seconds[stage] = time.perf_counter() - began
    return found


def _learn(found: Findings, folders: _Folders, registry: TaskRegistry, advance: _Count) -> None:
    o = found.options
    learn_all([(folder, o.plan(run, registry)) for run, folder in folders.items()], registry, o.jobs, advance)
    found.minutes = {run: minutes(folder) for run, folder in folders.items()}
    found.metrics = {run: folder.metrics() for run, folder in folders.items() if run.policy in COMPARED}
    found.config = folders[found.options.runs[0]].config()


def _test(found: Findings, folders: _Folders, registry: TaskRegistry, advance: _Count) -> None:
    o = found.options
    tests = [(folder, run, changes) for run, folder in folders.items() for changes in run.tests]
    came = dict(side_by_side(partial(_tested, o, registry), tests, o.jobs, advance))
    found.episodes = {(run, changes): came[run, changes]["trained"] for _, run, changes in tests}
    found.planned = {n: episodes[n] for episodes in came.values() for n in (MPC, MPC_TREE) if n in episodes}


def _tested(
    options: Options, registry: TaskRegistry, test: tuple[RunFolder, Run, Changes], advance: _Count
) -> tuple[tuple[Run, Changes], dict[str, Episodes]]:
    folder, run, changes = test
    return (run, changes), tested(folder, options, run, changes, registry, advance)


def check(out: Path, options: Options, registry: TaskRegistry, *, resume: bool) -> None:
    """Check options and folder before anything is written.

    Raises:
        InputError: They cannot be used: runs are there that are not to be gone on with, or are others; or scikit-learn,
            which figure B.7 takes, or pytorch-mppi is not installed.
    """
    options.check()
    options.ppo(registry).check()
    if options.rounds:
        require_sklearn()
    if options.mpc:
        require_mppi()
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
