"""Import of MJCF: a `Tree` with the bodies, poses, joints and masses that MuJoCo's own compiler makes of the file.

MuJoCo reads and compiles in float64. Newton 1.8's ``add_mjcf`` was measured against it and cannot take its place: it
keeps float32, puts bodies inside ``<frame>`` after their siblings, sorts several joints of one body by kind and gives
them one common anchor, stops at boxes and ellipsoids given by ``fromto``, and leaves out ``settotalmass`` and
``shellinertia``.
"""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.console import uninterrupted
from ..base.errors import InputError
from ..base.mujoco_log import without_log
from ..base.rotation import axis_angle_quat, quat_matrix, quat_multiply, quat_rotate
from ..base.types import Array
from ..engine.stepping import Stepping
from ..trees.tree import Joint, Tree
from .mjcf_features import (
    FREE,
    Where,
    check_contacts,
    check_model,
    check_source,
    disabled,
    keep_bodies,
    line_of,
    world_masks,
)
from .mjcf_source import Source, read_source
from .omissions import Omissions, Place

if TYPE_CHECKING:
    from ..engine.simulator import Simulator

_STEPPING = Stepping()
_IDENTITY = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
#: What a measured mechanism may leave out: its recordings show what friction there is, and that nothing was in its way.
MEASURED = ("limits", "friction", "contacts", "actuators", "fluid")
_KINDS = {1: Joint.SPHERICAL, 2: Joint.PRISMATIC, 3: Joint.REVOLUTE}  # by MuJoCo's mjtJoint
_SPHERE = 2  # in MuJoCo's mjtGeom
_CAPSULES = (_SPHERE, 3, 5)  # with capsule and cylinder
_SAME = 1e-13  # relative difference by which the compiler's own rounding can move what the file states


@dataclass
class Mechanism:
    """What an imported file describes.

    Attributes:
        tree: The links.
        gravity: Acceleration of gravity [m/s^2], shape [3].
        qpos0: Coordinates in which the file draws the mechanism, MuJoCo's order, shape [num_coordinates]; zero, and
            the identity for spherical joints, unless joints have a ``ref``.
        ignored: Short descriptions of features that were left out.
        joint_name: Name of each link's joint in the file, length L; empty for a fixed link and a nameless joint.
        joint_place: Where in the file each link's joint stands, for messages, length L; empty for a fixed link.
        friction: Dry friction of each link's hinge or slide [N m or N], shape [L]. A `Tree` has none: `simulator`
            gives it to the effect ``dry_friction``, and so does ``bough simulate``.
    """

    tree: Tree
    gravity: Array
    qpos0: Array
    ignored: list[str] = field(default_factory=list)
    joint_name: list[str] = field(default_factory=list)
    joint_place: list[str] = field(default_factory=list)
    friction: Array = field(default_factory=lambda: np.zeros(0))

    def simulator(
        self, worlds: int = 1, stepping: Stepping = _STEPPING, effects: Mapping[str, Mapping[str, float]] | None = None
    ) -> Simulator:
        """Return a simulator of copies of the mechanism at ``qpos0``, with its dry friction as an effect.

        Args:
            worlds: Number of copies.
            stepping: Step, substeps, precision and device (`bough.sim.engine.stepping.Stepping`).
            effects: Further effects and their values, the same in all worlds.

        Raises:
            InputError: There is no such device or effect; the tree cannot move; ``dry_friction`` among the effects of
                a mechanism that has its own.
        """
        from ..engine.prepare import make_simulator  # Warp, which those who only read do not need

        simulator = make_simulator(stepping, self.tree, self.gravity, worlds, effects, self.friction)
        simulator.state.set_qpos(self.qpos0)
        simulator.refresh()
        simulator.mark_start()
        return simulator


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
    number: int = -1  # of the joint in MuJoCo's model
    friction: float = 0.0


def load_mjcf(path: str | Path, ignore: Sequence[str] = ()) -> Mechanism:
    """Read an MJCF file with hinge, slide, ball and free joints.

    Every body becomes a link, in MuJoCo's order. A body with several joints becomes a chain of links of which the
    last has the body's name and mass; the others are massless and are named ``<body>:<joint>``. A free body becomes
    three slides along the world's axes and a ball joint, which have its seven numbers in ``qpos``. Coordinates are
    MuJoCo's ``qpos``: a joint's ``ref`` is worked into the link's pose.

    Args:
        path: The file.
        ignore: Words of `bough.sim.formats.omissions` for what may be left out of the tree, or "all".

    Raises:
        InputError: The file cannot be read, is no valid MJCF, or holds physics a `Tree` cannot express: joint limits,
            contacts, actuators, closed loops, springy tendons, gravity compensation and the like unless ignored;
            flexible bodies, negative masses ...
    """
    source, omissions = read_source(path), Omissions(ignore)
    spec, model, world = _compile(source, Path(path).resolve().parent, omissions)
    bodies = _depth_first(source, spec, model)
    if not bodies:
        raise InputError(path, "<worldbody>", "no bodies", "at least one <body>")
    where = _places(source, spec)
    check_model(model, where, omissions)
    check_contacts(model, bodies, world, *_contact_section(source, model), where, omissions)
    written = Written({b.id: (b.quat, b.fullinertia) for b in spec.bodies}, {j.id: j.axis for j in spec.joints})
    name = source.root.attrib.get("model", Path(path).stem)
    mechanism = describe(model, bodies, name, omissions, where, written)
    tree = mechanism.tree.with_(preload=_preload(source, mechanism.tree.num_links))
    return replace(mechanism, tree=tree.validate(str(path)))


def describe(
    model: Any, bodies: list[tuple[int, int]], name: str, omissions: Omissions, where: Where, written: Written
) -> Mechanism:
    """Return the mechanism of a compiled model.

    Args:
        model: MuJoCo's compiled model, checked.
        bodies: Bodies and their parents (0 is the world), parents first.
        name: Name of the tree.
        omissions: What was found that a tree does not have.
        where: Gives places for messages.
        written: Numbers as the source states them, where it states any.

    Raises:
        InputError: Something may not be left out.
    """
    ignored = omissions.settle()
    links, body_link = _make_links(model, bodies, omissions.ignore, written)
    tree = _make_tree(name, links).with_(**_capsules(model, body_link))
    gravity = np.zeros(3) if disabled(model, "GRAVITY") else model.opt.gravity.copy()
    numbers = [link.number for link in links]
    return Mechanism(
        tree=tree,
        gravity=gravity,
        qpos0=np.concatenate([link.qpos0 for link in links]),
        ignored=ignored,
        joint_name=[model.joint(n).name if n >= 0 else "" for n in numbers],
        joint_place=[where("joint", n)[1] if n >= 0 else "" for n in numbers],
        friction=np.array([link.friction for link in links]),
    )


def _compile(source: Source, folder: Path, omissions: Omissions) -> tuple[Any, Any, tuple[int, int]]:
    """MuJoCo's description of the file, the model that it compiles of the bodies, and the world's collision masks.

    Files are sought in ``folder``.

    Raises:
        InputError: MuJoCo refuses the file, or it holds what a tree cannot express.
    """
    with uninterrupted(), without_log(), warnings.catch_warnings():
        import mujoco  # not needed by those who read no MJCF

        warnings.simplefilter("ignore")  # of a simulation, which this is not
        try:
            spec = mujoco.MjSpec.from_string("\n".join(source.lines))
            spec.modelfiledir = str(folder)
            check_source(source, spec, omissions)
            world = world_masks(spec)
            keep_bodies(spec)
            return spec, spec.compile(), world
        except InputError:
            raise
        except (ValueError, RuntimeError, mujoco.FatalError) as e:
            raise source.refusal(str(e)) from None


def _places(source: Source, spec: Any) -> Where:
    """Return what gives the places of joints and bodies."""
    joints, bodies = {j.id: j for j in spec.joints}, {b.id: b for b in spec.bodies}

    def where(kind: str, number: int) -> Place:
        """Return file and line of joint or body ``number``, or of the section ``kind``."""
        items = {"joint": joints, "body": bodies}.get(kind)
        section = source.root.find(kind) or source.root
        at = section if items is None else source.element(line_of(items[number]))
        return at.file, at.place

    return where


def _contact_section(source: Source, model: Any) -> tuple[set[tuple[int, int]], int]:
    """Return the pairs of bodies that the file excludes, and how many pairs of geoms it names."""
    numbers = {model.body(i).name: i for i in range(model.nbody)}
    found = source.section("contact")
    named = [(e.attrib.get("body1", ""), e.attrib.get("body2", "")) for e in found if e.tag == "exclude"]
    excluded = {(numbers[a], numbers[b]) for a, b in named if a in numbers and b in numbers}
    return excluded, sum(e.tag == "pair" for e in found)


def _depth_first(source: Source, spec: Any, model: Any) -> list[tuple[int, int]]:
    """Bodies and their parents (0 is the world) in MuJoCo's order, those cut out of deep chains back in their place."""
    bodies = {line_of(body): body.id for body in spec.bodies[1:]} if source.moved else {}
    moved = {bodies[hole]: bodies[body] for hole, body in source.moved.items()}
    away = set(moved.values())
    children: list[list[int]] = [[] for _ in range(model.nbody)]
    for body in range(model.nbody - 1, 0, -1):
        if body not in away:
            children[model.body_parentid[body]].append(moved.get(body, body))
    out, todo = [], [(body, 0) for body in children[0]]
    while todo:
        out.append(todo.pop())
        body = out[-1][0]
        todo += [(child, body) for child in children[body]]
    return out


def _preload(source: Source, count: int) -> Array:
    """Pre-loads [N m or N], shape [count, 3], which bough's own export keeps in ``<custom>``."""
    for item in source.section("custom"):
        if item.tag == "numeric" and item.attrib.get("name") == "bough_preload":
            return item.vector("data", 3 * count).reshape(count, 3)
    return np.zeros((count, 3))


@dataclass(frozen=True)
class Written:
    """Numbers as the source states them; the compiler rounds them.

    Attributes:
        bodies: Orientation and full inertia (NaN where not stated) of bodies by number.
        axes: Axes of joints by number.
    """

    bodies: Mapping[int, tuple[Array, Array]] = field(default_factory=dict)
    axes: Mapping[int, Array] = field(default_factory=dict)


def _make_links(
    model: Any, bodies: list[tuple[int, int]], ignore: Collection[str], written: Written
) -> tuple[list[Link], dict[int, int]]:
    """Links of all bodies and the index of each body's own link."""
    links: list[Link] = []
    body_link = {0: -1}
    for (body, parent), name in zip(bodies, _names(model, bodies), strict=True):
        quat, inertia = written.bodies.get(body, (model.body_quat[body], np.full(6, np.nan)))
        above = body_link[parent]
        pose = model.body_pos[body].copy(), _direction(quat, model.body_quat[body])
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        if len(joints) and model.jnt_type[joints[0]] == FREE:
            links += _free_links(model, name, pose, joints[0], len(links), ignore)
        else:
            for k, joint in enumerate(joints or [-1]):
                link = Link(name, above, Joint.FIXED, *pose)
                if joint >= 0:
                    _set_joint(model, link, joint, written.axes.get(joint, model.jnt_axis[joint]), ignore)
                    if k < len(joints) - 1:
                        link.link_name = f"{name}:{model.joint(joint).name or k}"
                links.append(link)
                above, pose = len(links) - 1, _IDENTITY
        links[-1].mass, links[-1].com = float(model.body_mass[body]), model.body_ipos[body].copy()
        links[-1].inertia = _inertia(model, body, inertia)
        body_link[body] = len(links) - 1
    return links, body_link


def _free_links(
    model: Any, name: str, pose: tuple[Array, Array], joint: int, first: int, ignore: Collection[str]
) -> list[Link]:
    """Three slides along the world's axes and a ball joint, or a link that is fixed where free joints are ignored."""
    if "free" in ignore:
        return [Link(name, -1, Joint.FIXED, *pose)]
    links, at, dof = [], model.jnt_qposadr[joint], model.jnt_dofadr[joint]
    for k, axis in enumerate(np.eye(3)):
        rest = np.array([model.qpos_spring[at + k], 0.0, 0.0, 0.0])
        above = first + k - 1 if k else -1
        link = Link(f"{name}:{'xyz'[k]}", above, Joint.PRISMATIC, *_IDENTITY, axis=axis, rest=rest)
        link.qpos0 = model.qpos0[at + k : at + k + 1].copy()
        links.append(link)
    turn = Link(name, first + 2, Joint.SPHERICAL, *_IDENTITY, number=joint)
    turn.rest, turn.qpos0 = (values[at + 3 : at + 7].copy() for values in (model.qpos_spring, model.qpos0))
    links.append(turn)
    for k, link in enumerate(links):
        _set_passive(model, link, joint, dof + k)
    return links


def _names(model: Any, bodies: list[tuple[int, int]]) -> list[str]:
    """Names of the bodies; a nameless one is called ``body<number>`` after its place in MuJoCo's order."""
    given = [model.body(body).name for body, _ in bodies]
    taken, names = set(given), []
    for i, name in enumerate(given):
        new = name or f"body{i + 1}"
        while not name and new in taken:
            new += "_"
        names.append(new)
    return names


def _inertia(model: Any, body: int, written: Array) -> Array:
    """Inertia of a body about its centre of mass in its own axes [kg m^2], shape [3, 3]."""
    R = quat_matrix(model.body_iquat[body])
    inertia = R @ np.diag(model.body_inertia[body]) @ R.T
    xx, yy, zz, xy, xz, yz = written  # NaN if the file has none
    return _as_written(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), inertia)


def _as_written(written: Array, compiled: Array) -> Array:
    """Return what the file states, to its last digit, where the compiler did no more than round it."""
    same = np.allclose(written, compiled, rtol=0.0, atol=_SAME * np.abs(compiled).max())
    return np.array(written if same else compiled)


def _direction(written: Array, compiled: Array) -> Array:
    """Return a unit axis or quaternion as the file states it, or as frames and other ways to write it make it."""
    return _as_written(written / np.linalg.norm(written), compiled)


def _set_passive(model: Any, link: Link, joint: int, dof: int) -> None:
    """Fill in a joint's spring, damper and armature."""
    link.stiffness = 0.0 if disabled(model, "SPRING") else float(model.jnt_stiffness[joint])
    link.damping = 0.0 if disabled(model, "DAMPER") else float(model.dof_damping[dof])
    link.armature = float(model.dof_armature[dof])


def _set_joint(model: Any, link: Link, joint: int, axis: Array, ignore: Collection[str]) -> None:
    """Fill in a link's joint; the pose, given at ``qpos = ref``, is taken back to ``qpos = 0``."""
    dof, at = model.jnt_dofadr[joint], model.jnt_qposadr[joint]
    link.joint, link.number = _KINDS[int(model.jnt_type[joint])], joint
    link.anchor = model.jnt_pos[joint].copy()
    _set_passive(model, link, joint, dof)
    if link.joint == Joint.SPHERICAL:
        link.rest = link.qpos0 = _IDENTITY[1]
        return
    off = "friction" in ignore or disabled(model, "FRICTIONLOSS") or disabled(model, "CONSTRAINT")
    link.friction = 0.0 if off else float(model.dof_frictionloss[dof])
    link.axis, ref = _direction(axis, model.jnt_axis[joint]), float(model.qpos0[at])
    link.rest, link.qpos0 = np.array([model.qpos_spring[at], 0.0, 0.0, 0.0]), np.array([ref])
    if link.joint == Joint.PRISMATIC:
        link.position = link.position - quat_matrix(link.rotation) @ link.axis * ref
    else:
        back = axis_angle_quat(link.axis, np.asarray(-ref))
        link.position = link.position + quat_rotate(link.rotation, link.anchor - quat_rotate(back, link.anchor))
        link.rotation = quat_multiply(link.rotation, back)


def _make_tree(name: str, links: list[Link]) -> Tree:
    columns = [key for key in vars(links[0]) if key not in ("link_name", "qpos0", "number", "friction")]
    arrays = {key: np.array([getattr(link, key) for link in links]) for key in columns}
    return Tree(name=name, link_name=[link.link_name for link in links], **arrays)


def _capsules(model: Any, body_link: dict[int, int]) -> dict[str, Array]:
    """Shapes of the tree, for drawing and contact: spheres, capsules and cylinders, link by link."""
    link = np.array([body_link[body] for body in model.geom_bodyid], dtype=np.int64)
    geoms = np.flatnonzero(np.isin(model.geom_type, _CAPSULES))
    geoms = geoms[np.argsort(link[geoms], kind="stable")]
    half = np.where(model.geom_type[geoms] == _SPHERE, 0.0, model.geom_size[geoms, 1])
    reach = quat_rotate(model.geom_quat[geoms], half[:, None] * np.array([0.0, 0.0, 1.0]))
    return {
        "shape_link": link[geoms],
        "shape_start": model.geom_pos[geoms] - reach,
        "shape_end": model.geom_pos[geoms] + reach,
        "shape_radius": np.repeat(model.geom_size[geoms, :1], 2, axis=1),
    }
