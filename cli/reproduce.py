"""``bough reproduce``: the thesis's tables and figures again, in simulation."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ..learn.tasks.ppo_settings import Preset, preset_of
from ..learn.tasks.registry import TaskRegistry, known_tasks
from ..learn.tasks.task import require_rsl_rl
from ..sim.base.console import bars, shown, start_warp, tell, warn
from .base.exit_codes import ExitCode


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
        json: Print tables.json as JSON instead of a sentence.
    """

    out: Path
    particles: int = 32
    iterations: int = 70
    branches: int = 3
    unseen: int = 25
    seed: int = 0
    json: bool = False

    def run(self) -> int:
        """Reproduce the chapter, say what came out and where the report is; return the exit code."""
        start_warp()
        from ..learn.thesis.chapter3.reproduce import Options, reproduce

        options = Options(self.particles, self.iterations, self.branches, self.unseen, self.seed)
        options.check()
        with bars(options.stages) as advance:
            line, converged = reproduce(self.out, options, lambda stage: advance(stage, 1))
        tell(f"{line} Open {shown(self.out)}/report.html", self.out / "tables.json", self.json)
        return ExitCode.DONE if converged else ExitCode.NOT_TRUSTED


@dataclass(frozen=True)
class Chapter4:
    """Make figures 4.4 and B.1 to B.8 of the thesis that need no robot, beside the figures of thesis and author.

    Trains and tests one policy after another, each in its own folder under runs, and writes report.html, tables.json
    and one PNG per figure; the page says which claims follow. Exit code 0: done; 2: bad input, nothing written; 3: a
    loss of a run is no longer finite, no report.

    Attributes:
        out: Folder to write to; it must not hold such runs, unless with --resume.
        preset: Size of the runs and of their steps; the device's own if not given.
        num_envs: Worlds of every run; the preset's if not given.
        iterations: Updates of every policy, 150 on a CPU and the preset's on a GPU if not given. With --resume it may
            be more than at first.
        sets: Test sets.
        worlds: Worlds per test set: 60 targets in five occlusion patterns.
        seeds: Trainings of PPO, CPO, PCAP and the policies past the thesis, of one seed after another; below three no
            claim is said to follow.
        ablation_seeds: Trainings of policies with raw torques, among other trees, with other springs.
        seed: First seed of everything random.
        rounds: Rounds of simulated motions for figure B.7; 0 leaves it out.
        mpc: Test sampling MPC without the tree, too, which counts to the oracle, and MPC that knows it.
        jobs: Policies that are trained and tested at the same time, each in a process of its own; on a CPU as many as
            there are cores, but at most 4, and one on a GPU, if not given. Results do not depend on it.
        device: cpu, cuda or cuda:N; a GPU if there is one.
        resume: Go on with runs that were killed or are to be longer, keep those that are done, and add seeds.
        json: Print tables.json as JSON instead of a sentence.
    """

    out: Path
    preset: Preset | None = None
    num_envs: int | None = None
    iterations: int | None = None
    sets: int = 1
    worlds: int = 300
    seeds: int = 3
    ablation_seeds: int = 1
    seed: int = 0
    rounds: int = 2
    mpc: bool = True
    jobs: int | None = None
    device: str | None = None
    resume: bool = False
    json: bool = False

    def run(self, registry: TaskRegistry | None = None) -> int:
        """Reproduce the chapter, say what came out and where the report is; return the exit code."""
        require_rsl_rl()
        start_warp()
        registry = registry or known_tasks()
        from ..learn.runs.processes import Processes
        from ..learn.runs.side_by_side import usual_jobs
        from ..learn.thesis.chapter4.reproduce import reproduce, stages
        from ..learn.thesis.chapter4.runs import Options

        device = Processes().device(self.device)
        options = Options(
            self.preset or preset_of(device), device, self.num_envs, self.iterations, self.sets, self.worlds,
            self.seeds, self.ablation_seeds, self.seed, self.rounds, self.mpc,
            usual_jobs(device) if self.jobs is None else self.jobs,
        )  # fmt: skip
        options.check()
        return _shown(self.out, stages(options, registry), lambda advance: reproduce(
            self.out, options, registry, resume=self.resume, advance=advance), self.json)  # fmt: skip


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
        jobs: Policies that are trained and tested at the same time, each in a process of its own; on a CPU as many as
            there are cores, but at most 4, and one on a GPU, if not given. Results do not depend on it.
        device: cpu, cuda or cuda:N; a GPU if there is one.
        resume: Go on with runs that were killed or are to be longer, keep those that are done, and add seeds.
        json: Print tables.json as JSON instead of a sentence.
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
    jobs: int | None = None
    device: str | None = None
    resume: bool = False
    json: bool = False

    def run(self, registry: TaskRegistry | None = None) -> int:
        """Reproduce the chapter, say what came out and where the report is; return the exit code."""
        require_rsl_rl()
        start_warp()
        registry = registry or known_tasks()
        from ..learn.runs.processes import Processes
        from ..learn.runs.side_by_side import usual_jobs
        from ..learn.thesis.chapter5.reproduce import reproduce, stages
        from ..learn.thesis.chapter5.runs import Options

        device = Processes().device(self.device)
        options = Options(
            self.preset or preset_of(device), device, self.num_envs, self.iterations, self.noise_levels, self.sets,
            self.worlds, self.seeds, self.seed, usual_jobs(device) if self.jobs is None else self.jobs,
        )  # fmt: skip
        options.check()
        return _shown(self.out, stages(options), lambda advance: reproduce(
            self.out, options, registry, resume=self.resume, advance=advance), self.json)  # fmt: skip


def _shown(
    out: Path, stages: Mapping[str, int | None], work: Callable[[Callable[[str, int], None]], str], as_json: bool
) -> int:
    """Reproduce a chapter of policies with progress shown; say what came out and return the exit code."""
    from ..learn.policies.train import LostError

    try:
        with bars(stages) as advance:
            line = work(advance)
    except LostError as error:
        warn(f"{error}; there is no report")
        return ExitCode.NOT_TRUSTED
    except KeyboardInterrupt:
        print(f"bough: interrupted; go on with the same command and --resume ({out})", file=sys.stderr)
        return ExitCode.INTERRUPTED
    tell(f"{line} Open {shown(out)}/report.html", out / "tables.json", as_json)
    return ExitCode.DONE


@dataclass(frozen=True)
class Reproduce:
    """Make a chapter's tables and figures again, beside the thesis's numbers.

    Attributes:
        chapter: What to reproduce.
    """

    chapter: (
        Annotated[Chapter3, tyro.conf.subcommand("chapter3", prefix_name=False)]
        | Annotated[Chapter4, tyro.conf.subcommand("chapter4", prefix_name=False)]
        | Annotated[Chapter5, tyro.conf.subcommand("chapter5", prefix_name=False)]
    )

    def run(self) -> int:
        """Reproduce the chapter; return the exit code."""
        return self.chapter.run()
