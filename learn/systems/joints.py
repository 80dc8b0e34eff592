"""Joints on a fixed frame with unknown inertia, springs, dampers and gravity torques."""

from __future__ import annotations

import numpy as np
import torch

from ...sim.base.errors import InputError
from ...sim.engine.model import Model
from ...sim.trees.tree import Joint, Tree
from ..cases.case import JointCase
from ..cases.joints import JointSpec
from .acting import ActingSet
from .joint_guess import guess_joint
from .system import FINEST, TURN, Parameter, Write, longest_step

#: Least upper bound of a spring or damper relative to its first guess.
SLOW = 30.0


class JointSystem:
    """Joints on a fixed frame, each with its own inertia, spring, damper and gravity torque; nulls are unknown.

    So is a constant offset of every measured effort.

    A revolute joint turns about the horizontal y axis; a prismatic one slides along x. The gravity torque
    -A sin(q - zero) is that of a mass hanging beside the joint (1 kg at A / g where A or zero is unknown); the moment
    of inertia about the joint is the given one whatever hangs there.

    Attributes:
        carried: Inertia of each joint by name [kg m^2], or mass [kg]; one where it is not known.
    """

    G = 9.81

    def __init__(self, case: JointCase) -> None:
        self.joints: tuple[JointSpec, ...] = tuple(j for j in case.joints if isinstance(j, JointSpec))
        self.gravity = np.array([0.0, 0.0, -self.G])
        # inertia and stiffness that are sought stay below the fastest oscillation that the samples can show
        self._finest = FINEST * case.dt
        self.substep = longest_step(case.dt)
        self._slots: list[tuple[int, str]] = []
        found: list[Parameter] = []
        fastest = (2.0 / case.dt) ** 2  # three samples a period
        slowest = (1.0 / max(t.t[-1] for t in case.trajectories)) ** 2
        for i, joint in enumerate(self.joints):
            found += self._unknowns(i, joint, slowest, fastest, guess_joint(case, joint))
            found += self._offset(i, joint, case)
        if not found:
            raise InputError(case.folder / "meta.yaml", "mechanism.joints", "no unknown", "at least one null")
        self.parameters = tuple(found)
        self.carried = {j.name: j.inertia or 1.0 for j in self.joints}
        self.tree = self._tree(case.name)

    def _unknowns(
        self, i: int, joint: JointSpec, slowest: float, fastest: float, guess: dict[str, float]
    ) -> list[Parameter]:
        turn = "rad" if joint.type == "revolute" else "m"
        force = "N m" if joint.type == "revolute" else "N"
        # motion too slow to show its inertia: upper bound at which it would oscillate as fast as the sampling resolves
        slow = guess.get("stiffness", 0.0) / fastest
        inertia = joint.inertia or max(guess.get("inertia", 0.0 if slow else 1.0), slow)
        sought = joint.inertia is None or joint.stiffness is None
        # slow motion shows a spring and a damper at any sampling rate, but no inertia
        stiffest = max(inertia * fastest, SLOW * guess.get("stiffness", 0.0))
        stickiest = max(inertia * fastest**0.5, SLOW * guess.get("damping", 0.0))
        self._resolve(inertia, joint.stiffness or guess.get("stiffness", 0.0), self._finest if sought else 0.0)
        out = []
        for name, value, unit, low, high in (
            ("inertia", joint.inertia, "kg m^2" if turn == "rad" else "kg", 1e-6 * inertia, 1e6 * inertia),
            ("stiffness", joint.stiffness, f"{force}/{turn}", inertia * slowest, stiffest),
            ("damping", joint.damping, f"{force} s/{turn}", inertia * 1e-3 * slowest**0.5, stickiest),
        ):
            if value is None:
                out.append(Parameter(f"{name} {joint.name}", unit, low, high, _inside(guess.get(name), low, high)))
                self._slots.append((i, name))
        if joint.gravity_torque is not None and joint.gravity_torque.amplitude is None:
            low, high = inertia * slowest, inertia * fastest
            typical = _inside(guess.get("gravity"), low, high)
            out.append(Parameter(f"gravity torque {joint.name}", force, low, high, typical))
            self._slots.append((i, "gravity"))
        if joint.gravity_torque is not None and joint.gravity_torque.zero_angle is None:
            middle = guess.get("zero", 0.0)
            out.append(Parameter(f"zero angle {joint.name}", turn, middle - np.pi, middle + np.pi, middle, "linear"))
            self._slots.append((i, "zero"))
        return out

    def _offset(self, i: int, joint: JointSpec, case: JointCase) -> list[Parameter]:
        """Return the constant offset of an effort sensor, bounded by the largest measured effort."""
        driven = [k for k, item in enumerate(case.inputs) if item.joint == joint.name]
        most = max(float(np.abs(t.effort[:, driven]).max(initial=0.0)) for t in case.trajectories)
        if most == 0.0:
            return []
        self._slots.append((i, "preload"))
        unit = "N m" if joint.type == "revolute" else "N"
        return [Parameter(f"offset {joint.name}", unit, -most, most, 0.0, "linear")]

    def _resolve(self, inertia: float, stiffness: float, finest: float) -> None:
        """Shorten the step so that an oscillation of the guessed frequency turns by at most `TURN` in a step."""
        if stiffness > 0.0:
            self.substep = min(self.substep, max(finest, TURN * (inertia / stiffness) ** 0.5))

    def _tree(self, name: str) -> Tree:
        n = len(self.joints)
        revolute = np.array([j.type == "revolute" for j in self.joints])
        gravity = [j.gravity_torque for j in self.joints]
        zero = np.array([0.0 if g is None else g.zero_angle or 0.0 for g in gravity])
        amplitude = np.array([0.0 if g is None or g.zero_angle is None else g.amplitude or 0.0 for g in gravity])
        inertia = np.array(list(self.carried.values()))
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
            if name in ("gravity", "zero"):
                self._hang_up(i, values, place, write)
            elif name == "inertia":
                revolute = self.joints[i].type == "revolute"
                for c in range(3 if revolute else 1):
                    write("inertia" if revolute else "mass", place, c, v)
            else:
                write(name, place, 0, v)

    def _hang_up(self, i: int, values: torch.Tensor, place: int, write: Write) -> None:
        """Write where the mass hangs that gives a joint its gravity torque; size or direction may be known."""
        gravity, column = self.joints[i].gravity_torque, {slot: c for c, slot in enumerate(self._slots)}
        assert gravity is not None

        def of(name: str, known: float | None) -> torch.Tensor:
            """Return a number of the joint, [sets]: its column of unknowns, or the known value, or 0."""
            at = column.get((i, name))
            return values[:, at] if at is not None else torch.full_like(values[:, 0], known or 0.0)

        size, zero = of("gravity", gravity.amplitude) / self.G, of("zero", gravity.zero_angle)
        write("com", place, 0, size * torch.sin(zero))
        write("com", place, 2, -size * torch.cos(zero))


def _inside(value: float | None, low: float, high: float) -> float | None:
    """Return a guess where there is one inside its box."""
    return value if value is not None and low < value < high else None
