"""What laws remember from one recording to the next, and what a replay clears between them."""

from typing import Any

import warp as wp

from ..lanes.algebra import mul
from ..lanes.real import real
from .structs import PARAMETERS
from .terms import Term, function_of, memory_row, named_all

__all__ = ["BETWEEN", "EVERYTHING", "fader_of", "forget", "kept_rows"]

#: What `forget` clears: what the end of a recording clears, or damage too.
BETWEEN = wp.constant(0)
EVERYTHING = wp.constant(1)


def kept_rows(terms: tuple[Term, ...]) -> Any:
    """Mark the rows of memory for `forget`: what `BETWEEN` recordings clears, or only `EVERYTHING`; or that none is."""
    marks = [int(term.persistent) for term in terms for _ in range(term.memory)] or [EVERYTHING + 1]
    return wp.constant(wp.types.vector(len(marks), wp.int32)(*marks))


@wp.func
def forget(e: int, kept: Any, most: int, m: Any, fx: Any):
    """Clear the memories of a group whose rows are marked up to ``most`` in ``kept``."""
    for row in range(len(kept)):
        if kept[row] <= most:
            for i in range(m.count[e] + 1):
                z = fx.memory[e, row * fx.stride + i]
                o = real(0.0, z.x)  # no difference of the memory itself: what is not a number would stay so
                fx.memory[e, row * fx.stride + i] = type(z)(o, o, o)


def _fade_own(term: Term, key: str, row: int) -> Any:
    """Device function that keeps of a law's memory the share that one of its parameters says."""
    share, own, memory = term.slot * PARAMETERS + term.fades, int(term.per_joint), term.memory

    def fade_own(e: int, m: Any, fx: Any):
        """Multiply this law's memories at every joint by their share."""
        for i in range(m.count[e] + 1):
            kept = fx.parameter[e, share * fx.stride + i * own]
            for k in range(memory):
                at = (row + k) * fx.stride + i
                fx.memory[e, at] = fx.memory[e, at] * kept

    return function_of(fade_own, term, f"fade{key}")


def fader_of(terms: tuple[Term, ...], key: str) -> Any:
    """Return the device function that a recording begins with: laws that forget some of the one before do so."""
    own = [term for term in terms if term.persistent and term.fades >= 0]
    slots, count = [term.slot for term in own], len(own)
    fades = [_fade_own(term, key, memory_row(terms, term.slot)) for term in own]
    named = named_all(fades, f"fade_{key}")

    def fade(e: int, m: Any, fx: Any):
        """Let every active law that forgets keep its share."""
        if wp.static(False):
            named(m)
        for n in range(wp.static(count)):
            for _ in range(fx.active[e, wp.static(slots[n])]):
                wp.static(fades[n])(e, m, fx)

    return wp.func(fade, name=f"fade_{key}")
