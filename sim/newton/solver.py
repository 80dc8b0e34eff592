"""A Newton solver that steps a Newton model with bough's kernels."""

from __future__ import annotations

import newton
import newton.solvers
import numpy as np
import warp as wp

from ...kernels.tree.newton_exchange import Slots, read_load, read_state, write_state
from ..base import rotation
from ..base.errors import InputError
from ..base.types import Array
from ..engine.arrays import integer_array
from ..engine.model import Model
from ..engine.simulator import Simulator
from ..trees.tree import Joint
from .bridge import from_newton
from .layout import SOURCE, WorldLayout, host, read_layout, xyzw

_CHANGES = (
    newton.ModelFlags.JOINT_PROPERTIES
    | newton.ModelFlags.JOINT_DOF_PROPERTIES
    | newton.ModelFlags.JOINT_DOF_FORCE_PROPERTIES
    | newton.ModelFlags.JOINT_DOF_INERTIAL_PROPERTIES
    | newton.ModelFlags.JOINT_REFERENCE_POSE_PROPERTIES
    | newton.ModelFlags.BODY_INERTIAL_PROPERTIES
    | newton.ModelFlags.MODEL_PROPERTIES
)
_REFUSED = {
    "joint_target_ke": "a drive",
    "joint_target_kd": "a drive",
    "joint_friction": "joint friction",
}


class BoughSolver(newton.solvers.SolverBase):
    """Steps worlds of fixed, revolute, ball and prismatic joints: semi-implicit Euler with implicit spring-dampers.

    Takes over ``Model.joint_stiffness``, ``joint_damping``, ``joint_rest_q``, ``joint_armature`` and gravity, and in
    each step ``State.body_f`` (wrenches about the centres of mass) and ``Control.joint_f``. Contacts and joint limits
    are left out. Not differentiable. A world that leaves the finite is frozen (``simulator.state.faults()`` tells
    where and when) and does not touch its neighbours; `reset` lets it move again.

    A step allocates nothing on the device and copies nothing to the host, and can be captured as a graph after a first
    step of the same ``dt``.

    Attributes:
        simulator: bough's simulator of the same worlds, in the order of `layout.read_layout`.
    """

    def __init__(
        self, model: newton.Model, *, dt: float = 1.0 / 240.0, substeps: int = 1, threads: int | None = None
    ) -> None:
        """Build bough's arrays from a model.

        Args:
            model: The model.
            dt: Step the solver is made ready for [s]; `step` with another one makes it ready for that.
            substeps: Equal parts that a step is taken in.
            threads: CPU threads; None takes all cores.

        Raises:
            InputError: A joint of another kind, a closed loop, a drive, joint friction, a ball joint with different
                springs about its axes, or worlds with different gravity.
        """
        super().__init__(model)
        self._substeps, self._threads = substeps, threads
        self._control = model.control(clone_variables=False)
        self._build(dt)

    def _build(self, dt: float) -> None:
        """Read the model anew."""
        for name, what in _REFUSED.items():
            for dof in np.flatnonzero(host(self.model, name)):
                joint = np.searchsorted(host(self.model, "joint_qd_start"), dof, side="right") - 1
                place = f"joint {self.model.joint_label[joint]}"
                raise InputError(SOURCE, place, f"{what}, {name} {host(self.model, name)[dof]:g}", "0")
        layout = read_layout(self.model)
        self._worlds = np.array([host(self.model, "body_world")[w.body[0]] for w in layout])
        bough = Model(from_newton(self.model), gravity=_gravity(self.model), device=self.model.device)
        self._slots = _slots(bough, layout)
        self._first: wp.array = wp.array(bough.first_link.astype(np.int32), dtype=int, device=bough.device)
        self._carried = wp.zeros(len(bough.link_slot), dtype=wp.vec3, device=bough.device)
        self._prepare(bough, dt)

    def _prepare(self, bough: Model, dt: float) -> None:
        """Make ready for steps of one length: the springs' implicit share depends on it, and on the model's pose."""
        self.simulator = Simulator(bough, dt=dt, substeps=self._substeps, threads=self._threads)
        self.simulator.load.point.assign(bough.scatter(bough.links.com, [0.0, 0.0, 0.0]))
        self._rotation = wp.from_torch(self.simulator.rotation, dtype=wp.vec4)
        self._read_state(self.model.joint_q, self.model.joint_qd)
        self.simulator.refresh()

    def step(
        self,
        state_in: newton.State,
        state_out: newton.State,
        control: newton.Control | None,
        contacts: newton.Contacts | None,
        dt: float,
        *,
        observables: newton.solvers.SolverBase.Observables | None = None,
    ) -> None:
        """Advance ``state_in`` by ``dt`` into ``state_out`` (may be the same): joint and body coordinates, velocities.

        Args:
            state_in: Joint coordinates and velocities, and wrenches on bodies [N, N m].
            state_out: Receives ``joint_q``, ``joint_qd``, ``body_q`` and ``body_qd``.
            control: Joint forces [N, N m]; None takes the model's.
            contacts: Left out.
            dt: Step [s].
            observables: None; the solver offers none.
        """
        self.validate_observables(observables)
        if dt != self.simulator.dt:
            self._prepare(self.simulator.model, dt)
        joint_q, joint_qd = state_out.joint_q, state_out.joint_qd
        assert joint_q is not None and joint_qd is not None  # a model that bough takes has joints
        self._read_state(state_in.joint_q, state_in.joint_qd)
        self._read_load(state_in, self._control if control is None else control)
        self.simulator.step()
        given = [self._slots, *self._moving(), joint_q, joint_qd]
        wp.launch(write_state, self._carried.size, given, device=self.model.device)
        newton.eval_fk(self.model, joint_q, joint_qd, state_out)

    def _moving(self) -> tuple[wp.array, wp.array]:
        """Return coordinates and velocities, number by number."""
        state = self.simulator.state
        return state.coordinate.entries(), state.velocity.entries()

    def _read_state(self, joint_q: wp.array | None, joint_qd: wp.array | None) -> None:
        given = [self._slots, joint_q, joint_qd, *self._moving()]
        wp.launch(read_state, self._carried.size, given, device=self.model.device)

    def _read_load(self, state: newton.State, control: newton.Control) -> None:
        self.simulator.observe()
        load = self.simulator.load
        given = [self._slots, self._first, self._rotation, state.joint_q, control.joint_f, state.body_f]
        given += [self._carried, load.force.entries(), load.effort.entries()]
        wp.launch(read_load, len(self._worlds), given, device=self.model.device)

    def reset(
        self,
        state: newton.State,
        world_mask: wp.array | None = None,
        flags: newton.StateFlags | int | None = None,
    ) -> None:
        """Let frozen worlds move again; their state is the caller's to set.

        Args:
            state: Not changed.
            world_mask: Worlds to let go, bool, shape [world_count + 1], the last for bodies outside of worlds; None is
                all.
            flags: Not looked at.
        """
        super().reset(state, world_mask, flags)
        chosen = None if world_mask is None else wp.to_torch(world_mask)[self._worlds]
        self.simulator.reset(chosen)

    def notify_model_changed(self, flags: newton.ModelFlags | int) -> None:
        """Read the model anew where joints, springs, masses or gravity changed; graphs must be captured again.

        Args:
            flags: What changed. Shapes, tendons and body poses have no part in the steps.
        """
        if flags & _CHANGES:
            self._build(self.simulator.dt)


def _gravity(model: newton.Model) -> Array:
    rows = host(model, "gravity").reshape(-1, 3).astype(np.float64)
    if (rows != rows[0]).any():
        raise InputError(SOURCE, "gravity", "worlds with different gravity", "one gravity for all worlds")
    return rows[0]


def _slots(bough: Model, layout: list[WorldLayout]) -> Slots:
    """Index both layouts, link by link."""
    links, device = bough.links, bough.device
    first = bough.first_link[links.world]
    parent = np.concatenate([w.parent for w in layout])
    joint_frame = np.concatenate([w.turn for w in layout])
    spherical = (links.kind == Joint.SPHERICAL)[:, None]
    rest = np.where(spherical, links.rest, [1.0, 0.0, 0.0, 0.0])
    left = rotation.quat_multiply(rotation.quat_conjugate(rotation.quat_multiply(rest, links.frame)), joint_frame)
    slots = Slots()
    integers = {name: np.concatenate([getattr(w, name) for w in layout]) for name in ("q_start", "qd_start", "body")}
    integers |= {"group": bough.link_slot // bough.width, "lane": bough.link_slot % bough.width}
    integers |= {"place": bough.link_place, "kind": links.kind, "parent": np.where(parent < 0, -1, parent + first)}
    for name, values in integers.items():
        setattr(slots, name, integer_array(values, device))
    right = rotation.quat_multiply(rotation.quat_conjugate(joint_frame), links.frame)
    for name, turn in (("left", left), ("right", right), ("frame", links.frame)):
        setattr(slots, name, wp.array(xyzw(turn), dtype=wp.quat, device=device))
    slots.rest = wp.array(links.rest[:, 0], dtype=float, device=device)
    slots.axis = wp.array(links.axis, dtype=wp.vec3, device=device)
    return slots
