"""Ctrl-C while compiled code runs."""

import os
import signal

import pytest
from bough.sim.base.console import uninterrupted


def test_ctrl_c_waits_for_the_end_of_the_block():
    """Run the block to its end, raise then, and leave the signal's handler as it was."""
    before, done = signal.getsignal(signal.SIGINT), []
    with pytest.raises(KeyboardInterrupt), uninterrupted():
        os.kill(os.getpid(), signal.SIGINT)
        done.append(True)
    assert done and signal.getsignal(signal.SIGINT) is before
    with uninterrupted():
        pass


def test_an_error_of_the_block_is_not_hidden():
    """Let an error through, Ctrl-C or not."""
    with pytest.raises(ValueError, match="mine"), uninterrupted():
        os.kill(os.getpid(), signal.SIGINT)
        raise ValueError("mine")
