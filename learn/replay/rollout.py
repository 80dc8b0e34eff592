"""Replaying recorded trajectories with many sets of parameters at once."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.tree.midway import midway_types
from ...kernels.tree.rollout import rollout_kernels
from ..cases.case import BranchCase, JointCase
from ..systems.acting import FIELD
from ..systems.branch import BranchSystem, Unknowns
from .effect_rollout import EffectArrays, midway_arrays, prepare
from .midstep import Armature, driving
from .recording import Recording
from .worlds import ReplayWorlds


class Rollout(ReplayWorlds):
    """Simulates R recordings for S sets of parameters, all in one launch; see `ReplayWorlds`.

    Attributes:
        effects: Parameters and memories of the system's effects, None where it has none.
        world_steps: World-steps taken so far.
        seconds: Wall time spent in simulation so far [s].
    """

    def __init__(
        self, case: BranchCase | JointCase, chosen: Sequence[Recording], num_sets: int, *,
        unknowns: Unknowns | None = None, device: Any = None, track: bool = False, finer: int = 1,
        alone: bool = False,
    ) -> None:  # fmt: skip
        """Build the worlds, see `ReplayWorlds`."""
        super().__init__(
            case, chosen, num_sets, unknowns=unknowns, device=device, track=track, finer=finer, alone=alone
        )
        self.world_steps, self.seconds = 0, 0.0
        self.effects: EffectArrays | None = None
        arrays = self.model.arrays
        half = 0.0 if isinstance(self.system, BranchSystem) else self._damper_ahead
        self._armature = Armature(arrays["armature"].torch, arrays["damping"].torch, half)
        self._prepare()

    def _prepare(self) -> None:
        if self.system.acting.names:
            self.effects, self._replay = prepare(self)
            return
        m, sim, dev = self.model, self.simulator, self.device
        longest, count = int(self.samples.max()), len(self.recordings)
        inputs = np.zeros((count, longest, max(1, self.recordings[0].input.shape[1])))
        for j, (r, acts) in enumerate(zip(self.recordings, driving(self.case, self.recordings), strict=True)):
            inputs[j, : len(r.t), : acts.shape[1]] = acts
        trajectory: wp.array = wp.array(np.repeat(np.arange(count), self.blocks), dtype=int, device=dev)
        length: wp.array = wp.array(self.samples, dtype=int, device=dev)
        drive: wp.array = wp.array(inputs, dtype=wp.float64, device=dev)
        kernels = rollout_kernels(m.width, m.precision)
        before = [sim._dynamics, sim.state.kernel, sim.load.kernel]
        if isinstance(self.system, BranchSystem):
            kernel, before = kernels.point, [*before, self._midway(), self._grasped(), trajectory, length, drive]
        else:
            kernel, before = kernels.joint, [*before, *self.joint_arguments(), trajectory, length, drive]
        after = [self.substeps, sim.dt / self.substeps, sim.max_speed, self.allocate_output().kernel]
        self._replay = sim._launcher.prepare(kernel, before, after)

    def coordinates(self) -> torch.Tensor:
        """Return the tracked coordinates of the last call, kernel quaternions [S, R, T, places + 1, 4]."""
        assert self.effects is not None and self.track
        out = self.effects.arrays["track"].torch.unflatten(0, (self.chains, self.blocks))
        out = out.flatten(1, 2)[:, : self.num_sets].transpose(0, 1)
        return out.reshape(self.num_sets, len(self.recordings), -1, self.model.places + 1, 4)

    def _midway(self) -> Any:
        """Return what the steps of a branch remember of each other, see `kernels.tree.midway`."""
        self._between = midway_arrays(self.model)
        out = midway_types(self.model.width, self.model.precision).Midway()
        for name, array in self._between.items():
            setattr(out, name, array.kernel)
        return out

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
        self._armature.restore()
        self.system.write(self._padded(values).view(self.blocks, width, -1).flatten(0, 1), self.model, self._write)
        self._armature.centre()
        self._reset(start)
        sim.refresh()
        if self.effects is not None:
            self.effects.refresh(self, self._padded(values))
        clock = time.perf_counter()
        self._replay()
        self.seconds += time.perf_counter() - clock
        self.world_steps += int(self.samples.sum()) * self.substeps * self.blocks * width
        out = self._output.torch[..., 0].unflatten(0, (self.chains, self.blocks))
        out = out.unflatten(-1, (-1, self.channels)).flatten(1, 2)[:, : self.num_sets].transpose(0, 1)
        out = out.reshape(self.num_sets, len(self.recordings), -1, self.channels)
        return out if isinstance(self.system, BranchSystem) else self._watched(out)

    @property
    def _half_step(self) -> float:
        """Half of a step [s], by which joints' coordinates are ahead of their rates."""
        return 0.5 * self.simulator.dt / self.substeps

    @property
    def _damper_ahead(self) -> float:
        """How far ahead of a step's middle an implicit damper has its rate [s]."""
        return self._half_step

    def _watched(self, out: torch.Tensor) -> torch.Tensor:
        """Measured channels of joints at their samples.

        A step takes rates at its ends and coordinates, like what acts, in its middle (leapfrog): the coordinates are
        half a step h ahead, x(t) = x - h / 2 v - h^2 / 8 a. So they are at the start, see `_reset`.
        """
        half = self._half_step
        ahead, rate, gained = out.unflatten(-1, (-1, 3)).unbind(-1)
        at_sample = torch.stack([ahead - half * (rate + 0.5 * half * gained), rate, gained], -1)
        return at_sample.flatten(-2)[..., self._select]

    def _write(self, field: str, place: int | list[int], component: int, values: torch.Tensor) -> None:
        array = self.effects.arrays[FIELD] if self.effects and field == FIELD else self.model.arrays[field]
        target = array.torch.unflatten(0, (self.chains, self.blocks))
        target[:, :, :, place, component] = values.unflatten(0, (self.blocks, self.model.width))

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
        # a step looks ahead by the change of the rate in the last one: there was none
        for field, entry, c in ((state.coordinate, 1, 0), (state.velocity, 0, 1), (state.velocity, 2, 1)):
            target = field.torch.unflatten(0, (self.chains, self.blocks))
            for i in range(start.shape[2]):
                place = self._places[i]
                target[:, :, :, place, entry] = rows[:, :, :, i, c].permute(2, 0, 1)
