"""Joints on a fixed frame with unknown inertia, springs, dampers and gravity torques."""

from __future__ import annotations

import numpy as np
import torch

from ..sim.errors import InputError
from ..sim.model import Model
from ..sim.tree import Joint, Tree
from .acting import ActingSet
from .case import JointCase
from .case_joints import JointSpec
from .plant import Parameter, Write


class JointPlant:
    """Joints on a fixed frame, each with its own inertia, spring, damper and gravity torque; nulls are unknown.

    A revolute joint turns about the horizontal y axis; a prismatic one slides along x. The gravity torque
    -A sin(q - zero) is that of a mass hanging beside the joint (1 kg at A / g where A is unknown); the moment of
    inertia about the joint is the given one whatever hangs there.
    """

    G = 9.81

    def __init__(self, case: JointCase) -> None:
        self.joints: tuple[JointSpec, ...] = tuple(j for j in case.joints if isinstance(j, JointSpec))
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

    acting = ActingSet((), "joint", [])

    def write(self, values: torch.Tensor, model: Model, write: Write) -> None:
        """Write the unknowns [sets, n]."""
        self.acting.write(values[:, len(self._slots) :], model, write, [j.link for j in self.joints])
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
