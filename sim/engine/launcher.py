"""Launching group kernels: in one piece on a GPU, split over threads on a CPU."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from ...kernels.lanes.team import TEAM
from ...kernels.tree.layout import layout_of
from ..base.console import meanwhile
from ..base.header import keep_header, share_header
from ..base.host import num_threads
from ..base.thread_pool import Launches, recorded, together
from .arrays import LaneArray
from .model import Model

_SCRATCH = {
    "pose": "Quat", "r": "Vec", "relative": "Vec", "spin": "Vec", "alpha0": "Vec", "accel0": "Vec", "A": "Sym",
    "B": "Mat", "M": "Sym", "n": "Vec", "f": "Vec", "D": "Sym", "U": "Mat", "u": "Vec", "alpha": "Vec", "accel": "Vec",
    "calm": "Real",
}  # fmt: skip

#: Bytes left free between the scratch rows of two CPU threads. Rows side by side, two threads ran 1.05 times as fast as
#: one: their neighbouring lines were fetched back and forth; a page apart, 1.9 times.
APART = 4096

#: What is said while a module is compiled.
COMPILING = "compiling kernels (once for each set of laws; minutes)"

#: Threads of a block on a GPU: one warp, so that a thousand worlds occupy 32 multiprocessors instead of four.
BLOCK = TEAM


def rows_by_group(device: Any) -> bool:
    """Return whether every group has a scratch row of its own (GPU), or every thread (CPU)."""
    return bool(device.is_cuda)


def team_of(device: Any) -> int:
    """Return how many threads share what takes long in some worlds: those of a block on a GPU, one on a CPU."""
    return BLOCK if device.is_cuda else 1


class Launcher:
    """Launches kernels over the groups of a model.

    On a CPU every thread takes a run of groups and works in a scratch row of its own, which stays in its cache; Warp's
    launch releases the GIL. On a GPU every group has its row.

    Attributes:
        scratch: The kernels' working memory (`kernels.tree.layout` Scratch).
        by_group: Whether every group has a scratch row, so that several kernels in turn may make a step.
        team: `team_of` its device.
    """

    def __init__(self, model: Model, threads: int | None = None) -> None:
        self.model, self.device = model, model.device
        self.by_group, self.team = rows_by_group(self.device), team_of(self.device)
        self._block = BLOCK if self.device.is_cuda else 1
        wanted = num_threads() if threads is None else threads
        self.threads = 1 if self.by_group else max(1, min(wanted, model.groups))
        self._stride = 1 if self.threads == 1 else 1 + -(-APART // self._row_bytes(model))
        self._rows = model.groups if self.by_group else 1 + self._stride * (self.threads - 1)
        cuts = np.linspace(0, model.groups, self.threads + 1).astype(int)
        self._ranges = list(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True))
        self._fields = {name: self.field(kind) for name, kind in _SCRATCH.items()}
        self.scratch = layout_of(model.width, model.precision).Scratch()
        for name, field in self._fields.items():
            setattr(self.scratch, name, field.kernel)

    @staticmethod
    def _row_bytes(model: Model) -> int:
        """Bytes of the smallest field's row: one real a place."""
        return (model.places + 1) * model.width * model.precision // 8

    def field(
        self, kind: str, places: int | None = None, *, by_link: bool | None = None, team: int = 1
    ) -> LaneArray:  # fmt: skip
        """Return a zeroed working array, a row a thread on a CPU and a row a group on a GPU, or so many for a team.

        With ``by_link`` false a row's places lie side by side on a GPU, too: for what a team works on together.
        """
        m = self.model
        count, rows = m.places + 1 if places is None else places, self._rows * team
        shape: dict[str, Any] = {"width": m.width, "precision": m.precision, "device": self.device}
        return LaneArray(kind, rows, count, by_link=by_link, **shape)

    @property
    def nbytes(self) -> int:
        """Bytes of the scratch memory."""
        return sum(f.nbytes for f in self._fields.values())

    def prepare(
        self, kernel: Any, before: Sequence[Any], after: Sequence[Any], *, split: bool = True
    ) -> Callable[[], None]:
        """Return a function that launches ``kernel(*before, scratch, first, row, *after)`` over all groups.

        Launches are recorded once, so that a call costs microseconds and allocates nothing. With ``split`` false all
        groups run on the calling thread, as a graph capture needs.
        """
        load(kernel.module, self.device, self._block)
        ranges = self._ranges if split else [(0, self.model.groups)]
        commands = [
            recorded(
                kernel,
                b - a,
                [*before, self.scratch, a, -1 if self.by_group else row * self._stride, *after],
                self.device,
                self._block,
            )
            for row, (a, b) in enumerate(ranges)
        ]
        return together([[c] for c in commands])

    def prepare_parts(self, parts: Sequence[tuple[Any, int | None, Sequence[Any]]]) -> Callable[[], None]:
        """Return a function that launches kernels over all groups one after the other, where rows are by group.

        Args:
            parts: Kernels with the threads that each group has, None for one (the kernel has one dimension then), and
                all their arguments.
        """
        commands, groups = [], self.model.groups
        for kernel, team, inputs in parts:
            load(kernel.module, self.device, self._block)
            dim = groups if team is None else (groups, team)
            commands.append(recorded(kernel, dim, inputs, self.device, self._block))
        return Launches(commands)


def load(module: Any, device: Any, block: int) -> None:
    """Load a kernel's module as launches do, and say so where it must be compiled, which takes up to minutes."""
    wp.init()  # the cache has its place from then on
    share_header()
    kept = Path(str(wp.config.kernel_cache_dir)) / module.get_module_identifier(block)
    if any(kept.glob("*.o" if device.is_cpu else "*.sm*")):
        module.load(device, block_dim=block)
        return
    with meanwhile(COMPILING):
        module.load(device, block_dim=block)
    keep_header()


class Recorded:
    """Launches that are recorded for the arrays they are given, and anew when other memory is given.

    Packing a launch's arguments takes longer than a small kernel runs.
    """

    def __init__(self, record: Callable[..., list[Any]]) -> None:
        """Take what returns recorded launches (`warp.Launch`) for arrays."""
        self._record = record
        self._given: tuple[wp.array, ...] = ()
        self._launches = Launches([])

    def __call__(self, *given: wp.array) -> None:
        """Launch for these arrays, which are kept until others come."""
        if [(a.ptr, a.shape) for a in given] != [(a.ptr, a.shape) for a in self._given]:
            self._given, self._launches = given, Launches(self._record(*given))
        self._launches()
