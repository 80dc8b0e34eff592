"""Whether pulls that the diagnosis proposes name a hidden effect sooner than a fixed set of eight pulls.

Every branch is a twin's (`learn.robot.twin_branch`): MuJoCo's with effects hidden by laws of another form than the
diagnosis's, a Jaco 2 whose guard and gripper pull it, sensors with noise. All designs pull the same branch with the
same noise, force limit and length of a recording, and are diagnosed by the same settings. Two of them are diagnosed
after every recording from the second on, and stop by the same rule (`learn.probing.settled`). The clock is simulated:
nothing waits.

- whole: ramp, release, triangle, sweep, steps, release across, and the first two again (`learn.probing.menu.FIXED`),
  then one diagnosis, as of a case that somebody has recorded: eight recordings always;
- fixed: the same in that order, but diagnosed after each and ended by the rule;
- proposed: what `learn.gap.next_probe` proposes, of the registry's pulls; one of three pushes costs three recordings.

Counted are recordings until the right name (and no other) stays to the end, and until the rule settles; a wrong name
that settled is wrong. Intervals of differences are bootstrapped over branches (2000 draws).

Run: ``python benchmarks/robots/probing.py [--quick] [--seed n] [--branches n]``
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import measuring
import numpy as np
from bough.learn.gap.diagnosis import Settings
from bough.learn.probing.folder import Folder
from bough.learn.probing.hand import ForceError, Ways
from bough.learn.probing.loop import Budget, Prober
from bough.learn.probing.menu import FIXED
from bough.learn.probing.rounds import Finding
from bough.learn.probing.structure import read_structure
from bough.learn.robot.limits import default_limits
from bough.learn.robot.stepped import SteppedRobot
from bough.learn.robot.twin_branch import BranchTwin, Hiding, twin_effects
from bough.sim.arms.jaco2 import jaco2
from measuring import Figure

MOST = len(FIXED)
#: Range of what a hidden effect changes, a share of the motion's rms.
SIZES = (0.05, 0.3)


@dataclass(frozen=True)
class Ended:
    """How a design ended on a branch.

    Attributes:
        design: One of `DESIGNS`.
        right: Recordings from which on the right name, alone, stayed; None if it never did.
        settled: Recordings at which the rule settled; None if the budget ended it.
        named: Effects named at the end.
        correct: Whether those are what is hidden.
        width: Half width of the interval over the value at the end.
    """

    design: str
    right: int | None
    settled: int | None
    named: tuple[str, ...]
    correct: bool
    width: float | None


class FixedProber(Prober):
    """The same loop with the fixed set in the place of proposals."""

    def __init__(self, *arguments, **options) -> None:
        super().__init__(*arguments, **options)
        self._pulls = {f"fixed_{k + 1}": pull for k, pull in enumerate(FIXED)}

    def _planned(self, number: int, done: int):
        if done >= min(self._budget.recordings, MOST):
            return None
        plan = {"pull": f"fixed_{number}", "words": FIXED[number - 1].words, "recordings": 1, "why": "fixed"}
        self._folder.set_plan(number, plan)
        return plan


class WholeProber(FixedProber):
    """All eight, then one diagnosis."""

    def _examined(self, number: int, done: int):
        return super()._examined(number, done) if done == MOST else None


DESIGNS: dict[str, type[Prober]] = {"proposed": Prober, "fixed": FixedProber, "whole": WholeProber}


def probed(design: str, seed: int, hiding: Hiding, segments: int, settings: Settings, folder: Path) -> Ended:
    """Probe a branch by a design."""
    arm = jaco2()
    twin = BranchTwin(arm, seed=seed, segments=segments, hidings=[hiding])
    folder.mkdir(parents=True)
    twin.write_structure(folder / "branch.yaml")
    own = Folder(folder / "out")
    own.begin({}, resume=False)
    prober = DESIGNS[design](SteppedRobot(twin, default_limits(arm)), arm, read_structure(folder / "branch.yaml"), own,
                  ways=Ways(), budget=Budget(MOST), settings=settings, say=lambda _text: None)  # fmt: skip
    try:
        ended = prober.run().settled is not None
    except ForceError:  # as far as it came
        ended = False
    findings = [f for f in own.findings() if not f.reason]
    if not findings:
        return Ended(design, None, None, (), False, None)
    last, right = findings[-1], {hiding.name}
    return Ended(design, since(findings, right), last.recordings if ended else None, last.effects,
                 set(last.names) == right, None if np.isinf(last.width) else last.width)  # fmt: skip


def since(findings: list[Finding], right: set[str]) -> int | None:
    """Return the recordings from which on the right names stayed to the end."""
    out = None
    for finding in reversed(findings):
        if set(finding.names) != right:
            break
        out = finding.recordings
    return out


def measured(options: argparse.Namespace) -> list[Figure]:
    """Measure and print."""
    count = 1 if options.quick else options.branches
    rng = np.random.default_rng([options.seed, 90])
    names = rng.permutation(options.effects or twin_effects()).tolist()
    settings = Settings(effects=tuple(options.effects), particles=0, max_effects=1)
    rows = kept(options.rows)
    for k in range(count):
        name, seed = names[k % len(names)], int(rng.integers(2**31))
        hiding = Hiding(name, None, float(np.exp(rng.uniform(*np.log(options.sizes)))))
        for design in options.designs:
            if any((r["branch"], r["design"]) == (k + 1, design) for r in rows):
                continue
            clock = time.process_time()
            with tempfile.TemporaryDirectory() as work:
                ended = probed(design, seed, hiding, options.segments, settings, Path(work) / "probe")
            row = {"branch": k + 1, "hidden": name, "size": hiding.size, **asdict(ended),
                   "cpu_s": time.process_time() - clock}  # fmt: skip
            rows.append(row)
            print(json.dumps(row), flush=True)
            if options.rows:
                with open(options.rows, "a") as file:
                    file.write(json.dumps(row) + "\n")
    return told(rows)


def kept(rows: Path | None) -> list[dict]:
    """Return the rows that an earlier run with the same options has left."""
    return [json.loads(line) for line in rows.read_text().splitlines()] if rows and rows.exists() else []


def told(rows: list[dict]) -> list[Figure]:
    """Print all designs side by side and return their figures."""
    print("\n| design | right at the end | recordings until right (9: never) | recordings done | settled wrongly |")
    print("|---|---|---|---|---|")
    figures = [figure for design in DESIGNS if (own := [r for r in rows if r["design"] == design])
               for figure in row(design, own)]  # fmt: skip
    for other in ("fixed", "whole"):
        pairs = both(rows, other)
        if not pairs:
            continue
        for name, count in (("until right", until), ("done", done)):
            fewer = np.array([count(b) - count(a) for a, b in pairs])
            low, high = interval(fewer)
            print(f"\nproposed beside {other}, recordings {name}: fewer by {fewer.mean():.2f} (95 % {low:.2f} to"
                  f" {high:.2f}), {(fewer > 0).sum()} branches sooner, {(fewer < 0).sum()} later")  # fmt: skip
        ratio = narrower(pairs)
        if len(ratio):
            low, high = np.exp(interval(ratio))
            print(f"where both end right after as many, intervals are {np.exp(ratio.mean()):.2f} times as wide (95 %"
                  f" {low:.2f} to {high:.2f}, {len(ratio)} branches)")  # fmt: skip
    return figures


def row(design: str, own: list[dict]) -> list[Figure]:
    """Print a design's row and return its figures."""
    right, wrong = sum(r["correct"] for r in own), sum(bool(r["settled"] and not r["correct"]) for r in own)
    sooner, spent = float(np.mean([until(r) for r in own])), float(np.mean([done(r) for r in own]))
    print(f"| {design} | {right} of {len(own)} | {sooner:.2f} | {spent:.2f} | {wrong} |")
    return [Figure(design, "recordings until right", sooner, "recordings"),
            Figure(design, "recordings done", spent, "recordings")]  # fmt: skip


def until(r: dict) -> int:
    """Return the recordings from which on the right name stayed, one more than there are if it never did."""
    return r["right"] or MOST + 1


def done(r: dict) -> int:
    """Return the recordings that were done."""
    return r["settled"] or MOST


def both(rows: list[dict], other: str) -> list[tuple[dict, dict]]:
    """Return the rows of the proposals and of another design, of branches that both have probed."""
    own = {(r["branch"], r["design"]): r for r in rows}
    return [(r, own[k, other]) for (k, d), r in own.items() if d == "proposed" and (k, other) in own]


def narrower(pairs: list[tuple[dict, dict]]) -> np.ndarray:
    """Return log ratios of the widths, proposed over other, of branches that both end right with as many recordings."""
    sound = [(a, b) for a, b in pairs if a["correct"] and b["correct"] and a["width"] and b["width"]]
    return np.array([np.log(a["width"] / b["width"]) for a, b in sound if done(a) == done(b)])


def interval(values: np.ndarray) -> np.ndarray:
    """Return the 95 % interval of a mean over branches, by 2000 draws of them."""
    draws = np.random.default_rng(0).integers(len(values), size=(2000, len(values)))
    return np.percentile(values[draws].mean(axis=1), (2.5, 97.5))


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    out = measuring.quick_and_seed(__doc__, "one branch")
    out.add_argument("--branches", type=int, default=20)
    out.add_argument("--segments", type=int, default=3)
    out.add_argument("--effects", nargs="*", default=[], help="hidden ones and candidates; all if none is given")
    out.add_argument("--sizes", type=float, nargs=2, default=SIZES, help="range of what a hidden effect changes")
    out.add_argument("--designs", nargs="*", default=list(DESIGNS), choices=list(DESIGNS))
    out.add_argument(
        "--rows", type=Path, help="file with a line for every branch and design; those in it are not repeated"
    )
    return out


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "probing"))
