"""MJCF text on its way to MuJoCo's compiler: includes pasted, one element a line, each line traced to its file.

MuJoCo reads MJCF; this module reads the XML first, for what MuJoCo does not do: its errors give a line but not which
of several included files it is in, and its XML reader stops at 500 elements inside one another, while a chain may be
thousands of bodies long. Sections that do not move bodies (pictures, sensors, motors, ...) are not handed on, so that
files they name may be missing.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

from ..base.errors import InputError
from .xml_tree import Element, read_xml

_NOT_COMPILED = (
    "actuator", "camera", "contact", "custom", "extension", "keyframe", "light", "material", "plugin", "sensor",
    "size", "skin", "statistic", "texture", "visual",
)  # fmt: skip
_REFUSED = {
    "attach": "bodies written out",
    "composite": "bodies written out",
    "flex": "rigid bodies",
    "flexcomp": "rigid bodies",
    "plugin": "MuJoCo without plugins",
}
_NUMBERS = ("worldbody", "default", "compiler", "option")  # sections in which every number must be finite
_WORDS = ("name", "class", "childclass", "mesh")
#: MuJoCo's words for an error (a pattern), what is found in ours, and what is allowed.
_SAID = (
    (r".*mjMINVAL.*", "a moving body without mass or inertia", "a geom, or an <inertial> with both"),
    (r"fromto points too close.*", "a segment of length zero", "two different points"),
    (r"(axis too small|zero quaternion).*", "a direction of length zero", "a direction"),
    (r"multiple orientation specifiers.*", "several orientations", "one orientation"),
    (r"repeated name ('.*') in (.*)", r"the name \1 twice", r"unique names of each \2"),
    (r"(.*A \+ B >= C.*)", r"\1", "A + B >= C, as for real matter"),
    (r"(.*negative.*|.*must be positive.*)", r"\1", "more than zero, or zero where that has a meaning"),
    (r"(.*)", r"\1", "what MuJoCo's XML reference says"),
)
_ORIENTATIONS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
# Bodies inside one another: MuJoCo's time to compile a chain grows with the cube of its length, and its XML reader
# stops at 500. A body without a joint may give mass to the one it hangs on, which makes it the second choice.
_DEEP, _DEEPEST = 10, 400


@dataclass
class Source:
    """An MJCF file as MuJoCo is given it.

    Attributes:
        root: The ``<mujoco>`` element, includes pasted.
        lines: The text, line by line.
        elements: The element that stands on each line.
        moved: Line of each body that was cut out of a deep chain by the line of the empty body left in its place.
    """

    root: Element
    lines: list[str] = field(default_factory=list)
    elements: list[Element] = field(default_factory=list)
    moved: dict[int, int] = field(default_factory=dict)

    def add(self, element: Element, line: str) -> int:
        """Append a line that belongs to an element and return its number, from 1."""
        self.lines.append(line)
        self.elements.append(element)
        return len(self.lines)

    def section(self, tag: str) -> list[Element]:
        """Children of all top-level sections with this tag, in document order."""
        return [child for section in self.root.find_all(tag) for child in section.children]

    def element(self, line: int) -> Element:
        """Element on a line of the text, from 1."""
        return self.elements[line - 1]

    def refusal(self, message: str) -> InputError:
        """Return MuJoCo's error as one that names the file, the element's line in it and the attributes it is about."""
        number = re.search(r"[Ll]ine(?: number=| )(\d+)", message)
        text = " ".join(line for line in message.splitlines() if not line.startswith("Element "))
        text = re.sub(r"(XML Error|Error|Schema violation): |Error=.*Line number=\d+: ", "", text).strip()
        element = self.element(int(number[1])) if number else self._mentioned(text)
        said, (_, found, allowed) = next((m, row) for row in _SAID if (m := re.fullmatch(row[0], text)))
        if "unrecognized attribute" in text:
            allowed = _attributes(element.tag)
        about = _about(element, text)
        reason = said.expand(found)
        return element.error(f"{about} ({reason})" if about else reason, said.expand(allowed))

    def _mentioned(self, text: str) -> Element:
        """Element of which an attribute stands in quotes in the text, such as a missing file; the root if none."""
        names = {Path(word).name for word in re.findall(r"'([^']+)'", text)}
        return next((e for e in self.elements if names & {Path(v).name for v in e.attrib.values()}), self.root)


def _about(element: Element, text: str) -> str:
    """Attributes of the element that the text names: in quotes, as words, or as ways to give an orientation."""
    quoted, words = set(re.findall(r"'([^']*)'", text)), set(re.findall(r"\w+", text))
    turns = _ORIENTATIONS if words & {"orientation", "quaternion"} else ()
    found = [k for k, v in element.attrib.items() if k in quoted or v in quoted or k in turns]
    found = found or [k for k in element.attrib if k in words - {"name"}]
    return " and ".join(f"{key}='{element.attrib[key]}'" for key in found)


def _attributes(tag: str) -> str:
    """Attributes that an element may have, from MuJoCo's table of its XML where that lists them."""
    import mujoco

    table = mujoco.mj_printSchema(False, False)
    row = re.search(rf"^ *{tag} +\(.\) +(\S.*(?:\n +[^()\n]+$)*)", table, re.MULTILINE)
    return " ".join(sorted(row[1].split())) if row else "an attribute of MuJoCo's XML reference"


def read_source(path: str | Path) -> Source:
    """Read an MJCF file and write it anew for MuJoCo.

    Raises:
        InputError: Unreadable or malformed XML, an include that is missing or used twice, a flexible body, a plugin,
            a number that is not finite, a negative mass.
    """
    root = read_xml(path)
    if root.tag != "mujoco":
        raise root.error(f"<{root.tag}> as the root", "<mujoco>")
    _paste_includes(root, Path(path).parent, [Path(path).resolve()])
    for section in root.children:
        _check_section(section)
    source = Source(root)
    _write(source)
    return source


def _paste_includes(element: Element, folder: Path, seen: list[Path]) -> None:
    """Replace ``<include>`` elements, at any depth, by the children of the files they name."""
    todo = [element]
    while todo:
        parent = todo.pop()
        while any(child.tag == "include" for child in parent.children):
            parent.children = [new for child in parent.children for new in _included(child, folder, seen)]
        todo.extend(parent.children)


def _included(element: Element, folder: Path, seen: list[Path]) -> list[Element]:
    if element.tag != "include":
        return [element]
    name = element.text("file")
    options = [folder / name, element.file.parent / name]
    path = next((p for p in options if p.is_file()), None)
    if path is None:
        raise element.error(f"file='{name}', which does not exist", f"a file in {folder}")
    if path.resolve() in seen:
        raise element.error(f"file='{name}' a second time", "each file at most once")
    seen.append(path.resolve())
    return read_xml(path).children


def _check_section(section: Element) -> None:
    """Refuse what MuJoCo would expand or let pass: soft bodies, numbers that are not finite, negative masses."""
    todo = [section]
    while todo:
        element = todo.pop()
        todo += element.children[::-1]
        if section.tag in ("worldbody", "deformable") and element.tag in _REFUSED:
            soft = "a flexible body" if element.tag == "flex" else f"an unsupported element <{element.tag}>"
            raise element.error(soft, _REFUSED[element.tag])
        if section.tag in _NUMBERS:
            _check_numbers(element)
    if not re.fullmatch("[xyzXYZ]{3}", section.attrib.get("eulerseq", "xyz")):
        raise section.error(f"eulerseq='{section.attrib['eulerseq']}'", "three letters out of x, y, z, X, Y, Z")


def _check_numbers(element: Element) -> None:
    for key, value in element.attrib.items():
        if key not in _WORDS and not all(_is_finite(word) for word in value.split()):
            raise element.error(f"{key}='{value}'", "finite numbers")
    if element.tag == "inertial" and "mass" in element.attrib:
        element.positive("mass")


def _is_finite(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return True  # no number at all, or one that MuJoCo names


def _write(source: Source) -> None:
    """Write the lines, without recursion; bodies deep in a chain move to the end, as if they hung on the world."""
    tail: list[tuple[int, Element]] = []
    source.add(source.root, "<mujoco>")
    for section in source.root.children:
        if section.tag not in _NOT_COMPILED:
            _write_element(source, section, tail)
    while tail:
        hole, body = tail.pop()
        source.add(body, "<worldbody>")
        source.moved[hole] = len(source.lines) + 1
        _write_element(source, body, tail)
        source.add(body, "</worldbody>")
    source.add(source.root, "</mujoco>")


def _write_element(source: Source, top: Element, tail: list[tuple[int, Element]]) -> None:
    """Write one element and what is in it, apart from the bodies that are put on the tail with the lines they left."""
    todo: list[tuple[Element, str, int, str]] = [(top, "", 0, "")]
    while todo:
        element, above, depth, childclass = todo.pop()
        if above == "end":
            source.add(element, f"</{element.tag}>")
            continue
        childclass = element.attrib.get("childclass", childclass)
        if above == element.tag == "body" and depth >= (_DEEP if element.find("joint") else _DEEPEST):
            inherited = {"childclass": childclass} if childclass else {}
            tail.append((source.add(element, "<body/>"), replace(element, attrib=element.attrib | inherited)))
            continue
        depth += -(10**6) if element.tag == "replicate" else element.tag == "body"
        attributes = "".join(f" {k}={quoteattr(v)}" for k, v in element.attrib.items() if k != "material")
        inner = [child for child in element.children if child.tag not in _NOT_COMPILED or element.tag == "default"]
        source.add(element, f"<{element.tag}{attributes}{'' if inner else '/'}>")
        if inner:
            todo.append((element, "end", 0, ""))
            todo += [(child, element.tag, depth, childclass) for child in reversed(inner)]
