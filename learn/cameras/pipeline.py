"""Cameras as a source of clouds: processes side by side, the newest clouds at hand, their age bounded.

    camera process -> pictures -> (segmenter process -> key frames ->) clouds process -> clouds -> policy

All of it goes through shared memory that nobody locks (`learn.cameras.ring`), so nobody waits for anybody: a slow
segmenter makes clouds older, and an arm that is steered by them stops where they get too old.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import numpy as np

from ...sim.arms.arm import Arm
from ...sim.base.types import Array
from . import workers
from .calibration import Rig
from .frames import Clouds
from .source import Source

LIMIT = 0.3
"""Greatest age of clouds [s]."""

_END = 2.0  # s for a process to end by itself


class CameraClouds:
    """The newest clouds of a source of pictures (`learn.cameras.frames.CloudSource`).

    Attributes:
        trouble: Why there are none, in one line.
        limit: Greatest age of what `latest` returns [s].
        ages: Ages of what it returned, newest last [s], the last thousand.
    """

    def __init__(
        self, source: Source, rig: Rig, arm: Arm | None, *, limit: float = LIMIT,
        segmenter: Callable[[], workers.Segmenter], keyed: bool = False,
        tracker: Callable[[], workers.Tracker] | None = None,
    ) -> None:  # fmt: skip
        """Start the processes; returns at once.

        Args:
            source: Takes the pictures.
            rig: The cameras.
            arm: The arm that is cut out of what they see, whose joints are told by `tell`; None for none.
            limit: Greatest age of clouds [s].
            segmenter: Returns what makes masks; made in the process that uses it, so it must be picklable.
            keyed: Whether it is slow and has a process of its own, which looks at key frames.
            tracker: Returns what carries the masks of key frames on to every picture; None for nothing.
        """
        self.limit, self.trouble = limit, "no picture yet"
        self.ages: list[float] = []
        names = ("camera", "segmenter", "clouds") if keyed else ("camera", "clouds")
        self._board = workers.Board.of(source.sizes, 0 if arm is None else arm.num_dofs, names, keyed=keyed)
        own = None if keyed else segmenter
        work: dict[str, tuple[Any, ...]] = {"camera": (workers.take, source)}
        if keyed:
            work["segmenter"] = (workers.segment, segmenter)
        work["clouds"] = (workers.cloud, rig, arm, own, tracker)
        context = multiprocessing.get_context("spawn")
        self.processes = {
            name: context.Process(target=workers.run, args=(task, self._board, name, *rest), name=name, daemon=True)
            for name, (task, *rest) in work.items()
        }
        for process in self.processes.values():
            process.start()

    def __enter__(self) -> CameraClouds:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def latest(self) -> Clouds | None:
        """Return the newest clouds, None where they are older than the limit or a process has ended."""
        row = self._board.clouds.read()
        age = np.inf if row is None else time.monotonic() - float(row["time"])
        self.trouble = self._ended() or self._late(age)
        if self.trouble or row is None:
            return None
        self.ages = [*self.ages[-999:], age]
        branches, line = row["counts"]
        return Clouds(float(row["time"]), row["branches"][:branches], row["line"][:line])

    def _ended(self) -> str:
        for name, process in self.processes.items():
            if not process.is_alive():
                code = process.exitcode
                why = self._board.heard(name) or (f"killed by signal {-code}" if code and code < 0 else "ended")
                return f"{name}: {why}"
        return ""

    def _late(self, age: float) -> str:
        if age <= self.limit:
            return ""
        told = [f"{name}: {self._board.heard(name)}" for name in self.processes if self._board.heard(name)]
        late = "no clouds yet" if np.isinf(age) else f"clouds are {age:.2f} s old, more than {self.limit:g} s"
        return "; ".join([late, *told])

    def tell(self, time: float, q: Array) -> None:
        """Take joint positions [rad], [D], measured at a time of `time.monotonic` [s]; ignored without an arm."""
        if self._board.joints.read_shape("q") == (0,):
            return
        self._board.joints.write(time=time, q=q)

    def close(self) -> None:
        """End all processes. Their memory has no name, and goes with them."""
        for process in self.processes.values():
            process.terminate()
        end = time.monotonic() + _END
        for process in self.processes.values():
            process.join(max(0.0, end - time.monotonic()))
            if process.is_alive():
                process.kill()
                process.join()
        self.trouble = "closed"
