"""A `Tree` as URDF text for the robotics tools that read it.

What URDF lacks, and what is written instead:

- A URDF link's frame is where its joint is, so link frames sit at the joint's ``anchor``: a body frame origin is
  ``R (-anchor)`` from it, with the same axes.
- No spherical joints: three revolute joints in a row, about x, y and z, with two nearly massless links between. For
  their angles a, b, c the spherical joint's rotation is ``Rx(a) Ry(b) Rz(c)`` (intrinsic x-y-z), singular at
  b = +-90 degrees. Damping on the three angles equals the spherical joint's only for small angles.
- No springs, rest positions, armature or pre-loads: written as attributes of a ``<bough>`` element inside the
  (first) joint, which other readers skip.
- No capsules: a cylinder of the mean radius and two spheres of the end radii.
"""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

from ..base.errors import InputError
from ..base.rotation import quat_matrix, quat_rotate
from ..base.types import Array
from ..trees.tree import Joint, Tree
from .export_mesh import level_color
from .export_mjcf import numbers
from .import_urdf import NO_LIMIT

ROOT = "world"
"""Name of the massless URDF link that the tree's roots hang on."""

_KIND = {Joint.FIXED: "fixed", Joint.REVOLUTE: "continuous", Joint.PRISMATIC: "prismatic"}
_LIGHT = 1e-9  # mass and inertia of the links inside a spherical joint, as a share of the link that it carries
_FAR = {"lower": f"{-NO_LIMIT:g}", "upper": f"{NO_LIMIT:g}", "effort": "1e9", "velocity": "1e9"}


def to_urdf(tree: Tree) -> str:
    """Write one tree as URDF; see the head of this module for what is mapped to what.

    Every joint is named ``<link>_joint``, those of a spherical joint ``<link>_x``, ``<link>_y``, ``<link>_z``.
    Numbers are written so that they read back to the same float64.

    Returns:
        The text, ending in a newline.

    Raises:
        InputError: A link's name collides with one that the spherical joints or the root need.
    """
    _check_names(tree)
    robot = ET.Element("robot", name=tree.name)
    text = (
        " Spherical joints are three: R = Rx(a) Ry(b) Rz(c). Springs [N m/rad, N/m], armature, rest, preload: <bough>. "
    )
    robot.append(ET.Comment(text))
    ET.SubElement(robot, "link", name=ROOT)
    for i in range(tree.num_links):
        _write_link(robot, tree, i)
        if tree.joint[i] == Joint.SPHERICAL:
            _write_spherical(robot, tree, i)
        else:
            _write_joint(robot, tree, i)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def _check_names(tree: Tree) -> None:
    spherical = [n for n, j in zip(tree.link_name, tree.joint, strict=True) if j == Joint.SPHERICAL]
    taken = {ROOT, *(f"{n}_{suffix}" for n in spherical for suffix in "xy")}
    for name in tree.link_name:
        if name in taken:
            allowed = "a name that URDF's own links leave free"
            raise InputError(tree.name, f"link {name}", f"the name {name!r}", allowed)


def _above(tree: Tree, i: int) -> str:
    """Name of the URDF link that link i hangs on."""
    return tree.link_name[tree.parent[i]] if tree.parent[i] >= 0 else ROOT


def _anchor(tree: Tree, i: int) -> Array:
    """Origin of link i's URDF frame in its body frame [m], shape [3]."""
    turns = i >= 0 and tree.joint[i] in (Joint.REVOLUTE, Joint.SPHERICAL)
    return tree.anchor[i] if turns else np.zeros(3)


def _write_link(robot: ET.Element, tree: Tree, i: int) -> None:
    link = ET.SubElement(robot, "link", name=tree.link_name[i])
    shift = -_anchor(tree, i)
    _write_inertial(link, tree.mass[i], tree.com[i] + shift, tree.inertia[i])
    for s in np.flatnonzero(tree.shape_link == i):
        start, end = tree.shape_start[s] + shift, tree.shape_end[s] + shift
        _write_capsule(link, start, end, tree.shape_radius[s], int(tree.level[i]))


def _write_inertial(link: ET.Element, mass: float, com: Array, inertia: Array) -> None:
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=numbers(com), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=numbers([mass]))
    entries = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}
    ET.SubElement(inertial, "inertia", {f"i{k}": numbers([inertia[ij]]) for k, ij in entries.items()})


def _write_capsule(link: ET.Element, start: Array, end: Array, radius: Array, level: int) -> None:
    across, length = end - start, float(np.linalg.norm(end - start))
    parts = [("sphere", start, {"radius": numbers(radius[:1])}), ("sphere", end, {"radius": numbers(radius[1:])})]
    if length > 0:
        size = {"radius": numbers([radius.mean()]), "length": numbers([length])}
        parts.append(("cylinder", (start + end) / 2, size))
    pitch, yaw = np.arctan2(np.hypot(*across[:2]), across[2]), np.arctan2(across[1], across[0])
    for tag in ("visual", "collision"):
        for shape, centre, size in parts:
            item = ET.SubElement(link, tag)
            ET.SubElement(item, "origin", xyz=numbers(centre), rpy=numbers([0.0, pitch, yaw]))
            ET.SubElement(ET.SubElement(item, "geometry"), shape, size)
            if tag == "visual":
                paint = ET.SubElement(item, "material", name=f"level{level}")
                ET.SubElement(paint, "color", rgba=" ".join(f"{c:.3f}" for c in (*level_color(level), 1.0)))


def _add_joint(robot: ET.Element, name: str, kind: str, links: tuple[str, str]) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=links[0])
    ET.SubElement(joint, "child", link=links[1])
    return joint


def _write_origin(joint: ET.Element, tree: Tree, i: int) -> None:
    """Place link i's URDF frame in its parent's."""
    p = int(tree.parent[i])
    xyz = tree.position[i] + quat_rotate(tree.rotation[i], _anchor(tree, i)) - _anchor(tree, p)
    ET.SubElement(joint, "origin", xyz=numbers(xyz), rpy=numbers(roll_pitch_yaw(quat_matrix(tree.rotation[i]))))


def _write_joint(robot: ET.Element, tree: Tree, i: int) -> None:
    kind, name = Joint(int(tree.joint[i])), tree.link_name[i]
    joint = _add_joint(robot, f"{name}_joint", _KIND[kind], (_above(tree, i), name))
    _write_origin(joint, tree, i)
    if kind == Joint.FIXED:
        return
    ET.SubElement(joint, "axis", xyz=numbers(tree.axis[i]))
    if kind == Joint.PRISMATIC:
        ET.SubElement(joint, "limit", _FAR)
    ET.SubElement(joint, "dynamics", damping=numbers([tree.damping[i]]), friction="0")
    _write_extension(joint, tree, i, "scalar")


def _write_spherical(robot: ET.Element, tree: Tree, i: int) -> None:
    """Write link i's spherical joint as revolute joints about x, y and z with two light links between."""
    name = tree.link_name[i]
    chain = [_above(tree, i), f"{name}_x", f"{name}_y", name]
    light = _LIGHT * float(np.trace(tree.inertia[i])) * np.eye(3)
    for k, letter in enumerate("xyz"):
        if k < 2:
            _write_inertial(ET.SubElement(robot, "link", name=chain[k + 1]), _LIGHT * tree.mass[i], np.zeros(3), light)
        joint = _add_joint(robot, f"{name}_{letter}", "continuous", (chain[k], chain[k + 1]))
        if k == 0:
            _write_origin(joint, tree, i)
            _write_extension(joint, tree, i, "spherical")
        ET.SubElement(joint, "axis", xyz=numbers(np.eye(3)[k]))
        ET.SubElement(joint, "dynamics", damping=numbers([tree.damping[i]]), friction="0")


def _write_extension(joint: ET.Element, tree: Tree, i: int, kind: str) -> None:
    count = (4, 3) if kind == "spherical" else (1, 1)
    values = {"stiffness": numbers([tree.stiffness[i]]), "armature": numbers([tree.armature[i]])}
    values |= {"rest": numbers(tree.rest[i, : count[0]]), "preload": numbers(tree.preload[i, : count[1]])}
    ET.SubElement(joint, "bough", {"joint": kind, **values})


def roll_pitch_yaw(matrix: Array) -> Array:
    """Angles r, p, y [rad] with ``matrix`` = Rz(y) Ry(p) Rx(r), exact also where p is 90 degrees."""
    pitch = np.arctan2(-matrix[2, 0], np.hypot(matrix[0, 0], matrix[1, 0]))
    yaw = np.arctan2(matrix[1, 0], matrix[0, 0])
    s, c = np.sin(yaw), np.cos(yaw)
    roll = np.arctan2(s * matrix[0, 2] - c * matrix[1, 2], c * matrix[1, 1] - s * matrix[0, 1])
    return np.array([roll, pitch, yaw])
