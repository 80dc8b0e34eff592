"""When to stop: the verdict is settled, nothing more can be told, or the budget is spent.

A verdict is settled when two rounds in a row, the second with at least one recording more, give the same one, and

- ``effects``: the same names, ahead of every model with other names by `CLEAR` in the information criterion in both
  rounds, and, where the user asks, an interval that is narrow enough;
- ``none``: an effect that changes the motion by `rounds.MATTERS` would have been seen with a probability of `POWER`,
  for half of the names at least (some change a pull at one point in ways that springs can imitate);
- ``unknown``: no pull on the menu is expected to tell the preferred model from its rival by `next_probe.ENOUGH`.

Two rounds: a name that one recording can overturn is none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..gap.next_probe import ENOUGH
from .rounds import CLEAR, MATTERS, Finding

POWER = 0.9


def settled(findings: Sequence[Finding], width: float | None = None) -> str | None:
    """Return in words why the verdict is settled, None where it is not.

    Args:
        findings: Of all rounds so far, in order.
        width: Half width of the first effect's interval over its value that is asked for, None for any.
    """
    if len(findings) < 2 or findings[-1].reason or findings[-2].reason:
        return None
    before, last = findings[-2:]
    if before.verdict != last.verdict or set(before.names) != set(last.names):
        return None
    return {"effects": _named, "none": _none, "unknown": _unknown}[last.verdict](before, last, width)


def _named(before: Finding, last: Finding, width: float | None) -> str | None:
    if min(before.lead, last.lead) < CLEAR or (width is not None and last.width > width):
        return None
    return f"{' and '.join(last.effects)} twice in a row, ahead of {_other(last)} by {last.lead:.0f}"


def _none(_before: Finding, last: Finding, _width: float | None) -> str | None:
    power = last.power or {}
    seen = [name for name, p in power.items() if p >= POWER]
    if not power or float(np.median(list(power.values()))) < POWER:
        return None
    hidden = sorted(set(power) - set(seen))
    more = f"; not so sure of {', '.join(hidden)}" if hidden else ""
    return f"nothing twice in a row; {100 * MATTERS:.0f} % of the motion would have been seen by {len(seen)} laws{more}"


def _unknown(_before: Finding, last: Finding, _width: float | None) -> str | None:
    if last.gain >= ENOUGH:
        return None
    return f"unknown twice in a row, and no pull would tell more (the best adds {last.gain:.1f})"


def _other(finding: Finding) -> str:
    return " and ".join(finding.rival) or "no effect"
