"""Chapter 3 of the thesis again, in simulation: tables 3.1 and A.1, figures 3.5 to 3.9, beside the thesis's figures."""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from .. import __version__
from ..sim.errors import InputError
from ..sim.files import output_folder
from ..sim.host import describe
from . import chapter3_baselines as baselines
from . import chapter3_cost as cost
from . import chapter3_prior as prior
from . import chapter3_robust as robust
from .chapter3_bench import Bench, Scores
from .threads import one_thread

REFERENCE = 2000
"""Iterations of the outside sampler that stands for the posterior."""
LEAST_UPDATES = 10
"""Updates without which a sampler is not judged."""
MARKS = (35, 70, 140)
"""Iterations at which SVGD as the thesis runs it is scored."""
PUBLISHED_ETAS = (prior.ETA, 100.0, 1000.0)

Advance = Callable[[str], None]


@dataclass(frozen=True)
class Options:
    """Size of a reproduction; see `command_reproduce.Reproduce`."""

    particles: int = 32
    iterations: int = 70
    branches: int = 3
    unseen: int = 25
    seed: int = 0

    def check(self) -> None:
        """Raise `InputError` for numbers that cannot be."""
        limits = {
            "particles": (12, math.inf), "iterations": (LEAST_UPDATES, prior.MOST_ITERATIONS),
            "branches": (1, math.inf), "unseen": (3, math.inf), "seed": (0, math.inf),
        }  # fmt: skip
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not low <= value <= high:
                allowed = f"{low} or more" if math.isinf(high) else f"{low} to {high}, as in the thesis"
                raise InputError("reproduce", f"--{name}", str(value), allowed)

    @property
    def marks(self) -> tuple[int, ...]:
        """Iterations at which SVGD as the thesis runs it is scored."""
        return tuple(round(m * self.iterations / prior.MOST_ITERATIONS) for m in MARKS)

    def shares(self, branch: int) -> tuple[float, ...]:
        """Shares of the budget that samplers are compared at: a curve on the first branch, the full budget on all."""
        enough = tuple(s for s in baselines.SHARES if s * self.iterations >= LEAST_UPDATES)
        return enough if branch == 0 else (1.0,)

    @property
    def stages(self) -> dict[str, int | None]:
        """Number of steps of every stage."""
        methods = len(baselines.GRADIENT) + len(baselines.WALKS) + 1
        compared = sum(1 + methods * len(self.shares(b)) for b in range(self.branches))
        sweep = 2 * len(prior.TEMPERATURES) * self.branches + len(prior.ETAS)
        return {
            "table 3.1, figure 3.6": sweep + len(MARKS) * (1 + len(PUBLISHED_ETAS)),
            "figure 3.5": compared,
            "figures 3.7 to 3.9": len(robust.NOISES) + len(robust.TESTED_AT) + len(robust.STAND_INS),
            "cost": len(cost.TIMES) + len(cost.TRAJECTORIES) + len(cost.SEGMENTS),
        }


@dataclass
class Findings:
    """Everything the report is made of.

    Attributes:
        options: Size of the reproduction.
        benches: The simulated branches.
        pairs: Runs of every branch at every temperature without and with the inequality prior.
        etas: The first branch with other sharpnesses of the prior.
        published: SVGD as the thesis runs it on the first branch, by eta (None: without the prior), at every mark.
        entries: Samplers at equal calls.
        references: What stands for the posterior of every branch.
        noise, grasp, stand_ins: Studies of figures 3.7, 3.8 and 3.9.
        costs: Of an iteration, by what grows.
        seconds: Wall time of every stage.
    """

    options: Options
    benches: list[Bench]
    pairs: list[prior.Pair] = field(default_factory=list)
    etas: list[prior.Pair] = field(default_factory=list)
    published: dict[float | None, list[Scores]] = field(default_factory=dict)
    entries: list[baselines.Entry] = field(default_factory=list)
    references: list[baselines.Reference] = field(default_factory=list)
    noise: list[robust.Study] = field(default_factory=list)
    grasp: list[robust.Study] = field(default_factory=list)
    stand_ins: list[robust.Study] = field(default_factory=list)
    costs: dict[str, list[cost.Cost]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    def at(self, kt: float) -> list[prior.Pair]:
        """Return the pairs of all branches at a temperature."""
        return [p for p in self.pairs if p.kt == kt]


def find(folder: Path, options: Options, advance: Advance = lambda stage: None) -> Findings:
    """Run every experiment; cases are written under ``folder``."""
    o = options
    found = Findings(o, [Bench(folder / f"branch_{b}", o.seed + b, unseen=o.unseen) for b in range(o.branches)])
    experiments = dict(zip(o.stages, (_priors, _samplers, _robust, _costs), strict=True))
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
    for eta in (None, *PUBLISHED_ETAS):
        found.published[eta] = prior.published_svgd(
            first, eta, particles=o.particles, marks=o.marks, seed=o.seed, advance=advance
        )


def _samplers(found: Findings, folder: Path, advance: prior.Advance) -> None:
    o = found.options
    length = max(20, REFERENCE * o.iterations // prior.MOST_ITERATIONS)
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
    from .chapter3_report import content, tables
    from .report import write_report

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
