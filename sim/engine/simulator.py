"""The simulator: steps a batch of worlds, resets them, looks at them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.tree.layout import layout_of
from ...kernels.tree.observe import energy_kernel, pose_kernel, probe_kernel
from ...kernels.tree.reset import reset_kernels
from ...kernels.tree.stability import damping_kernel
from ...kernels.tree.step import step_kernels
from ..base import rotation
from ..base.errors import InputError
from ..base.thread_pool import recorded
from ..base.types import Array, IntArray
from .arrays import integer_array
from .forest_effects import ForestEffects
from .last_states import KEPT, LastStates, of_world
from .launcher import Launcher, Recorded
from .load import Load
from .model import Model
from .state import State
from .tensors import WorldTensors


class Simulator:
    """Steps all worlds of a model together.

    The integrator is semi-implicit Euler with implicit dampers; a joint's spring is implicit by the smallest share
    that keeps the step stable (`kernels.tree.stability`), which is none where MuJoCo's ``implicitfast`` is stable too.

    Attributes:
        model: What is constant of the worlds.
        state: What moves: coordinates, velocities, faults.
        effects: Parameters of the effects that act, ``effects[name][parameter]``, torch tensors to be written in place,
            [worlds, links] (laws at joints, masses at links' ends) or [worlds]; neutral at first (`ForestEffects`).
        dt: Length of one call of `step` [s], taken in ``substeps`` equal parts.
        position: Origins of the body frames after `observe` [m], torch view [worlds, links, 3]; links in the order of
            each world's tree.
        rotation: Orientations of the body frames after `observe`, w, x, y, z, torch view [worlds, links, 4].
    """

    #: Share of the articulated inertia that explicit springs may use up before they are made implicit.
    MARGIN = 0.5

    def __init__(
        self,
        model: Model,
        *,
        dt: float = 1.0 / 240.0,
        substeps: int = 1,
        threads: int | None = None,
        max_speed: float | None = None,
        effects: Sequence[str] = (),
    ) -> None:
        """Allocate everything that stepping needs.

        Args:
            model: The worlds.
            dt: Step [s].
            substeps: Equal parts that a step is taken in.
            threads: CPU threads; None takes all cores.
            max_speed: Joint speed [rad/s or m/s] at which the guard freezes a world; None takes half a turn a substep.
            effects: Names of effects (`bough.sim.effects`) that the step is built with. Without any it is the plain
                step.

        Raises:
            InputError: ``dt``, ``substeps`` or ``max_speed`` is not positive; an effect that a forest cannot have.
        """
        for name, value in (("dt", dt), ("substeps", substeps), ("max_speed", 1.0 if max_speed is None else max_speed)):
            if not (math.isfinite(value) and value > 0):
                raise InputError("simulator", name, str(value), "a number above zero")
        self.model, self.state = model, State(model)
        self.dt, self.substeps = float(dt), int(substeps)
        self.max_speed = math.pi * substeps / dt if max_speed is None else float(max_speed)
        self._launcher = Launcher(model, threads)
        self.effects = ForestEffects(model, self._launcher, effects)
        self._kernels = step_kernels(model.width, model.precision, model.has_free_trees)
        self._steps: dict[tuple[int, bool], Callable[[], None]] = {}
        self._looking: dict[bool, Callable[[], None]] = {}
        self._tensors: WorldTensors | None = None
        self._stale = False
        self._load: Load | None = Load(model) if effects else None
        self._last: LastStates | None = None
        self._index_slots()
        self._allocate_outputs()
        self._start = {name: model.field(kind) for name, kind in (("coordinate", "Quat"), ("velocity", "Vec"))}
        self._resets = Recorded(self._record_resets)
        self._everyone = torch.ones(model.num_worlds, dtype=torch.bool, device=self.state.fault_link.device)
        self._dynamics = self._dynamic_model()
        self._judges = self._prepare_judges()
        self.refresh()
        self.mark_start()

    # ---- memory --------------------------------------------------------------------------------------------------

    def _index_slots(self) -> None:
        m = self.model
        world = np.full(m.groups * m.width, -1, np.int32)
        world[m.world_slot] = np.arange(m.num_worlds)
        link = np.full((len(world), m.places + 1), -1, np.int32)
        link[m.link_slot, m.link_place] = np.arange(len(m.link_slot)) - m.first_link[m.links.world]
        self._slot_world: wp.array = wp.array(world, dtype=int, device=m.device)
        self._slot_link = integer_array(link, m.device)

    def _allocate_outputs(self) -> None:
        m = self.model
        scalar = wp.float64 if m.precision == 64 else wp.float32
        self._out3, self._out4 = wp.types.vector(3, scalar), wp.types.vector(4, scalar)
        shape = (m.num_worlds, max(t.num_links for t in m.trees))
        self._position = wp.zeros(shape, dtype=self._out3, device=m.device)
        self._rotation = wp.zeros(shape, dtype=self._out4, device=m.device)
        self.position: torch.Tensor = wp.to_torch(self._position)
        self.rotation: torch.Tensor = wp.to_torch(self._rotation)
        self._energy = wp.zeros((m.num_worlds, 3), dtype=scalar, device=m.device)
        self._momentum = wp.zeros((m.num_worlds, 2), dtype=self._out3, device=m.device)
        frame, anchor = m.field("Quat"), m.field("Vec")
        frame.assign(m.scatter(rotation.quat_conjugate(m.links.frame), [1.0, 0.0, 0.0, 0.0]))
        anchor.assign(m.scatter(m.links.anchor, [0.0, 0.0, 0.0]))
        self._bodies = (anchor, frame)

    def _dynamic_model(self) -> object:
        """Copy the model's struct with a damping array of its own: physical plus what the springs' share amounts to."""
        self._damping, self._limit = self.model.field("Real"), self.model.field("Real")
        struct = layout_of(self.model.width, self.model.precision).Model()
        for name in self.model.kernel._cls.vars:
            setattr(struct, name, getattr(self.model.kernel, name))
        struct.damping, struct.limit = self.effects.bind(self._damping).kernel, self._limit.kernel
        return struct

    @property
    def nbytes(self) -> int:
        """Bytes of state and parameters on the device, scratch included."""
        own = self._damping.nbytes + self._limit.nbytes + self._launcher.nbytes + self.effects.nbytes
        return self.model.nbytes + self.state.nbytes + own

    # ---- stepping ------------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Find each joint's implicit share anew, at the springs' rest and at the present pose.

        Needed after stiffness, damping, masses or geometry of the model have changed in its arrays; parameters that
        were written through `tensors` do this before the next step.
        """
        self._stale = False
        self._damping.torch.copy_(self.model.arrays["damping"].torch)
        self._limit.torch.fill_(self.max_speed)
        for judge in self._judges:
            judge()
        self._note_rest()

    def _parameters_changed(self) -> None:
        """Have `refresh` run before the next step."""
        self._stale = True

    def _prepare_judges(self) -> list[Callable[[], None]]:
        """Return launches that judge stability at the springs' rest and at the present pose."""
        kernel = damping_kernel(self.model.width, self.model.precision)
        after = [self.dt / self.substeps, self.MARGIN, self._damping.kernel, self._limit.kernel]
        self._rest = State(self.model)
        self._note_rest = self.effects.prepare_rest(self._rest)
        return [
            self._launcher.prepare(kernel, [self.model.kernel, state.kernel], after)
            for state in (self._rest, self.state)
        ]

    def implicit_worlds(self) -> int:
        """Return in how many worlds springs are too stiff for the step to be explicit (see `kernels.tree.stability`).

        Their fast motion is damped and slowed to what the step resolves; more substeps resolve more of it.
        """
        held = (self._limit.torch[..., 0] < self.max_speed).any(-1).reshape(-1)
        return int(held[torch.as_tensor(self.model.world_slot, device=held.device)].sum())

    def keep_last(self, count: int = KEPT) -> LastStates:
        """Keep the states before the last ``count`` calls of `step` from now on, for worlds that are frozen."""
        self._last = LastStates(self.model, self.state, self._about, count)
        return self._last

    def _about(self, world: int) -> dict[str, Any]:
        """Return what a world's steps depend on beside its model and state."""
        own = {"damping in effect": self._damping, "limit": self._limit}
        effects = {f"effect {n} {p}": t[world].cpu().numpy() for n, e in self.effects.items() for p, t in e.items()}
        return {
            "dt": self.dt, "substeps": self.substeps, "max_speed": self.max_speed, **effects,
            **{name: of_world(self.model, array, world) for name, array in own.items()},
        }  # fmt: skip

    def step(self, count: int = 1) -> None:
        """Advance all worlds by ``count`` steps of ``dt``; inside a graph capture, in one launch that it records."""
        if self._stale:
            self.refresh()
        if self._last is not None:
            self._last.note()
        key = (count, not self.model.device.is_capturing)
        if key not in self._steps:
            self._steps[key] = self._prepare_step(count, split=key[1])
        self._steps[key]()

    def _prepare_step(self, count: int, *, split: bool) -> Callable[[], None]:
        after = [count * self.substeps, self.dt / self.substeps, self.max_speed]
        before: list[Any] = [self._dynamics, self.state.kernel]
        if self._load is None:
            return self._launcher.prepare(self._kernels.step, before, after, split=split)
        before.append(self._load.kernel)
        if not self.effects:
            return self._launcher.prepare(self._kernels.step_loaded, before, after, split=split)
        before.append(self.effects.kernel)
        return self._launcher.prepare(self.effects.step_kernel(), before, after, split=split)

    def capture(self, count: int = 1) -> Callable[[], None]:
        """Return a function that replays ``count`` steps and an observation as one graph (CPU and GPU).

        It is recorded anew where a load has come to be since.
        """
        graph, load = self._graph(count), self._load

        def replay() -> None:  # keeps this simulator, on whose memory the graph works
            """Launch the graph, recorded anew if the load is another; refresh first where parameters are stale."""
            nonlocal graph, load
            if self._stale:
                self.refresh()
            if load is not self._load:
                graph, load = self._graph(count), self._load
            wp.capture_launch(graph)

        return replay

    def _graph(self, count: int) -> Any:
        """Return the graph of ``count`` steps and an observation."""
        step = self._prepare_step(count, split=False)
        look = self._prepare_look(split=False)
        with wp.ScopedCapture(device=self.model.device) as scope:
            if self._last is not None:
                self._last.note()
            step()
            look()
        return scope.graph

    @property
    def tensors(self) -> WorldTensors:
        """Coordinates, velocities, forces and parameters of all worlds as tensors, [worlds, ...], to get and set."""
        if self._tensors is None:
            self._tensors = WorldTensors(self.model, self.state, lambda: self.load, self._parameters_changed)
        return self._tensors

    @property
    def load(self) -> Load:
        """Forces and efforts that the next steps apply, to be written in place; steps without cost nothing for them."""
        if self._load is None:
            self._load = Load(self.model)
            self._steps.clear()
        return self._load

    # ---- resets --------------------------------------------------------------------------------------------------

    def mark_start(self) -> None:
        """Take the present state, with the effects' memories and clocks, as the one that `reset` returns to."""
        self.effects.mark_start()
        self._start["coordinate"].torch.copy_(self.state.coordinate.torch)
        self._start["velocity"].torch.copy_(self.state.velocity.torch)

    def reset(self, mask: torch.Tensor | None = None) -> None:
        """Put the masked worlds (bool, [worlds]; None is all) back to their start and clear their faults.

        Memories of effects, damage too, and clocks go back to what they were at the start: empty and zero, unless
        `mark_start` was called in between. Their parameters stay.
        """
        mask = self._everyone if mask is None else mask.to(self._everyone.device)
        chosen: Any = wp.from_torch(mask.contiguous(), dtype=wp.bool)
        self._reset(chosen)

    def _reset(self, chosen: wp.array) -> None:
        self._resets(chosen)
        self.effects.reset(chosen, self._slot_world)

    def _record_resets(self, chosen: wp.array) -> list[Any]:
        """Return the launches that put the chosen worlds back."""
        kernels, m = reset_kernels(self.model.precision), self.model
        plan: list[tuple[Any, Any, list[Any]]] = []
        for name, stored in self._start.items():
            field = getattr(self.state, name).entries()
            plan.append((kernels.restore, (m.groups, m.places + 1), [stored.entries(), field]))
        faults = [self.state.alive.entries(), self.state._fault_link, self.state._fault_tick]
        plan.append((kernels.revive, m.groups * m.width, faults))
        given = [chosen, self._slot_world]
        return [recorded(k, d, [*given, *i], m.device) for k, d, i in plan]

    # ---- looking -------------------------------------------------------------------------------------------------

    def observe(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Write body frames into `position` and `rotation` and return both."""
        split = not self.model.device.is_capturing
        if split not in self._looking:
            self._looking[split] = self._prepare_look(split=split)
        self._looking[split]()
        return self.position, self.rotation

    def _prepare_look(self, *, split: bool) -> Callable[[], None]:
        anchor, frame = self._bodies
        before = [self.model.kernel, self.state.kernel, anchor.kernel, frame.kernel, self._slot_world, self._slot_link]
        return self._launcher.prepare(
            pose_kernel(self.model.width, self.model.precision), before, [self._position, self._rotation], split=split
        )

    def energy(self) -> tuple[Array, Array]:
        """Return energies [worlds, 3] (kinetic, gravitational, springs) [J] and momenta [worlds, 2, 3].

        The springs' is with their pre-loads. Momenta are linear [kg m/s] and angular about the origin [kg m^2/s].
        """
        before = [self.model.kernel, self.state.kernel, self._slot_world]
        self._launcher.prepare(
            energy_kernel(self.model.width, self.model.precision), before, [self._energy, self._momentum]
        )()
        return self._energy.numpy().astype(np.float64), self._momentum.numpy().astype(np.float64)

    def probes(self, points: Sequence[Sequence[tuple[int, Array]]]) -> Probes:
        """Return a recorder of points fixed to links: for every world, (link, point in the body frame [m]) pairs.

        Every world has the same number of probes.
        """
        return Probes(self, points)


class Probes:
    """Positions and velocities of points fixed to links.

    Attributes:
        position, velocity: Torch views [worlds, probes, 3], in m and m/s, after `read`.
    """

    def __init__(self, simulator: Simulator, points: Sequence[Sequence[tuple[int, Array]]]) -> None:
        m = simulator.model
        count = len(points[0])
        place = np.zeros((m.groups * m.width, count), np.int64)
        local = np.zeros((m.groups * m.width, count, 3))
        for world, chosen in enumerate(points):
            for j, (link, point) in enumerate(chosen):
                n = m.first_link[world] + link
                place[m.world_slot[world], j] = m.link_place[n]
                local[m.world_slot[world], j] = m.links.in_link_frame(n, np.asarray(point, np.float64))
        self._place = integer_array(_per_group(place, m.width), m.device)
        self._local = m.field("Vec", places=count)
        self._local.assign(local)
        self._position = wp.zeros((m.num_worlds, count), dtype=simulator._out3, device=m.device)
        self._velocity = wp.zeros((m.num_worlds, count), dtype=simulator._out3, device=m.device)
        self.position: torch.Tensor = wp.to_torch(self._position)
        self.velocity: torch.Tensor = wp.to_torch(self._velocity)
        before = [m.kernel, simulator.state.kernel, self._place, self._local.kernel, simulator._slot_world]
        self._read = simulator._launcher.prepare(
            probe_kernel(m.width, m.precision), before, [self._position, self._velocity]
        )

    def read(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Write and return `position` and `velocity`."""
        self._read()
        return self.position, self.velocity


def _per_group(place: IntArray, width: int) -> IntArray:
    """Return the places of each group's probes; the worlds of a group share them.

    Raises:
        InputError: Worlds of one group have their probes at different places.
    """
    rows = place.reshape(-1, width, place.shape[1])
    shared = rows.max(axis=1)
    if not ((rows == shared[:, None]) | (rows == 0)).all():
        raise InputError("probes", "link", "different places in worlds that share a thread", "Model(..., width=1)")
    return shared
