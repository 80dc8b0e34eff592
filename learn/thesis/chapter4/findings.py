"""Everything that a reproduction of chapter 4 finds, and which claims of the thesis follow from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ....sim.base.types import Array
from ...policies.compare import Episodes, feasible, mean, relative_success
from ...tasks.measures import REACH_COLUMNS
from ..common.interval import LEAST_SEEDS, Interval, interval
from .runs import BEYOND, COMPARED, GENTLER, MPC, PATTERNS, PERIODS, TORQUES, Changes, Options, Run

COLUMNS = {column.name: column for column in REACH_COLUMNS}
SUCCESS, FORCE, RUPTURE, STEPS = "Test SR %", "Force N", "Above 80 N %", "Steps %"
ALL = "all"
_LESS, _MORE = "PCAP's mean force over {}'s (past the thesis)", "{}'s success less PCAP's, points (past the thesis)"
#: Largest logarithm of a ratio's interval that is told.
MOST_LOG = 50.0


@dataclass
class Findings:
    """Everything the report is made of.

    Attributes:
        options: Size of the reproduction.
        episodes: What every run came to, by run and settings that it was tested with.
        planned: What MPC came to, by its name (`MPC`, `MPC_TREE`); empty where it was left out.
        metrics: Numbers of every iteration of the compared runs.
        minutes: Time that every run spent in its iterations [min].
        touch: By kind of classifier: shares and area with their intervals, and the ROC.
        config: Of the first run: settings, versions, machine.
        seconds: Wall time of every stage now; less than it takes where a run was gone on with.
    """

    options: Options
    episodes: dict[tuple[Run, Changes], Episodes] = field(default_factory=dict)
    planned: dict[str, Episodes] = field(default_factory=dict)
    metrics: dict[Run, list[dict[str, float | None]]] = field(default_factory=dict)
    minutes: dict[Run, float] = field(default_factory=dict)
    touch: dict[str, dict[str, Any]] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    def each(self, run: Run, changes: Changes = (), pattern: str = ALL) -> list[Episodes]:
        """Return the episodes of every seed of a run, of all patterns or of one."""
        found = [self.episodes[r, changes] for r in self.options.repeats(run)]
        return [e if pattern == ALL else e.of(e.kinds[pattern]) for e in found]

    def over_seeds(self, run: Run, column: str, changes: Changes = (), pattern: str = ALL) -> Interval:
        """Return the mean of a column over the seeds, and its interval."""
        return interval([mean(e, COLUMNS[column]) for e in self.each(run, changes, pattern)])

    @property
    def ensemble(self) -> tuple[Run, ...]:
        """Return the trained policies of the oracle (thesis, B.3): two PPO where there are two, a CPO, a PCAP."""
        return (*self.options.repeats(Run("ppo"))[:2], Run("cpo"), Run("pcap"))

    def possible(self) -> Array:
        """Return in which worlds any of the oracle succeeds, bool; of MPC only the thesis's, which knows no tree."""
        mpc = [self.planned[MPC]] if MPC in self.planned else []
        return feasible([*(self.episodes[run, ()] for run in self.ensemble), *mpc])

    def relative(self, policy: str, pattern: str = ALL) -> Interval:
        """Return success relative to the oracle's [%], the mean over the seeds and its interval."""
        values = []
        for run in self.options.repeats(Run(policy)):
            e = self.episodes[run, ()]
            mask = np.ones(len(e.target), bool) if pattern == ALL else e.kinds[pattern]
            values.append(100.0 * relative_success(e.of(mask), self.possible()[mask])[0])
        return interval(values)

    @property
    def patterns(self) -> tuple[str, ...]:
        """Return the occlusion patterns that the tests hold."""
        return tuple(p for p in PATTERNS if self.episodes[Run("ppo"), ()].kinds[p].any())

    @property
    def hardest(self) -> str:
        """Return the pattern in which PPO succeeds least."""
        return min(self.patterns, key=lambda p: self.over_seeds(Run("ppo"), SUCCESS, pattern=p).mean)


@dataclass(frozen=True)
class Claim:
    """What the thesis says, what was found, and whether it follows.

    Attributes:
        text: The claim.
        thesis: Its figure in the thesis.
        found: The same here, over the seeds.
        holds: Whether all of the interval is on the claim's side; None where there are fewer than three seeds, or the
            interval is on both sides.
        as_much: Whether the mean is at least as much as the thesis's; None where the thesis has no figure.
    """

    text: str
    thesis: str
    found: Interval
    holds: bool | None
    as_much: bool | None

    @property
    def verdict(self) -> str:
        """Return what follows, in words."""
        if self.holds is None:
            few = self.found.count < LEAST_SEEDS
            return f"not said: fewer than {LEAST_SEEDS} seeds" if few else "not said: the interval is on both sides"
        if not self.holds:
            return "does not follow"
        return "follows" if self.as_much is not False else "follows, but by less"


def claims(found: Findings) -> list[Claim]:
    """Return the claims of 4.5.1, B.4, B.5, B.6 and B.7, and those of the policies past the thesis."""
    ppo, cpo, pcap = (Run(p) for p in ("ppo", "cpo", "pcap"))
    plus = Run(TORQUES[0])
    out = [
        *_beside_ppo(found, "pcap", "PCAP"),
        _ratio(found, "PCAP's steps over PPO's", 1.25, pcap, ppo, STEPS),
        _ratio(found, "PCAP's success over CPO's", None, pcap, cpo, SUCCESS),
        _ratio(found, "PPO+'s mean force over PCAP's", 2.0, plus, pcap, FORCE),
        _ratio(found, "PPO+'s steps above 80 N over PCAP's", 5.0, plus, pcap, RUPTURE),
        _ratio(found, "success among Ta trees of PCAP trained there over one trained among fractal trees", None, pcap,
               (Run("pcap", "fractal"), ("forest=Ta",)), SUCCESS),
        _ratio(found, "success of PCAP among rudimentary springs over success among beams, each as trained", None, pcap,
               Run("pcap", springs="beam"), SUCCESS),
    ]  # fmt: skip
    past = [claim for p in BEYOND for claim in (
        _ratio(found, _LESS.format(p), None, pcap, Run(p), FORCE),
        _more_success(found, _MORE.format(p), Run(p), pcap))]  # fmt: skip
    return [*out, *past, *_beside_ppo(found, GENTLER, GENTLER)]


def _beside_ppo(found: Findings, policy: str, name: str) -> list[Claim]:
    """Return what the thesis claims of PCAP beside PPO on the hardest pattern, of a policy."""
    hard, ppo, own = found.hardest, Run("ppo"), Run(policy)
    return [
        _ratio(found, f"PPO's mean force over {name}'s, {hard}", 3.0, ppo, own, FORCE, hard),
        _ratio(found, f"PPO's steps above 80 N over {name}'s, {hard}", 15.0, ppo, own, RUPTURE, hard),
        _gap(found, f"PPO's success less {name}'s, relative to the oracle, at most 10 points, {hard}", hard, policy),
    ]


def gentler(said: Sequence[Claim]) -> list[str]:
    """Return the policies past the thesis that by these claims press less than PCAP and succeed as often."""
    holds = {claim.text: claim.holds for claim in said}
    return [p for p in BEYOND if holds[_LESS.format(p)] and holds[_MORE.format(p)] is not False]


Place = Run | tuple[Run, Changes]


def _ratio(
    found: Findings, text: str, thesis: float | None, above: Place, below: Place, column: str, pattern: str = ALL
) -> Claim:
    """Return the claim that a ratio is above one: of seed k over seed k, the geometric mean.

    Its interval is that of the logarithms: twice as much and half as much are as far from one.
    """
    rows = [_values(found, place, column, pattern) for place in (above, below)]
    pairs = list(zip(*rows, strict=False))
    logs = interval([math.log(a / b) if a > 0.0 and b > 0.0 else math.nan for a, b in pairs])
    middle, low, high = (math.exp(min(x, MOST_LOG)) for x in (logs.mean, logs.low, logs.high))
    got = Interval(middle, low, high, logs.count)
    as_much = None if thesis is None else got.mean >= thesis
    return Claim(text, "above 1" if thesis is None else f"{thesis:g}", got, _on_side(got, 1.0), as_much)


def _more_success(found: Findings, text: str, one: Place, other: Place) -> Claim:
    """Return the claim that one succeeds more often than the other, in all patterns: seed k of both."""
    rows = [_values(found, place, SUCCESS, ALL) for place in (one, other)]
    got = interval([a - b for a, b in zip(*rows, strict=False)])
    return Claim(text, "above 0", got, _on_side(got, 0.0), None)


def _values(found: Findings, place: Place, column: str, pattern: str) -> list[float]:
    """Return a column of every seed; where no step was above 80 N it is as if one had been."""
    run, changes = place if isinstance(place, tuple) else (place, ())
    each = found.each(run, changes, pattern)
    least = [100.0 / (PERIODS * len(e.target)) if column == RUPTURE else -math.inf for e in each]
    return [max(mean(e, COLUMNS[column]), few) for e, few in zip(each, least, strict=True)]


def _gap(found: Findings, text: str, pattern: str, policy: str) -> Claim:
    """Return the claim that a policy loses at most ten points of relative success, PPO's less its own."""
    possible = found.possible()
    values = []
    for one, other in zip(*(found.options.repeats(Run(p)) for p in ("ppo", policy)), strict=True):
        shares = []
        for run in (one, other):
            e = found.episodes[run, ()]
            mask = e.kinds[pattern]
            shares.append(relative_success(e.of(mask), possible[mask])[0])
        values.append(100.0 * (shares[0] - shares[1]))
    got = interval(values)
    within = None if got.count < LEAST_SEEDS or got.low <= 10.0 < got.high else got.mean <= 10.0
    return Claim(text, "10 (69 to 59 %)", got, within, None)


def _on_side(value: Interval, bound: float) -> bool | None:
    """Return whether an interval of three seeds or more lies above a bound; None where it does on both sides."""
    if value.count < LEAST_SEEDS or value.low <= bound <= value.high:
        return None
    return value.low > bound


def by_pattern(found: Findings, get: Callable[[str, str], Interval]) -> Mapping[str, Mapping[str, Interval]]:
    """Return a number of every compared policy by pattern."""
    return {policy: {p: get(policy, p) for p in found.patterns} for policy in COMPARED}
