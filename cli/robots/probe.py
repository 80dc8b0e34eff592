"""``bough probe``: experiments on a branch that run themselves."""

from __future__ import annotations

import signal
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ...sim.base.console import bars, shown, start_warp, tell, warn
from ...sim.base.errors import InputError
from ..base.exit_codes import ExitCode
from .robot import Wrist

if TYPE_CHECKING:
    from ...learn.gap.diagnosis import Settings
    from ...learn.probing.hand import Ways
    from ...learn.probing.loop import Budget, Outcome
    from ...learn.probing.structure import Structure
    from ...learn.robot.client import RobotClient

_STAGES = {"base": 1, "scan": None, "fits": None, "evidence": 1, "sampling": 24}


@dataclass(frozen=True)
class Probe:
    """Pull a branch by an arm, diagnose it, pull what would tell most, until the verdict is settled.

    The arm is one behind `bough robot serve`: a robot, or a twin (--backend branch). It waits until the branch hangs
    still, grasps it, pulls, lets go, and diagnoses all recordings so far after each pull. It ends when two verdicts in
    a row agree and are clear, when no pull would tell more, or when the budget is spent. Writes the case, what every
    round found, and at the end the diagnosis with its report. --resume goes on after anything, kill -9 too; nothing
    that was measured is lost. Exit code 0: done; 1: the arm was stopped or lost, what was recorded is kept; 2: bad
    input.

    Attributes:
        branch: YAML file of the branch: meta.yaml of a case without recordings, in the arm's base frame. A twin writes
            its own.
        out: Folder for all of it.
        robot: Address of the service.
        token_file: File whose first line the service wants to hear.
        certificate: PEM file that vouches for a service over https.
        wrist: Of the Jaco 2.
        force: Largest force [N]; above one and a half times of it the gripper opens.
        reach: Largest displacement of the grasp point that is aimed at [m].
        rate: Sampling rate of the case [Hz], of the service's 60 Hz; a lower one blurs how a branch is let go.
        samples: Samples of a recording.
        budget: Most recordings.
        width: Go on until the 95 % interval of the first effect's first parameter is narrower than this share to
            either side; any width if not given.
        pulls: Names of pulls to choose from; all that the arm can do if none is given.
        effects: Effects that may be tried; all that the case can show if none is given.
        max_effects: Most effects that are named together.
        seed: Of everything random in the diagnosis.
        resume: Go on with what is in --out.
        json: Print result.json instead of a sentence.
    """

    branch: Path
    out: Path
    robot: str = "http://127.0.0.1:3738"
    token_file: Path | None = None
    certificate: Path | None = None
    wrist: Wrist = "curved"
    force: float = 10.0
    reach: float = 0.18
    rate: float = 60.0
    samples: int = 219
    budget: int = 12
    width: float | None = None
    pulls: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    max_effects: int = 2
    seed: int = 0
    resume: bool = False
    json: bool = False

    def run(self) -> int:
        """Probe, and say what was found and where it is."""
        from ...learn.gap.diagnosis import Settings
        from ...learn.probing.loop import Budget
        from ...learn.probing.structure import read_structure
        from ...learn.robot.access import read_token
        from ...learn.robot.client import RobotClient, RobotError

        settings = Settings(self.effects, max_effects=self.max_effects, seed=self.seed)
        settings.check()
        budget, ways = Budget(self.budget, self.width, self.pulls), self._ways()
        budget.check()
        structure = read_structure(self.branch)
        token = None if self.token_file is None else read_token(self.token_file)
        start_warp()
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            with RobotClient(self.robot, token, self.certificate) as robot:
                return self._probe(robot, structure, ways, budget, settings)
        except RobotError as error:
            self._kept(f"{self.robot.rpartition('@')[2]}: {error}")
            return ExitCode.FAILED
        except KeyboardInterrupt:
            self._kept("interrupted")
            return ExitCode.INTERRUPTED

    def _kept(self, why: str) -> None:
        kept = f"what was recorded is kept in {shown(self.out)}, and --resume goes on"
        print(f"bough: {why}; {kept}", file=sys.stderr)

    def _ways(self) -> Ways:
        from ...learn.probing.hand import Ways

        for option, value, low, high in (
            ("--force", self.force, 0.1, 100.0), ("--reach", self.reach, 0.01, 0.5), ("--rate", self.rate, 5.0, 60.0),
            ("--samples", self.samples, 40, 2000),
        ):  # fmt: skip
            if not low <= value <= high:
                raise InputError("probe", option, f"{value:g}", f"{low:g} to {high:g}")
        return Ways(self.force, self.reach, self.rate, self.samples)

    def _probe(
        self, robot: RobotClient, structure: Structure, ways: Ways, budget: Budget, settings: Settings
    ) -> int:  # fmt: skip
        from ...learn.probing.folder import Folder
        from ...learn.probing.loop import Prober, conclude, copy_structure
        from ...sim.arms.jaco2 import jaco2

        folder = Folder(self.out)
        prober = Prober(
            robot, jaco2(self.wrist), structure, folder, ways=ways, budget=budget, settings=settings, say=_say,
        )  # fmt: skip
        folder.begin(self._asked(ways, budget, settings), self.resume)
        copy_structure(self.branch, folder)
        outcome = prober.run()
        with bars(_STAGES) as advance:
            found = conclude(folder, outcome, settings, advance)
        return self._tell(outcome, found.sentence)

    def _asked(self, ways: Ways, budget: Budget, settings: Settings) -> dict[str, object]:
        """Return what a resumed run must ask for as well; the budget may grow."""
        structure = self.branch.read_text()
        own = {"width": budget.width, "pulls": list(budget.only), "branch": structure, "wrist": self.wrist}
        return asdict(ways) | own | {key: list(v) if isinstance(v, tuple) else v for key, v in asdict(settings).items()}

    def _tell(self, outcome: Outcome, sentence: str) -> int:
        if outcome.settled is None:
            warn(f"the budget of {self.budget} recordings is spent, and the verdict is not settled")
        ended = f"Settled after {outcome.recordings} recordings: {outcome.settled}. " if outcome.settled else ""
        said = f"{ended}{sentence} Open {shown(self.out)}/diagnosis/report.html"
        tell(said, self.out / "result.json", self.json)
        return ExitCode.DONE


def _say(text: str) -> None:
    print(f"bough: {text}", file=sys.stderr, flush=True)
