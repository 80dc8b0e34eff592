"""What a file describes and a tree of bough does not have: refused by name, or left out where that was asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ..base.errors import InputError
from ..base.types import IntArray

#: What can be left out, by the word that says so, and what is left of it then.
WORDS: Mapping[str, str] = MappingProxyType(
    {
        "limits": "joints move without end stops",
        "friction": "joints move without dry friction",
        "contacts": "bodies, floors and walls pass through each other",
        "actuators": "no motor acts",
        "equality": "bodies and joints are not tied to each other",
        "tendons": "tendons pull nothing",
        "gravcomp": "every body has its full weight",
        "fluid": "air and water do not drag",
        "mimic": "joints that copy others move on their own",
        "free": "free bodies are held where the file draws them",
    }
)
ALL = "all"

#: A source, such as a file, and a place in it.
Place = tuple[str | Path, str]


class Omissions:
    """What of a description has to be left out, collected until all of it is known.

    Attributes:
        ignore: Words of `WORDS` that the user said. With "all" what bough simulates is not left out.
    """

    def __init__(self, ignore: Sequence[str] = ()) -> None:
        """Take words of `WORDS`, or "all".

        Raises:
            InputError: There is no such word.
        """
        for word in ignore:
            if word not in (*WORDS, ALL):
                raise InputError("--ignore", "", f"'{word}'", ", ".join((*WORDS, ALL)))
        self.ignore = frozenset(ignore)
        self._first: tuple[Place, str] | None = None
        self._needed: list[str] = []
        self._counts: dict[str, int] = {}

    def found(self, word: str, place: Place, what: str, name: str, count: int = 1) -> None:
        """Note something that has to be left out.

        Args:
            word: Of `WORDS`.
            place: Where it is: file and place in it.
            what: What stands there, for the refusal.
            name: What it and its like are called in the list of what was left out.
            count: How many there are.
        """
        if word in self.ignore or ALL in self.ignore:
            self.noted(name, count)
            return
        self._first = self._first or (place, what)
        if word not in self._needed:
            self._needed.append(word)

    def noted(self, name: str, count: int = 1) -> None:
        """Note something that changes no motion by itself, or that its own word leaves out."""
        if count:
            self._counts[name] = self._counts.get(name, 0) + count

    def settle(self) -> list[str]:
        """Return short descriptions of what was left out.

        Raises:
            InputError: There was something that may not be left out: the first one, with all words that would do it.
        """
        if self._first is not None:
            place, what = self._first
            words = ",".join(self._needed)
            raise InputError(*place, what, f"a tree without, or --ignore {words} to leave it out")
        return [f"{name} ({count})" for name, count in self._counts.items()]


def touching(
    parent: Sequence[int], moves: Sequence[bool], masks: IntArray, excluded: set[tuple[int, int]]
) -> list[tuple[int, int]]:
    """Return the pairs of bodies that could touch by MuJoCo's rules: not fixed to each other, and not neighbours.

    Args:
        parent: Parent of each body, a smaller number, from 1 on; body 0 is the world.
        moves: Whether each body has a joint.
        masks: contype and conaffinity of each body's geoms, or-ed, shape [bodies, 2].
        excluded: Pairs that the file excludes, the smaller number first.
    """
    weld, above = np.zeros(len(parent), np.int64), np.zeros(len(parent), np.int64)
    for body in range(1, len(parent)):
        weld[body] = body if moves[body] else weld[parent[body]]
        above[body] = weld[parent[body]] if moves[body] else above[parent[body]]
    pairs: list[tuple[int, int]] = []
    for body in range(len(parent)):
        others = np.arange(body + 1, len(parent))
        meets = (masks[body, 0] & masks[others, 1]) | (masks[others, 0] & masks[body, 1])
        neighbours = (weld[body] == above[others]) | (weld[others] == above[body])
        apart = (weld[body] != weld[others]) & ~(neighbours & (weld[body] != 0) & (weld[others] != 0))
        pairs += [(body, other) for other in others[(meets != 0) & apart].tolist()]
    return [pair for pair in pairs if pair not in excluded]
