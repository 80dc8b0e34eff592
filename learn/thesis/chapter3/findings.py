"""How large a reproduction of chapter 3 is, and everything that it finds."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ....sim.base.errors import InputError
from . import baselines, cost, literal, prior, robust
from .bench import Bench, Scores

REFERENCE = 6000
"""Most iterations of the outside sampler that stands for the posterior."""
LEAST_UPDATES = 10
"""Updates without which a sampler is not judged."""


@dataclass(frozen=True)
class Options:
    """Size of a reproduction; see `cli.reproduce.Reproduce`."""

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
        """Iterations at which SVGD by the letter is scored."""
        return tuple(round(m * self.scale) for m in literal.MARKS)

    @property
    def scale(self) -> float:
        """Iterations over the most that the thesis takes."""
        return self.iterations / prior.MOST_ITERATIONS

    def shares(self, branch: int) -> tuple[float, ...]:
        """Shares of the budget that samplers are compared at: a curve on the first branch, the full budget on all."""
        enough = tuple(s for s in baselines.SHARES if s * self.iterations >= LEAST_UPDATES)
        return enough if branch == 0 else (1.0,)

    @property
    def stages(self) -> dict[str, int | None]:
        """Number of steps of every stage."""
        methods = len(baselines.GRADIENT) + len(baselines.WALKS) + 1
        starts = len(baselines.ORIGINS)
        compared = sum(1 + starts * methods * len(self.shares(b)) for b in range(self.branches))
        sweep = 2 * len(prior.TEMPERATURES) * self.branches + len(prior.ETAS)
        return {
            "table 3.1, figure 3.6": sweep,
            "SVGD by the letter": literal.SEEDS * len(literal.BOX_SIGMAS) * (1 + len(literal.ETAS)) + 3,
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
        letter: SVGD by the letter, by its box and eta (None: without the prior), by branch, at every mark.
        letter_studies: Figures 3.7, 3.8 and 3.9 by the letter.
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
    letter: dict[literal.Variant, list[list[Scores]]] = field(default_factory=dict)
    letter_studies: dict[str, list[literal.LiteralStudy]] = field(default_factory=dict)
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
