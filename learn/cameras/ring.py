"""Numbers that go from one process to others through shared memory, without a lock, a name or a queue.

One process writes, any read. The memory is anonymous (`multiprocessing.RawArray`: a file that is unlinked before it is
used), so nothing of it is left behind, however its processes end. A writer that is killed in the midst of a write
leaves the slots before it as they were: what counts the writes is raised last.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Fields = Mapping[str, tuple[str, tuple[int, ...]]]


class Ring:
    """The newest of what one process writes, for others to read; sent to them as an argument of `Process`."""

    def __init__(self, fields: Fields, slots: int = 4) -> None:
        """Allocate, all zero.

        Args:
            fields: Type and shape of each array of a write, by name.
            slots: Writes that are kept; a reader must not take longer than as many writes but one.
        """
        self._type = np.dtype([(name, kind, shape) for name, (kind, shape) in fields.items()])
        self._slots = slots
        context = multiprocessing.get_context("spawn")
        self._memory: Any = context.RawArray("b", self._type.itemsize * slots)
        self._count: Any = context.RawArray("q", 1)

    def _rows(self) -> NDArray[Any]:
        return np.frombuffer(self._memory, self._type)

    @property
    def count(self) -> int:
        """Number of writes so far."""
        return int(self._count[0])

    def read_shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a field."""
        return self._type[name].shape

    def write(self, **values: Any) -> None:
        """Write all fields, as the next; only one process may."""
        row = self._rows()[self.count % self._slots]
        for name, value in values.items():
            row[name] = value
        self._count[0] += 1

    def read(self) -> dict[str, Any] | None:
        """Return a copy of the newest write, None before the first."""
        while True:
            number = self.count
            if not number:
                return None
            row = self._rows()[(number - 1) % self._slots].copy()
            if self.count - number < self._slots - 1:  # nobody has begun to write over it
                return {name: row[name] for name in self._type.names or ()}

    def history(self) -> NDArray[Any]:
        """Return a copy of all writes that are kept and whole, oldest first, as a structured array."""
        number = self.count
        rows = self._rows().copy()
        first = max(0, self.count - self._slots + 1)  # the slot after the newest may be in the midst of a write
        return rows[[k % self._slots for k in range(first, number)]]
