"""Columns of the tables of tests, by kind of task, and what reports call measures; torch is not needed here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from .parts import Column

CLEARING_COLUMNS = (
    Column("Test Rew", "return"), Column("Test SR %", "success", 100.0), Column("Occ Drop %", "occlusion_drop", 100.0),
    Column("Touch %", "breach", 100.0), Column("Steps in Succ", "steps_clear", of_successes=True),
)  # fmt: skip
"""Of a clearing task, as table 5.2 calls them; it has Train Rew and Trials before."""

REACH_COLUMNS = (
    Column("Test Rew", "return"), Column("Test SR %", "success", 100.0, interval=True), Column("Force N", "force"),
    Column("Above 80 N %", "rupture", 100.0), Column("Steps %", "duration", 100.0), Column("Off cm", "distance", 100.0),
    Column("Broken", "broken"), Column("Rolling %", "rolling", 100.0), Column("Retracting %", "retracting", 100.0),
    Column("Slowing %", "slowing", 100.0),
)  # fmt: skip
"""Of ``reach``: success raw, mean contact force and share of steps above 80 N whether or not the target was reached,
time to the target as a share of the step limit (all of it for a failure), distance at the end, joints broken where the
wood has a strength, and what the arm does, shares of steps (`kernels.tasks.reach.behave`)."""


class Label(NamedTuple):
    """What reports call a measure, its unit, the label of its axis, what it is times, and what else is said of it."""

    name: str
    unit: str
    axis: str
    scale: float = 1.0
    says: str = ""


LABELS = {
    "return": Label("Return", "", "return of an episode"),
    "success": Label("Success", "%", "success [%]", 100.0),
    "occlusion_drop": Label("Occlusion drop", "%", "occlusion drop [%]", 100.0),
    "breach": Label(
        "Inside the margin", "%", "steps inside the margin [%]", 100.0, "Share of steps; less is better."
    ),
    "force": Label("Contact force", "N", "mean contact force [N]", 1.0, "Mean over all steps; less is better."),
    "rupture": Label("Above 80 N", "%", "steps above 80 N [%]", 100.0, "Share of steps; less is better."),
}  # fmt: skip
"""Labels of known measures."""


def label_of(name: str) -> Label:
    """Return the label of a measure; one that is not known goes by its own name."""
    return LABELS.get(name, Label(name, "", name))


def measures_of(rows: Sequence[Mapping[str, float | None]]) -> list[str]:
    """Return the measures among the columns of ``metrics.csv``: known ones first, in the order of `LABELS`."""
    names = list(rows[0]) if rows else list(LABELS)
    own = names[names.index("reward") + 1 :] if "reward" in names else names
    own = own[: next((k for k, name in enumerate(own) if name.endswith("_loss")), len(own))]
    order = list(LABELS)
    return sorted(own, key=lambda name: (name not in LABELS, order.index(name) if name in LABELS else 0))
