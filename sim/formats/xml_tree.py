"""XML with line numbers, so that an error in a robot file names the line.

The standard library's `xml.etree` forgets where an element stood; expat, which it is built on, knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from ..base.errors import InputError
from ..base.files import read_text
from ..base.types import Array


@dataclass
class Element:
    """One XML element and where it stands.

    Attributes:
        tag: Name of the element.
        attrib: Attributes as text.
        file: File it was read from.
        line: Line of its start tag, from 1.
        children: Child elements in document order.
    """

    tag: str
    attrib: dict[str, str]
    file: Path
    line: int
    children: list[Element] = field(default_factory=list)

    @property
    def place(self) -> str:
        """Line, tag and name, for messages."""
        name = f" name='{self.attrib['name']}'" if "name" in self.attrib else ""
        return f"line {self.line}, <{self.tag}{name}>"

    def error(self, found: str, allowed: str) -> InputError:
        """Return the error that says what was found in this element and what is allowed."""
        return InputError(self.file, self.place, found, allowed)

    def find_all(self, tag: str) -> list[Element]:
        """Children with this tag."""
        return [child for child in self.children if child.tag == tag]

    def find(self, tag: str) -> Element | None:
        """First child with this tag, or None."""
        return next((child for child in self.children if child.tag == tag), None)

    def require(self, tag: str) -> Element:
        """First child with this tag.

        Raises:
            InputError: There is none.
        """
        child = self.find(tag)
        if child is None:
            raise self.error(f"no <{tag}>", f"one <{tag}>")
        return child

    def text(self, key: str) -> str:
        """Value of an attribute that must be there.

        Raises:
            InputError: The attribute is missing.
        """
        if key not in self.attrib:
            raise self.error(f"no attribute '{key}'", f"the attribute '{key}'")
        return self.attrib[key]

    def vector(
        self, key: str, count: int, default: Sequence[float] | None = None, at_least: int | None = None
    ) -> Array:
        """Finite numbers of an attribute, shape [count]; fewer, down to ``at_least``, if that is given.

        Raises:
            InputError: The attribute is missing without a default, not made of numbers, or of another length.
        """
        if key not in self.attrib and default is not None:
            return np.array(default, dtype=np.float64)
        text, low = self.text(key), count if at_least is None else at_least
        try:
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = np.array([np.nan])
        if not low <= len(values) <= count or not np.isfinite(values).all() or "_" in text:
            size = str(count) if low == count else f"{low} to {count}"
            raise self.error(f"{key}='{text}'", f"{size} finite number{'s' if count > 1 else ''}")
        return values

    def number(self, key: str, default: float | None = None) -> float:
        """Finite number of an attribute.

        Raises:
            InputError: The attribute is missing without a default, or not one number.
        """
        return float(self.vector(key, 1, None if default is None else [default])[0])

    def positive(self, key: str, default: float | None = None) -> float:
        """Return a number that must be zero or more.

        Raises:
            InputError: As `number`, or the number is negative.
        """
        value = self.number(key, default)
        if value < 0:
            raise self.error(f"{key}='{self.attrib[key]}'", "zero or more")
        return value

    def keyword(self, key: str, default: str, allowed: Sequence[str]) -> str:
        """Value of an attribute out of a list of words.

        Raises:
            InputError: The value is not in the list.
        """
        value = self.attrib.get(key, default)
        if value not in allowed:
            raise self.error(f"{key}='{value}'", ", ".join(allowed))
        return value

    def check_attributes(self, allowed: str) -> None:
        """Refuse attributes that are not among ``allowed`` (words separated by spaces).

        Raises:
            InputError: There is one, for instance a misspelt ``stifness``.
        """
        unknown = sorted(set(self.attrib) - set(allowed.split()))
        if unknown:
            raise self.error(f"unknown attribute '{unknown[0]}'", " ".join(sorted(allowed.split())))


#: Most elements inside one another. MuJoCo takes a minute for a chain of so many bodies, the square of that for more.
DEEPEST = 5000


def read_xml(path: str | Path) -> Element:
    """Read an XML file and return its root element.

    Raises:
        InputError: The file cannot be read, is not well-formed XML or too deep; the message names the line.
    """
    file = Path(path)
    parser = expat.ParserCreate()
    root = Element("", {}, file, 0)
    stack = [root]

    def start(tag: str, attrib: dict[str, str]) -> None:
        """Put a new element under the one that is open, and open it; raise where that is deeper than `DEEPEST`."""
        if len(stack) > DEEPEST:
            found = f"elements nested more than {DEEPEST} deep"
            raise InputError(file, f"line {parser.CurrentLineNumber}", found, f"{DEEPEST} at most")
        element = Element(tag, attrib, file, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    try:
        parser.Parse(read_text(file), True)
    except expat.ExpatError as e:
        reason = expat.errors.messages[e.code]
        raise InputError(file, f"line {e.lineno}", f"{reason} at column {e.offset + 1}", "well-formed XML") from None
    return root.children[0]
