"""The worlds of a replay: which recording and which set of parameters each of them carries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import warp as wp

from ...sim.base.host import simd_width
from ...sim.engine.arrays import LaneArray
from ...sim.engine.model import Model
from ...sim.engine.simulator import Simulator
from ..cases.case import BranchCase, JointCase
from ..systems.branch import BranchSystem, Unknowns
from ..systems.choose import system_of
from .recording import Recording


class ReplayWorlds:
    """Worlds that replay R recordings for S sets of parameters: one world each, nothing copied to the host.

    Worlds are ordered by recording, then by set; sets are padded to whole groups of lanes.

    Attributes:
        num_sets: Sets S that a call takes.
        blocks: Groups of worlds that the sets of a recording take.
        num_locals: Numbers of a start state per recording (two per joint; none for a branch at rest).
        torch_device: Where parameters are taken and channels returned.
        chained: Whether one world replays all recordings in turn: what one leaves behind is there in the next.
        chains: Worlds that the recordings of one set take: one where they are chained, else one per recording.
    """

    def __init__(
        self, case: BranchCase | JointCase, chosen: Sequence[Recording], num_sets: int, *,
        unknowns: Unknowns | None = None, device: Any = None, track: bool = False, finer: int = 1,
        alone: bool = False,
    ) -> None:  # fmt: skip
        """Build the worlds; with ``track`` those of a branch with effects note their joints' coordinates too.

        With ``alone`` every recording begins with a branch that nothing has happened to. Steps are ``finer`` times as
        short as the system's own. Worlds are on the CPU unless a Warp device is given: a case is some hundred of them,
        and all laws in one kernel keep NVIDIA's compiler busy for more than 18 minutes.
        """
        self.track = track
        self.case, self.system = case, system_of(case, unknowns)
        self.recordings = list(chosen)
        self.num_sets, self.num_locals = num_sets, chosen[0].start.size
        self.device = wp.get_device("cpu" if device is None else device)
        width = 1 if self.device.is_cuda else simd_width()
        self.blocks = -(-num_sets // width)
        self.chained = self.system.acting.persists and not alone
        self.chains = 1 if self.chained else len(chosen)
        worlds = [self.system.tree] * (self.chains * self.blocks * width)
        self.model = Model(worlds, gravity=self.system.gravity, device=self.device, width=width)
        self.substeps = finer * max(1, int(np.ceil(case.dt / self.system.substep - 1e-9)))
        self.simulator = Simulator(self.model, dt=case.dt, substeps=self.substeps)
        self.samples = np.array([len(r.t) for r in chosen])
        self.torch_device = self.simulator.position.device

    def allocate_output(self) -> LaneArray:
        """Return fresh memory for the channels of every recording that a world replays."""
        places = len(self.recordings) // self.chains * int(self.samples.max()) * self.channels
        self._output = self.model.field("Real", places=places)
        return self._output

    def place_marks(self, array: LaneArray, marks: torch.Tensor) -> None:
        """Write one number per padded set [sets] into the worlds of all recordings."""
        target = array.torch.unflatten(0, (self.chains, self.blocks))
        target[:, :, :, 0, 0] = marks.view(self.blocks, self.model.width)

    def joint_arguments(self) -> list[object]:
        """Return driven joints, whether inputs are linear between samples, and watched joints, as kernels take them."""
        system, case = self.system, self.case
        assert not isinstance(system, BranchSystem) and isinstance(case, JointCase)
        place = {j.name: int(self.model.link_place[j.link]) for j in system.joints}
        names, self._places = list(place), list(place.values())
        driven = [place[item.joint] for item in case.inputs]
        linear = int(not case.inputs or case.inputs[0].hold == "linear")
        watched: wp.array = wp.array(self._places, dtype=int, device=self.device)
        self.channels = 3 * len(names)
        quantity = {"position": 0, "velocity": 1, "acceleration": 2}
        self._select = [3 * names.index(o.joint) + quantity[o.quantity] for o in case.outputs]
        return [wp.array(driven, dtype=int, device=self.device), linear, watched]
