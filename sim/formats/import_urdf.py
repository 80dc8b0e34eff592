"""Import of URDF through Newton's importer.

Newton gives the order of links and joints and the masses of links that have only collision shapes. It keeps float32
and reads its way past much that is wrong, so the file is checked first, with line numbers, and numbers that are
written in it (poses, axes, masses, inertias, damping) are taken from it in float64. A ``<bough>`` element in a joint,
as `bough.sim.formats.export_urdf` writes it, adds what URDF lacks; with ``joint="spherical"`` it makes one
spherical joint of the three revolute joints that start there.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from ..base.console import start_warp
from ..base.errors import InputError
from ..base.rotation import axis_angle_quat, quat_multiply, quat_rotate
from ..base.types import Array
from ..trees.inertia import MassProperties
from ..trees.pose import zero_qpos
from ..trees.tree import Joint, Tree
from .import_mjcf import Mechanism
from .omissions import Omissions, touching
from .xml_tree import Element, read_xml

_KINDS = {
    "fixed": Joint.FIXED,
    "revolute": Joint.REVOLUTE,
    "continuous": Joint.REVOLUTE,
    "prismatic": Joint.PRISMATIC,
    "floating": Joint.SPHERICAL,
    "planar": Joint.REVOLUTE,
}
#: Joints that become several, and the number of slides before the last.
_SLIDES = {"floating": 3, "planar": 2}
#: A limit this far from zero is none: URDF demands limits of a slide [rad or m].
NO_LIMIT = 1000.0
_INERTIA = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")


def load_urdf(path: str | Path, ignore: Sequence[str] = ()) -> Mechanism:
    """Read a URDF file with fixed, revolute, continuous, prismatic, floating and planar joints.

    The root link is fixed to the world; a root called ``world`` is the world. A floating joint becomes three slides
    along the axes of its frame and a ball joint, a planar one two slides and a hinge. Gravity is 9.81 m/s^2 along -z.

    Args:
        path: The file.
        ignore: Words of `bough.sim.formats.omissions` for what may be left out of the tree, or "all".

    Raises:
        InputError: The file cannot be read or is no valid URDF, or holds a closed loop, a link that does not exist, a
            negative mass or damping; limits or mimic joints unless ignored.
    """
    root, omissions = read_xml(path), Omissions(ignore)
    if root.tag != "robot":
        raise root.error(f"<{root.tag}> as the root", "<robot>")
    links = _links(root)
    joints = _joints(root, links)
    values = {name: _link_values(link) for name, link in links.items()}
    for name, joint in joints.items():
        values[name] |= _joint_values(joint)
        _note_omissions(joint, omissions)
    _note_contacts(links, joints, omissions)
    ignored = omissions.settle()
    tree = _through_newton(Path(path), root.attrib.get("name", Path(path).stem))
    for i, name in enumerate(tree.link_name):
        for key, value in values[name].items():
            getattr(tree, key)[i] = value
    tree = _with_cylinders(tree, links)
    tree = _merge_spherical(tree, joints)
    tree = _with_slides(tree, joints, omissions.ignore)
    tree = _without_world(tree)
    if tree.num_links == 0:
        raise root.error("no link besides the world", "at least one <link>")
    named = [joints.get(name) for name in tree.link_name]
    return Mechanism(
        tree=tree.validate(str(path)),
        gravity=np.array([0.0, 0.0, -9.81]),
        qpos0=zero_qpos(tree),
        ignored=ignored,
        joint_name=[j.text("name") if j else "" for j in named],
        joint_place=[j.place if j else "" for j in named],
        friction=np.array([_friction(j) if j and "friction" not in omissions.ignore else 0.0 for j in named]),
    )


def _note_omissions(joint: Element, omissions: Omissions) -> None:
    """Note a joint's end stops, the joint that it copies, and friction where it is not that of one axis."""
    kind, limit, place = joint.attrib["type"], joint.find("limit"), (joint.file, joint.place)
    if kind in _SLIDES and "free" in omissions.ignore:
        omissions.noted("free joints")
        return
    if limit is not None and kind in ("revolute", "prismatic"):
        ends = limit.number("lower", 0.0), limit.number("upper", 0.0)
        if not (ends[0] <= -NO_LIMIT and ends[1] >= NO_LIMIT):
            omissions.found("limits", place, f"a joint limit, {ends[0]:g} to {ends[1]:g}", "joint limits")
    if joint.find("mimic") is not None:
        omissions.found("mimic", place, "a <mimic> (a joint that copies another)", "mimic joints")
    if _friction(joint) > 0:
        extension = joint.find("bough")
        if kind in _SLIDES or (extension is not None and extension.attrib.get("joint") == "spherical"):
            omissions.found("friction", place, "friction of several axes", "joint friction")
        elif "friction" in omissions.ignore:
            omissions.noted("joint friction")


def _friction(joint: Element) -> float:
    """Dry friction of a joint [N m or N]; none of a fixed joint."""
    dynamics = joint.find("dynamics")
    return 0.0 if dynamics is None or joint.attrib["type"] == "fixed" else dynamics.positive("friction", 0.0)


def _note_contacts(links: dict[str, Element], joints: dict[str, Element], omissions: Omissions) -> None:
    """Say which links could touch; URDF does not say whether a robot's own links do, so that they may pass."""
    order: list[str] = []
    todo = [name for name in links if name not in joints]
    below: dict[str, list[str]] = {name: [] for name in links}
    for child, joint in joints.items():
        below[joint.require("parent").text("link")].append(child)
    while todo:
        order.append(todo.pop())
        todo += below[order[-1]]
    number = {name: i + 1 for i, name in enumerate(order)}
    parent = [0, *(number[joints[n].require("parent").text("link")] if n in joints else 0 for n in order)]
    moves = [False, *(n in joints and joints[n].attrib["type"] != "fixed" for n in order)]
    masks = np.array([[0, 0], *([int(links[n].find("collision") is not None)] * 2 for n in order)], np.int64)
    pairs = touching(parent, moves, masks, set())
    if pairs:
        omissions.noted("contacts between pairs of links", len(pairs))


def _links(root: Element) -> dict[str, Element]:
    links: dict[str, Element] = {}
    for link in root.find_all("link"):
        if link.text("name") in links:
            raise link.error("the name twice", "unique link names")
        links[link.text("name")] = link
    if not links:
        raise root.error("no <link>", "at least one")
    return links


def _joints(root: Element, links: dict[str, Element]) -> dict[str, Element]:
    """Joints by the name of their child link, checked to make a tree of all links."""
    joints: dict[str, Element] = {}
    names: set[str] = set()
    for joint in root.find_all("joint"):
        _check_joint(joint, links)
        child = joint.require("child").text("link")
        if child in joints:
            raise joint.error(f"a second joint to link '{child}' (a closed loop)", "one joint to each link")
        if joint.text("name") in names:
            raise joint.error("the name twice", "unique joint names")
        names.add(joint.text("name"))
        joints[child] = joint
    roots = [name for name in links if name not in joints]
    if len(roots) != 1:
        found = "a closed loop of joints" if not roots else "several links without a joint: " + ", ".join(roots)
        raise root.error(found, "one root link that all others hang on")
    for name in links:
        _check_reaches_root(name, joints)
    return joints


def _check_joint(joint: Element, links: dict[str, Element]) -> None:
    joint.keyword("type", "", tuple(_KINDS))
    for end in ("parent", "child"):
        name = joint.require(end).text("link")
        if name not in links:
            raise joint.error(f"{end} link '{name}', which does not exist", "one of the file's links")


def _check_reaches_root(name: str, joints: dict[str, Element]) -> None:
    seen: set[str] = set()
    while name in joints:
        if name in seen:
            raise joints[name].error("a closed loop of joints", "a tree")
        seen.add(name)
        name = joints[name].require("parent").text("link")


def _through_newton(path: Path, name: str) -> Tree:
    """Import the file with Newton; values are float32."""
    start_warp(torch=False)  # Newton starts Warp, whose greeting on stdout is no part of a command's result
    import newton

    from ..newton.bridge import from_newton  # Newton is slow to import, and checks of the file come first

    class Builder(newton.ModelBuilder):
        """A builder that fixes what floats, which `_with_slides` lets float again, and lets no joint copy another."""

        def add_joint_free(self, *args: Any, **given: Any) -> int:
            """Fix the body instead of letting it float."""
            return self._fixed(**given)

        def add_joint_d6(self, *args: Any, **given: Any) -> int:
            """Fix the body instead of letting it move in six degrees of freedom."""
            return self._fixed(**given)

        def set_joint_mimic(self, *args: Any, **given: Any) -> None:
            """Let the joint move on its own."""

        def _fixed(self, **given: Any) -> int:
            known = ("parent", "child", "parent_xform", "child_xform", "label")
            return int(self.add_joint_fixed(**{key: given[key] for key in known if key in given}))

    builder = Builder()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # meshes that are only drawn may be missing
            builder.add_urdf(str(path))
            model = builder.finalize(device="cpu", skip_validation_inertia=True)
    except Exception as e:  # Newton raises whatever its reading of a malformed shape or limit stumbles on
        raise InputError(path, "", f"a robot that Newton cannot read ({e})", "a valid URDF") from None
    tree = from_newton(model)[0]
    return tree.with_(name=name)


def _origin(element: Element) -> tuple[Array, Array]:
    """Position [m] and orientation (w, x, y, z) of an ``<origin>``: roll, pitch, yaw about fixed x, y, z."""
    origin = element.find("origin")
    if origin is None:
        return np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    roll, pitch, yaw = (
        axis_angle_quat(e, a) for e, a in zip(np.eye(3), origin.vector("rpy", 3, [0, 0, 0]), strict=True)
    )
    return origin.vector("xyz", 3, [0.0, 0.0, 0.0]), quat_multiply(quat_multiply(yaw, pitch), roll)


def _link_values(link: Element) -> dict[str, object]:
    """Fields of `Tree` that a link's ``<inertial>`` gives."""
    inertial = link.find("inertial")
    if inertial is None:
        return {}
    mass, inertia = inertial.require("mass").positive("value"), inertial.require("inertia")
    matrix = np.array([inertia.number(key, 0.0) for key in _INERTIA]).reshape(3, 3)
    if np.linalg.eigvalsh(matrix)[0] < -1e-12 * np.trace(matrix):
        raise inertia.error("a negative principal inertia", "zero or more")
    return vars(MassProperties(mass, np.zeros(3), matrix).placed(_origin(inertial)))


def _joint_values(joint: Element) -> dict[str, object]:
    """Fields of `Tree` that a joint gives."""
    out: dict[str, object] = dict(zip(("position", "rotation"), _origin(joint), strict=True))
    if joint.attrib["type"] == "fixed":
        return out
    axis = joint.find("axis")
    vector = np.array([1.0, 0.0, 0.0]) if axis is None else axis.vector("xyz", 3, [1.0, 0.0, 0.0])
    if not vector.any():
        raise joint.error("an axis of length zero", "a direction")
    dynamics, extension = joint.find("dynamics"), joint.find("bough")
    out["axis"] = vector / np.linalg.norm(vector)
    out["damping"] = 0.0 if dynamics is None else dynamics.positive("damping", 0.0)
    if joint.attrib["type"] in _SLIDES and out["damping"]:
        raise joint.error(f"damping of a {joint.attrib['type']} joint", "0, or joints of one axis each")
    return out if extension is None else out | _extension_values(extension)


def _extension_values(extension: Element) -> dict[str, object]:
    """Fields of `Tree` in a ``<bough>`` element: springs, armature and pre-loads, which URDF lacks."""
    out: dict[str, object] = {key: extension.positive(key, 0.0) for key in ("stiffness", "armature")}
    if extension.keyword("joint", "scalar", ("scalar", "spherical")) == "scalar":
        rest, preload = extension.number("rest", 0.0), extension.number("preload", 0.0)
        return out | {"rest": [rest, 0.0, 0.0, 0.0], "preload": [preload, 0.0, 0.0]}
    quaternion = extension.vector("rest", 4, [1.0, 0.0, 0.0, 0.0])
    if not quaternion.any():
        raise extension.error("a rest orientation of length zero", "a quaternion w, x, y, z")
    preload3 = extension.vector("preload", 3, [0.0, 0.0, 0.0])
    return out | {"rest": quaternion / np.linalg.norm(quaternion), "preload": preload3}


def _with_cylinders(tree: Tree, links: dict[str, Element]) -> Tree:
    """Add the file's cylinders as capsules, for drawing and contact."""
    found = []
    for i, name in enumerate(tree.link_name):
        for item in links[name].find_all("collision") or links[name].find_all("visual"):
            shape = item.require("geometry").find("cylinder")
            if shape is not None:
                centre, turn = _origin(item)
                reach = quat_rotate(turn, np.array([0.0, 0.0, shape.positive("length") / 2]))
                found.append((i, centre - reach, centre + reach, [shape.positive("radius")] * 2))
    keys = ("shape_link", "shape_start", "shape_end", "shape_radius")
    columns = list(zip(*found, strict=True)) if found else [np.zeros((0, *getattr(tree, k).shape[1:])) for k in keys]
    return tree.with_(
        **{k: np.concatenate([getattr(tree, k), np.array(c)]) for k, c in zip(keys, columns, strict=True)}
    )


def _merge_spherical(tree: Tree, joints: dict[str, Element]) -> Tree:
    """Turn each three revolute joints that start with ``<bough joint="spherical">`` into one spherical joint."""
    dropped = []
    for i, name in enumerate(tree.link_name):
        extension = joints[name].find("bough") if name in joints else None
        if extension is None or extension.attrib.get("joint") != "spherical":
            continue
        children = tree.children()
        chain = [i]
        while len(chain) < 3 and len(children[chain[-1]]) == 1:
            chain.append(children[chain[-1]][0])
        if (
            len(chain) < 3
            or (tree.joint[chain] != Joint.REVOLUTE).any()
            or not np.allclose(tree.axis[chain], np.eye(3))
        ):
            raise extension.error("no revolute joints about x, y and z from here on", "three of them in a row")
        last = chain[-1]
        for key in ("position", "rotation", "stiffness", "damping", "armature", "rest", "preload"):
            getattr(tree, key)[last] = getattr(tree, key)[i]
        tree.joint[last], tree.parent[last], tree.axis[last] = Joint.SPHERICAL, tree.parent[i], [0.0, 0.0, 1.0]
        dropped += chain[:2]
    return _drop(tree, dropped)


def _with_slides(tree: Tree, joints: dict[str, Element], ignore: Collection[str]) -> Tree:
    """Put slides before the links of floating and planar joints, which are fixed so far."""
    for i in range(tree.num_links - 1, -1, -1):
        joint = joints.get(tree.link_name[i])
        count = 0 if joint is None or "free" in ignore else _SLIDES.get(joint.attrib["type"], 0)
        if joint is not None and count:
            tree = _with_slides_at(tree, i, count, _KINDS[joint.attrib["type"]])
    return tree


def _with_slides_at(tree: Tree, i: int, count: int, last: Joint) -> Tree:
    """Put ``count`` slides before link ``i``: along its frame's axes, or across its joint's axis where that turns."""
    axis = tree.axis[i].copy()
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    axes = np.eye(3) if last == Joint.SPHERICAL else np.array([across, np.cross(axis, across)])
    changes: dict[str, Any] = {}
    for item in fields(tree):
        value = getattr(tree, item.name)
        if isinstance(value, np.ndarray) and not item.name.startswith("shape_"):
            changes[item.name] = np.insert(value, [i] * count, 0, axis=0)
    new, link = slice(i, i + count), i + count
    numbers = np.where(np.arange(tree.num_links + 1) >= i, count, 0) + np.arange(tree.num_links + 1)
    numbers[-1] = -1  # stands for the world
    changes["parent"] = np.insert(numbers[tree.parent], [i] * count, 0)
    changes["shape_link"] = numbers[tree.shape_link]
    changes["parent"][new] = [numbers[tree.parent[i]], *range(i, link - 1)]
    changes["parent"][link] = link - 1
    changes["joint"][new], changes["joint"][link] = int(Joint.PRISMATIC), int(last)
    changes["axis"][new] = axes[:count]
    for key, neutral in (("position", np.zeros(3)), ("rotation", np.array([1.0, 0.0, 0.0, 0.0]))):
        changes[key][i], changes[key][i + 1 : link + 1] = getattr(tree, key)[i], neutral
    changes["level"][new] = tree.level[i]
    if last == Joint.SPHERICAL:
        changes["axis"][link], changes["rest"][link] = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]
    name = tree.link_name[i]
    names = [*tree.link_name[:i], *(f"{name}:{'xyz'[k]}" for k in range(count)), *tree.link_name[i:]]
    return tree.with_(**changes, link_name=names)


def _without_world(tree: Tree) -> Tree:
    roots = [i for i in range(tree.num_links) if tree.parent[i] < 0 and tree.link_name[i] == "world"]
    return _drop(tree, roots)


def _drop(tree: Tree, links: list[int]) -> Tree:
    """Remove links; children of a removed link become roots."""
    keep = np.setdiff1d(np.arange(tree.num_links), links)
    number = np.full(tree.num_links + 1, -1)  # its last entry stands for the world, index -1
    number[keep] = np.arange(len(keep))
    shapes = np.isin(tree.shape_link, keep)
    changes: dict[str, object] = {}
    for item in fields(tree):
        value = getattr(tree, item.name)
        if isinstance(value, np.ndarray):
            changes[item.name] = value[shapes] if item.name.startswith("shape_") else value[keep]
    changes["parent"] = number[tree.parent[keep]]
    changes["shape_link"] = number[tree.shape_link[shapes]]
    return tree.with_(**changes, link_name=[tree.link_name[i] for i in keep])
