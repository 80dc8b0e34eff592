"""A `Tree` as MJCF text for MuJoCo and everything that reads its format."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np

from ..base.errors import InputError
from ..base.types import Array
from ..trees.tree import Joint, Tree
from .export_mesh import level_color

_KIND = {Joint.REVOLUTE: "hinge", Joint.SPHERICAL: "ball", Joint.PRISMATIC: "slide"}
_SMALLEST = 1e-15  # MuJoCo's mjMINVAL: the least mass and principal inertia of a body that moves


def to_mjcf(tree: Tree, *, gravity: float = 9.81, timestep: float = 1.0 / 240.0) -> str:
    """Write one tree as MJCF.

    Bodies are nested with children in index order; a tree numbered depth-first keeps its numbering in MuJoCo.
    Numbers are written so that they read back to the same float64. A capsule's geom has the mean of its two radii,
    takes no part in collision and adds no mass. MJCF has no pre-load: non-zero ``preload`` is kept,
    link by link, in ``<custom><numeric name="bough_preload"/></custom>``.

    Args:
        tree: The tree.
        gravity: Gravity along -z [m/s^2].
        timestep: Step of MuJoCo's integrator [s].

    Returns:
        The text, ending in a newline.

    Raises:
        InputError: Names the link that MJCF or MuJoCo cannot represent: a link named world, a spherical joint whose
            spring is relaxed away from joint zero, a moving link without mass or inertia, principal inertias that
            no body can have.
    """
    root = ET.Element("mujoco", model=tree.name)
    ET.SubElement(root, "compiler", angle="radian", inertiafromgeom="false", autolimits="true")
    option = {"gravity": numbers([0.0, 0.0, -gravity]), "timestep": numbers([timestep])}
    ET.SubElement(root, "option", {"integrator": "implicitfast", **option})
    if tree.preload.any():
        _write_preload(root, tree)
    world, children = ET.SubElement(root, "worldbody"), tree.children()
    todo = [(i, world) for i in reversed(range(tree.num_links)) if tree.parent[i] < 0]
    while todo:
        i, above = todo.pop()
        body = _write_link(above, tree, i, children)
        todo += [(c, body) for c in reversed(children[i])]
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _write_preload(root: ET.Element, tree: Tree) -> None:
    root.append(ET.Comment(" bough_preload: pre-loads [N m or N], three numbers a link, not in MuJoCo "))
    data = numbers(tree.preload.ravel())
    ET.SubElement(ET.SubElement(root, "custom"), "numeric", name="bough_preload", data=data)


def _write_link(above: ET.Element, tree: Tree, i: int, children: list[list[int]]) -> ET.Element:
    """Append link i's body to its parent's element and return it."""
    if tree.link_name[i] == "world":
        raise InputError(tree.name, "link world", "the name 'world'", "in MJCF, any other name")
    pose = {"pos": numbers(tree.position[i]), "quat": numbers(tree.rotation[i])}
    body = ET.SubElement(above, "body", {"name": tree.link_name[i], **pose})
    if tree.joint[i] != Joint.FIXED:
        if not _has_mass(tree, i, children):
            found = f"mass {tree.mass[i]:g} kg with principal inertias {np.linalg.eigvalsh(tree.inertia[i])} kg m^2"
            allowed = "for MuJoCo, above 1e-15 on every link with a moving joint (or on one fixed to it)"
            raise InputError(tree.name, f"link {tree.link_name[i]}", found, allowed)
        _write_joint(body, tree, i)
    _write_inertial(body, tree, i)
    for s in np.flatnonzero(tree.shape_link == i):
        _write_capsule(body, tree, int(s))
    return body


def _has_mass(tree: Tree, i: int, children: list[list[int]]) -> bool:
    """Whether MuJoCo accepts the link as moving: mass and inertia of its own or of a link fixed to it."""
    if tree.mass[i] >= _SMALLEST and np.linalg.eigvalsh(tree.inertia[i])[0] >= _SMALLEST:
        return True
    return any(tree.joint[c] == Joint.FIXED and _has_mass(tree, c, children) for c in children[i])


def _write_joint(body: ET.Element, tree: Tree, i: int) -> None:
    kind = Joint(int(tree.joint[i]))
    parameters = {name: numbers([getattr(tree, name)[i]]) for name in ("stiffness", "damping", "armature")}
    if kind == Joint.SPHERICAL:
        if abs(tree.rest[i, 0]) < 1.0 - 1e-12:
            found = f"a spherical joint relaxed at the quaternion {numbers(tree.rest[i])}"
            place, allowed = f"link {tree.link_name[i]}", "in MJCF, one relaxed at joint zero (1 0 0 0)"
            raise InputError(tree.name, place, found, allowed)
    else:
        parameters |= {"axis": numbers(tree.axis[i]), "springref": numbers(tree.rest[i, :1])}
    name, pos = f"{tree.link_name[i]}_joint", numbers(tree.anchor[i])
    ET.SubElement(body, "joint", {"name": name, "type": _KIND[kind], "pos": pos, **parameters})


def _write_inertial(body: ET.Element, tree: Tree, i: int) -> None:
    inertia, principal = tree.inertia[i], np.linalg.eigvalsh(tree.inertia[i])
    if principal[0] + principal[1] < principal[2] * (1.0 - 1e-9):
        found, allowed = f"principal inertias {principal} kg m^2", "the largest at most the sum of the other two"
        raise InputError(tree.name, f"link {tree.link_name[i]}", found, allowed)
    if np.count_nonzero(inertia - np.diag(np.diag(inertia))) == 0:
        moments = {"diaginertia": numbers(np.diag(inertia))}
    else:
        moments = {"fullinertia": numbers(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])}
    ET.SubElement(body, "inertial", {"pos": numbers(tree.com[i]), "mass": numbers([tree.mass[i]]), **moments})


def _write_capsule(body: ET.Element, tree: Tree, s: int) -> None:
    start, end, link = tree.shape_start[s], tree.shape_end[s], tree.shape_link[s]
    look = {"rgba": " ".join(f"{c:.3f}" for c in (*level_color(tree.level[link]), 1.0))}
    form = {"type": "capsule", "fromto": numbers([*start, *end])}
    if np.linalg.norm(end - start) < 1e-9:  # MuJoCo refuses a capsule without length
        form = {"type": "sphere", "pos": numbers(start)}
    size = numbers([tree.shape_radius[s].mean()])
    ET.SubElement(body, "geom", {**form, "size": size, "mass": "0", "contype": "0", "conaffinity": "0", **look})


def numbers(values: Array | list[float]) -> str:
    """Numbers with the fewest digits that read back to the same float64."""
    return " ".join(repr(float(v)) for v in values)
