"""Bodies of an MJCF file: poses with frames resolved, joints, mass properties and capsules."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..base.rotation import quat_rotate, z_to
from ..base.types import Array
from .mjcf_document import IDENTITY, ORIENTATIONS, Document
from .mjcf_features import check_attributes, check_joint
from .mjcf_inertia import (
    MASSLESS,
    SIZES,
    SMALL,
    MassProperties,
    Pose,
    combined,
    compose,
    geom_sizes,
    mesh_geom,
    primitive,
)
from .xml_tree import Element


@dataclass
class Capsule:
    """One capsule for drawing and contact: end points [3] [m] in the body frame and radius [m]."""

    start: Array
    end: Array
    radius: float


@dataclass
class Body:
    """One body of the file: its pose in its parent's frame and what it carries, frames resolved."""

    element: Element
    parent: int
    pose: Pose
    joints: list[tuple[Element, Pose]] = field(default_factory=list)
    geoms: list[tuple[Element, Pose]] = field(default_factory=list)
    inertial: tuple[Element, Pose] | None = None
    matter: MassProperties = field(default_factory=MassProperties)
    capsules: list[Capsule] = field(default_factory=list)


def read_bodies(document: Document) -> list[Body]:
    """Read all bodies, depth first in document order, with their mass properties.

    Raises:
        InputError: A malformed or unsupported body, a body that moves without mass, a name given twice.
    """
    bodies = _walk(document)
    for body in bodies:
        _read_geoms(document, body)
    _check_mass(bodies)
    _scale_total_mass(document, bodies)
    return bodies


def _walk(document: Document) -> list[Body]:
    """Walk the world without recursion: chains may be thousands of bodies long."""
    bodies: list[Body] = []
    world = [(child, -1, IDENTITY, "main") for child in document.sections("worldbody")]
    stack = world[::-1]
    while stack:
        element, body, frame, childclass = stack.pop()
        if element.tag in ("body", "frame"):
            check_attributes(element)
            document.defaults(element, "childclass", childclass)
            childclass = element.attrib.get("childclass", childclass)
            frame = compose(frame, document.pose(document.resolved(element, "main")))
            if element.tag == "body":
                bodies.append(Body(element, body, frame))
                body, frame = len(bodies) - 1, IDENTITY
            stack.extend((child, body, frame, childclass) for child in element.children[::-1])
        elif body >= 0:
            _attach(document, bodies[body], element, frame, childclass)
    return bodies


def _attach(document: Document, body: Body, element: Element, frame: Pose, childclass: str) -> None:
    """Give a body a joint, a geom or its inertia."""
    if element.tag not in ("joint", "geom", "inertial"):
        return
    check_attributes(element)
    resolved = document.resolved(element, childclass)
    if element.tag == "joint":
        check_joint(resolved)
        body.joints.append((resolved, frame))
    elif element.tag == "geom":
        body.geoms.append((resolved, frame))
    elif body.inertial is not None:
        raise element.error("a second <inertial>", "one per body")
    else:
        body.inertial = (resolved, frame)


def _read_geoms(document: Document, body: Body) -> None:
    """Work out a body's mass properties and capsules."""
    low, high = document.compiler.vector("inertiagrouprange", 2, [0, 5])
    parts = []
    for geom, frame in body.geoms:
        matter = _read_geom(document, body, geom, frame)
        if low <= geom.number("group", 0) <= high:
            parts.append(matter)
    mode = document.compiler.keyword("inertiafromgeom", "auto", ("auto", "true", "false"))
    explicit = None if body.inertial is None else _explicit_inertia(document, *body.inertial)
    total = combined(parts)
    if explicit is not None and (mode != "true" or total.mass < SMALL):
        total = explicit
    elif mode == "false":
        total = MassProperties()
    body.matter = _bounded(document, body, total)


def _read_geom(document: Document, body: Body, geom: Element, frame: Pose) -> MassProperties:
    kind = geom.keyword("type", "mesh" if "mesh" in geom.attrib else "sphere", (*SIZES, *MASSLESS, "mesh"))
    if kind == "plane":
        raise geom.error("a plane in a body", "planes in <worldbody> only")
    if kind in MASSLESS:
        return MassProperties()
    if "mesh" in geom.attrib:
        pose = compose(frame, document.pose(geom))
        return mesh_geom(geom, _mesh_asset(document, geom), document.compiler).placed(pose)
    if kind == "mesh":
        raise geom.error("a mesh geom without the attribute 'mesh'", "the name of a mesh")
    pose, size = _primitive_placement(document, geom, kind)
    pose = compose(frame, pose)
    if kind in ("sphere", "capsule", "cylinder"):
        reach = quat_rotate(pose[1], np.array([0.0, 0.0, size[1] if kind != "sphere" else 0.0]))
        body.capsules.append(Capsule(pose[0] - reach, pose[0] + reach, float(size[0])))
    return primitive(geom, kind, size).placed(pose)


def _mesh_asset(document: Document, geom: Element) -> Element:
    for asset in document.sections("asset"):
        name = asset.attrib.get("name", Path(asset.attrib.get("file", "")).stem)
        if asset.tag == "mesh" and name == geom.attrib["mesh"]:
            resolved = document.resolved(asset, "main")
            resolved.attrib = {k: v for k, v in resolved.attrib.items() if k != "class"} | {"name": name}
            return resolved
    raise geom.error(f"mesh='{geom.attrib['mesh']}'", "the name of a mesh in <asset>")


def _primitive_placement(document: Document, geom: Element, kind: str) -> tuple[Pose, Array]:
    """Pose and sizes of a primitive geom; ``fromto`` puts its z axis along the segment, from the end to the start."""
    if "fromto" not in geom.attrib:
        return document.pose(geom), geom_sizes(geom, kind, has_segment=False)
    if kind == "sphere" or "pos" in geom.attrib:
        raise geom.error("fromto with " + ("a sphere" if kind == "sphere" else "pos"), "fromto alone, not for spheres")
    ends = geom.vector("fromto", 6)
    half = (ends[:3] - ends[3:]) / 2
    length = float(np.linalg.norm(half))
    if length < 1e-14:
        raise geom.error(f"fromto='{geom.attrib['fromto']}', a segment of length zero", "two different points")
    size = geom_sizes(geom, kind, has_segment=True)
    if kind in ("box", "ellipsoid"):
        size[1] = size[0]
    size[-1] = length
    return ((ends[:3] + ends[3:]) / 2, z_to(half / length)), size


def _explicit_inertia(document: Document, element: Element, frame: Pose) -> MassProperties:
    """Mass properties of an ``<inertial>`` element in the body frame."""
    mass, com = element.positive("mass"), element.vector("pos", 3)
    if "fullinertia" in element.attrib:
        if "diaginertia" in element.attrib or set(ORIENTATIONS) & set(element.attrib):
            raise element.error("fullinertia with diaginertia or an orientation", "fullinertia alone")
        xx, yy, zz, xy, xz, yz = element.vector("fullinertia", 6)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        inertia = np.diag(element.vector("diaginertia", 3, [0.0, 0.0, 0.0]))
    if np.linalg.eigvalsh(inertia)[0] < 0:
        raise element.error("a negative principal inertia", "zero or more")
    rotation = document.pose(element)[1]
    # As in MuJoCo 4.0, which composes the frame of an <inertial> like that of a geom.
    return MassProperties(mass, np.zeros(3), inertia).placed(compose(frame, (com, rotation)))


def _bounded(document: Document, body: Body, matter: MassProperties) -> MassProperties:
    """Apply ``boundmass``, ``boundinertia`` and ``balanceinertia``, or refuse an inertia no matter can have."""
    low = document.compiler.positive("boundinertia", 0.0)
    mass = max(matter.mass, document.compiler.positive("boundmass", 0.0))
    values, axes = np.linalg.eigh(matter.inertia)
    bounded = np.maximum(values, low)
    if bounded[0] + bounded[1] < bounded[2] * (1 - 1e-9):
        if document.compiler.attrib.get("balanceinertia") != "true":
            raise body.element.error(f"principal inertias {bounded} kg m^2", "A + B >= C, as for real matter")
        bounded = np.full(3, bounded.mean())
    inertia = matter.inertia if np.array_equal(values, bounded) else axes @ np.diag(bounded) @ axes.T
    return MassProperties(mass, matter.com, inertia)


def _check_mass(bodies: list[Body]) -> None:
    """Refuse a body that moves without mass or inertia of its own or of what is fixed to it."""
    mass = [body.matter.mass for body in bodies]
    inertia = [float(np.linalg.eigvalsh(body.matter.inertia)[0]) for body in bodies]
    for i in range(len(bodies) - 1, -1, -1):
        body = bodies[i]
        if body.joints and (mass[i] < SMALL or inertia[i] < SMALL):
            raise body.element.error("a moving body without mass or inertia", "a geom, or an <inertial> with both")
        if not body.joints and body.parent >= 0:
            mass[body.parent] += mass[i]
            inertia[body.parent] += inertia[i]


def _scale_total_mass(document: Document, bodies: list[Body]) -> None:
    total = document.compiler.number("settotalmass", -1.0)
    now = sum(body.matter.mass for body in bodies)
    if total > 0 and now > 0:
        for body in bodies:
            m = body.matter
            body.matter = MassProperties(m.mass * total / now, m.com, m.inertia * total / now)
