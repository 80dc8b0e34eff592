"""Import of MJCF: a `Tree` with the bodies, poses, joints and masses that C MuJoCo compiles from the same file.

Bodies, joints and primitive geoms are read here, in float64; meshes go through Newton's importer. Newton 1.8's
``add_mjcf`` was measured against C MuJoCo 4.0 first and cannot be the base: it keeps float32, puts bodies inside
``<frame>`` after their siblings, sorts several joints of one body by kind and gives them one common anchor, stops at
boxes and ellipsoids given by ``fromto``, and leaves out ``settotalmass`` and ``shellinertia``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.rotation import axis_angle_quat, quat_matrix, quat_multiply, quat_rotate
from ..base.types import Array
from ..trees.tree import Joint, Tree
from .mjcf_bodies import Body, read_bodies
from .mjcf_document import IDENTITY, Document, read_document, unit
from .mjcf_features import ignored_features, refuse_unsupported
from .mjcf_inertia import Pose
from .xml_tree import Element

_KINDS = {"hinge": Joint.REVOLUTE, "slide": Joint.PRISMATIC, "ball": Joint.SPHERICAL}


@dataclass
class Mechanism:
    """What an imported file describes.

    Attributes:
        tree: The links.
        gravity: Acceleration of gravity [m/s^2], shape [3].
        qpos0: Coordinates in which the file draws the mechanism, MuJoCo's order, shape [num_coordinates]; zero, and
            the identity for spherical joints, unless joints have a ``ref``.
        ignored: Short descriptions of features that were left out.
    """

    tree: Tree
    gravity: Array
    qpos0: Array
    ignored: list[str] = field(default_factory=list)


@dataclass
class Link:
    """One link of the tree; the fields are those of `Tree`."""

    link_name: str
    parent: int
    joint: Joint
    position: Array
    rotation: Array
    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))
    stiffness: float = 0.0
    damping: float = 0.0
    armature: float = 0.0
    anchor: Array = field(default_factory=lambda: np.zeros(3))
    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    rest: Array = field(default_factory=lambda: np.zeros(4))
    qpos0: Array = field(default_factory=lambda: np.zeros(0))


def load_mjcf(path: str | Path) -> Mechanism:
    """Read an MJCF file with hinge, slide and ball joints.

    Every body becomes a link, in MuJoCo's order. A body with several joints becomes a chain of links of which the
    last has the body's name and mass; the others are massless and are named ``<body>:<joint>``. Coordinates are
    MuJoCo's ``qpos``: a joint's ``ref`` is worked into the link's pose.

    Raises:
        InputError: The file cannot be read, is no valid MJCF, or holds physics a `Tree` cannot express (free joints,
            closed loops, springy tendons, flexible bodies, gravity compensation, negative masses ...).
    """
    document = read_document(path)
    refuse_unsupported(document)
    bodies = read_bodies(document)
    if not bodies:
        raise InputError(path, "<worldbody>", "no bodies", "at least one <body>")
    links, body_link = _make_links(document, bodies)
    tree = _make_tree(document.root.attrib.get("model", Path(path).stem), links)
    capsules = [(body_link[i], c) for i, body in enumerate(bodies) for c in body.capsules]
    tree = tree.with_(
        preload=_preload(document, len(links)),
        shape_link=np.array([link for link, _ in capsules], dtype=np.int64),
        shape_start=np.array([c.start for _, c in capsules]).reshape(-1, 3),
        shape_end=np.array([c.end for _, c in capsules]).reshape(-1, 3),
        shape_radius=np.array([[c.radius, c.radius] for _, c in capsules]).reshape(-1, 2),
    )
    qpos0 = np.concatenate([link.qpos0 for link in links])
    joints = [joint for body in bodies for joint, _ in body.joints]
    ignored = ignored_features(document, joints, [geom for body in bodies for geom, _ in body.geoms])
    return Mechanism(tree.validate(str(path)), _gravity(document), qpos0, ignored)


def _preload(document: Document, count: int) -> Array:
    """Constant joint forces [N m or N], shape [count, 3], which bough's own export keeps in ``<custom>``."""
    for item in document.sections("custom"):
        if item.tag == "numeric" and item.attrib.get("name") == "bough_preload":
            return item.vector("data", 3 * count).reshape(count, 3)
    return np.zeros((count, 3))


def _gravity(document: Document) -> Array:
    gravity = np.array([0.0, 0.0, -9.81])
    for option in document.root.find_all("option"):
        gravity = option.vector("gravity", 3, list(gravity))
    return gravity * float(document.flag("gravity"))


def _make_links(document: Document, bodies: list[Body]) -> tuple[list[Link], list[int]]:
    """Links of all bodies and the index of each body's own link."""
    links: list[Link] = []
    body_link: list[int] = []
    names = _names(bodies)
    for body, name in zip(bodies, names, strict=True):
        parent, pose = (body_link[body.parent] if body.parent >= 0 else -1), body.pose
        joints: list[tuple[Element | None, Pose]] = list(body.joints) or [(None, IDENTITY)]
        for k, (joint, frame) in enumerate(joints):
            last = k == len(joints) - 1
            link_name = name if last or joint is None else f"{name}:{joint.attrib.get('name', k)}"
            link = Link(link_name, parent, Joint.FIXED, *pose)
            if joint is not None:
                _set_joint(document, link, joint, frame)
            links.append(link)
            parent, pose = len(links) - 1, IDENTITY
        links[-1].mass, links[-1].com, links[-1].inertia = body.matter.mass, body.matter.com, body.matter.inertia
        body_link.append(len(links) - 1)
    return links, body_link


def _names(bodies: list[Body]) -> list[str]:
    """Names of the bodies; a nameless one is called ``body<id>`` after its number in MuJoCo."""
    taken: set[str] = {"world"}
    for body in bodies:
        name = body.element.attrib.get("name", "")
        if name and name in taken:
            raise body.element.error(f"the name '{name}' twice", "unique body names, other than 'world'")
        taken.add(name)
    names = []
    for i, body in enumerate(bodies):
        name = body.element.attrib.get("name", "") or f"body{i + 1}"
        while not body.element.attrib.get("name") and name in taken:
            name += "_"
        names.append(name)
    return names


def _set_joint(document: Document, link: Link, joint: Element, frame: Pose) -> None:
    """Fill in a link's joint; the pose, given at ``qpos = ref``, is taken back to ``qpos = 0``."""
    link.joint = _KINDS[joint.keyword("type", "hinge", tuple(_KINDS))]
    link.anchor = frame[0] + quat_rotate(frame[1], joint.vector("pos", 3, [0.0, 0.0, 0.0]))
    link.stiffness = float(joint.vector("stiffness", 3, [0.0], at_least=1)[0]) * document.flag("spring")
    link.damping = float(joint.vector("damping", 3, [0.0], at_least=1)[0]) * document.flag("damper")
    link.armature = joint.positive("armature", 0.0)
    if link.joint == Joint.SPHERICAL:
        link.rest = link.qpos0 = IDENTITY[1]
        return
    axis = joint.vector("axis", 3, [0.0, 0.0, 1.0])
    link.axis = quat_rotate(frame[1], unit(joint, "axis", axis))
    angle = document.angle_unit if link.joint == Joint.REVOLUTE else 1.0
    ref = joint.number("ref", 0.0) * angle
    link.rest = np.array([joint.number("springref", 0.0) * angle, 0.0, 0.0, 0.0])
    link.qpos0 = np.array([ref])
    if link.joint == Joint.PRISMATIC:
        link.position = link.position - quat_matrix(link.rotation) @ link.axis * ref
    else:
        back = axis_angle_quat(link.axis, np.asarray(-ref))
        link.position = link.position + quat_rotate(link.rotation, link.anchor - quat_rotate(back, link.anchor))
        link.rotation = quat_multiply(link.rotation, back)


def _make_tree(name: str, links: list[Link]) -> Tree:
    columns = [key for key in vars(links[0]) if key not in ("link_name", "qpos0")]
    arrays = {key: np.array([getattr(link, key) for link in links]) for key in columns}
    return Tree(name=name, link_name=[link.link_name for link in links], **arrays)
