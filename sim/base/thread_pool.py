"""Recorded launches: in turn, or on all cores by threads that wait for the next ones a while before they sleep."""

from __future__ import annotations

import ctypes
import os
import threading
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from ...kernels.lanes.thread_pool import DONE, JOB, POSTED, WORDS, follow, lead
from .host import num_cores

#: How long a thread looks for its next launches before it sleeps, and the caller for the others' end [s]. To wake a
#: thread takes about as long, so that waiting costs at most twice what the better of both choices would.
PATIENCE = 5.0e-4


def recorded(kernel: Any, dim: Any, inputs: Sequence[Any], device: Any, block: int | None = None) -> Any:
    """Return a launch (`warp.Launch`) that is not made now; it keeps the arrays that it is given.

    Args:
        kernel: Warp kernel.
        dim: Threads.
        inputs: All arguments of the kernel.
        device: Warp device.
        block: Threads of a block; None takes Warp's default.
    """
    size: dict[str, Any] = {} if block is None else {"block_dim": block}
    return wp.launch(kernel, dim=dim, inputs=list(inputs), device=device, record_cmd=True, **size)


class Launches:
    """Recorded launches of one device that run one after the other where they are called, inside a graph capture too.

    On a CPU kernels are called with arguments packed once: Warp packs them at every launch, which takes longer than a
    small kernel runs.
    """

    def __init__(self, commands: Sequence[Any]) -> None:
        """Take recorded launches (`warp.Launch`)."""
        self._commands = commands
        self._calls = [_Call(c) for c in commands if c.device.is_cpu]

    def __call__(self) -> None:
        """Launch them."""
        if self._calls and not self._commands[0].device.is_capturing:
            for call in self._calls:
                call()
        else:
            for command in self._commands:
                command.launch()


class Job(Launches):
    """Recorded launches on a CPU that one thread runs in their order.

    Attributes:
        address: Of what `kernels.lanes.thread_pool` runs; valid as long as this lives.
    """

    def __init__(self, commands: Sequence[Any]) -> None:
        """Take launches that were recorded with ``block_dim=1``."""
        super().__init__(commands)
        entries = [len(commands), *(a for call in self._calls for a in call.addresses)]
        self._entries = np.array(entries, np.int64)
        self.address = self._entries.ctypes.data


class _Call:
    """A recorded launch as a plain call of the compiled kernel, ``kernel(bounds, arguments)``."""

    def __init__(self, command: Any) -> None:
        if command.block_dim > 1:
            raise ValueError(f"{command.kernel.key}: block_dim {command.block_dim}, where threads take 1")
        given, self._command = command.params[1:], command  # which keeps the arrays
        self._kernel, self._bounds = command.hooks.forward, command.params[0]
        self._arguments = _structure(tuple(type(v) for v in given))(*given)

    @property
    def addresses(self) -> tuple[int, int, int]:
        """Where kernel, bounds and arguments are."""
        kernel = ctypes.cast(self._kernel, ctypes.c_void_p).value
        assert kernel is not None
        return kernel, ctypes.addressof(self._bounds), ctypes.addressof(self._arguments)

    def __call__(self) -> None:
        self._kernel(ctypes.byref(self._bounds), ctypes.byref(self._arguments))


@lru_cache
def _structure(types: tuple[Any, ...]) -> Any:
    """Return the structure that a compiled kernel takes its arguments in."""
    fields = [(f"argument{k}", kind) for k, kind in enumerate(types)]
    return type("Arguments", (ctypes.Structure,), {"_fields_": fields})


def together(parts: Sequence[Sequence[Any]]) -> Callable[[], None]:
    """Return a function that runs lists of recorded launches at the same time; one list runs where it is called.

    Threads take launches on a CPU, outside a graph capture; a list alone may be of any device.
    """
    if len(parts) == 1:
        return Launches(parts[0])
    jobs = [Job(part) for part in parts]
    return lambda: run(jobs)


def run(jobs: Sequence[Job]) -> None:
    """Run jobs at the same time, the first on the calling thread; return when all are done.

    Where another thread of the process is at this already, all run here, one after the other.
    """
    _pool(os.getpid()).run(jobs)


@lru_cache(maxsize=1)
def _pool(_process: int) -> _Pool:
    """Return the pool of a process: threads do not live on in a forked one."""
    return _Pool(num_cores() - 1)


class _Pool:
    """Threads beside the calling one; see `kernels.lanes.thread_pool` for what they share."""

    def __init__(self, threads: int) -> None:
        self._array = wp.zeros((max(1, threads), WORDS), dtype=wp.int64, device="cpu")
        self._own = wp.zeros(1, dtype=wp.int64, device="cpu")
        self._words, self._first = self._array.numpy(), self._own.numpy()
        self._busy = threading.Lock()
        self._awake = [threading.Condition() for _ in range(threads)]
        self._asleep = [False] * threads
        self._turns = self._looks()
        self._leads = [self._record(lead, n, self._own) for n in range(threads + 1)]
        for row in range(threads):
            given = (row, self._record(follow, row))
            threading.Thread(target=self._work, args=given, name=f"bough {row}", daemon=True).start()

    def _record(self, kernel: Any, rows: int, *more: Any) -> _Call:
        inputs = [self._array, rows, *more, self._turns]
        return _Call(recorded(kernel, 1, inputs, "cpu", block=1))

    def _looks(self) -> int:
        """Return how many looks fill `PATIENCE`."""
        self._turns = 20_000
        wait = self._record(follow, 0)
        begun = time.perf_counter()
        wait()
        return max(1, int(self._turns * PATIENCE / (time.perf_counter() - begun)))

    def _work(self, row: int, wait_and_run: _Call) -> None:
        """Follow a row for ever."""
        words = self._words[row]
        while True:
            wait_and_run()
            with self._awake[row]:
                self._asleep[row] = True
                while words[POSTED] == words[DONE]:
                    self._awake[row].wait()
                self._asleep[row] = False

    def run(self, jobs: Sequence[Job]) -> None:
        """Run jobs at once and return when all are done; one after the other where the pool is busy or too small."""
        if len(jobs) > len(self._awake) + 1 or not self._busy.acquire(blocking=False):
            for job in jobs:
                job()
            return
        try:
            self._first[0] = jobs[0].address
            for row, job in enumerate(jobs[1:]):
                self._post(row, job)
            self._leads[len(jobs) - 1]()
        finally:
            self._wait(len(jobs) - 1)
            self._busy.release()

    def _post(self, row: int, job: Job) -> None:
        with self._awake[row]:
            self._words[row, JOB] = job.address
        with self._awake[row]:  # the lock between both keeps their order on processors that may change it
            self._words[row, POSTED] += 1
            if self._asleep[row]:
                self._awake[row].notify()

    def _wait(self, rows: int) -> None:
        """Wait until all rows are done, whatever interrupts: threads work on memory that the caller may free."""
        interrupted, begun = None, time.perf_counter()
        while (self._words[:rows, POSTED] != self._words[:rows, DONE]).any():
            try:
                time.sleep(min(2.0e-3, 0.05 * (time.perf_counter() - begun)))
            except KeyboardInterrupt as stop:
                interrupted = stop
        if interrupted is not None:
            raise interrupted
