"""Exit codes of the commands."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """What a command ends with."""

    DONE = 0
    FAILED = 1
    """The machine failed, such as by a full disk."""
    BAD_INPUT = 2
    """One line on stderr says what was wrong; nothing was written."""
    NOT_TRUSTED = 3
    """Done, but the result is not to be relied on: every world frozen, a sampler not converged, a loss not finite."""
    INTERRUPTED = 130
    """Ctrl-C."""
