"""What goes with a diagnosis through all its stages: settings, checkpoint, progress and wall time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from ..runs.checkpoint import Checkpoint
from .diagnosis import Settings

Progress = Callable[[str, int], None]
#: Stages in the order in which they report progress.
STAGES = ("base", "scan", "fits", "evidence", "sampling")


def silent(stage: str, done: int) -> None:
    """Report nothing."""


@dataclass
class Run:
    """A diagnosis under way.

    Attributes:
        settings: How to diagnose.
        keep: Where to keep what has been reached.
        progress: Called with a stage of `STAGES` and the number of steps done.
        seconds: Wall time of each stage so far.
    """

    settings: Settings
    keep: Checkpoint = field(default_factory=Checkpoint)
    progress: Progress = silent
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the wall time of a block to a stage."""
        begun = time.perf_counter()
        yield
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begun
