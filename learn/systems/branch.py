"""A measured branch with unknown springs, dampers, density or rest angles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, get_args

import numpy as np
import torch

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ...sim.engine.model import Model
from ...sim.trees.measured import MeasuredBranch, axis_rotation, measured_tree
from ..cases.case import BranchCase
from . import weight
from .acting import Acting, ActingSet, branch_settings
from .pivot import BELOW, SLIDES, on_pivot, write_pivot
from .system import Parameter, Write, bounded

Kind = Literal["stiffness", "damping", "density", "rest_angle"]
Joints = Literal["spherical", "revolute"]

#: Longest and shortest step [s], and the largest phase that the swing of a held segment turns by in one [rad].
LONGEST, SHORTEST, TURN = 5e-3, 2e-4, 0.1


@dataclass(frozen=True)
class Unknowns:
    """What is inferred about a branch, and within which bounds.

    Attributes:
        joints: ``spherical`` joints, or ``revolute`` ones that bend every segment up and down.
        infer: Kinds of unknowns; what is not inferred keeps its typical value (springs, dampers) or the case's.
        shared: Kinds that have one number for all joints.
        box: Bounds as ``KIND=LOW:HIGH`` or ``NAME=LOW:HIGH``, in SI units.
        effects: Effects that act; their unknown parameters follow those of the system. Any case may have them.
    """

    joints: Joints = "spherical"
    infer: tuple[Kind, ...] = ("stiffness", "damping")
    shared: tuple[Kind, ...] = ()
    box: tuple[str, ...] = ()
    effects: tuple[Acting, ...] = ()


class BranchSystem:
    """A branch of R segments on joints; its unknowns are those of `Unknowns`.

    The box of springs and dampers comes from the beam model (thesis eq. 4.2) for Young's moduli of 1 MPa to 100 GPa
    and from dampers that relax a joint, D / K, in 0.1 ms to 10 s. Density may be a third to three times what the case
    says; a rest angle (error of a segment's measured elevation) within 30 degrees. Whatever the unknowns, the branch
    is at rest in its given pose: pre-loads follow.

    Attributes:
        tree: The branch at typical values.
        gravity: Acceleration of free fall [m/s^2], shape [3].
        parameters: Unknowns, base first.
        substep: Longest step [s].
        acting: Effects that act.
        first: Link of the first segment: 0, or the one above those that `base_compliance` adds.
    """

    YOUNG = (1e6, 1e11)
    RELAXATION = (1e-4, 10.0)
    #: Least inertia of a segment about its own axis over h^2 K, h the substep; its own is a thousandth of that. Twist
    #: then follows what twists it within 1/sqrt(2) substeps, where a recording shows swings of 60 substeps and more.
    LEAST_AXIAL = 0.5
    #: Least relaxation time D / K of a ball joint and of a trunk, in substeps.
    LEAST_RELAXATION, LEAST_OF_TRUNK = 0.1, 0.3
    TYPICAL_YOUNG, TYPICAL_RELAXATION = 5e8, 0.02

    def __init__(self, branch: MeasuredBranch, unknowns: Unknowns | None = None) -> None:
        self.branch, self.unknowns = branch, unknowns or Unknowns()
        self.gravity = np.array([0.0, 0.0, -branch.gravity])
        self._rho = float(getattr(branch, "density", 1000.0))
        self.substep = substep_of(branch)
        self._per_young = np.pi * branch.radius.mean(axis=1) ** 4 / (2.0 * branch.length)
        spring = self.TYPICAL_YOUNG * self._per_young
        self._slots: list[tuple[Kind, list[int]]] = []
        found = [p for kind in self._kinds() for p in self._of_kind(kind)]
        effects = self.unknowns.effects
        settings = branch_settings(branch) if isinstance(branch, BranchCase) and effects else []
        self.acting = ActingSet(effects, "branch", settings, branch.name)
        self.parameters = bounded([*found, *self.acting.parameters], self.unknowns.box)
        self.tree = measured_tree(branch, spring, spring * self.TYPICAL_RELAXATION, self.unknowns.joints)
        self._copies: dict[tuple[str, tuple[int, ...], bytes], torch.Tensor] = {}
        self.first = len(BELOW) if self.acting.has("base_compliance") else 0
        if self.first:
            self.tree = on_pivot(self.tree, self._pivot(branch), branch.gravity)

    @staticmethod
    def _pivot(branch: MeasuredBranch) -> float:
        below = branch.trunk_pivot_below_base if isinstance(branch, BranchCase) else None
        if below is None:
            raise InputError(branch.name, "trunk_pivot_below_base_m", "null", "a length, for base_compliance")
        return below

    def _kinds(self) -> Sequence[Kind]:
        return [kind for kind in get_args(Kind) if kind in self.unknowns.infer]

    def _of_kind(self, kind: Kind) -> list[Parameter]:
        """Parameters of a kind: one per segment, or one for all."""
        segments = range(self.branch.num_segments)
        groups = [list(segments)] if kind in self.unknowns.shared else [[i] for i in segments]
        self._slots += [(kind, group) for group in groups]
        return [self._one(kind, group) for group in groups]

    def _one(self, kind: Kind, group: list[int]) -> Parameter:
        whole = kind in self.unknowns.shared and len(self.branch.segment_name) > 1
        label = kind.replace("_", " ")
        name = label if whole else f"{label} {self.branch.segment_name[group[0]]}"
        beam = self._per_young[group]
        low, high, middle = (y * b for y, b in zip((*self.YOUNG, self.TYPICAL_YOUNG),
                             (beam.min(), beam.max(), np.exp(np.log(beam).mean())), strict=True))  # fmt: skip
        if kind == "stiffness":
            return Parameter(name, "N m/rad", low, high, middle)
        if kind == "damping":
            short, long = self.RELAXATION
            return Parameter(name, "N m s/rad", low * short, high * long, middle * self.TYPICAL_RELAXATION)
        if kind == "density":
            return Parameter(name, "kg/m^3", self._rho / 3.0, self._rho * 3.0, self._rho)
        return Parameter(name, "rad", -np.pi / 6, np.pi / 6, 0.0, "linear")

    def values(self, kind: Kind, row: Array) -> Array:
        """Return a kind's value at every segment [R] from parameter values [n]; NaN where it is not inferred."""
        out = np.full(self.branch.num_segments, np.nan)
        for (own, group), value in zip(self._slots, row[: len(self._slots)], strict=True):
            if own == kind:
                out[group] = value
        return out

    def write(self, values: torch.Tensor, model: Model, write: Write) -> None:
        """Write the unknowns [sets, n]; dampers of ball joints and axial inertias as `_explicit` says."""
        n = self.branch.num_segments
        per_segment: dict[Kind, dict[int, torch.Tensor]] = {}
        for column, (kind, group) in enumerate(self._slots):
            for i in group:
                per_segment.setdefault(kind, {})[i] = values[:, column]
        spring = self._stacked(per_segment.get("stiffness"), values, self.tree.stiffness[self.first :])
        damper = self._stacked(per_segment.get("damping"), values, self.tree.damping[self.first :])
        share = self._stacked(per_segment.get("density"), values, np.full(n, self._rho)) / self._rho
        if {"density", "rest_angle"} & set(per_segment):
            tilt = self._stacked(per_segment.get("rest_angle"), values, np.zeros(n))
            self._write_weight(share, tilt, model, write)
        if self.unknowns.joints == "spherical":
            damper, axial = self._explicit(share, spring, damper)
            for i in range(n):
                write("inertia", int(model.link_place[self.first + i]), 2, axial[:, i])
        for i in range(n):
            write("stiffness", int(model.link_place[self.first + i]), 0, spring[:, i])
            write("damping", int(model.link_place[self.first + i]), 0, damper[:, i])
        if self.unknowns.effects:
            columns = values[:, len(self._slots) :]
            self.acting.write(columns, model, write, range(self.first, self.first + n))
            if self.first:
                write_pivot(self.acting, columns, self.LEAST_OF_TRUNK * self.substep, model, write)

    def _explicit(
        self, share: torch.Tensor, spring: torch.Tensor, damper: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return dampers and axial inertias with which explicit springs are stable; masses times ``share``, [sets, R].

        Else the simulator would make springs of all joints partly implicit at once; that jump in the dynamics splits a
        posterior into spurious modes. A joint with c = h^2 K - 2 h D > 0 takes 2 c from both of its segments, about any
        axis, of the 4 I that their inertias are worth (`kernels.tree.stability`; Gershgorin). So c is half of the
        smaller I across the segments at most, and I about their own axes the sum of c at both ends at least.
        """
        h = self.substep
        across, axial = (self._on(spring.device, self.tree.inertia[self.first :, c, c]) * share for c in (0, 2))
        smaller = torch.minimum(across, torch.nn.functional.pad(across[:, :-1], (1, 0), value=np.inf))
        least = torch.maximum(self.LEAST_RELAXATION * h * spring, 0.5 * h * spring - smaller / (4.0 * h))
        damper = torch.maximum(damper, least)
        lacks = (h * h * spring - 2.0 * h * damper).clamp(min=0.0)
        needed = self.LEAST_AXIAL * h * h * spring + lacks + torch.nn.functional.pad(lacks[:, 1:], (0, 1))
        return damper, torch.maximum(axial, needed)

    def _stacked(self, found: dict[int, torch.Tensor] | None, values: torch.Tensor, fill: Array) -> torch.Tensor:
        """Values of a kind [sets, R] in float64, with what stands in [R] where it is not inferred."""
        if found is None:
            return self._on(values.device, fill).expand(len(values), -1)
        return torch.stack([found[i].double() for i in range(self.branch.num_segments)], 1)

    def _on(self, device: torch.device, array: Array) -> torch.Tensor:
        """Return the segments' rows of an array on a device, in float64, copied there once."""
        rows = np.ascontiguousarray(array[: self.branch.num_segments], dtype=np.float64)
        key = (str(device), rows.shape, rows.tobytes())
        if key not in self._copies:
            self._copies[key] = torch.as_tensor(rows, device=device)
        return self._copies[key]

    def _write_weight(self, share: torch.Tensor, tilt: torch.Tensor, model: Model, write: Write) -> None:
        """Write masses times ``share``, elevations plus ``tilt``, both [sets, R], and the pre-loads that hold them."""
        n, links = self.branch.num_segments, model.links
        fixed = partial(self._on, share.device)
        mass, frame = fixed(self.tree.mass[self.first :]) * share, fixed(links.frame[self.first :])
        world, turn = weight.turned_chain(fixed(axis_rotation(self.branch.elevation, self.branch.azimuth)), tilt)
        held = weight.holding_torque(
            mass, fixed(self.tree.com[self.first :]), fixed(self.branch.length), world, self.branch.gravity
        )
        if self.first:  # the pivot below carries the same moment: its own arm is along the weight
            below = weight.rotate(world[:, 0], held[:, 0])
            for c in range(3):
                write("preload", int(model.link_place[SLIDES]), c, below[:, c])
            write("preload", int(model.link_place[SLIDES - 1]), 0, mass.sum(1) * self.branch.gravity)
        held = weight.rotate(weight.conjugate(frame), held)
        if self.unknowns.joints == "revolute":
            held = torch.nn.functional.pad((held * fixed(links.axis[self.first :])).sum(-1, keepdim=True), (0, 2))
        above = torch.cat([torch.tensor([[1.0, 0, 0, 0]], dtype=frame.dtype, device=frame.device), frame[:-1]])
        turn = weight.multiply(weight.multiply(weight.conjugate(above), turn), frame)
        inertia = fixed(links.inertia[self.first :]) * share[..., None]
        for field, block in (("mass", mass[..., None]), ("inertia", inertia), ("turn", turn), ("preload", held)):
            for i in range(n):
                for c in range(block.shape[-1]):
                    write(field, int(model.link_place[self.first + i]), c, block[:, i, c])


def substep_of(branch: MeasuredBranch) -> float:
    """Return the longest step [s] of a branch, in which the segments that are held swing by at most `TURN`."""
    swing = _swing(branch)
    return min(LONGEST, max(SHORTEST, TURN / swing)) if swing > 0.0 else LONGEST


def _swing(branch: MeasuredBranch) -> float:
    """Return about how fast the segments that are held swing [rad/s]; zero where no recording says.

    As a rigid segment on a spring: force over displacement while it is held, against its mass as felt there.
    """
    found = []
    for t in branch.trajectories if isinstance(branch, BranchCase) else ():
        held = ~t.no_contact
        moved, force = (float((x[held] ** 2).sum()) for x in (t.displacement, t.force))
        arm = max(t.grasp_distance / float(branch.length[t.grasp_segment]), 0.2)
        felt = float(branch.mass[t.grasp_segment]) / (3.0 * arm**2)
        found.append(np.sqrt(np.sqrt(force / moved) / felt) if moved > 0.0 else 0.0)
    return float(np.median(found)) if found else 0.0
