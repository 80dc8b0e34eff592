"""Pieces of work that do not need each other, several at a time, each in a process of its own."""

from __future__ import annotations

import errno
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, TypeVar

from ...sim.base.console import start_warp
from ...sim.base.host import num_threads

Item = TypeVar("Item")
Result = TypeVar("Result")
Advance = Callable[[int], None]

#: Most jobs where a command does not say: each may take a gigabyte.
MOST = 4
#: Time between looks at what the processes report [s].
LOOK = 0.2
#: Most reports that are read between two looks at what is done: workers may count faster than they are heard.
HEARD = 1000
#: Where a worker's steps go.
_steps: Any = None


def usual_jobs(device: str) -> int:
    """Return how many jobs share a device where a command does not say: a thread each on a CPU, one on a GPU."""
    return min(num_threads(), MOST) if device == "cpu" else 1


def side_by_side(
    work: Callable[[Item, Advance], Result], items: Sequence[Item], jobs: int, advance: Advance
) -> Iterator[Result]:
    """Yield what ``work`` returns for every item as it comes; with one job in order, and in this process.

    The threads that this process may take (`sim.base.host.num_threads`) are shared among the jobs.

    Args:
        work: A function of a module, called with an item and with what counts its steps.
        items: What is worked on.
        jobs: How many at a time.
        advance: Called in this process with steps done since the last call.

    Raises:
        ChildProcessError: A process was killed, so that its item will never come.
        Exception: Whatever ``work`` raises.
    """
    if jobs == 1:
        yield from (work(item, advance) for item in items)
        return
    context = multiprocessing.get_context("spawn")
    steps = context.SimpleQueue()
    with _threads_shared(jobs), ProcessPoolExecutor(jobs, context, _begin, (steps,)) as pool:
        try:
            yield from _as_they_come([pool.submit(_do, work, item) for item in items], steps, advance)
        except BrokenProcessPool:
            said = "a process was killed, for memory perhaps; the same command, with --resume if it has that, goes on"
            raise ChildProcessError(errno.ECHILD, said) from None
        finally:  # after an error or Ctrl-C nothing is waited for
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in multiprocessing.active_children():
                worker.terminate()


def _as_they_come(left: Sequence[Future[Result]], steps: Any, advance: Advance) -> Iterator[Result]:
    waiting = set(left)
    while waiting:
        done, waiting = wait(waiting, LOOK, FIRST_COMPLETED)
        for _ in range(HEARD):
            if steps.empty():
                break
            advance(steps.get())
        for future in done:
            yield future.result()


@contextmanager
def _threads_shared(jobs: int) -> Iterator[None]:
    """Let processes that begin in the block take a job's share of the threads."""
    name = "OMP_NUM_THREADS"
    before, share = os.environ.get(name), max(1, num_threads() // jobs)
    os.environ[name] = str(share)
    try:
        yield
    finally:
        os.environ.pop(name) if before is None else os.environ.update({name: before})


def _begin(steps: Any) -> None:
    """Begin a worker: Ctrl-C is its parent's to answer, which ends it; one whose parent was killed ends too."""
    global _steps
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _steps = steps
    start_warp()


def _end_with_parent() -> None:
    """End this process when its parent is gone: who goes on with the work would meet it in the same folders."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)


def _do(work: Callable[[Item, Advance], Result], item: Item) -> Result:
    return work(item, _steps.put)
