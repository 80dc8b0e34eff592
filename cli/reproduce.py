"""``bough reproduce``: the thesis's tables and figures again, in simulation."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ..learn.policies.ppo_settings import Preset, preset_of
from ..learn.tasks.registry import TaskRegistry, builtin_tasks
from ..learn.tasks.task import require_rsl_rl
from ..sim.base.console import bars, shown, start_warp, warn
from .exit_codes import ExitCode


@dataclass(frozen=True)
class Chapter3:
    """Make tables 3.1 and A.1 and figures 3.5 to 3.9 of the thesis in simulation, beside the thesis's numbers.

    Writes report.html, tables.json and one PNG per figure. Exit code 0: done; 2: bad input, nothing written; 3:
    written, but the run of table 3.1 did not converge.

    Attributes:
        out: Folder to write to.
        particles: Particles of SVGD, chains of the other samplers.
        iterations: Updates of the samplers that use gradients; the thesis takes at most 70.
        branches: Simulated branches that table 3.1 and figure 3.5 are repeated on.
        unseen: Trajectories to predict.
        seed: Seed of everything random.
    """

    out: Path
    particles: int = 32
    iterations: int = 70
    branches: int = 3
    unseen: int = 25
    seed: int = 0

    def run(self) -> int:
        """Reproduce the chapter, say what came out and where the report is; return the exit code."""
        start_warp()
        from ..learn.thesis.chapter3.reproduce import Options, reproduce

        options = Options(self.particles, self.iterations, self.branches, self.unseen, self.seed)
        options.check()
        with bars(options.stages) as advance:
            line, converged = reproduce(self.out, options, lambda stage: advance(stage, 1))
        print(f"{line} Open {shown(self.out)}/report.html")
        return ExitCode.DONE if converged else ExitCode.NOT_TRUSTED


@dataclass(frozen=True)
class Chapter5:
    """Make tables 5.2 and 5.3 and figure 5.4 of the thesis at the scale given, beside the thesis's numbers.

    Trains and tests one policy after another, each in its own folder under runs, and writes report.html, tables.json
    and one PNG per figure. Exit code 0: done; 2: bad input, nothing written; 3: a loss of a run is no longer finite,
    no report.

    Attributes:
        out: Folder to write to; it must not hold such runs, unless with --resume.
        preset: Size of trees, steps and networks; the device's own if not given.
        num_envs: Worlds of every run; the preset's if not given.
        iterations: Updates of every policy, 100 on a CPU and the preset's on a GPU if not given. With --resume it may
            be more than at first.
        noise_levels: Greatest deviations d_max of the points in the runs of figure 5.4 [m]; the thesis takes 0.005 to
            0.04. Runs that table 5.2 has as well, at 0.005 and 0.02, are shared.
        sets: Test sets of table 5.2; figure 5.4 takes the first.
        worlds: Worlds per test set.
        seeds: Trainings of every policy, of one seed after another; below three nothing is said to help.
        seed: First seed of everything random.
        device: cpu, cuda or cuda:N; a GPU if there is one.
        resume: Go on with runs that were killed or are to be longer, keep those that are done, and add seeds.
    """

    out: Path
    preset: Preset | None = None
    num_envs: int | None = None
    iterations: int | None = None
    noise_levels: tuple[float, ...] = (0.005, 0.02, 0.04)
    sets: int = 3
    worlds: int = 512
    seeds: int = 3
    seed: int = 0
    device: str | None = None
    resume: bool = False

    def run(self, registry: TaskRegistry | None = None) -> int:
        """Reproduce the chapter, say what came out and where the report is; return the exit code."""
        require_rsl_rl()
        start_warp()
        registry = registry or builtin_tasks()
        from ..learn.policies.train import LostError
        from ..learn.runs.processes import Processes
        from ..learn.thesis.chapter5.reproduce import reproduce, stages
        from ..learn.thesis.chapter5.runs import Options

        device = Processes().device(self.device)
        options = Options(
            self.preset or preset_of(device), device, self.num_envs, self.iterations, self.noise_levels, self.sets,
            self.worlds, self.seeds, self.seed,
        )  # fmt: skip
        options.check()
        try:
            with bars(stages(options)) as advance:
                line = reproduce(self.out, options, registry, resume=self.resume, advance=advance)
        except LostError as error:
            warn(f"{error}; there is no report")
            return ExitCode.NOT_TRUSTED
        except KeyboardInterrupt:
            print(f"bough: interrupted; go on with the same command and --resume ({self.out})", file=sys.stderr)
            return ExitCode.INTERRUPTED
        print(f"{line} Open {shown(self.out)}/report.html")
        return ExitCode.DONE


@dataclass(frozen=True)
class Reproduce:
    """Make a chapter's tables and figures again, beside the thesis's numbers.

    Attributes:
        chapter: What to reproduce.
    """

    chapter: (
        Annotated[Chapter3, tyro.conf.subcommand("chapter3", prefix_name=False)]
        | Annotated[Chapter5, tyro.conf.subcommand("chapter5", prefix_name=False)]
    )

    def run(self) -> int:
        """Reproduce the chapter; return the exit code."""
        return self.chapter.run()
