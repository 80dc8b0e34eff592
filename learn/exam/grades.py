"""Verdicts scored against what was hidden: one table for branches and for measured joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..gap import TOLERANCE

Criterion = tuple[str, tuple[float, float, float], bool]
#: Wanted at 1, 3 and 5 % noise (issue's table): (criterion, bounds, whether more is better).
WANTED: tuple[Criterion, ...] = (
    ("right name first, visible single effects", (0.92, 0.88, 0.78), True),
    ("right name in the reported set", (0.97, 0.95, 0.90), True),
    ("wrong name asserted, all cases", (0.05, 0.05, 0.08), False),
    ("false alarm on null", (0.05, 1 / 30, 1 / 30), False),
    ("outside the list: unknown", (0.85, 0.80, 0.60), True),
    ("pairs: both named", (0.60, 0.55, 0.40), True),
    ("pairs: at least one and none wrong", (0.85, 0.80, 0.70), True),
    ("right joint, given the right name", (0.90, 0.90, 0.80), True),
    ("held-out gap shrinks by (median)", (6.0, 4.0, 3.0), True),
    ("gap after over noise floor (median)", (1.5, 1.3, 1.3), False),
)
LEVELS = (0.01, 0.03, 0.05)

#: Of measured joints, at any noise: one bound each, and how often the interval of a parameter holds the truth.
WANTED_JOINTS: tuple[Criterion, ...] = (
    *((name, (bounds[1], bounds[1], bounds[1]), more) for name, bounds, more in WANTED),
    ("intervals of named parameters that hold the truth (98 % at most)", (0.9, 0.9, 0.9), True),
)


Table = dict[str, tuple[float | None, int]]


def grades(results: Sequence[dict[str, Any]], wanted: Sequence[Criterion] = WANTED) -> Table:
    """Return every criterion's value and from how many cases it is, None where there is none."""
    kinds = {k: [r for r in results if r["kind"] == k] for k in ("null", "single", "pair", "outside")}
    visible, pairs = ([r for r in kinds[k] if r["truth"]["visible_gap"] > r["noise"]] for k in ("single", "pair"))
    outside = [r for r in kinds["outside"] if r["truth"]["visible_gap"] > r["noise"]]
    shrunk = [r["verdict"]["gap"] for r in (*visible, *pairs)
              if r["verdict"]["gap"]["base"] > 3.0 * r["verdict"]["gap"]["noise_floor"]]  # fmt: skip
    named = [r for r in visible if _right_first(r) and r["truth"]["effects"][0]["joint"] is not None]
    values = (
        _share(visible, _right_first),
        _share(visible, _in_set),
        _share(results, _asserts_wrong),
        _share(kinds["null"], _false_alarm),
        _share(outside, lambda r: r["verdict"]["verdict"] == "unknown"),
        _share(pairs, _both),
        _share(pairs, lambda r: bool(names_of(r)) and not _asserts_wrong(r)),
        _share(named, _joint_right),
        _median([g["base"] / g["repaired"] for g in shrunk]),
        _median([g["repaired"] / g["noise_floor"] for g in shrunk]),
        _share(_intervals(results), lambda r: bool(r["low"] <= r["truth"] <= r["high"])),
    )
    return {name: value for (name, _, _), value in zip(wanted, values, strict=False)}


def _intervals(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the intervals of rightly named effects' parameters whose true values are known."""
    out = []
    for r in results:
        hidden = {(e["name"], e["joint"]): e["params"] for e in r["truth"]["effects"]}
        for e in r["verdict"]["effects"]:
            known = hidden.get((e["name"], e["joint"]), {})
            out += [{**e["parameters"][n], "truth": x} for n, x in known.items() if n in e["parameters"]]
    return out


def _share(cases: Sequence[dict[str, Any]], holds: Callable[[dict[str, Any]], bool]) -> tuple[float | None, int]:
    return (sum(map(holds, cases)) / len(cases) if cases else None), len(cases)


def _median(values: Sequence[float]) -> tuple[float | None, int]:
    return (float(np.median(values)) if values else None), len(values)


def names_of(result: dict[str, Any]) -> list[str]:
    """Return the names that a verdict asserts."""
    return [e["name"] for e in result["verdict"]["effects"]]


def _accepted(result: dict[str, Any]) -> set[str]:
    truth = result["truth"]
    names = {e["name"] for e in truth["effects"]}
    return names | {n for e in names for n in truth["equivalents"].get(e, [])}


def _is_right(result: dict[str, Any], name: str) -> bool:
    return name in _accepted(result)


def _right_first(result: dict[str, Any]) -> bool:
    return any(_is_right(result, n) for n in names_of(result)[:1])


def _in_set(result: dict[str, Any]) -> bool:
    reported = {*names_of(result), *(n for v in result["verdict"]["alternatives"].values() for n in v)}
    return bool(reported & _accepted(result))


def _asserts_wrong(result: dict[str, Any]) -> bool:
    return any(not _is_right(result, n) for n in names_of(result))


def _false_alarm(result: dict[str, Any]) -> bool:
    """Return whether a case with nothing hidden is told to lack something.

    Where wrong geometry and mountings alone leave more than the tolerance, something is wrong with the model, so that
    only a name is an alarm there.
    """
    if result["truth"].get("measurement_gap", 0.0) > TOLERANCE:
        return bool(names_of(result))
    return bool(result["verdict"]["verdict"] != "none")


def _both(result: dict[str, Any]) -> bool:
    truth, named = result["truth"], set(names_of(result))
    return all(named & {e["name"], *truth["equivalents"].get(e["name"], [])} for e in truth["effects"])


def _joint_right(result: dict[str, Any]) -> bool:
    return bool(result["verdict"]["effects"][0]["joint"] == result["truth"]["effects"][0]["joint"])


def as_text(table: Table, noise: float | None, wanted: Sequence[Criterion] = WANTED) -> str:
    """Return the table as Markdown, with what is wanted at the nearest of the three noise levels.

    ``noise`` is None for joints, whose sensors differ from case to case.
    """
    level = 1 if noise is None else int(np.argmin([abs(noise - x) for x in LEVELS]))
    title = "measured joints" if noise is None else f"{100 * noise:g} % noise"
    lines = [f"| {title} | wanted | reached | cases |", "|---|---|---|---|"]
    for name, bounds, more in wanted:
        value, count = table[name]
        share = "shrinks" not in name and "floor" not in name
        bound = f"{100 * bounds[level]:.0f} %" if share else f"{bounds[level]:g}"
        reached = "-" if value is None else (f"{100 * value:.0f} %" if share else f"{value:.2f}")
        lines.append(f"| {name} | {'>=' if more else '<='} {bound} | {reached} | {count} |")
    return "\n".join(lines)
