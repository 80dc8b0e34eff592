"""``bough identify``: learn the springs of a measured branch, or the unknowns of measured joints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from ..sim.console import bars, shown, start_warp, warn


@dataclass(frozen=True)
class Identify:
    """Learn a case's springs and dampers with intervals; write posterior.npz, report.json, figures and report.html.

    Attributes:
        case: Case folder: meta.yaml and one CSV a trajectory.
        out: Folder to write to.
        particles: Samples of the posterior.
        iterations: Steps of Stein variational gradient descent.
        seed: Seed of everything random.
    """

    case: tyro.conf.Positional[Path]
    out: Path
    particles: int = 64
    iterations: int = 60
    seed: int = 0

    def run(self) -> int:
        """Identify the case, say what came out and where the report is; return 0."""
        start_warp()
        from .identify import Settings, headline, identify

        settings = Settings(particles=self.particles, iterations=self.iterations, seed=self.seed)
        stages = {"finding modes": None, "moving particles": self.iterations, "predicting": 1}
        says = dict(zip(("modes", "particles", "prediction"), stages, strict=True))
        with bars(stages) as advance:
            outcome = identify(self.case, self.out, settings, lambda stage, done: advance(says[stage], done))
        for line in outcome.case.warnings:
            warn(line)
        print(f"{headline(outcome)[0]} Open {shown(self.out)}/report.html")
        return 0
