"""What a command shows while it works: progress bars, warnings, and nothing of Warp's own."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Put Ctrl-C off until the block is done.

    Compiled modules turn it into another error, or lose it, where it comes while they are imported or call back.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before in (signal.SIG_IGN, None):
        yield
        return
    pressed: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _frame: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        raise KeyboardInterrupt


@contextmanager
def bar(text: str, total: int | None) -> Iterator[Callable[[int], None]]:
    """Show a progress bar on stderr while the block runs; yield the function that advances it by so many.

    Without a ``total`` the bar only shows that something happens, and for how long. It vanishes at the end, and where
    stderr is no terminal nothing is shown.
    """
    with bars({text: total}) as advance:
        advance(text, 0)
        yield lambda count: advance(text, count)


@contextmanager
def bars(totals: Mapping[str, int | None]) -> Iterator[Callable[[str, int], None]]:
    """Show progress through stages, a bar each from when it is first reported on; otherwise as `bar`.

    Args:
        totals: Steps of every stage by what its bar says; None where the number is not known.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TextColumn, TimeElapsedColumn
    from rich.text import Text

    class Count(MofNCompleteColumn):
        def render(self, task: Task) -> Text:
            return Text() if task.total is None else super().render(task)

    console = Console(stderr=True)
    columns = [TextColumn("{task.description}"), BarColumn(), Count(), TimeElapsedColumn()]
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        tasks = {name: progress.add_task(name, total=n, visible=False, start=False) for name, n in totals.items()}
        current: list[str] = []

        def advance(stage: str, count: int) -> None:
            if current != [stage]:
                for name in current:
                    progress.stop_task(tasks[name])
                current[:] = [stage]
                progress.start_task(tasks[stage])
            progress.update(tasks[stage], advance=count, visible=True)

        yield advance


def warn(text: str) -> None:
    """Print one line of warning on stderr."""
    print(f"bough: warning: {text}", file=sys.stderr)


def start_warp(*, torch: bool = True) -> None:
    """Import Warp and, where it will be needed, torch; Ctrl-C waits meanwhile.

    Warp is initialised without its greeting and without its complaint that there is no GPU; what else it says is kept.
    """
    with uninterrupted():
        import warp as wp

        if torch:
            import_module("torch")
    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    for line in _said_by_native_code(wp.init):
        if "CUDA driver" not in line:
            print(line, file=sys.stderr)


def _said_by_native_code(call: Callable[[], object]) -> list[str]:
    """Return the lines that ``call`` writes to file descriptor 2, past Python's own ``sys.stderr``."""
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as heard:
        os.dup2(heard.fileno(), 2)
        try:
            call()
        finally:
            sys.stderr.flush()
            os.dup2(kept, 2)
            os.close(kept)
        heard.seek(0)
        return heard.read().decode(errors="replace").splitlines()


def shown(path: str | Path) -> str:
    """Return a path as the last line of a command prints it: short where it lies under the present folder."""
    absolute = Path(path).absolute()
    here = Path.cwd()
    return str(absolute.relative_to(here)) if absolute.is_relative_to(here) else str(absolute)
