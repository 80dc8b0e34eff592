"""What a case describes, as something that parameters can be written into: a tree, its unknowns, how it is driven."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from ..sim.errors import InputError
from ..sim.measured import MeasuredBranch, measured_tree
from ..sim.model import Model
from ..sim.tree import Array, Joint, Tree
from .case import BranchCase, JointCase
from .case_joints import JointSpec


@dataclass(frozen=True)
class Parameter:
    """One unknown, positive by construction: inference works on its logarithm.

    Attributes:
        name: Such as ``stiffness child``.
        unit: SI unit.
        low, high: Box that the prior is flat in.
    """

    name: str
    unit: str
    low: float
    high: float


class Write(Protocol):
    """Writes values [sets] of one field entry into the worlds of all sets: (field, place, component, values)."""

    def __call__(self, field: str, place: int, component: int, values: torch.Tensor) -> None:
        """Write."""


class Plant(Protocol):
    """A mechanism with unknowns.

    Attributes:
        tree: The mechanism, at nominal values.
        gravity: Acceleration of free fall [m/s^2], shape [3].
        parameters: The unknowns, in the order of the inference's vectors.
        substep: Longest step that integrates it well [s].
    """

    tree: Tree
    gravity: Array
    parameters: tuple[Parameter, ...]
    substep: float

    def write(self, values: torch.Tensor, model: Model, write: Write) -> None:
        """Write parameter values [sets, n] into the worlds."""


class BranchPlant:
    """A branch of R segments on ball joints; unknown are every joint's spring and damper.

    The box comes from the beam model (thesis eq. 4.2) for Young's moduli of 10 MPa to 100 GPa and from dampers that
    relax a joint, D / K, in 0.1 ms to 10 s.
    """

    YOUNG = (1e7, 1e11)
    RELAXATION = (1e-4, 10.0)
    TYPICAL_YOUNG, TYPICAL_RELAXATION = 5e8, 0.02

    def __init__(self, branch: MeasuredBranch) -> None:
        r4 = np.prod(branch.radius.mean(axis=1, keepdims=True).repeat(4, axis=1), axis=1)
        per_young = np.pi * r4 / (2.0 * branch.length)
        springs = [
            Parameter(f"stiffness {n}", "N m/rad", self.YOUNG[0] * b, self.YOUNG[1] * b)
            for n, b in zip(branch.segment_name, per_young, strict=True)
        ]
        dampers = [
            Parameter(f"damping {n}", "N m s/rad", self.YOUNG[0] * b * self.RELAXATION[0],
                      self.YOUNG[1] * b * self.RELAXATION[1])
            for n, b in zip(branch.segment_name, per_young, strict=True)
        ]  # fmt: skip
        self.parameters = (*springs, *dampers)
        typical = self.TYPICAL_YOUNG * per_young
        self.typical: Array = np.concatenate([typical, typical * self.TYPICAL_RELAXATION])
        self.tree = measured_tree(branch, typical, typical * self.TYPICAL_RELAXATION)
        self.gravity = np.array([0.0, 0.0, -branch.gravity])
        self.grasp = branch.grasp
        self.substep = 2.5e-3

    def write(self, values: torch.Tensor, model: Model, write: Write) -> None:
        """Write springs and dampers [sets, 2 R]."""
        n = self.tree.num_links
        for i in range(n):
            place = int(model.link_place[i])
            write("stiffness", place, 0, values[:, i])
            write("damping", place, 0, values[:, n + i])


class JointPlant:
    """Joints on a fixed frame, each with its own inertia, spring, damper and gravity torque; nulls are unknown.

    A revolute joint turns about the horizontal y axis; a prismatic one slides along x. The gravity torque
    -A sin(q - zero) is that of a mass hanging beside the joint (1 kg at A / g where A is unknown); the moment of
    inertia about the joint is the given one whatever hangs there.
    """

    G = 9.81

    def __init__(self, case: JointCase) -> None:
        if case.mjcf is not None:
            raise InputError(case.folder / "meta.yaml", "mechanism.mjcf", "a mechanism from a file", "mechanism.joints")
        self.joints: tuple[JointSpec, ...] = case.joints
        self.gravity = np.array([0.0, 0.0, -self.G])
        self.substep = 1e-3
        self._slots: list[tuple[int, str]] = []
        found: list[Parameter] = []
        fastest = (0.25 / case.dt) ** 2
        slowest = (1.0 / max(t.t[-1] for t in case.trajectories)) ** 2
        for i, joint in enumerate(self.joints):
            found += self._unknowns(i, joint, slowest, fastest)
        if not found:
            raise InputError(case.folder / "meta.yaml", "mechanism.joints", "no unknown", "at least one null")
        self.parameters = tuple(found)
        box = np.array([[p.low, p.high] for p in found])
        self.typical: Array = np.sqrt(box.prod(axis=1))
        self.tree = self._tree(case.name)

    def _unknowns(self, i: int, joint: JointSpec, slowest: float, fastest: float) -> list[Parameter]:
        turn = "rad" if joint.type == "revolute" else "m"
        force = "N m" if joint.type == "revolute" else "N"
        inertia = joint.inertia or 1.0
        out = []
        for name, value, unit, low, high in (
            ("inertia", joint.inertia, "kg m^2" if turn == "rad" else "kg", 1e-6, 1e6),
            ("stiffness", joint.stiffness, f"{force}/{turn}", inertia * slowest, inertia * fastest),
            ("damping", joint.damping, f"{force} s/{turn}", inertia * 1e-3 * slowest**0.5, inertia * fastest**0.5),
        ):
            if value is None:
                out.append(Parameter(f"{name} {joint.name}", unit, low, high))
                self._slots.append((i, name))
        if joint.gravity_torque is not None and joint.gravity_torque.amplitude is None:
            out.append(Parameter(f"gravity torque {joint.name}", force, inertia * slowest, inertia * fastest))
            self._slots.append((i, "gravity"))
        return out

    def _tree(self, name: str) -> Tree:
        n = len(self.joints)
        revolute = np.array([j.type == "revolute" for j in self.joints])
        zero = np.array([0.0 if j.gravity_torque is None else j.gravity_torque.zero_angle for j in self.joints])
        amplitude = np.array(
            [0.0 if j.gravity_torque is None else j.gravity_torque.amplitude or 0.0 for j in self.joints]
        )
        inertia = np.array([j.inertia or 1.0 for j in self.joints])
        self._hang = np.stack([np.sin(zero), np.zeros(n), -np.cos(zero)], axis=-1)
        known = amplitude != 0.0
        # an arm short enough that the hanging mass takes a tenth of the given inertia
        arm = np.where(known, 0.1 * inertia * self.G / np.where(known, np.abs(amplitude), 1.0), 0.0)
        mass = np.where(revolute, np.where(known, amplitude / (self.G * np.where(known, arm, 1.0)), 1.0), inertia)
        com = self._hang * arm[:, None]
        steiner = (arm**2)[:, None, None] * np.eye(3) - com[:, :, None] * com[:, None, :]
        tensor = np.where(revolute, inertia, 1.0)[:, None, None] * np.eye(3) - mass[:, None, None] * steiner
        return Tree(
            name=name,
            link_name=[j.name for j in self.joints],
            parent=np.full(n, -1),
            joint=np.where(revolute, Joint.REVOLUTE, Joint.PRISMATIC),
            position=np.zeros((n, 3)),
            rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
            axis=np.where(revolute[:, None], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]),
            mass=mass,
            com=com,
            inertia=tensor,
            stiffness=np.array([j.stiffness or 0.0 for j in self.joints]),
            damping=np.array([j.damping or 0.0 for j in self.joints]),
        )

    def write(self, values: torch.Tensor, model: Model, write: Write) -> None:
        """Write the unknowns [sets, n]."""
        for column, (i, name) in enumerate(self._slots):
            place = int(model.link_place[i])
            v = values[:, column]
            if name == "gravity":
                for c in (0, 2):
                    write("com", place, c, v * float(self._hang[i, c] / self.G))
            elif name == "inertia":
                revolute = self.joints[i].type == "revolute"
                for c in range(3 if revolute else 1):
                    write("inertia" if revolute else "mass", place, c, v)
            else:
                write(name, place, 0, v)


def plant_of(case: BranchCase | JointCase) -> BranchPlant | JointPlant:
    """Return the plant that a case describes."""
    return BranchPlant(case) if isinstance(case, BranchCase) else JointPlant(case)


def box_of(parameters: Sequence[Parameter]) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the logarithms of the box's ends, float64, shapes [n]."""
    ends = torch.tensor([[p.low, p.high] for p in parameters], dtype=torch.float64).log()
    return ends[:, 0], ends[:, 1]
