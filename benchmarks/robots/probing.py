"""Whether pulls that the diagnosis proposes name a hidden effect sooner than a fixed set of eight pulls.

Every branch is a twin's (`learn.robot.twin_branch`): MuJoCo's with effects hidden by laws of another form than the
diagnosis's, a Jaco 2 whose guard and gripper pull it, sensors with noise. Both designs pull the same branch with the
same noise, force limit and length of a recording, stop by the same rule (`learn.probing.settled`) and are diagnosed by
the same settings after every recording from the second on. The clock is simulated: nothing waits.

- fixed: ramp, release, triangle, sweep, steps, release across, and the first two again (`learn.probing.menu.FIXED`);
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
        design: ``fixed`` or ``proposed``.
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


def probed(design: str, seed: int, hiding: Hiding, segments: int, settings: Settings, folder: Path) -> Ended:
    """Probe a branch by a design."""
    arm = jaco2()
    twin = BranchTwin(arm, seed=seed, segments=segments, hidings=[hiding])
    folder.mkdir(parents=True)
    twin.write_structure(folder / "branch.yaml")
    own = Folder(folder / "out")
    own.begin({}, resume=False)
    kind = {"fixed": FixedProber, "proposed": Prober}[design]
    prober = kind(SteppedRobot(twin, default_limits(arm)), arm, read_structure(folder / "branch.yaml"), own,
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
        for design in ("proposed", "fixed"):
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
    """Print both designs side by side and return their figures."""
    figures = []
    print("\n| design | right at the end | recordings until right (9: never) | until settled | settled wrongly |")
    print("|---|---|---|---|---|")
    counts = {}
    for design in ("proposed", "fixed"):
        own = [r for r in rows if r["design"] == design]
        counts[design] = np.array([r["right"] or MOST + 1 for r in own], float)
        settled = np.array([r["settled"] or MOST for r in own], float)
        right = sum(r["correct"] for r in own)
        wrong = sum(bool(r["settled"] and not r["correct"]) for r in own)
        print(f"| {design} | {right} of {len(own)} | {counts[design].mean():.2f} | {settled.mean():.2f} | {wrong} |")
        figures += [Figure(design, "recordings until right", float(counts[design].mean()), "recordings"),
                    Figure(design, "recordings until settled", float(settled.mean()), "recordings")]  # fmt: skip
    fewer = counts["fixed"] - counts["proposed"]
    draws = np.random.default_rng(0).integers(len(fewer), size=(2000, len(fewer)))
    low, high = np.percentile(fewer[draws].mean(axis=1), (2.5, 97.5))
    print(f"\nfewer by {fewer.mean():.2f} recordings (95 % {low:.2f} to {high:.2f}) over {len(fewer)} branches;"
          f" sooner on {(fewer > 0).sum()}, later on {(fewer < 0).sum()}")  # fmt: skip
    return figures


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    out = measuring.quick_and_seed(__doc__, "one branch")
    out.add_argument("--branches", type=int, default=20)
    out.add_argument("--segments", type=int, default=3)
    out.add_argument("--effects", nargs="*", default=[], help="hidden ones and candidates; all if none is given")
    out.add_argument("--sizes", type=float, nargs=2, default=SIZES, help="range of what a hidden effect changes")
    out.add_argument(
        "--rows", type=Path, help="file with a line for every branch and design; those in it are not repeated"
    )
    return out


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "probing"))
