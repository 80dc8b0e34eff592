"""What is asked of a user: on a terminal a question, elsewhere one line that names the flag."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from ...sim.base.errors import InputError

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Question:
    """Something that was not said.

    Attributes:
        flag: The flag that says it.
        text: The question.
        found: What is there instead, for who cannot be asked.
        allowed: What would answer it.
        default: What an empty answer means; None where one is needed.
    """

    flag: str
    text: str
    found: str
    allowed: str
    default: str | None = None


@dataclass
class Asker:
    """Asks on a terminal, or refuses.

    Attributes:
        source: What errors name: the command.
        terminal: Whether somebody can be asked.
        helps: Help of every flag, shown where the answer is ``?``.
        notes: What was guessed and assumed, a line each.
        warnings: What is odd but possible, a line each.
    """

    source: str
    terminal: bool = False
    helps: Mapping[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def __call__(self, question: Question, parse: Callable[[str], Answer]) -> Answer:
        """Return the answer, read by ``parse``; a default stands where nobody can be asked.

        Raises:
            InputError: There is no terminal and no default, or the terminal was closed.
        """
        if not self.terminal:
            if question.default is None:
                raise self.missing(question)
            return parse(question.default)
        while True:
            text = self._read(question)
            if text == "?":
                print(self.helps.get(question.flag, question.allowed), file=sys.stderr)
                continue
            try:
                return parse(text or question.default or "")
            except InputError as error:
                print(error, file=sys.stderr)

    def _read(self, question: Question) -> str:
        empty = "" if question.default is None else f", Enter for {question.default or 'none'}"
        print(f"{question.text} ({question.flag}; ? for help{empty}) ", end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        if not line:
            raise self.missing(question)
        return line.strip()

    def missing(self, question: Question) -> InputError:
        """Return the one line that says which flag is missing."""
        return InputError(self.source, question.flag, question.found, question.allowed)
