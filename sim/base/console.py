"""What a command shows while it works: progress bars, warnings, and nothing of Warp's own."""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Put Ctrl-C off until the block is done, and SIGTERM where it is taken as Ctrl-C.

    Compiled modules turn it into another error, or lose it, where it comes while they are imported or call back; and
    what is written in steps that belong together must not end between them.
    """
    held = _handlers() if threading.current_thread() is threading.main_thread() else {}
    pressed: list[int] = []
    for number in held:
        signal.signal(number, lambda caught, _frame: pressed.append(caught))
    try:
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
    if pressed:
        raise KeyboardInterrupt


def _handlers() -> dict[int, Any]:
    """Return the handlers of the signals that end a command as Ctrl-C does."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    return {number: handler for number, handler in handlers.items()
            if handler is signal.default_int_handler
            or (number == signal.SIGINT and handler not in (signal.SIG_IGN, None))}  # fmt: skip


@contextmanager
def first_ctrl_c_told() -> Iterator[Callable[[], bool]]:
    """Yield what tells whether Ctrl-C was pressed in the block; only a second one raises ``KeyboardInterrupt``.

    For loops that share locks with other threads: an exception in the midst of them may leave one locked. Does nothing
    outside of a process's main thread, and where Ctrl-C is ignored.
    """
    before = signal.getsignal(signal.SIGINT)
    taken = threading.current_thread() is threading.main_thread() and before is signal.default_int_handler
    pressed: list[int] = []

    def note(number: int, _frame: object) -> None:
        """Note that Ctrl-C was pressed, and let the next one interrupt as before."""
        pressed.append(number)
        signal.signal(signal.SIGINT, before)

    if taken:
        signal.signal(signal.SIGINT, note)
    try:
        yield lambda: bool(pressed)
    finally:
        if taken:
            signal.signal(signal.SIGINT, before)


@contextmanager
def dropped_ctrl_c_raised_again() -> Iterator[None]:
    """Send Ctrl-C again, in the block, where Python dropped it.

    ``KeyboardInterrupt`` that comes up while an object is finalised or native code calls back is printed and forgotten
    (`sys.unraisablehook`), and the command would go on.
    """
    before = sys.unraisablehook

    def hook(dropped: sys.UnraisableHookArgs) -> None:
        """Pass on what Python dropped, but send Ctrl-C again 10 ms later."""
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            return before(dropped)
        again = threading.Timer(0.01, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT))
        again.daemon = True
        again.start()  # a little later, when what drops it is over

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before


@contextmanager
def bar(text: str, total: int | None) -> Iterator[Callable[[int], None]]:
    """Show a progress bar on stderr while the block runs; yield the function that advances it by so many.

    Without a ``total`` the bar only shows that something happens, and for how long. It vanishes at the end. Where
    stderr is no terminal, plain lines stand for it (`bars`).
    """
    with bars({text: total}) as advance:
        advance(text, 0)
        yield lambda count: advance(text, count)


#: Seconds between plain lines, and before the first: what is done sooner says nothing.
EVERY = 10.0
#: Seconds after which what happens meanwhile has a plain line.
SOON = 2.0
#: What is called with a text, and with None once it is over, while a command shows its progress (`meanwhile`).
_listening: list[Callable[[str | None], None]] = []


@contextmanager
def bars(totals: Mapping[str, int | None]) -> Iterator[Callable[[str, int], None]]:
    """Show progress through stages, a bar each from when it is first reported on; otherwise as `bar`.

    Where stderr is no terminal (a pipe, a log file) there is a plain line every `EVERY` seconds, and one where a stage
    ends or begins after the first such line.

    Args:
        totals: Steps of every stage by what its bar says; None where the number is not known.
    """
    from rich.console import Console

    console = Console(stderr=True)
    with _drawn(totals, console) if console.is_terminal else _written(totals) as (advance, listener):
        _listening.append(listener)
        try:
            yield advance
        finally:
            _listening.remove(listener)


@contextmanager
def meanwhile(text: str) -> Iterator[None]:
    """Say under a command's progress what takes so long while the block runs; say nothing outside of a command."""
    said = _listening[-1] if _listening else None
    if said is not None:
        said(text)
    try:
        yield
    finally:
        if said is not None:
            said(None)


Shown = tuple[Callable[[str, int], None], Callable[[str | None], None]]


@contextmanager
def _drawn(totals: Mapping[str, int | None], console: Any) -> Iterator[Shown]:
    """Draw bars on a terminal."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TextColumn, TimeElapsedColumn
    from rich.text import Text

    class Count(MofNCompleteColumn):
        """How many of a stage's items are done; nothing where their number is not known."""

        def render(self, task: Task) -> Text:
            """Return the count as text, empty for a stage without a total."""
            return Text() if task.total is None else super().render(task)

    columns = [TextColumn("{task.description}"), BarColumn(), Count(), TimeElapsedColumn()]
    with Progress(*columns, console=console, transient=True) as progress:
        tasks = {name: progress.add_task(name, total=n, visible=False, start=False) for name, n in totals.items()}
        aside = progress.add_task("", total=None, visible=False, start=False)
        current: list[str] = []

        def advance(stage: str, count: int) -> None:
            """Add to a stage's bar; stop the clock of the stage before and start its own when it begins."""
            if current != [stage]:
                for name in current:
                    progress.stop_task(tasks[name])
                current[:] = [stage]
                progress.start_task(tasks[stage])
            progress.update(tasks[stage], advance=count, visible=True)

        def listen(text: str | None) -> None:
            """Show what happens meanwhile as a line of its own, or take that away."""
            progress.reset(aside, start=text is not None, description=text or "", visible=text is not None)

        yield advance, listen


@contextmanager
def _written(totals: Mapping[str, int | None]) -> Iterator[Shown]:
    """Write plain lines on stderr."""
    begun, names = time.monotonic(), list(totals)
    done = dict.fromkeys(totals, 0)
    now, last, told = [names[0]], [begun], [False]  # stage under way, time of the last line, whether it has one
    waiting: list[threading.Timer] = []
    aside: list[str] = []  # what happens meanwhile
    ended = threading.Event()

    def write(text: str) -> None:
        """Write a line with the seconds since the beginning."""
        last[0] = time.monotonic()
        print(f"bough: {last[0] - begun:.0f} s: {text}", file=sys.stderr, flush=True)

    def tell() -> None:
        """Write the stage under way and how far it is."""
        stage, told[0] = now[0], True
        of = "" if totals[stage] is None else f" of {totals[stage]}"
        write(f"{stage}, {done[stage]}{of}" if done[stage] else stage)

    def advance(stage: str, count: int) -> None:
        """Add to a stage's count; tell when `EVERY` seconds have passed or a stage that was told gives way."""
        changed, now[0] = stage != now[0], stage
        done[stage] += count
        if time.monotonic() - last[0] >= EVERY or (changed and told[0]):
            tell()
        at = names.index(stage) + 1
        if done[stage] == totals[stage] and at < len(names):
            now[0] = names[at]

    def beat() -> None:
        """Write a line after every `EVERY` seconds of silence, until the end."""
        while not ended.wait(EVERY or 1.0):
            if time.monotonic() - last[0] >= 0.99 * EVERY:
                write(aside[0]) if aside else tell()

    def listen(text: str | None) -> None:
        """Write what happens meanwhile after `SOON` seconds, unless it is over before."""
        aside[:] = [] if text is None else [text]
        while waiting:
            waiting.pop().cancel()
        if text is not None:
            waiting.append(threading.Timer(SOON, write, [text]))
            waiting[0].daemon = True
            waiting[0].start()

    threading.Thread(target=beat, daemon=True).start()
    try:
        yield advance, listen
    finally:
        ended.set()


def warn(text: str) -> None:
    """Print one line of warning on stderr."""
    print(f"bough: warning: {text}", file=sys.stderr)


def start_warp(*, torch: bool = True) -> None:
    """Import Warp and, where it will be needed, torch; Ctrl-C waits meanwhile.

    Warp is initialised without its greeting and without its complaints that there is no GPU and that it will not run on
    Python 3.10 for ever, which the page of install tells; what else it says is kept.
    """
    with uninterrupted():
        import warp as wp

        from .header import share_header

        if torch:
            import_module("torch")
    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    for line in _said_by_native_code(wp.init):
        if "CUDA driver" not in line and "Support for Python 3.10" not in line:
            print(line, file=sys.stderr)
    share_header()


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


def tell(text: str, result: Mapping[str, Any] | Path, as_json: bool) -> None:
    """Print what a command has come to: a text for people, or its result as JSON for programs.

    Args:
        text: What people read.
        result: What programs read, or the JSON file that holds it.
        as_json: Whether a program reads.
    """
    if as_json:
        text = result.read_text() if isinstance(result, Path) else json.dumps(result, indent=2, allow_nan=False)
    print(text.rstrip("\n"))
