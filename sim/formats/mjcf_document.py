"""The MJCF document: includes, compiler settings, default classes and poses.

What MuJoCo's reader does before it builds bodies. Follows MuJoCo 4.0's XML reference; each rule is tested against C
MuJoCo on random files.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base.rotation import axis_angle_quat, quat_multiply, z_to
from ..base.types import Array
from .mjcf_inertia import Pose
from .xml_tree import Element, read_xml

ORIENTATIONS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
IDENTITY: Pose = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
_SECTIONS = (
    "compiler", "option", "size", "visual", "statistic", "default", "custom", "asset", "extension", "worldbody",
    "contact", "equality", "tendon", "actuator", "sensor", "keyframe", "deformable",
)  # fmt: skip
_COMPILER = (
    "alignfree angle assetdir autolimits balanceinertia boundinertia boundmass conflict coordinate discardvisual "
    "eulerseq fitaabb fusestatic inertiafromgeom inertiagrouprange meshdir passthrough savecanonical savecompiled "
    "saveinertial settotalmass strippath texturedir usethread"
)
_PREFIX_VECTORS = {"size", "stiffness", "damping"}  # an element may override only the first numbers of these


@dataclass
class Document:
    """An MJCF file with its includes pasted in.

    Attributes:
        root: The ``<mujoco>`` element.
        compiler: All compiler settings merged into one element; the last one wins.
        classes: Attributes of every default class by class name and tag, inheritance resolved.
    """

    root: Element
    compiler: Element
    classes: dict[str, dict[str, dict[str, str]]]

    @property
    def angle_unit(self) -> float:
        """Radians per unit of angle in the file."""
        return np.pi / 180 if self.compiler.keyword("angle", "degree", ("degree", "radian")) == "degree" else 1.0

    def sections(self, tag: str) -> Iterable[Element]:
        """Children of all top-level sections with this tag, in document order."""
        return (child for section in self.root.find_all(tag) for child in section.children)

    def flag(self, name: str) -> bool:
        """Whether an option flag that is on by default (gravity, spring, damper, contact) is left on.

        Raises:
            InputError: The flag is neither "enable" nor "disable".
        """
        on = True
        for flag in (f for option in self.root.find_all("option") for f in option.find_all("flag")):
            on = flag.keyword(name, "enable" if on else "disable", ("enable", "disable")) == "enable"
        return on

    def resolved(self, element: Element, childclass: str, tag: str = "") -> Element:
        """Return the element with the attributes it inherits from its class, or else from ``childclass``.

        Raises:
            InputError: The class is unknown, or two orientations are given at once.
        """
        inherited = dict(self.defaults(element, "class", childclass).get(tag or element.tag, {}))
        given = [key for key in ORIENTATIONS if key in element.attrib]
        if len(given) > 1:
            raise element.error(" and ".join(given), "one of " + ", ".join(ORIENTATIONS))
        if given:
            inherited = {key: value for key, value in inherited.items() if key not in ORIENTATIONS}
        return replace(element, attrib=_merged(inherited, element.attrib))

    def defaults(self, element: Element, key: str, fallback: str) -> dict[str, dict[str, str]]:
        """Attributes by tag of the default class named by attribute ``key`` of an element.

        Raises:
            InputError: The class is unknown.
        """
        name = element.attrib.get(key, fallback)
        if name not in self.classes:
            raise element.error(f"{key}='{name}'", "a default class: " + ", ".join(sorted(self.classes)))
        return self.classes[name]

    def pose(self, element: Element) -> Pose:
        """Position [m] and orientation (quaternion w, x, y, z) that an element gives.

        Raises:
            InputError: A malformed number or a direction of length zero.
        """
        return element.vector("pos", 3, [0.0, 0.0, 0.0]), self._orientation(element)

    def _orientation(self, element: Element) -> Array:
        if "euler" in element.attrib:
            return self._euler(element)
        if "axisangle" in element.attrib:
            v = element.vector("axisangle", 4)
            return axis_angle_quat(unit(element, "axisangle", v[:3]), np.asarray(v[3] * self.angle_unit))
        if "xyaxes" in element.attrib:
            v = element.vector("xyaxes", 6)
            x = unit(element, "xyaxes", v[:3])
            y = unit(element, "xyaxes", v[3:] - x * (x @ v[3:]))
            return matrix_quat(np.stack([x, y, np.cross(x, y)], axis=1))
        if "zaxis" in element.attrib:
            return z_to(unit(element, "zaxis", element.vector("zaxis", 3)))
        return unit(element, "quat", element.vector("quat", 4, [1.0, 0.0, 0.0, 0.0]))

    def _euler(self, element: Element) -> Array:
        """Turn about moving axes for lower-case letters of ``eulerseq``, about fixed ones for capitals."""
        angles = element.vector("euler", 3) * self.angle_unit
        sequence = self.compiler.attrib.get("eulerseq", "xyz")
        if len(sequence) != 3 or set(sequence) - set("xyzXYZ"):
            raise self.compiler.error(f"eulerseq='{sequence}'", "three letters out of x, y, z, X, Y, Z")
        out = IDENTITY[1]
        for letter, angle in zip(sequence, angles, strict=True):
            turn = axis_angle_quat(np.eye(3)["xyz".index(letter.lower())], angle)
            out = quat_multiply(out, turn) if letter.islower() else quat_multiply(turn, out)
        return out


def read_document(path: str | Path) -> Document:
    """Read an MJCF file, paste its includes and resolve its default classes.

    Raises:
        InputError: Unreadable or malformed file, an include that is missing or used twice, an unknown section.
    """
    root = read_xml(path)
    if root.tag != "mujoco":
        raise root.error(f"<{root.tag}> as the root", "<mujoco>")
    _paste_includes(root, Path(path).parent, [Path(path).resolve()])
    for section in root.children:
        if section.tag not in _SECTIONS:
            raise section.error(f"an unknown section <{section.tag}>", ", ".join(_SECTIONS))
    compiler = Element("compiler", {}, root.file, root.line)
    for part in root.find_all("compiler"):
        part.check_attributes(_COMPILER)
        compiler = replace(part, attrib=compiler.attrib | part.attrib)
    classes: dict[str, dict[str, dict[str, str]]] = {"main": {}}
    for default in root.find_all("default"):
        _read_class(default, None, classes)
    return Document(root, compiler, classes)


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


def _read_class(element: Element, parent: str | None, classes: dict[str, dict[str, dict[str, str]]]) -> None:
    """Store one default class and, after it, those nested in it, which start from its attributes."""
    name = element.attrib.get("class", "" if parent else "main")
    if not name or (parent and name in classes) or (not parent and name != "main"):
        raise element.error(f"class='{name}'", "a new name for a nested class, 'main' for the outermost")
    base = classes[parent] if parent else classes["main"]
    classes[name] = {tag: dict(attrib) for tag, attrib in base.items()}
    for child in element.children:
        if child.tag != "default":
            own = Document(element, element, {name: classes[name]}).resolved(child, name)
            classes[name][child.tag] = {k: v for k, v in own.attrib.items() if k != "class"}
    for child in element.find_all("default"):
        _read_class(child, name, classes)


def _merged(inherited: dict[str, str], own: dict[str, str]) -> dict[str, str]:
    out = inherited | own
    for key in _PREFIX_VECTORS & set(inherited) & set(own):
        words = own[key].split()
        out[key] = " ".join(words + inherited[key].split()[len(words) :])
    return out


def unit(element: Element, key: str, vector: Array) -> Array:
    """Vector at length one.

    Raises:
        InputError: Its length is zero.
    """
    length = np.linalg.norm(vector)
    if length < 1e-14:
        raise element.error(f"{key}='{element.attrib[key]}', a direction of length zero", "a direction")
    return vector / length


def matrix_quat(R: Array) -> Array:
    """Quaternion w, x, y, z of a rotation matrix (largest component first, so that nothing is divided by zero)."""
    squares = np.array([1 + np.trace(R), *(1 + 2 * np.diag(R) - np.trace(R))])
    i = int(np.argmax(squares))
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    if i == 0:
        q = np.array([squares[0], *skew])
    else:
        q = np.array([skew[i - 1], *(R[i - 1] + R[:, i - 1])])
        q[i] = squares[i]
    return q / np.linalg.norm(q)
