"""``bough reproduce``: the thesis's tables and figures again, in simulation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from ..sim.console import bars, shown, start_warp
from .command_identify import NOT_CONVERGED


@dataclass(frozen=True)
class Reproduce:
    """Make tables 3.1 and A.1 and figures 3.5 to 3.9 of the thesis in simulation, beside its own figures.

    Writes report.html, tables.json and a PNG a figure. Exit code 0: done; 2: bad input, nothing written; 3: written,
    but the run of table 3.1 did not converge.

    Attributes:
        what: What to reproduce.
        out: Folder to write to.
        particles: Particles of SVGD, chains of the other samplers.
        iterations: Updates of the samplers that use gradients; the thesis takes at most 70.
        branches: Simulated branches that table 3.1 and figure 3.5 are repeated on.
        unseen: Trajectories to predict.
        seed: Seed of everything random.
    """

    what: tyro.conf.Positional[Literal["chapter3"]]
    out: Path
    particles: int = 32
    iterations: int = 70
    branches: int = 3
    unseen: int = 25
    seed: int = 0

    def run(self) -> int:
        """Reproduce the chapter, say what came out and where the report is; return the exit code."""
        start_warp()
        from .chapter3 import Options, reproduce

        options = Options(self.particles, self.iterations, self.branches, self.unseen, self.seed)
        options.check()
        with bars(options.stages) as advance:
            line, converged = reproduce(self.out, options, lambda stage: advance(stage, 1))
        print(f"{line} Open {shown(self.out)}/report.html")
        return 0 if converged else NOT_CONVERGED
