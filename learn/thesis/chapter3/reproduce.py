"""Chapter 3 of the thesis again, in simulation: tables 3.1 and A.1, figures 3.5 to 3.9, beside the thesis's figures."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from ....sim.base.files import output_folder
from ....sim.base.host import describe
from ....version import __version__
from ...runs.threads import one_thread
from . import baselines, cost, literal, prior, robust
from .bench import Bench
from .findings import REFERENCE, Findings, Options

Advance = Callable[[str], None]


def find(folder: Path, options: Options, advance: Advance = lambda stage: None) -> Findings:
    """Run every experiment; cases are written under ``folder``."""
    o = options
    found = Findings(o, [Bench(folder / f"branch_{b}", o.seed + b, unseen=o.unseen) for b in range(o.branches)])
    experiments = dict(zip(o.stages, (_priors, _literal, _samplers, _robust, _costs), strict=True))
    for stage, experiment in experiments.items():
        began = time.perf_counter()
        experiment(found, folder, lambda stage=stage: advance(stage))  # type: ignore[misc]
        found.seconds[stage] = time.perf_counter() - began
    return found


def _priors(found: Findings, folder: Path, advance: prior.Advance) -> None:
    o, first = found.options, found.benches[0]
    found.pairs = prior.temperature_sweep(
        found.benches, prior.TEMPERATURES, particles=o.particles, iterations=o.iterations, seed=o.seed, advance=advance
    )
    pair = found.at(prior.ETA_KT)[0]
    found.etas = prior.eta_sweep(
        pair, first, particles=o.particles, iterations=o.iterations, seed=o.seed, advance=advance
    )


def _literal(found: Findings, folder: Path, advance: prior.Advance) -> None:
    o = found.options
    found.letter = literal.table_3_1(
        folder, found.benches, literal.SEEDS, particles=o.particles, marks=o.marks, unseen=o.unseen, seed=o.seed,
        advance=advance,
    )  # fmt: skip
    studies = literal.Studies(folder, o.unseen, o.scale, o.particles, o.seed)
    for name, study in (("figure_3_7", lambda: studies.noise(robust.NOISES)), ("figure_3_8", studies.grasp),
                        ("figure_3_9", studies.stand_ins)):  # fmt: skip
        found.letter_studies[name] = study()
        advance()


def _samplers(found: Findings, folder: Path, advance: prior.Advance) -> None:
    o = found.options
    length = max(20, round(REFERENCE * o.scale))
    for b, bench in enumerate(found.benches):
        entries, reference = baselines.compare(
            bench, b, o.shares(b), particles=o.particles, iterations=o.iterations, reference=length, seed=o.seed,
            advance=advance,
        )  # fmt: skip
        found.entries += entries
        found.references.append(reference)


def _robust(found: Findings, folder: Path, advance: prior.Advance) -> None:
    o = found.options
    size = {"particles": o.particles, "iterations": o.iterations, "seed": o.seed}
    found.noise = robust.noise_study(folder, robust.NOISES, o.unseen, **size, advance=advance)
    found.grasp = robust.grasp_study(folder, o.unseen, **size, advance=advance)
    found.stand_ins = robust.stand_ins(folder, **size, advance=advance)


def _costs(found: Findings, folder: Path, advance: prior.Advance) -> None:
    o = found.options
    found.costs = cost.measure_costs(folder, found.benches[0], particles=o.particles, seed=o.seed, advance=advance)


def reproduce(out: str | Path, options: Options, advance: Advance = lambda stage: None) -> tuple[str, bool]:
    """Reproduce the chapter into ``out``; return the headline and whether the run of table 3.1 converged.

    Raises:
        InputError: The options or the folder cannot be used; nothing is written then.
    """
    from ...reports.page import write_report
    from .report import content, tables

    options.check()
    began = time.perf_counter()
    with output_folder(out) as work, tempfile.TemporaryDirectory() as scratch, one_thread():
        found = find(Path(scratch), options, advance)
        found.seconds["in all"] = time.perf_counter() - began
        page = content(found)
        kept = {"version": __version__, "machine": describe(), "options": vars(options), "seconds": found.seconds,
                "tables": {name: vars(table) for name, table in tables(found).items()}}  # fmt: skip
        (work / "tables.json").write_text(json.dumps(kept, indent=2) + "\n")
        write_report(work, page)
    first = found.pairs[0]
    return page.headline, first.without.convergence.converged and first.with_prior.convergence.converged
