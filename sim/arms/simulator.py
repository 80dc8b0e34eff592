"""Worlds in which an arm moves among branches and along a power line, with contact between all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.contact.look import capsule_kernel
from ...kernels.contact.reset_arm import reset_arm_kernel
from ...kernels.contact.step import contact_step_kernel, contact_step_parts
from ...kernels.effects.step import term_types
from ..base.errors import InputError
from ..base.thread_pool import recorded
from ..engine.load import Load
from ..engine.model import Model
from ..engine.rupture import Rupture
from ..engine.simulator import Simulator
from ..trees.tree import Tree
from .arm import Arm
from .arrays import ArmArrays, TouchArrays

#: Contacts that a world of few capsules has room for.
_LEAST_ROOM = 32


@dataclass(frozen=True)
class Contacts:
    """What touches what, and how.

    Attributes:
        stiffness: Of a contact [N/m]: 80 N indent by 1.3 mm.
        damping: Of a contact, while it touches [N s/m].
        friction: Coulomb's coefficient, at first the same in every world.
        creep: Speed below which a contact that sticks still slides [m/s]; friction grows with the speed up to here.
        capacity: Contacts that a world has room for; more are counted in `ArmSimulator.overflow`. None takes one for
            every two capsules of the arm and the largest tree, four times that where branches touch each other, and 32
            at least.
        arm_branch, arm_line, arm_arm, branch_branch: Which pairs touch. Branches touch the line where `line_mask` says
            so, and each other where they are apart at the start.
        line_radius: Of the power line [m].
        ground: Height of the ground [m]; None is no ground.
        repeats: Sweeps over the contacts a step at most, until their forces agree.
    """

    stiffness: float = 6.0e4
    damping: float = 60.0
    friction: float = 0.5
    creep: float = 2.0e-3
    capacity: int | None = None
    arm_branch: bool = True
    arm_line: bool = True
    arm_arm: bool = False
    branch_branch: bool = False
    line_radius: float = 0.01
    ground: float | None = None
    repeats: int = 32

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping", "friction", "creep", "line_radius"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0) or (name in ("stiffness", "creep") and value == 0):
                raise InputError("contacts", name, f"{value}", "a number above zero")
        for name in ("capacity", "repeats"):
            if getattr(self, name) is not None and getattr(self, name) < 1:
                raise InputError("contacts", name, f"{getattr(self, name)}", "one or more")

    def room_for(self, trees: Sequence[Tree], arm: Arm) -> int:
        """Return the contacts that each world of these trees has room for.

        Measured with every contact on, thrown trees and random arms: 0.4 a capsule at most in 160 worlds of 40 links,
        2.1 in 32 of 121 links (median 0.3). A world's memory grows with the square of the room on a GPU: 74 KB for 32,
        0.7 MB for 100; on a CPU only a thread's does.
        """
        if self.capacity is not None:
            return self.capacity
        capsules = len(arm.base_radius) + arm.num_capsules + max(len(tree.shape_link) for tree in trees)
        return max(_LEAST_ROOM, 2 * capsules if self.branch_branch else -(-capsules // 2))


@dataclass(frozen=True)
class Capsules:
    """Capsules of all worlds in world axes, Warp arrays [worlds, C]; the first ``num_arm`` are the arm's, hand last.

    Attributes:
        start, end: Ends of the axes [m], vec3.
        radius: [m]; 0 where a world has none.
        num_arm: How many belong to the arm and its base.
    """

    start: wp.array
    end: wp.array
    radius: wp.array
    num_arm: int


@dataclass(frozen=True)
class Line:
    """The power line of every world: ends of its axis [m], Warp arrays of vec3 [worlds], and its radius [m]."""

    start: wp.array
    end: wp.array
    radius: float


class ArmSimulator(Simulator):
    """Steps an arm among branches in all worlds together: `Simulator` with an arm, a line, a ground and contact.

    The world frame is the arm's base frame, z up. The branches are `model`'s trees and obey everything that
    `Simulator` says, effects included (a `load` acts beside effects only); the arm is solved world by world
    (`kernels.contact.arm`), contact by `kernels.contact.law`.

    Attributes:
        arm: The arm, the same in all worlds.
        contacts: What touches what.
        q: Joint positions of the arm [rad], torch view [worlds, dof].
        qd: Joint speeds of the arm [rad/s], [worlds, dof].
        torque: Of the arm's servos [N m], [worlds, dof].
        target: Joint speeds that the arm is asked for, to be written in place [rad/s], [worlds, dof].
        end_position: Of the end-effector [m], [worlds, 3].
        end_rotation: Of the end-effector, w, x, y, z, [worlds, 4].
        arm_force: Net contact force on every link of the arm [N], [worlds, dof, 3], in the last substep.
        arm_peak: Greatest norm of it since it was last set to zero [N], [worlds, dof]: the rupture measure.
        branch_force: Net contact force on every capsule of the branches [N], [worlds, B, 3].
        friction: Coefficient of friction, to be written in place, [worlds].
        line_start: Where the power line's axis begins, to be written [m], [worlds, 3]; far below at first.
        line_end: Where it ends [m], [worlds, 3].
        line_mask: 1 where branches touch the line, int32, to be written in place, [worlds].
        start_q: Joint positions that `reset` returns to, to be written in place [rad], [worlds, dof].
        overflow: Contacts that found no room since the last reset, int32 [worlds]; see `without_room`.
        unsettled: 1 where the contacts' forces of the last substep were still changing, int32 [worlds].
        rupture: Strength of every joint and which are broken (`Rupture`), None unless ``breakable``.
        capsules: Arm and branches as Warp arrays, for perception.
        line: The line as Warp arrays, for perception.
    """

    def __init__(
        self,
        trees: Tree | Sequence[Tree],
        arm: Arm,
        *,
        contacts: Contacts | None = None,
        dt: float = 1.0 / 240.0,
        substeps: int = 1,
        gravity: Sequence[float] = (0.0, 0.0, -9.81),
        device: Any = None,
        threads: int | None = None,
        width: int | None = None,
        breakable: bool = False,
        effects: Sequence[str] = (),
    ) -> None:
        """Allocate everything that stepping needs.

        Args:
            trees: The branches of every world.
            arm: The arm, the same in all worlds.
            contacts: What touches what; None takes the defaults.
            dt: Step [s].
            substeps: Equal parts that a step is taken in.
            gravity: Acceleration of free fall [m/s^2].
            device: Warp device; None takes Warp's default.
            threads: CPU threads; None takes all cores.
            width: Worlds a thread; None takes what suits the device and the number of worlds.
            breakable: Whether joints break whose springs pass `strength`.
            effects: Names of effects that the branches' step is built with; see `Simulator`.

        Raises:
            InputError: As `Model` and `Simulator` do.
        """
        self.arm, self.contacts = arm, Contacts() if contacts is None else contacts
        model = Model(trees, gravity=gravity, device=device, width=width)
        super().__init__(model, dt=dt, substeps=substeps, threads=threads, effects=effects)
        worlds = model.num_worlds
        self._arm = ArmArrays(arm, worlds, model.gravity, model.device, self.dt / self.substeps)
        self._touch = TouchArrays(model, self._launcher, arm, self.contacts.room_for(model.trees, arm))
        self._set_rule()
        for name in ("q", "qd", "torque", "target", "end_position", "end_rotation"):
            setattr(self, name, getattr(self._arm, name))
        self.arm_force = self._arm.force
        for name in (
            "friction",
            "line_start",
            "line_end",
            "line_mask",
            "overflow",
            "unsettled",
            "depth",
            "branch_force",
            "arm_peak",
        ):
            setattr(self, name, getattr(self._touch, name))
        self.friction.fill_(self.contacts.friction)
        self.line_start.copy_(torch.tensor([-0.5, 0.0, -1.0e3]))
        self.line_end.copy_(torch.tensor([0.5, 0.0, -1.0e3]))
        self._start_q = wp.zeros((worlds, arm.num_dofs), dtype=float, device=model.device)
        self.start_q: torch.Tensor = wp.to_torch(self._start_q)
        self.start_q.copy_(torch.tensor(arm.home, dtype=torch.float32))
        self._make_capsules()
        self._outlining: dict[bool, Callable[[], None]] = {}
        self.rupture = Rupture(self) if breakable else None
        self.reset()
        if self.contacts.branch_branch:
            start, end, radius = (a.numpy()[:, self.capsules.num_arm :] for a in
                                  (self.capsules.start, self.capsules.end, self.capsules.radius))  # fmt: skip
            self._touch.pair_branches(start, end, radius)

    q: torch.Tensor
    qd: torch.Tensor
    torque: torch.Tensor
    target: torch.Tensor
    end_position: torch.Tensor
    end_rotation: torch.Tensor
    friction: torch.Tensor
    line_start: torch.Tensor
    line_end: torch.Tensor
    line_mask: torch.Tensor
    overflow: torch.Tensor
    unsettled: torch.Tensor
    depth: torch.Tensor
    branch_force: torch.Tensor
    arm_peak: torch.Tensor

    @property
    def nbytes(self) -> int:
        """Bytes of state and parameters on the device, scratch included."""
        return super().nbytes + self._arm.nbytes + self._touch.nbytes

    def faults(self) -> list[tuple[int, str, int]]:
        """Return (world, link name, tick) of every lost world; the arm's name, and tick -1, where the arm was lost."""
        lost = torch.nonzero(self._arm.lost).flatten().tolist()
        return self.state.faults() + [(w, self.arm.name, -1) for w in lost]

    @property
    def without_room(self) -> int:
        """Contacts that found no room in any world since this was made, resets or not; a look from the host."""
        return int((self._touch.forgotten + self.overflow).sum())

    def _set_rule(self) -> None:
        rule, c = self._touch.kernel[0], self.contacts
        for name in ("stiffness", "damping", "creep", "line_radius"):
            setattr(rule, name, float(getattr(c, name)))
        for name in ("arm_branch", "arm_line", "arm_arm", "branch_branch", "repeats"):
            setattr(rule, name, int(getattr(c, name)))
        rule.has_ground = int(c.ground is not None)
        rule.ground = 0.0 if c.ground is None else float(c.ground)

    def _make_capsules(self) -> None:
        m, t = self.model, self._touch
        most = t.branch_force.shape[1]
        radius = np.zeros((m.num_worlds, t.num_arm + most), np.float32)
        radius[:, : t.num_arm] = self._arm.constants.shape_radius.numpy()
        for w, tree in enumerate(m.trees):
            radius[w, t.num_arm : t.num_arm + len(tree.shape_link)] = tree.shape_radius.mean(axis=1)
        start, end = (wp.zeros(radius.shape, dtype=wp.vec3, device=m.device) for _ in range(2))
        self.capsules = Capsules(start, end, wp.array(radius, dtype=float, device=m.device), t.num_arm)
        self.line = Line(t.warp["line_start"], t.warp["line_end"], self.contacts.line_radius)

    # ---- stepping ----------------------------------------------------------------------------------------------------

    def step(self, count: int = 1) -> None:
        """Advance all worlds by ``count`` steps of ``dt``; joints break between calls, not within one."""
        super().step(count)
        if self.rupture is not None:
            self.rupture.judge()

    @property
    def load(self) -> Load:
        """Forces on the branches, as in `Simulator`, where the step is built with an effect (a neutral one will do).

        Raises:
            InputError: There is no effect; such a step reads no load.
        """
        if not self.effects:
            found = "a load on branches, which a step without effects does not read"
            allowed = 'ArmSimulator(..., effects=("steady_wind",)), which is neutral at first'
            raise InputError("simulator", "load", found, allowed)
        return super().load

    def _prepare_step(self, count: int, *, split: bool) -> Callable[[], None]:
        if self._launcher.by_group:
            return self._launcher.prepare_parts(self._parts(count * self.substeps))
        kernel = contact_step_kernel(self.model.width, self.arm.num_dofs, self.effects.terms)
        before = [*self._movers(), *self._touch.kernel, *self._laws(), self._worlds()]
        after = [count * self.substeps, self.dt / self.substeps, self.max_speed]
        return self._launcher.prepare(kernel, before, after, split=split)

    def _movers(self) -> list[Any]:
        return [self._dynamics, self.state.kernel, *self._arm.kernel]

    def _laws(self) -> list[Any]:
        types = term_types(self.model.width, self.model.precision)
        # a step without effects reads neither
        return [self.load.kernel, self.effects.kernel] if self.effects else [types.Load(), types.Terms()]

    def _worlds(self) -> wp.array:
        return self._slot_world.reshape((1, -1))

    def _parts(self, substeps: int) -> list[tuple[Any, int | None, list[Any]]]:
        """Return the kernels of so many substeps in their order, with threads a world and arguments."""
        team, h, scratch, worlds = self._launcher.team, self.dt / self.substeps, self._launcher.scratch, self._worlds()
        parts = contact_step_parts(self.arm.num_dofs, self.effects.terms, team)
        rule, _, touch, space, lanes = self._touch.kernel
        before = [*self._movers(), *self._touch.kernel, *self._laws(), worlds, scratch]
        solved = [*self._arm.kernel, rule, space, worlds, 0, h]
        after = [*self._movers(), rule, touch, space, lanes, worlds, scratch, h, self.max_speed]
        return [
            part
            for step in range(substeps)
            for part in (
                (parts.approach, None, [*before, step, substeps, h]),
                (parts.solve, team, solved),
                (parts.leave, None, [*after, int(step == substeps - 1)]),
            )
        ]

    def look(self) -> None:
        """Write where all capsules are into `capsules`."""
        split = not self.model.device.is_capturing
        if split not in self._outlining:
            self._outlining[split] = self._prepare_capsules(split=split)
        self._outlining[split]()

    def _prepare_capsules(self, *, split: bool) -> Callable[[], None]:
        kernel = capsule_kernel(self.model.width, self.arm.num_dofs)
        _, shapes, touch, _, arms = self._touch.kernel
        before = [self.model.kernel, self.state.kernel, *self._arm.kernel[:2], shapes, touch, arms, self._slot_world]
        return self._launcher.prepare(kernel, before, [self.capsules.start, self.capsules.end], split=split)

    def reset(self, mask: torch.Tensor | None = None) -> None:
        """Put the masked worlds (bool, [worlds]; None is all) back: branches to their start, the arm to `start_q`."""
        super().reset(mask)
        self.look()

    def _reset(self, chosen: wp.array) -> None:
        super()._reset(chosen)
        if self.rupture is not None:
            self.rupture.heal(chosen)

    def _record_resets(self, chosen: wp.array) -> list[Any]:
        kernel, m = reset_arm_kernel(self.arm.num_dofs), self.model
        inputs = [chosen, self._start_q, *self._arm.kernel[1:], self._touch.kernel[0]]
        own = recorded(kernel, m.num_worlds, inputs, m.device)
        return [*super()._record_resets(chosen), own]
