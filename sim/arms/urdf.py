"""Any serial arm out of a URDF file.

The file is checked and read by `import_urdf`'s own functions, without Newton, whose importer would give links without
``<inertial>`` a mass of its own. This module picks the chain of revolute joints, freezes what is not on it, reads the
limits, and makes capsules of the collision shapes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from ..base.errors import InputError
from ..base.rotation import quat_conjugate, quat_multiply, quat_rotate
from ..base.types import Array
from ..formats.import_urdf import _KINDS, _SLIDES, _joint_values, _joints, _link_values, _links, _origin, _without_world
from ..formats.xml_tree import Element, read_xml
from ..trees.inertia import MassProperties, Pose, combined
from ..trees.pose import pose, zero_qpos
from ..trees.tree import Joint, Tree
from .arm import SERVO_GAIN, Arm

_IDENTITY: Pose = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
_Capsule = tuple[Array, Array, float]
_RULE = "one chain of revolute or continuous joints from the base to the end link"


def arm_from_urdf(path: str | Path, end_link: str | None = None) -> Arm:
    """Read the arm between a URDF's root link and ``end_link``.

    Joints that do not lead to ``end_link`` (a gripper's) stay still at zero, or at their limit nearest to it. Links
    that do not move against a link of the chain become part of it: mass, inertia and capsules; those that hang on the
    root become the static base. Home is zero, or the middle of the limits where zero is outside. The file's
    ``<dynamics>`` give friction and viscous damping; the servo's gain is `arm.SERVO_GAIN` on every joint.

    Collision shapes become capsules: a cylinder one of its length, so that its ends bulge by a radius; a sphere one
    without length; a box or a mesh the capsule along one of its principal axes that encloses it most closely.

    Args:
        path: The URDF file, z up.
        end_link: Link whose frame is the end-effector's. None takes the only link that carries no other, or the last
            link that moves where there are several.

    Raises:
        InputError: The file is no valid URDF (a missing link, a loop, ...), the chain branches, holds a prismatic or
            mimic joint or none that moves, a joint lacks its limits (effort and velocity are always needed, lower and
            upper of a revolute joint), a moving link has no mass, a mesh cannot be read, or no moving link has a
            collision shape.
    """
    file, root = Path(path), read_xml(path)
    tree, joints = _read(root)
    own = {link.text("name"): _link_capsules(link, file) for link in root.find_all("link")}
    chain = _chain(file, tree, joints, end_link)
    limits = np.array([_limits(joints[tree.link_name[i]]) for i in chain])
    placed = _Placed(tree, chain, joints)
    shapes = placed.shapes(own)
    end = _end(tree, chain, end_link)
    base = shapes.pop(-1, [])
    return Arm(
        name=tree.name,
        tree=_arm_tree(file, tree, chain, placed, shapes),
        lower=limits[:, 0],
        upper=limits[:, 1],
        torque_limit=limits[:, 2],
        velocity_limit=limits[:, 3],
        gain=np.full(len(chain), SERVO_GAIN),
        friction=np.array([_friction(joints[tree.link_name[i]]) for i in chain]),
        end_link=placed.carrier[end],
        end_position=placed.frame[end][0],
        end_rotation=placed.frame[end][1],
        home=np.array([0.0 if a <= 0.0 <= b else (a + b) / 2 for a, b in limits[:, :2]]),
        base_start=np.array([s for s, _, _ in base]).reshape(-1, 3),
        base_end=np.array([e for _, e, _ in base]).reshape(-1, 3),
        base_radius=np.array([r for _, _, r in base]),
    )


# ---- the file --------------------------------------------------------------------------------------------------------


def _read(root: Element) -> tuple[Tree, dict[str, Element]]:
    """Return all links of the file, parents first, and the joints by the name of their child link.

    A ``<mimic>`` is no error yet: it is one only in the chain.
    """
    if root.tag != "robot":
        raise root.error(f"<{root.tag}> as the root", "<robot>")
    mimics = {id(joint): joint.find_all("mimic") for joint in root.find_all("joint")}
    for joint in root.find_all("joint"):
        joint.children = [c for c in joint.children if c.tag != "mimic"]
    links = _links(root)
    joints = _joints(root, links)
    for joint in joints.values():
        joint.children += mimics[id(joint)]
    return _without_world(_all_links(root, links, joints)), joints


def _all_links(root: Element, links: dict[str, Element], joints: dict[str, Element]) -> Tree:
    above = {name: joint.require("parent").text("link") for name, joint in joints.items()}
    order = [name for name in links if name not in joints]
    for name in order:  # grows while it is gone through
        order += [child for child in links if above.get(child) == name]
    kinds = [Joint.FIXED if n not in joints else _KINDS[joints[n].attrib["type"]] for n in order]
    count = len(order)
    tree = Tree(
        name=root.attrib.get("name", root.file.stem),
        link_name=order,
        parent=np.array([order.index(above[n]) if n in above else -1 for n in order]),
        joint=np.array(kinds),
        position=np.zeros((count, 3)),
        rotation=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        mass=np.zeros(count),
        com=np.zeros((count, 3)),
        inertia=np.zeros((count, 3, 3)),
        stiffness=np.zeros(count),
        damping=np.zeros(count),
    )
    for i, name in enumerate(order):
        values = _link_values(links[name]) | (_joint_values(joints[name]) if name in joints else {})
        for key, value in values.items():
            getattr(tree, key)[i] = value
    return tree.validate(str(root.file))


# ---- the chain -------------------------------------------------------------------------------------------------------


def _chain(file: Path, tree: Tree, joints: dict[str, Element], end_link: str | None) -> list[int]:
    """Return the moving links from the base to the end."""
    moving = [i for i in range(tree.num_links) if tree.joint[i] != Joint.FIXED]
    if end_link is None:
        chain = _only_chain(tree, moving, joints)
    elif end_link in tree.link_name:
        chain = [i for i in _ancestry(tree, tree.link_name.index(end_link)) if i in moving][::-1]
    else:
        raise InputError(file, "end_link", f"'{end_link}', which does not exist", "one of the file's links")
    for i in chain:
        kind = joints[tree.link_name[i]].attrib["type"]
        if tree.joint[i] != Joint.REVOLUTE or kind in _SLIDES:  # the last turn of a planar joint is a hinge of the tree
            found = f"type='{kind}'" if kind in _SLIDES else f"a {Joint(tree.joint[i]).name.lower()} joint"
            raise joints[tree.link_name[i]].error(found, _RULE)
        if joints[tree.link_name[i]].find("mimic") is not None:
            raise joints[tree.link_name[i]].error("a <mimic> in the chain", "joints that move on their own")
    if not chain:
        raise InputError(file, "" if end_link is None else f"end_link {end_link}", "no joint that moves", _RULE)
    return chain


def _ancestry(tree: Tree, i: int) -> list[int]:
    """Link i and those that carry it, outermost first."""
    out = []
    while i >= 0:
        out.append(i)
        i = int(tree.parent[i])
    return out


def _only_chain(tree: Tree, moving: list[int], joints: dict[str, Element]) -> list[int]:
    """All moving links in order, if each carries at most one other.

    Raises:
        InputError: Two moving links hang on one.
    """
    chain: list[int] = []
    for i in moving:  # parents come before their children
        above = next((j for j in _ancestry(tree, i)[1:] if j in moving), -1)
        if above != (chain[-1] if chain else -1):
            where = "the base" if above < 0 else f"link '{tree.link_name[above]}'"
            other = tree.link_name[chain[chain.index(above) + 1 if above >= 0 else 0]]
            found = f"a branching chain: '{other}' and '{tree.link_name[i]}' both move on {where}"
            raise joints[tree.link_name[i]].error(found, "one chain, or end_link to pick the one that is the arm")
        chain.append(i)
    return chain


def _end(tree: Tree, chain: list[int], end_link: str | None) -> int:
    """Link whose frame is the end-effector's."""
    if end_link is not None:
        return tree.link_name.index(end_link)
    leaves = [i for i, below in enumerate(tree.children()) if not below]
    return leaves[0] if len(leaves) == 1 else chain[-1]


# ---- joints ----------------------------------------------------------------------------------------------------------


def _limits(joint: Element) -> tuple[float, float, float, float]:
    """Lower and upper limit [rad], effort [N m] and velocity [rad/s] of a joint of the chain."""
    limit = joint.find("limit")
    if limit is None:
        raise joint.error("no <limit>", '<limit effort="..." velocity="..."/>: what the servo may do')
    drive = [limit.positive(key) for key in ("effort", "velocity")]
    if min(drive) == 0:
        raise limit.error(f"effort {drive[0]:g} N m and velocity {drive[1]:g} rad/s", "both above zero")
    if joint.attrib["type"] == "continuous":
        return -np.inf, np.inf, drive[0], drive[1]
    lower, upper = limit.number("lower", 0.0), limit.number("upper", 0.0)
    if lower >= upper:
        raise limit.error(f"lower {lower:g} and upper {upper:g} rad", "a lower limit below the upper one")
    return lower, upper, drive[0], drive[1]


def _friction(joint: Element) -> float:
    dynamics = joint.find("dynamics")
    return 0.0 if dynamics is None else dynamics.positive("friction", 0.0)


def _held(tree: Tree, chain: list[int], joints: dict[str, Element]) -> Array:
    """Joint coordinates with the chain at zero and every other joint where it stays."""
    qpos, k = zero_qpos(tree), 0
    for i in range(tree.num_links):
        joint = Joint(tree.joint[i])
        limit = joints[tree.link_name[i]].find("limit") if joint.dofs == 1 and i not in chain else None
        if limit is not None and joints[tree.link_name[i]].attrib["type"] != "continuous":
            qpos[k] = np.clip(0.0, limit.number("lower", 0.0), limit.number("upper", 0.0))
        k += joint.coordinates
    return qpos


# ---- links -----------------------------------------------------------------------------------------------------------


class _Placed:
    """Where every link of the file is in the frame of the chain's link that carries it.

    Attributes:
        tree: The file's links.
        carrier: Number in the chain of each link's carrier, -1 for the static base.
        frame: Frame of each link in its carrier's, the world's for the base.
        joint_frame: Frame of each chain link in the one before, at joint zero.
    """

    def __init__(self, tree: Tree, chain: list[int], joints: dict[str, Element]) -> None:
        self.tree = tree
        at, turn = pose(tree, _held(tree, chain, joints))
        world = list(zip(at, turn, strict=True))
        above = [next((j for j in _ancestry(tree, i) if j in chain), -1) for i in range(tree.num_links)]
        self.carrier = [chain.index(j) if j >= 0 else -1 for j in above]
        self.frame = [_seen_from(world[j] if j >= 0 else _IDENTITY, world[i]) for i, j in enumerate(above)]
        before = [_IDENTITY, *(world[j] for j in chain[:-1])]
        self.joint_frame = [_seen_from(a, world[i]) for a, i in zip(before, chain, strict=True)]

    def mass(self, number: int) -> MassProperties:
        """Return the mass of a chain link and of all that is fixed to it."""
        t = self.tree
        own = [i for i, c in enumerate(self.carrier) if c == number]
        return combined([MassProperties(t.mass[i], t.com[i], t.inertia[i]).placed(self.frame[i]) for i in own])

    def shapes(self, own: dict[str, list[_Capsule]]) -> dict[int, list[_Capsule]]:
        """Capsules by number in the chain, in the carrier's frame, -1 for the base, from those by name of the link."""
        out: dict[int, list[_Capsule]] = {}
        number = {name: i for i, name in enumerate(self.tree.link_name)}
        for name, capsules in own.items():
            i = number.get(name)  # None: the root is called world
            carrier, frame = (-1, _IDENTITY) if i is None else (self.carrier[i], self.frame[i])
            out.setdefault(carrier, []).extend(_moved(c, frame) for c in capsules)
        return {carrier: _without_swallowed(capsules) for carrier, capsules in out.items()}


def _seen_from(a: Pose, b: Pose) -> Pose:
    """Frame b in frame a, both given in the world."""
    back = quat_conjugate(a[1])
    return quat_rotate(back, b[0] - a[0]), quat_multiply(back, b[1])


def _moved(capsule: _Capsule, frame: Pose) -> _Capsule:
    start, end, radius = capsule
    return frame[0] + quat_rotate(frame[1], start), frame[0] + quat_rotate(frame[1], end), radius


def _arm_tree(file: Path, tree: Tree, chain: list[int], placed: _Placed, shapes: dict[int, list[_Capsule]]) -> Tree:
    bodies = [placed.mass(k) for k in range(len(chain))]
    for i, body in zip(chain, bodies, strict=True):
        if body.mass <= 0:
            found = "no mass on it or on what is fixed to it"
            raise InputError(file, f"link {tree.link_name[i]}", found, "a mass above zero on every link that moves")
    columns = [(k, *capsule) for k in sorted(shapes) for capsule in shapes[k]]
    if not columns:
        raise InputError(
            file, "", "no <collision> on a moving link", "at least one: without it, nothing can be touched"
        )
    link, start, end, radius = zip(*columns, strict=True)
    return Tree(
        name=tree.name,
        link_name=[tree.link_name[i] for i in chain],
        parent=np.arange(-1, len(chain) - 1),
        joint=tree.joint[chain],
        position=np.array([f[0] for f in placed.joint_frame]),
        rotation=np.array([f[1] for f in placed.joint_frame]),
        anchor=tree.anchor[chain],
        axis=tree.axis[chain],
        mass=np.array([b.mass for b in bodies]),
        com=np.array([b.com for b in bodies]),
        inertia=np.array([b.inertia for b in bodies]),
        stiffness=tree.stiffness[chain],
        damping=tree.damping[chain],
        armature=tree.armature[chain],
        preload=tree.preload[chain],
        shape_link=np.array(link),
        shape_start=np.array(start),
        shape_end=np.array(end),
        shape_radius=np.repeat(np.array(radius)[:, None], 2, axis=1),
    )


# ---- shapes ----------------------------------------------------------------------------------------------------------


def _link_capsules(link: Element, file: Path) -> list[_Capsule]:
    """Capsules of a link's collision shapes in its frame."""
    items = link.find_all("collision")
    return [_moved(_capsule(item.require("geometry"), file), _origin(item)) for item in items]


def _capsule(geometry: Element, file: Path) -> _Capsule:
    for tag in ("cylinder", "capsule", "sphere"):
        shape = geometry.find(tag)
        if shape is not None:
            radius, half = shape.positive("radius"), 0.0 if tag == "sphere" else shape.positive("length") / 2
            if radius == 0:
                raise shape.error("radius='0'", "above zero")
            return np.array([0.0, 0.0, -half]), np.array([0.0, 0.0, half]), radius
    box, mesh = geometry.find("box"), geometry.find("mesh")
    if box is not None:
        size = box.vector("size", 3)
        if (size <= 0).any():
            raise box.error(f"size='{box.attrib['size']}'", "three edges above zero")
        return enclosing_capsule(size / 2 * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T)
    if mesh is not None:
        return enclosing_capsule(_mesh_points(mesh, file))
    raise geometry.error("no known shape", "box, capsule, cylinder, mesh or sphere")


def _mesh_points(mesh: Element, file: Path) -> Array:
    """Corners of a mesh file in metres, shape [V, 3]."""
    path, scale = _mesh_path(mesh, file), mesh.vector("scale", 3, [1.0, 1.0, 1.0])
    try:
        corners = np.asarray(trimesh.load_mesh(path).vertices, dtype=np.float64) * scale
    except Exception as e:  # trimesh raises whatever the reader of the format stumbles on
        raise mesh.error(f"{path}, which cannot be read ({e})", "a readable STL, OBJ or PLY file") from None
    if len(corners) == 0 or not np.isfinite(corners).all() or not np.ptp(corners, axis=0).any():
        raise mesh.error(f"{path}, a mesh without size", "a mesh with finite corners")
    return corners


def _mesh_path(mesh: Element, file: Path) -> Path:
    """File behind a mesh's name; ``package://NAME/`` is a folder NAME beside the URDF or above it."""
    name = mesh.text("filename")
    above = file.resolve().parents
    if name.startswith("package://"):
        package, _, rest = name.removeprefix("package://").partition("/")
        tries = [a / package / rest for a in above] + [a / rest for a in above if a.name == package]
    else:
        tries = [above[0] / name.removeprefix("file://")]
    for path in tries:
        if path.is_file():
            return path
    raise mesh.error(f"filename='{name}', which does not exist", "a mesh file relative to the URDF or its package")


def enclosing_capsule(points: Array) -> _Capsule:
    """Return a close capsule around points [N, 3]: the smallest by volume of three along their principal axes.

    Returns:
        Ends of its axis [3] and [3], and its radius, in the unit of the points.
    """
    middle = points.mean(axis=0)
    axes = np.linalg.eigh((points - middle).T @ (points - middle))[1].T
    candidates = [_capsule_along(points - middle, np.roll(axes, k, axis=0)) for k in range(3)]
    start, end, radius = min(candidates, key=lambda c: c[2] ** 2 * (np.linalg.norm(c[1] - c[0]) + 4 / 3 * c[2]))
    return middle + start, middle + end, radius


def _capsule_along(points: Array, axes: Array) -> _Capsule:
    """Return a capsule around points along the first of three orthonormal axes (rows)."""
    x = points @ axes.T
    centre = (x[:, 1:].min(axis=0) + x[:, 1:].max(axis=0)) / 2
    across = np.linalg.norm(x[:, 1:] - centre, axis=1)
    radius = float(across.max())
    bulge = np.sqrt(np.maximum(radius**2 - across**2, 0.0))  # how far the half-sphere reaches beyond the end, there
    low, high = (x[:, 0] + bulge).min(), (x[:, 0] - bulge).max()
    if low > high:
        low = high = (low + high) / 2
    return np.array([low, *centre]) @ axes, np.array([high, *centre]) @ axes, radius


def _without_swallowed(capsules: list[_Capsule]) -> list[_Capsule]:
    """Drop spheres inside a capsule of the same link: the round ends that files add to a cylinder."""

    def swallowed(ball: _Capsule, other: _Capsule) -> bool:
        """Return whether a sphere lies inside a capsule, to rounding."""
        along = other[1] - other[0]
        length = float(along @ along)
        if length == 0 or np.any(ball[0] != ball[1]):
            return False
        near = other[0] + np.clip((ball[0] - other[0]) @ along / length, 0.0, 1.0) * along
        return bool(np.linalg.norm(ball[0] - near) + ball[2] <= other[2] * (1 + 1e-9) + 1e-9)

    return [c for c in capsules if not any(swallowed(c, other) for other in capsules)]
