"""Experiments that run themselves: pull, diagnose, propose, until the verdict is settled or the budget is spent."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...sim.arms.arm import Arm
from ...sim.base.errors import InputError, shortened
from ..cases.case import BranchCase
from ..gap.diagnosis import Diagnosis, Settings
from ..replay.probes import ArmProbe, Push
from ..robot.client import RobotClient
from .folder import Folder
from .hand import ForceError, Hand, Ways
from .menu import first, left, menu
from .rounds import Finding, examine
from .settled import settled
from .structure import Structure, within_reach

#: Fewest recordings that say anything of a branch (`learn.gap.usable.too_few`).
FEWEST = 2
#: How often pulls are halved because the branch pulled harder than allowed, before that ends a probing.
GENTLER = 3


@dataclass(frozen=True)
class Budget:
    """How long to go on, and for what.

    Attributes:
        recordings: Most recordings.
        width: Half width of the first effect's interval over its value that is asked for, None for any.
        only: Names of the pulls to choose from; all if empty.
    """

    recordings: int = 12
    width: float | None = None
    only: tuple[str, ...] = ()

    def check(self) -> None:
        """Raise `InputError` for what cannot be."""
        if not FEWEST <= self.recordings <= 100:
            raise InputError("probe", "--budget", str(self.recordings), f"{FEWEST} to 100 recordings")
        if self.width is not None and not 0.0 < self.width < 10.0:
            raise InputError("probe", "--width", f"{self.width:g}", "above 0, below 10")


@dataclass(frozen=True)
class Outcome:
    """How a probing ended.

    Attributes:
        settled: Why the verdict is settled, None where the budget ended it.
        recordings: Recordings of the case.
        findings: Of all rounds.
        case: The case.
    """

    settled: str | None
    recordings: int
    findings: tuple[Finding, ...]
    case: BranchCase


Say = Callable[[str], None]


class Prober:
    """Probes one branch by one arm, into one folder; every step can be done again by another process."""

    def __init__(
        self, robot: RobotClient, arm: Arm, structure: Structure, folder: Folder, *, ways: Ways, budget: Budget,
        settings: Settings, say: Say,
    ) -> None:  # fmt: skip
        """Take what it works with; nothing moves yet.

        Args:
            robot: The arm behind its service.
            arm: Its description.
            structure: The branch.
            folder: Begun.
            ways: How it is pulled.
            budget: How long.
            settings: Of the diagnosis.
            say: Told every step in a line.

        Raises:
            InputError: A pull of the budget that there is not, or a branch out of the arm's way.
        """
        within_reach(structure, ways.reach)
        self._hand = Hand(robot, arm, structure, ways)
        self._pulls = menu(self._hand.releases, budget.only)
        self._structure, self._folder, self._ways = structure, folder, ways
        self._budget, self._settings, self._say = budget, settings, say

    def run(self) -> Outcome:
        """Go on from where the folder is until the verdict is settled or the budget is spent.

        Raises:
            ForceError: The branch pulled harder than allowed, also with an eighth of the pull.
            RobotError: The arm was stopped, refused, or lost; what was recorded is kept.
            OSError: Something could not be written; what was is kept.
        """
        self._prepare()
        number, done = 0, 0
        while True:
            number += 1
            plan = self._folder.plan(number) or self._planned(number, done)
            if plan is None:
                return self._outcome(number - 1, done)
            done += self._pulled(number, plan)
            if done >= FEWEST and self._examined(number, done) is not None:
                return self._outcome(number, done)

    def _prepare(self) -> None:
        """Find out where the branch hangs at rest and how stiff it is, once."""
        known = self._folder.zero
        if known is None:
            self._say("waiting until the branch hangs still")
            self._hand.leave()
            rest = self._hand.calm()
            self._hand.grasp()
            scale = self._hand.feel()
            self._hand.leave()
            known = {"rest_m": rest.tolist(), "stiffness_scale": scale}
            self._folder.zero = known
        self._hand.scale = float(known["stiffness_scale"])
        self._hand.share = float(known.get("share", 1.0))
        self._say(f"pulls of {self._hand.largest:.2g} N at most, {self._hand.scale:.2g} times typical springs")

    def _planned(self, number: int, done: int) -> dict[str, Any] | None:
        """Return the next pull as the last round proposes it, None where the budget does not reach for one."""
        last = self._folder.finding(number - 1) if number > 1 else None
        name = last.propose if last is not None and last.propose else first(self._pulls, done, self._hand.releases)
        left = self._budget.recordings - done
        if len(self._pull(f"round_{number - 1}.json", "propose", name).pushes) > left:
            name = next((n for n, p in self._pulls.items() if len(p.pushes) <= left), "")
        if left <= 0 or not name:
            return None
        why = because(last) if last is not None and last.propose else "a first look"
        plan = {"pull": name, "words": self._pulls[name].words, "recordings": len(self._pulls[name].pushes), "why": why}
        self._folder.set_plan(number, plan)
        return plan

    def _pulled(self, number: int, plan: Mapping[str, Any]) -> int:
        """Do what of a pull is not recorded yet; return how many recordings it has."""
        pull = self._pull(f"plan_{number}.json", "pull", plan["pull"])
        for part, push in enumerate(pull.pushes, 1):
            path = self._folder.recording(number, part)
            if not path.exists():
                self._say(f"pull {number}: {plan['words']} ({plan['why']})")
                self._within_force(push, path)
        return len(pull.pushes)

    def _pull(self, name: str, key: str, pull: str) -> ArmProbe:
        """Return the pull that a file names."""
        if pull not in self._pulls:
            raise InputError(self._folder.path / name, key, shortened(pull), ", ".join(self._pulls))
        return self._pulls[pull]

    def _within_force(self, push: Push, path: Path) -> None:
        """Pull; where the branch pulls harder than allowed, let go and begin again with half of it, a few times.

        A law that stiffens, or a sweep at a resonance, shows no earlier. Later pulls stay as gentle.
        """
        while True:
            try:
                self._hand.pull(push, path)
                return
            except ForceError as error:
                if self._hand.share <= 0.5**GENTLER:
                    raise
                self._hand.share /= 2.0
                self._folder.zero = (self._folder.zero or {}) | {"share": self._hand.share}
                self._say(f"{error}; again with half of it, {self._hand.largest:.2g} N at most")

    def _examined(self, number: int, done: int) -> str | None:
        """Diagnose all recordings, unless it was done; return why the verdict is settled, None where it is not."""
        finding = self._folder.finding(number)
        if finding is None:
            case = self._folder.make_case(self._structure, self._ways, number)
            done_so_far = {str(plan["pull"]) for k in range(1, number + 1) if (plan := self._folder.plan(k))}
            finding = examine(case, self._settings, left(self._pulls, done_so_far))
            self._folder.set_finding(number, finding)
        self._say(f"{done} recordings: {spoken(finding)}")
        return settled(self._upto(number), self._budget.width)

    def _upto(self, number: int) -> list[Finding]:
        found = (self._folder.finding(k) for k in range(1, number + 1))
        return [f for f in found if f is not None]

    def _outcome(self, number: int, done: int) -> Outcome:
        findings = self._upto(number)
        case = self._folder.make_case(self._structure, self._ways, number)
        return Outcome(settled(findings, self._budget.width), done, tuple(findings), case)


def because(finding: Finding) -> str:
    """Return in a few words why a round proposes its pull."""
    return f"adds {finding.gain:.0f} in twice the log likelihood" if finding.gain else "a plain pull, to confirm"


def spoken(finding: Finding) -> str:
    """Return what a round found, in a line."""
    if finding.reason:
        return f"nothing to be said yet: {finding.reason}"
    named = " and ".join(finding.effects) if finding.verdict == "effects" else finding.verdict
    rival = " and ".join(finding.rival) or "no effect"
    return f"{named}, ahead of {rival} by {finding.lead:.0f}; next best: {finding.propose}, {because(finding)}"


def conclude(folder: Folder, outcome: Outcome, settings: Settings, progress: Callable[[str, int], None]) -> Diagnosis:
    """Write the diagnosis of the case, with posterior and report, and how the probing ended; return the former."""
    from ..gap.diagnose import diagnose

    found = diagnose(outcome.case, folder.path / "diagnosis", settings, resume=True, progress=progress)
    folder.set_result({
        "settled": outcome.settled, "recordings": outcome.recordings, "verdict": found.verdict,
        "effects": [a.label for a in found.effects], "rounds": [f.as_json() for f in outcome.findings],
    })  # fmt: skip
    return found


def copy_structure(given: Path, folder: Folder) -> None:
    """Keep the structure's file beside what was measured; a copy that is there stays."""
    target = folder.path / "branch.yaml"
    if not target.exists():
        fresh = target.with_name(".branch.yaml")
        shutil.copyfile(given, fresh)
        fresh.replace(target)
