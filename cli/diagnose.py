"""``bough diagnose``: what the model of a measured case lacks; ``bough exam``: how often the verdict is right."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from ..learn.gap import TOLERANCE
from ..sim.base.console import bar, bars, shown, start_warp, tell, warn
from ..sim.base.errors import InputError, check_seed
from ..sim.base.files import output_folder
from .base.exit_codes import ExitCode


@dataclass(frozen=True)
class Diagnose:
    """Find where simulation and measurement disagree, name the missing effect, add it, show the held-out error shrink.

    Writes verdict.json, model.yaml, figures and report.html. Of an arm's free recordings (docs/arm_gap.md) it says what
    the servos' model lacks. Exit code 0: done, whatever the verdict; 2: bad input, nothing written.

    Attributes:
        case: Case folder: meta.yaml and one CSV file per trajectory.
        out: Folder to write to.
        effects: Effects that may be tried; all that the case can show if not given.
        tolerance: Change of the motion, as a share of its rms, below which a missing effect is of no interest.
        max_effects: Most effects that are named together; one law at many joints of an arm or a branch counts once.
        seed: Seed of everything random.
        fit: Of joints measured directly: replay the motion that the efforts cause, or fit the torques that the motion
            needs; chosen by what was measured if not given.
        resume: Go on with a killed run of the same case, settings and --out.
        json: Print verdict.json as JSON instead of a sentence.
    """

    case: tyro.conf.Positional[Path]
    out: Path
    effects: tuple[str, ...] = ()
    tolerance: float = TOLERANCE
    max_effects: int = 2
    seed: int = 0
    fit: Literal["replay", "torque"] | None = None
    resume: bool = False
    json: bool = False

    def run(self) -> int:
        """Diagnose the case and say what came out and where the report is."""
        from ..learn.cases.arm import is_arm_case
        from ..learn.cases.case import load_case
        from ..learn.gap.diagnosis import Settings

        names = tuple(name for entry in self.effects for name in entry.split(","))
        if is_arm_case(self.case):
            return self._arm(names)
        settings = Settings(names, self.tolerance, self.max_effects, self.seed, fit=self.fit)
        settings.check()
        case = load_case(self.case)
        start_warp()
        from ..learn.gap.diagnose import diagnose  # torch and Warp, after what is quick to refuse
        from ..learn.gap.run import STAGES

        stages = {
            "fitting the base model": None,  # twice where a case is judged in two ways
            "scanning candidates": None,
            "fitting candidates": None,
            "comparing models": None,
            "sampling": 24,
        }
        says = dict(zip(STAGES, stages, strict=True))
        with bars(stages) as advance:
            found = diagnose(
                case, self.out, settings, resume=self.resume,
                progress=lambda stage, done: advance(says[stage], done),
            )  # fmt: skip
        for line in case.warnings:
            warn(line)
        tell(f"{found.sentence} Open {shown(self.out)}/report.html", self.out / "verdict.json", self.json)
        return ExitCode.DONE

    def _arm(self, names: tuple[str, ...]) -> int:
        """Diagnose the servos of an arm."""
        from ..learn.arms.diagnose import check_names, diagnose_arm
        from ..learn.arms.report import sentence, write_arm_diagnosis
        from ..learn.cases.arm import load_arm_case

        if self.fit is not None or self.resume:
            option = "--fit" if self.fit is not None else "--resume"
            raise InputError("diagnose", option, "given with an arm's recordings", "branches and measured joints only")
        check_names(names)
        case = load_arm_case(self.case)
        with output_folder(self.out) as folder, bar("searching channels", None) as advance:
            found = diagnose_arm(case, effects=names, tolerance=self.tolerance, most=max(3, self.max_effects),
                                 progress=advance)  # fmt: skip
            write_arm_diagnosis(folder, found)
        tell(f"{sentence(found)} Open {shown(self.out)}/report.html", self.out / "verdict.json", self.json)
        return ExitCode.DONE


@dataclass(frozen=True)
class Exam:
    """Hide effects in branches or joints of another simulator, diagnose them, score the verdicts, draw who is who.

    Writes results.jsonl (one line per case, appended: the same command continues a stopped exam), exam.json,
    confusion.png and exam.md. Exit code 0: done; 2: bad input, nothing written.

    Attributes:
        out: Folder to write to.
        cases: Number of cases, 10,000 at most: nothing hidden, one effect, two, or one that the registry does not have,
            3 : 3 : 1 : 1.
        joints: Measured joints and mechanisms instead of branches: thirty laws, ten of them on no list.
        noise: Noise of a branch's displacement and velocity as a share of their rms, 0.03 if not given; the force has
            half of it.
        seed: Seed of the cases.
        jobs: Cases that run at the same time.
        hard: Branches, probes, sensors, noise and laws as in nature and worse: see docs/hide.md.
        held_back: A hard exam of the laws' forms that are held back. Opened once a release, and noted in docs/hide.md.
        json: Print exam.json as JSON instead of a sentence.
    """

    out: Path
    cases: int = 104
    joints: bool = False
    noise: float | None = None
    seed: int = 0
    jobs: int = 2
    hard: bool = False
    held_back: bool = False
    json: bool = False

    def run(self) -> int:
        """Hold the exam and print its table."""
        check_seed("exam", self.seed)  # said before torch is there
        from ..learn.exam.hold import hold

        if self.held_back:
            warn("this opens the forms that are held back: note version, seed and table in docs/hide.md")
        table = hold(
            self.out, cases=self.cases, noise=self.noise, seed=self.seed, jobs=self.jobs, joints=self.joints,
            hard=self.hard, held_back=self.held_back,
        )  # fmt: skip
        tell(table, self.out / "exam.json", self.json)
        return ExitCode.DONE
