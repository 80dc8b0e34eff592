"""Ctrl-C while compiled code runs; progress on a terminal and in a pipe."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import pytest
from bough.sim.base import console
from bough.sim.base.console import bars, dropped_ctrl_c_raised_again, first_ctrl_c_told, meanwhile, uninterrupted


def test_ctrl_c_waits_for_the_end_of_the_block():
    """Run the block to its end, raise then, and leave the signal's handler as it was."""
    before, done = signal.getsignal(signal.SIGINT), []
    with pytest.raises(KeyboardInterrupt), uninterrupted():
        os.kill(os.getpid(), signal.SIGINT)
        done.append(True)
    assert done and signal.getsignal(signal.SIGINT) is before
    with uninterrupted():
        pass


def test_sigterm_waits_only_where_it_is_taken_as_ctrl_c():
    """Hold SIGTERM back where its handler raises KeyboardInterrupt, and leave another handler alone."""
    before, others, done = signal.getsignal(signal.SIGTERM), [], []
    try:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        with pytest.raises(KeyboardInterrupt), uninterrupted():
            os.kill(os.getpid(), signal.SIGTERM)
            done.append(True)
        assert done and signal.getsignal(signal.SIGTERM) is signal.default_int_handler
        signal.signal(signal.SIGTERM, lambda number, _frame: others.append(number))
        with uninterrupted():
            os.kill(os.getpid(), signal.SIGTERM)
            assert others == [signal.SIGTERM]
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_first_ctrl_c_is_told_and_a_second_raised():
    """Go on at the first and say so; raise at the second; leave the handler as it was, an ignored one too."""
    before, done = signal.getsignal(signal.SIGINT), []
    with pytest.raises(KeyboardInterrupt), first_ctrl_c_told() as ended:
        assert not ended()
        signal.raise_signal(signal.SIGINT)
        done.append(ended())
        signal.raise_signal(signal.SIGINT)
    assert done == [True] and signal.getsignal(signal.SIGINT) is before
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        with first_ctrl_c_told() as ended:
            signal.raise_signal(signal.SIGINT)
            assert not ended() and signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_ctrl_c_that_python_drops_comes_again():
    """Raise Ctrl-C that fell into a finaliser, once it is over; leave other dropped errors to the hook before."""

    class Mortal:
        def __init__(self, end):
            self.end = end

        def __del__(self):
            self.end()

    before, heard = sys.unraisablehook, []
    try:
        sys.unraisablehook = heard.append
        with pytest.raises(KeyboardInterrupt), dropped_ctrl_c_raised_again():
            Mortal(lambda: int("no number"))
            Mortal(lambda: signal.raise_signal(signal.SIGINT))
            time.sleep(60.0)
        assert [dropped.exc_type for dropped in heard] == [ValueError]
        assert sys.unraisablehook == heard.append
    finally:
        sys.unraisablehook = before


def test_an_error_of_the_block_is_not_hidden():
    """Let an error through, Ctrl-C or not."""
    with pytest.raises(ValueError, match="mine"), uninterrupted():
        os.kill(os.getpid(), signal.SIGINT)
        raise ValueError("mine")


def test_piped_progress_has_plain_lines(capsys, monkeypatch):
    """Write a line for every stage with what is done of how much, and none before the first ten seconds."""
    with bars({"fitting": 3, "sampling": None}) as advance:
        for stage in ("fitting", "fitting", "sampling"):
            advance(stage, 1)
    assert capsys.readouterr().err == ""  # sooner done than anyone looks
    monkeypatch.setattr(console, "EVERY", 0.0)
    with bars({"fitting": 3, "sampling": None}) as advance:
        for stage, count in (("fitting", 1), ("fitting", 2), ("sampling", 0), ("sampling", 4)):
            advance(stage, count)
    out, err = capsys.readouterr()
    lines = [line.split(" s: ") for line in err.splitlines()]
    assert out == "" and all(head.startswith("bough: ") and head[7:].isdigit() for head, _ in lines)
    assert [said for _, said in lines] == ["fitting, 1 of 3", "fitting, 3 of 3", "sampling", "sampling, 4"]


def test_a_stage_that_reports_nothing_has_lines_too(capsys, monkeypatch):
    """Say every so often which stage is under way, the next one where the last is done, also where none reports."""
    monkeypatch.setattr(console, "EVERY", 0.2)
    with bars({"fitting": 1, "sampling": 2}) as advance:
        time.sleep(0.5)
        with meanwhile("compiling"):
            time.sleep(0.5)
        advance("fitting", 1)
        time.sleep(0.5)
    said = [line.split(" s: ")[1] for line in capsys.readouterr().err.splitlines()]
    assert list(dict.fromkeys(said)) in (
        ["fitting", "compiling", "sampling"], ["fitting", "compiling", "fitting, 1 of 1", "sampling"],
    )  # fmt: skip


def test_a_stage_after_a_long_one_has_a_line_at_once(capsys, monkeypatch):
    """Write the next stage's line when it begins, once anything was written at all."""
    clock = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: clock[0])
    with bars({"fitting": 9, "sampling": 9}) as advance:
        for now, stage in (
            (1.0, "fitting"),
            (11.0, "fitting"),
            (12.0, "fitting"),
            (13.0, "sampling"),
            (14.0, "sampling"),
        ):
            clock[0] = now
            advance(stage, 1)
    assert capsys.readouterr().err.splitlines() == ["bough: 11 s: fitting, 2 of 9", "bough: 13 s: sampling, 1 of 9"]


def test_what_takes_long_meanwhile_is_said_under_a_command_alone(capsys, monkeypatch):
    """Say what happens while a command shows its progress, once it takes long; nothing in a program of one's own."""
    monkeypatch.setattr(console, "SOON", 0.0)
    with meanwhile("compiling"):
        pass
    with bars({"fitting": 1}):
        with meanwhile("compiling kernels"):
            time.sleep(0.2)  # the line comes from a timer's thread
        monkeypatch.setattr(console, "SOON", 60.0)
        with meanwhile("done sooner"):
            pass
    assert [line.split(" s: ")[1] for line in capsys.readouterr().err.splitlines()] == ["compiling kernels"]


def test_bars_of_a_terminal_are_drawn():
    """Draw what stages and what happens meanwhile say on a terminal, and leave nothing behind."""
    code = (
        "import time\nfrom bough.sim.base.console import bars, meanwhile\n"
        "with bars({'fitting': 3}) as advance:\n"
        "    advance('fitting', 1)\n"
        "    with meanwhile('compiling kernels'):\n        time.sleep(0.4)\n"
        "print('done')\n"
    )
    leader, follower = os.openpty()
    command = [sys.executable, "-c", code]
    with subprocess.Popen(
        command, stdin=follower, stdout=follower, stderr=follower, env=os.environ | {"TERM": "xterm"}
    ):
        os.close(follower)
        seen = b""
        with contextlib.suppress(OSError):  # the end of a pseudo-terminal
            while part := os.read(leader, 4096):
                seen += part
    os.close(leader)
    assert b"fitting" in seen and b"compiling kernels" in seen and seen.rstrip().endswith(b"done")
