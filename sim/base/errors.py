"""The one error a user meets: where it is, what was found, what is allowed."""

from __future__ import annotations

import reprlib
from pathlib import Path


class InputError(ValueError):
    """Bad input from outside: a file, a field, an option.

    Its text is one line, ``file: place: found; allowed``, printed as it is by the command line, which then exits
    with code 2.

    Args:
        source: The file or the command.
        place: Where in it: a line, a field, an option; may be empty.
        found: What is there.
        allowed: What may be there.
    """

    def __init__(self, source: str | Path, place: str, found: str, allowed: str) -> None:
        self.source, self.place, self.found, self.allowed = str(source), place, found, allowed
        parts = [str(source), place, f"found {found}; allowed: {allowed}"]
        super().__init__(" ".join(": ".join(p for p in parts if p).split()))

    def __reduce__(self) -> tuple[type[InputError], tuple[str, str, str, str]]:
        """Return how another process makes it again."""
        return type(self), (self.source, self.place, self.found, self.allowed)


#: Largest seed: generators of torch take 63 bits.
MOST_SEED = 2**63 - 1


def check_seed(source: str, seed: int) -> None:
    """Raise `InputError` for a ``--seed`` that not every generator of random numbers takes."""
    if not 0 <= seed <= MOST_SEED:
        raise InputError(source, "--seed", str(seed), f"0 to {MOST_SEED}")


class _Short(reprlib.Repr):
    """Long lists and texts cut short; integers that Python refuses to write out are told by their size."""

    def repr_int(self, x: int, level: int) -> str:
        """Return an integer, or how long it is."""
        return repr(x) if x.bit_length() <= 256 else f"an integer of {x.bit_length()} bits"


_SHORT = _Short()
_SHORT.maxlist = _SHORT.maxdict = _SHORT.maxtuple = 8
_SHORT.maxstring = _SHORT.maxother = 60


def shortened(value: object) -> str:
    """Return a value as an error shows it, sixty characters at most, without writing out all of a large one."""
    plain = value is None or isinstance(value, str | float)
    text = "null" if value is None else repr(value) if plain else _SHORT.repr(value)  # aliases may repeat without end
    return text if len(text) <= 60 else text[:57] + "..."
