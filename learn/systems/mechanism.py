"""A mechanism from an MJCF file, of which some masses, dimensions, springs and dampers are unknown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from ...sim.base import rotation
from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ...sim.engine.model import Model
from ...sim.engine.parameters import Links, link_parameters
from ...sim.formats.import_mjcf import MEASURED, load_mjcf
from ...sim.trees.tree import Tree
from ..cases.case import JointCase
from ..cases.joints import UNKNOWN, JointAxis
from .acting import ActingSet
from .system import FINEST, TURN, Parameter, Write, longest_step

Values = dict[str, torch.Tensor]

#: Parts of an unknown that has more than one: the centre of mass moves across the joint's axis only.
PARTS = {"com": ("com along", "com across")}


@dataclass(frozen=True)
class Body:
    """What a joint carries, at the file's values, about and across the joint's axis.

    Attributes:
        mass: Mass [kg].
        com: Distance of the centre of mass from a revolute joint's axis [m].
        along, across: Unit vectors in the link frame, both across the axis, the first towards the centre of mass.
        lift: Part of the centre of mass along the axis, link frame [m], shape [3].
        central: Moment of inertia about the line through the centre of mass along the axis [kg m^2].
        moments: Principal moments about the joint point [kg m^2], shape [3].
        about: Moment of inertia about the joint's axis [kg m^2].
    """

    mass: float
    com: float
    along: Array
    across: Array
    lift: Array
    central: float
    moments: Array
    about: float


class MechanismSystem:
    """A mechanism from an MJCF file; `JointCase.unknown` names what is not taken from the file.

    - ``damping``, ``stiffness``, ``armature``: of a joint.
    - ``preload``: a constant effort at a joint, such as the bias of a torque sensor.
    - ``mass``: of the link that a joint moves; its centre of mass stays, and so does its inertia about that.
    - ``com``: centre of mass of a link on a revolute joint, as distances from the joint's axis ``along`` the direction
      in which the file has it and ``across`` that one; its place along the axis does not matter to the joint.
    - ``inertia``: moment of inertia of such a link about the line through its centre of mass, along the joint's axis.
    - ``length``: distance of a joint from the one before it.

    A link's inertia about its joint's axis, central + m (along^2 + across^2), is thus that of a real body whatever the
    unknowns are. The whole tensor about the joint point is scaled to it: in a mechanism whose axes are parallel nothing
    else of it matters; elsewhere the shape of the tensor is the file's.

    Attributes:
        joints: Joints that can be driven and measured, in the file's order.
        tree: The mechanism as in the file; springs are relaxed at coordinate zero and pre-loaded to pull to their rest.
        gravity: Acceleration of free fall [m/s^2], shape [3].
        carried: Inertia about each joint's axis [kg m^2], or mass [kg], of all that it moves, as in the file.
        parameters: Unknowns, joint by joint.
        substep: Longest step [s].
    """

    def __init__(self, case: JointCase) -> None:
        assert case.mjcf is not None
        mechanism = load_mjcf(case.mjcf, MEASURED)
        self.joints: tuple[JointAxis, ...] = case.joints
        self.gravity = mechanism.gravity
        self.tree, self._rest = _relaxed_at_zero(mechanism.tree)
        self._links = link_parameters([self.tree])
        self._file = case.folder / "meta.yaml"
        self._case = case
        self._bodies = {j.name: _body(self._links, j.link) for j in self.joints}
        self.carried = {j.name: _carried(self.tree, j) for j in self.joints}
        steps = [max(FINEST * case.dt, TURN / w) for w in self._frequencies() if w > 0.0]
        self.substep = min([longest_step(case.dt), *steps])
        named = [(q, j) for j in self.joints for q in UNKNOWN if q in case.unknown or f"{q} {j.name}" in case.unknown]
        chosen = [(q, j) for q, j in named if self._exists(q, j)]
        self._slots = [(part, j) for q, j in chosen for part in PARTS.get(q, (q,))]
        if not self._slots:
            found = "nothing unknown" if not case.unknown else f"{', '.join(case.unknown)}, which no joint has"
            raise InputError(self._file, "mechanism.unknown", found, f"quantities of {', '.join(UNKNOWN)}")
        self.parameters = tuple(self._parameter(part, joint) for part, joint in self._slots)

    def _frequencies(self) -> list[float]:
        """Return the frequency of each joint's spring on its own link [rad/s], zero without a spring."""
        out = []
        for j in self.joints:
            body = self._bodies[j.name]
            inertia = float(self.tree.armature[j.link]) + (body.about if j.type == "revolute" else body.mass)
            out.append(float(np.sqrt(self.tree.stiffness[j.link] / inertia)) if inertia > 0.0 else 0.0)
        return out

    def _exists(self, quantity: str, joint: JointAxis) -> bool:
        """Return whether a joint has a quantity; raise `InputError` where it was asked for by name and has not."""
        revolute = joint.type == "revolute"
        has = {
            "mass": self._bodies[joint.name].mass > 0.0,
            "com": revolute and self._bodies[joint.name].mass > 0.0,
            "inertia": revolute and self._bodies[joint.name].central > 0.0,
            "length": bool(self.tree.parent[joint.link] >= 0 and np.abs(self._links.offset[joint.link]).max() > 0.0),
        }.get(quantity, True)
        if not has and f"{quantity} {joint.name}" in self._case.unknown:
            allowed = (
                "mass, com and inertia of a link with mass, com and inertia on a revolute joint, length after a link"
            )
            raise InputError(self._file, "mechanism.unknown", f"'{quantity} {joint.name}'", allowed)
        return has

    def _parameter(self, part: str, joint: JointAxis) -> Parameter:
        """Return an unknown with its box: about the file's value, and for joints from what the recordings resolve."""
        name, i = f"{part} {joint.name}", joint.link
        revolute = joint.type == "revolute"
        force, turn = ("N m", "rad") if revolute else ("N", "m")
        weight, body = "kg m^2" if revolute else "kg", self._bodies[joint.name]
        inertia, effort = self.carried[joint.name], self._largest_effort(joint)
        fastest, slowest = 0.25 / self._case.dt, 1.0 / max(t.t[-1] for t in self._case.trajectories)
        reach = body.com + float(np.sqrt(body.central / body.mass)) if body.mass else 0.0
        makers: dict[str, Callable[[], Parameter]] = {
            "damping": lambda: _about(name, f"{force} s/{turn}", float(self.tree.damping[i]), 10.0,
                                      1e-3 * inertia * slowest, inertia * fastest),
            "stiffness": lambda: _about(name, f"{force}/{turn}", float(self.tree.stiffness[i]), 10.0,
                                        inertia * slowest**2, inertia * fastest**2),
            "armature": lambda: _about(name, weight, float(self.tree.armature[i]), 10.0, 1e-4 * inertia, 10 * inertia),
            "preload": lambda: Parameter(name, force, -effort, effort, 0.0, "linear"),
            "mass": lambda: _about(name, "kg", body.mass, 10.0),
            "com along": lambda: Parameter(name, "m", -3.0 * reach, 3.0 * reach, body.com, "linear"),
            "com across": lambda: Parameter(name, "m", -3.0 * reach, 3.0 * reach, 0.0, "linear"),
            "inertia": lambda: _about(name, "kg m^2", body.central, 100.0),
            "length": lambda: _about(name, "m", float(np.linalg.norm(self._links.offset[i])), 3.0),
        }  # fmt: skip
        return makers[part]()

    def _largest_effort(self, joint: JointAxis) -> float:
        """Largest measured effort of a joint [N m or N], or the largest gravity load if nothing drives it."""
        driven = [i.joint for i in self._case.inputs]
        if joint.name in driven:
            column = driven.index(joint.name)
            return max(float(np.abs(t.effort[:, column]).max()) for t in self._case.trajectories)
        return float(np.linalg.norm(self.gravity)) * float(np.sqrt(self.carried[joint.name] * self.tree.mass.sum()))

    acting = ActingSet((), "joint", [])

    def write(self, values: torch.Tensor, model: Model, write: Write) -> None:
        """Write the unknowns [sets, n]."""
        self.acting.write(values[:, len(self._slots) :], model, write, [j.link for j in self.joints])
        by_joint: dict[str, Values] = {}
        for column, (part, joint) in enumerate(self._slots):
            by_joint.setdefault(joint.name, {})[part] = values[:, column]
        for joint in self.joints:
            own, place = by_joint.get(joint.name, {}), int(model.link_place[joint.link])
            for part in own.keys() & {"damping", "stiffness", "armature"}:
                write(part, place, 0, own[part])
            if own.keys() & {"preload", "stiffness"}:
                write("preload", place, 0, self._preload(joint, own))
            if "length" in own:
                offset = self._links.offset[joint.link]
                for c, share in enumerate(offset / np.linalg.norm(offset)):
                    write("offset", place, c, own["length"] * float(share))
            if own.keys() & {"mass", "com along", "inertia"}:
                self._write_body(joint, own, place, write)

    def _preload(self, joint: JointAxis, own: Values) -> torch.Tensor:
        """Constant effort: of the spring at coordinate zero, plus the unknown or given pre-load."""
        i = joint.link
        any_one = next(iter(own.values()))
        stiffness = own.get("stiffness", torch.full_like(any_one, float(self.tree.stiffness[i])))
        beside = float(self.tree.preload[i, 0] - self.tree.stiffness[i] * self._rest[i])
        return own.get("preload", torch.full_like(any_one, beside)) + stiffness * float(self._rest[i])

    def _write_body(self, joint: JointAxis, own: Values, place: int, write: Write) -> None:
        body = self._bodies[joint.name]
        like = next(iter(own.values()))
        mass = own.get("mass", torch.full_like(like, body.mass))
        write("mass", place, 0, mass)
        if joint.type == "prismatic":  # the same body, of another density
            for c in range(3):
                write("inertia", place, c, mass * float(body.moments[c] / body.mass))
            return
        along = own.get("com along", torch.full_like(like, body.com))
        across = own.get("com across", torch.zeros_like(like))
        central = own.get("inertia", torch.full_like(like, body.central))
        about = central + mass * (along**2 + across**2)
        for c in range(3):
            write("com", place, c, along * float(body.along[c]) + across * float(body.across[c]) + float(body.lift[c]))
            write("inertia", place, c, about * float(body.moments[c] / body.about))


def _about(name: str, unit: str, value: float, factor: float, low: float = np.inf, high: float = 0.0) -> Parameter:
    """Return a positive unknown with a box from ``low`` to ``high``, widened to the file's value times ``factor``."""
    if value <= 0.0:
        return Parameter(name, unit, low, high)
    return Parameter(name, unit, min(low, value / factor), max(high, value * factor), value)


def _relaxed_at_zero(tree: Tree) -> tuple[Tree, Array]:
    """Return a tree that moves the same with the scalar joints' springs relaxed at zero, and where they were [L].

    -k (q - rest) = -k q + k rest: the kernels' coordinates, counted from the rest, become the joints' own.
    """
    rest = tree.rest[:, 0].copy()
    preload = tree.preload.copy()
    preload[:, 0] += tree.stiffness * rest
    return tree.with_(rest=np.zeros_like(tree.rest), preload=preload), rest


def _body(links: Links, i: int) -> Body:
    """Return the body on joint ``i`` seen along the joint's axis."""
    axis, mass = links.axis[i], float(links.mass[i])
    lift = axis * float(axis @ links.com[i])
    arm = links.com[i] - lift
    com = float(np.linalg.norm(arm))
    # a body balanced on its axis has no direction of its own: any across the axis will do
    other = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    along = arm / com if com > 1e-9 else other / np.linalg.norm(other)
    about = float(axis**2 @ links.inertia[i])
    return Body(mass, com, along, np.cross(axis, along), lift, about - mass * com**2, links.inertia[i], about)


def _carried(tree: Tree, joint: JointAxis) -> float:
    """Return inertia about a joint's axis [kg m^2] or mass [kg] of all that it moves, at coordinates zero."""
    origin, turn = np.zeros((tree.num_links, 3)), np.zeros((tree.num_links, 4))
    for i in range(tree.num_links):
        p = int(tree.parent[i])
        before, at = (turn[p], origin[p]) if p >= 0 else (np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
        origin[i] = at + rotation.quat_rotate(before, tree.position[i])
        turn[i] = rotation.quat_multiply(before, tree.rotation[i])
    moved = {joint.link}
    for i in range(joint.link + 1, tree.num_links):
        if int(tree.parent[i]) in moved:
            moved.add(i)
    k = joint.link
    axis = rotation.quat_rotate(turn[k], tree.axis[k])
    anchor = origin[k] + rotation.quat_rotate(turn[k], tree.anchor[k])
    total = float(tree.armature[k])
    for i in moved:
        across = np.cross(axis, origin[i] + rotation.quat_rotate(turn[i], tree.com[i]) - anchor)
        own = rotation.quat_rotate(rotation.quat_conjugate(turn[i]), axis)
        about = own @ tree.inertia[i] @ own + tree.mass[i] * (across @ across)
        total += float(about if joint.type == "revolute" else tree.mass[i])
    return total
