"""Import of URDF through Newton's importer.

Newton gives the order of links and joints and the masses of links that have only collision shapes. It keeps float32
and reads its way past much that is wrong, so the file is checked first, with line numbers, and numbers that are
written in it (poses, axes, masses, inertias, damping) are taken from it in float64. A ``<bough>`` element in a joint,
as `bough.sim.formats.export_urdf` writes it, adds what URDF lacks; with ``joint="spherical"`` it makes one
spherical joint of the three revolute joints that start there.
"""

from __future__ import annotations

import warnings
from dataclasses import fields
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.rotation import axis_angle_quat, quat_multiply, quat_rotate
from ..base.types import Array
from ..trees.inertia import MassProperties
from ..trees.pose import zero_qpos
from ..trees.tree import Joint, Tree
from .import_mjcf import Mechanism
from .xml_tree import Element, read_xml

_KINDS = {
    "fixed": Joint.FIXED,
    "revolute": Joint.REVOLUTE,
    "continuous": Joint.REVOLUTE,
    "prismatic": Joint.PRISMATIC,
}
_INERTIA = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")


def load_urdf(path: str | Path) -> Mechanism:
    """Read a URDF file with fixed, revolute, continuous and prismatic joints.

    The root link is fixed to the world; a root called ``world`` is the world. Gravity is 9.81 m/s^2 along -z.

    Raises:
        InputError: The file cannot be read or is no valid URDF, or holds floating, planar or mimic joints, a closed
            loop, a link that does not exist, a negative mass or damping.
    """
    root = read_xml(path)
    if root.tag != "robot":
        raise root.error(f"<{root.tag}> as the root", "<robot>")
    links = _links(root)
    joints = _joints(root, links)
    values = {name: _link_values(link) for name, link in links.items()}
    for name, joint in joints.items():
        values[name] |= _joint_values(joint)
    tree = _through_newton(Path(path), root.attrib.get("name", Path(path).stem))
    for i, name in enumerate(tree.link_name):
        for key, value in values[name].items():
            getattr(tree, key)[i] = value
    tree = _with_cylinders(tree, links)
    tree = _merge_spherical(tree, joints)
    tree = _without_world(tree)
    if tree.num_links == 0:
        raise root.error("no link besides the world", "at least one <link>")
    gravity = np.array([0.0, 0.0, -9.81])
    named = [joints.get(name) for name in tree.link_name]
    names, places = [j.text("name") if j else "" for j in named], [j.place if j else "" for j in named]
    return Mechanism(tree.validate(str(path)), gravity, zero_qpos(tree), _ignored(joints), names, places)


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
    mimic = joint.find("mimic")
    if mimic is not None:
        raise joint.error("an unsupported <mimic>", "joints that move on their own")


def _check_reaches_root(name: str, joints: dict[str, Element]) -> None:
    seen: set[str] = set()
    while name in joints:
        if name in seen:
            raise joints[name].error("a closed loop of joints", "a tree")
        seen.add(name)
        name = joints[name].require("parent").text("link")


def _through_newton(path: Path, name: str) -> Tree:
    """Import the file with Newton; values are float32."""
    import newton

    from ..newton.bridge import from_newton  # Newton is slow to import, and checks of the file come first

    builder = newton.ModelBuilder()
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
    return out if extension is None else out | _extension_values(extension)


def _extension_values(extension: Element) -> dict[str, object]:
    """Fields of `Tree` in a ``<bough>`` element: springs, armature and constant forces, which URDF lacks."""
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


def _ignored(joints: dict[str, Element]) -> list[str]:
    limited = [j for j in joints.values() if j.attrib["type"] == "revolute" and j.find("limit") is not None]
    rubbing = [j for j in joints.values() for d in j.find_all("dynamics") if d.positive("friction", 0.0) > 0]
    counts = {"joint limits": len(limited), "joint friction": len(rubbing)}
    return [f"{name} ({count})" for name, count in counts.items() if count]
