"""Replaying recorded trajectories with many sets of parameters at once."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from ..kernels.rollout import rollout_kernels
from ..sim.arrays import LaneArray
from ..sim.host import simd_width
from ..sim.model import Model
from ..sim.simulator import Simulator
from ..sim.tree import Array
from .acting import FIELD
from .case import BranchCase, JointCase
from .effect_rollout import EffectArrays, prepare
from .plant_branch import BranchPlant, Unknowns
from .plants import plant_of


@dataclass(frozen=True)
class Recording:
    """One trajectory as inference uses it.

    Attributes:
        t: Times [s], shape [T].
        input: What acts at the samples: force [N] shape [T, 3], or efforts of the driven joints, shape [T, I].
        output: Measured channels, shape [T, C].
        start: Coordinate and rate of the joints at the first sample, shape [J, 2]; empty where it starts at rest.
        contact: Whether the gripper may hold the branch, so that the force is a measurement, shape [T].
        grasp: Link that is held and the grasp point in its body frame [m]; None where joints are driven.
        t_start: When it starts on the case's absolute clock [s].
        sensed: What a branch's force sensor read, gripper open or not [N], shape [T, 3]; None: the same as ``input``.
    """

    t: Array
    input: Array
    output: Array
    start: Array
    contact: NDArray[np.bool_]
    grasp: tuple[int, Array] | None = None
    t_start: float = 0.0
    sensed: Array | None = None


def recordings(case: BranchCase | JointCase) -> list[Recording]:
    """Return a case's trajectories; a branch's force is exactly zero where the gripper is known to be open."""
    if isinstance(case, BranchCase):
        return [
            Recording(t.t, np.where(t.no_contact[:, None], 0.0, t.force), np.hstack([t.displacement, t.velocity]),
                      np.zeros((0, 2)), ~t.no_contact, t.grasp, t.t_start, t.force)
            for t in case.trajectories
        ]  # fmt: skip
    return [
        Recording(t.t, t.effort, t.output,
                  _first_state(case, t.output, t.t), np.zeros(len(t.t), dtype=bool), None, t.t_start)
        for t in case.trajectories
    ]  # fmt: skip


def _first_state(case: JointCase, output: Array, t: Array) -> Array:
    """Guess coordinate and rate of every joint at the first sample by a parabola through the first samples."""
    start = np.zeros((len(case.joints), 2))
    n = max(3, min(len(t), int(0.02 * len(t)) + 1, 40))
    names = [j.name for j in case.joints]
    for c, channel in enumerate(case.outputs):
        joint = names.index(channel.joint)
        if channel.quantity == "position":
            coefficients = np.polynomial.polynomial.polyfit(t[:n], output[:n, c], 2 if n > 4 else 1)
            start[joint] = coefficients[:2]
        elif channel.quantity == "velocity":
            start[joint, 1] = output[:n, c].mean()
    return start


class Rollout:
    """Simulates R recordings for S sets of parameters: one world each, all in one launch, nothing copied to the host.

    Worlds are ordered by recording, then by set; sets are padded to whole groups of lanes.

    Attributes:
        num_sets: Sets S that a call takes.
        blocks: Groups of worlds that the sets of a recording take.
        num_locals: Numbers of a start state per recording (two a joint; none for a branch at rest).
        torch_device: Where parameters are taken and channels returned.
        world_steps: World-steps taken so far.
        seconds: Wall time spent in simulation so far [s].
    """

    def __init__(
        self, case: BranchCase | JointCase, chosen: Sequence[Recording], num_sets: int, *,
        unknowns: Unknowns | None = None, device: Any = None, track: bool = False,
    ) -> None:  # fmt: skip
        """Build the worlds; with ``track`` those of a branch with effects note their joints' coordinates too."""
        self.track = track
        self.case, self.plant = case, plant_of(case, unknowns)
        self.recordings = list(chosen)
        self.num_sets, self.num_locals = num_sets, chosen[0].start.size
        self.device = wp.get_device(device)
        width = 1 if self.device.is_cuda else simd_width()
        self.blocks = -(-num_sets // width)
        self._chains = 1 if self.plant.acting.persists else len(chosen)  # damage: one world replays all recordings
        worlds = [self.plant.tree] * (self._chains * self.blocks * width)
        self.model = Model(worlds, gravity=self.plant.gravity, device=self.device, width=width)
        self.substeps = max(1, int(np.ceil(case.dt / self.plant.substep - 1e-9)))
        self.simulator = Simulator(self.model, dt=case.dt, substeps=self.substeps)
        self._samples = np.array([len(r.t) for r in chosen])
        self.torch_device = self.simulator.position.device
        self.world_steps, self.seconds = 0, 0.0
        self.effects: EffectArrays | None = None
        self._prepare()

    def _prepare(self) -> None:
        if self.plant.acting.names:
            self.effects, self._replay = prepare(self)
            return
        m, sim, dev = self.model, self.simulator, self.device
        longest, count = int(self._samples.max()), len(self.recordings)
        inputs = np.zeros((count, longest, max(1, self.recordings[0].input.shape[1])))
        for j, r in enumerate(self.recordings):
            inputs[j, : len(r.t), : r.input.shape[1]] = r.input
        trajectory: wp.array = wp.array(np.repeat(np.arange(count), self.blocks), dtype=int, device=dev)
        length: wp.array = wp.array(self._samples, dtype=int, device=dev)
        drive: wp.array = wp.array(inputs, dtype=wp.float64, device=dev)
        kernels = rollout_kernels(m.width, m.precision)
        before = [sim._dynamics, sim.state.kernel, sim.load.kernel]
        if isinstance(self.plant, BranchPlant):
            kernel, before = kernels.point, [*before, self._grasped(), trajectory, length, drive]
        else:
            kernel, before = kernels.joint, [*before, *self.joint_arguments(), trajectory, length, drive]
        after = [self.substeps, sim.dt / self.substeps, sim.max_speed, self.allocate_output().kernel]
        self._replay = sim._launcher.prepare(kernel, before, after)

    def allocate_output(self) -> LaneArray:
        """Return fresh memory for the channels of every recording that a world replays."""
        places = len(self.recordings) // self._chains * int(self._samples.max()) * self.channels
        self._output = self.model.field("Real", places=places)
        return self._output

    def coordinates(self) -> torch.Tensor:
        """Return the tracked coordinates of the last call, kernel quaternions [S, R, T, places + 1, 4]."""
        assert self.effects is not None and self.track
        out = self.effects.arrays["track"].torch.unflatten(0, (self._chains, self.blocks))
        out = out.flatten(1, 2)[:, : self.num_sets].transpose(0, 1)
        return out.reshape(self.num_sets, len(self.recordings), -1, self.model.places + 1, 4)

    def place_marks(self, array: LaneArray, marks: torch.Tensor) -> None:
        """Write one number a padded set [sets] into the worlds of all recordings."""
        target = array.torch.unflatten(0, (self._chains, self.blocks))
        target[:, :, :, 0, 0] = marks.view(self.blocks, self.model.width)

    def _grasped(self) -> wp.array:
        """Write every recording's grasp point; return the places of the links that are held."""
        self.channels, places = 6, []
        points = self.simulator.load.point.torch.unflatten(0, (len(self.recordings), self.blocks))
        for j, r in enumerate(self.recordings):
            assert r.grasp is not None
            link, point = r.grasp
            places.append(int(self.model.link_place[link]))
            local = torch.as_tensor(self.model.links.in_link_frame(link, point), device=points.device)
            points[j, :, :, places[-1]] = local.to(points.dtype)
        return wp.array(places, dtype=int, device=self.device)

    def joint_arguments(self) -> list[object]:
        """Return driven joints, whether inputs are linear between samples, and watched joints, as kernels take them."""
        plant, case = self.plant, self.case
        assert not isinstance(plant, BranchPlant) and isinstance(case, JointCase)
        place = {j.name: int(self.model.link_place[j.link]) for j in plant.joints}
        names, self._places = list(place), list(place.values())
        driven = [place[item.joint] for item in case.inputs]
        linear = int(not case.inputs or case.inputs[0].hold == "linear")
        watched: wp.array = wp.array(self._places, dtype=int, device=self.device)
        self.channels = 3 * len(names)
        quantity = {"position": 0, "velocity": 1, "acceleration": 2}
        self._select = [3 * names.index(o.joint) + quantity[o.quantity] for o in case.outputs]
        return [wp.array(driven, dtype=int, device=self.device), linear, watched]

    def _write(self, field: str, place: int, component: int, values: torch.Tensor) -> None:
        array = self.effects.arrays[FIELD] if self.effects and field == FIELD else self.model.arrays[field]
        target = array.torch.unflatten(0, (self._chains, self.blocks))
        target[:, :, :, place, component] = values

    def __call__(self, values: torch.Tensor, start: torch.Tensor | None = None) -> torch.Tensor:
        """Return the channels of every recording for every set.

        Args:
            values: Parameters in SI units, shape [S, n].
            start: Coordinates and rates at the first sample, shape [S, R, J, 2]; None takes the recordings' guess.

        Returns:
            Shape [S, R, T, C], in the simulator's precision; samples past a recording's end are zero. A view of memory
            that the next call overwrites.
        """
        sim, width = self.simulator, self.model.width
        self.plant.write(self._padded(values).view(self.blocks, width, -1).flatten(0, 1), self.model, self._blocked)
        self._reset(start)
        sim.refresh()
        if self.effects is not None:
            self.effects.refresh(self, self._padded(values))
        clock = time.perf_counter()
        self._replay()
        self.seconds += time.perf_counter() - clock
        self.world_steps += int(self._samples.sum()) * self.substeps * self.blocks * width
        out = self._output.torch[..., 0].unflatten(0, (self._chains, self.blocks))
        out = out.unflatten(-1, (-1, self.channels)).flatten(1, 2)[:, : self.num_sets].transpose(0, 1)
        out = out.reshape(self.num_sets, len(self.recordings), -1, self.channels)
        return out if isinstance(self.plant, BranchPlant) else self._watched(out)

    @property
    def _half_step(self) -> float:
        """Half of a step [s], by which joints' coordinates are ahead of their rates."""
        return 0.5 * self.simulator.dt / self.substeps

    def _watched(self, out: torch.Tensor) -> torch.Tensor:
        """Measured channels of joints at their samples.

        A step takes rates at its ends and coordinates, like what acts, in its middle (leapfrog): the coordinates are
        half a step h ahead, x(t) = x - h / 2 v - h^2 / 8 a. So they are at the start, see `_reset`.
        """
        half = self._half_step
        ahead, rate, gained = out.unflatten(-1, (-1, 3)).unbind(-1)
        at_sample = torch.stack([ahead - half * (rate + 0.5 * half * gained), rate, gained], -1)
        return at_sample.flatten(-2)[..., self._select]

    def _blocked(self, field: str, place: int, component: int, values: torch.Tensor) -> None:
        self._write(field, place, component, values.view(self.blocks, self.model.width))

    def _padded(self, values: torch.Tensor) -> torch.Tensor:
        extra = self.blocks * self.model.width - self.num_sets
        if values.shape[0] != self.num_sets:
            raise ValueError(f"{values.shape[0]} sets of parameters; this rollout takes {self.num_sets}")
        return torch.cat([values, values[-1:].expand(extra, *values.shape[1:])]).to(self._output.torch.dtype)

    def _reset(self, start: torch.Tensor | None) -> None:
        state = self.simulator.state
        state.coordinate.torch.zero_()
        state.coordinate.torch[..., 0] = 1.0
        state.velocity.torch.zero_()
        state.alive.torch.fill_(1.0)
        if self.num_locals == 0:
            return
        if start is None:
            guess = torch.as_tensor(np.stack([r.start for r in self.recordings]), device=state.velocity.torch.device)
            start = guess.expand(self.num_sets, *guess.shape)
        rows = self._padded(start).view(self.blocks, self.model.width, *start.shape[1:]).clone()
        rows[..., 0] += self._half_step * rows[..., 1]
        for field, entry, c in ((state.coordinate, 1, 0), (state.velocity, 0, 1)):
            target = field.torch.unflatten(0, (self._chains, self.blocks))
            for i in range(start.shape[2]):
                place = self._places[i]
                target[:, :, :, place, entry] = rows[:, :, :, i, c].permute(2, 0, 1)
