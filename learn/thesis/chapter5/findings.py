"""Everything that a reproduction of chapter 5 finds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from ...policies.evaluate import Row
from ..common.interval import Interval, interval
from . import embedding
from .runs import Options, Run


@dataclass
class Findings:
    """Everything the report is made of.

    Attributes:
        options: Size of the reproduction.
        rows: What every run came to on the test sets, by policy (``trained``, and for some ``zero`` and ``random``).
        metrics: Numbers of every iteration of the runs of table 5.2.
        minutes: Time that every run spent in its iterations [min].
        times: Of the embeddings.
        config: Of the final model's run: settings, versions, machine.
        seconds: Wall time of every stage now; less than it takes where a run was gone on with.
    """

    options: Options
    rows: dict[Run, dict[str, Row]] = field(default_factory=dict)
    metrics: dict[Run, list[dict[str, float | None]]] = field(default_factory=dict)
    minutes: dict[Run, float] = field(default_factory=dict)
    times: list[embedding.EmbeddingTime] = field(default_factory=list)
    config: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    def trained(self, run: Run) -> list[Row]:
        """Return what a run's own policies came to, one of every seed."""
        return [self.rows[replace(run, repeat=k)]["trained"] for k in range(self.options.seeds)]

    def mean(self, run: Run, column: str) -> Interval:
        """Return the mean of a column over the seeds, and its interval."""
        return interval([row.mean(column) for row in self.trained(run)])

    def train_return(self, run: Run) -> Interval:
        """Return the mean of Train Rew over the seeds, and its interval."""
        return interval([row.train_return for row in self.trained(run)])
