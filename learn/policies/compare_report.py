"""What a test says of policies beside each other: differences with intervals, success relative to an ensemble."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..tasks.parts import Column
from .compare import Difference, Episodes, by_kind, difference, feasible, relative_success
from .tables import known, lines, wilson


@dataclass(frozen=True)
class Relative:
    """Success of a policy in the worlds that an ensemble finds possible.

    Attributes:
        share: Of them that it succeeds in, NaN of none.
        possible: How many those are.
        worlds: Of how many.
    """

    share: float
    possible: int
    worlds: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval."""
        return wilson(self.share, self.possible) if self.possible else (math.nan, math.nan)


@dataclass(frozen=True)
class Beside:
    """A policy beside others in the same worlds.

    Attributes:
        differences: By the other's name, kind of worlds and column: this policy's less the other's.
        ensemble: Names of the policies that decide what is possible; empty if none were asked for.
        relative: Success by policy and kind of worlds.
    """

    differences: Mapping[str, Mapping[str, Mapping[str, Difference]]]
    ensemble: tuple[str, ...]
    relative: Mapping[str, Mapping[str, Relative]]

    def plain(self) -> dict[str, Any]:
        """Return it as JSON."""
        differences = {
            other: {k: {c: {"difference": known(d.value), "interval": [known(d.low), known(d.high)]}
                        for c, d in columns.items()} for k, columns in kinds.items()}
            for other, kinds in self.differences.items()
        }  # fmt: skip
        relative = {
            policy: {k: {"share %": known(100.0 * r.share), "interval": [known(100.0 * v) for v in r.interval],
                         "possible": r.possible, "of": r.worlds} for k, r in kinds.items()}
            for policy, kinds in self.relative.items()
        }  # fmt: skip
        out: dict[str, Any] = {"differences": differences} if differences else {}
        return out | ({"oracle": {"ensemble": list(self.ensemble), "success": relative}} if self.ensemble else {})

    def markdown(self) -> list[str]:
        """Return it as paragraphs of Markdown."""
        out = []
        for other, kinds in self.differences.items():
            names = list(next(iter(kinds.values())))
            body = [(kind, *(_cell(columns[name]) for name in names)) for kind, columns in kinds.items()]
            out += [f"trained less {other}, with the 95 % interval of a paired bootstrap over targets:",
                    lines([("worlds", *names), *body])]  # fmt: skip
        if self.ensemble:
            first = next(iter(self.relative.values()))
            head = ("success in what is possible %", *(f"{k} ({r.possible} of {r.worlds})" for k, r in first.items()))
            body = [(policy, *map(_share, kinds.values())) for policy, kinds in self.relative.items()]
            out += [f"Possible is where any of {', '.join(self.ensemble)} succeeds.", lines([head, *body])]
        return out


def put_beside(
    found: Mapping[str, Episodes], against: Sequence[str], ensemble: Sequence[str], columns: Sequence[Column], seed: int
) -> Beside:
    """Return what is said of ``trained`` beside other policies, by all worlds and by kind.

    Args:
        found: Episodes of all policies in the same worlds.
        against: Policies that ``trained`` is compared with.
        ensemble: Policies that decide what is possible; none are asked if empty.
        columns: What is compared.
        seed: Of the bootstrap.
    """
    kinds = by_kind(found["trained"])
    differences = {
        other: {k: {c.name: difference(found["trained"].of(m), found[other].of(m), c, seed) for c in columns}
                for k, m in kinds.items()}
        for other in against
    }  # fmt: skip
    relative = {}
    if ensemble:
        possible = feasible([found[name] for name in ensemble])
        relative = {
            policy: {k: Relative(*relative_success(e.of(m), possible[m]), int(m.sum())) for k, m in kinds.items()}
            for policy, e in found.items()
        }  # fmt: skip
    return Beside(differences, tuple(ensemble), relative)


def _cell(d: Difference) -> str:
    return "-" if math.isnan(d.value) else f"{d.value:+.1f} [{d.low:+.1f}, {d.high:+.1f}]"


def _share(r: Relative) -> str:
    return (
        "-" if math.isnan(r.share) else "{:.1f} [{:.1f}, {:.1f}]".format(100 * r.share, *(100 * v for v in r.interval))
    )
