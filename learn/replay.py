"""A case's branch with nominal springs under its recorded forces: what is measured beside what is simulated."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure

from ..sim.command_simulate import Simulate, check_memory, make_simulator, steps_of
from ..sim.errors import InputError
from ..sim.figures import COLORS, STYLE
from ..sim.rotation import quat_rotate
from ..sim.simulator import Simulator
from ..sim.trajectory import Trajectory, record
from ..sim.tree import Array
from .case import BranchCase
from .plant_branch import BranchPlant
from .rollout import Recording, recordings


def replay(options: Simulate, case: BranchCase) -> Trajectory:
    """Simulate one world a recording from rest, with the springs that `BranchPlant` takes for typical.

    Raises:
        InputError: --seconds is longer than the recordings, or an option does not fit.
    """
    longest = min(float(t.t[-1]) for t in case.trajectories)
    seconds = longest if options.seconds is None else options.seconds
    if seconds > longest:
        raise InputError("--seconds", "", f"{seconds:g}", f"at most {longest:g}, the length of the recordings")
    plant = BranchPlant(case)
    steps = steps_of(options, seconds)
    check_memory(options, steps, len(case.trajectories), plant.tree.num_links)
    simulator = make_simulator(options, plant.tree, plant.gravity, len(case.trajectories))
    return record(simulator, steps, drive=Push(simulator, case, recordings(case)))


@dataclass
class Push:
    """Writes the recorded force on every world's grasp point, linear between the samples.

    Args:
        simulator: One world a recording.
        case: The branch.
        recorded: Its recordings.
    """

    simulator: Simulator
    case: BranchCase
    recorded: list[Recording]

    def __post_init__(self) -> None:
        link, point = self.case.grasp
        model = self.simulator.model
        first = model.first_link[:-1] + link
        local = model.links.in_link_frame(first, point)
        self._group, self._lane = np.divmod(model.world_slot, model.width)
        self._place = model.link_place[first]
        self._put(self.simulator.load.point.torch, local)

    def _put(self, field: torch.Tensor, values: Array) -> None:
        """Write values [W, 3] at the worlds' grasped links."""
        field[self._group, self._lane, self._place] = torch.as_tensor(values, dtype=field.dtype, device=field.device)

    def __call__(self, time: float) -> None:
        """Write the forces at a time [s]."""
        force = np.array([[np.interp(time, r.t, r.input[:, c]) for c in range(3)] for r in self.recorded])
        self._put(self.simulator.load.force.torch, force)


def grasp_displacement(case: BranchCase, trajectory: Trajectory) -> Array:
    """Displacement of the grasp point from its place at the start [m], shape [T, W, 3]."""
    link, point = case.grasp
    pos, quat = trajectory.body_pos[:, :, link], trajectory.body_quat[:, :, link]
    moved = pos + quat_rotate(quat, point)
    return np.asarray(moved - moved[:1], dtype=np.float64)


def case_figure(case: BranchCase, time: Array, grasp: Array) -> Figure:
    """Draw the measured (dots) and the simulated (lines) displacement of the grasp point, a panel a recording.

    Args:
        case: The case, W recordings.
        time: Times of the simulation [s], shape [T].
        grasp: Simulated displacement [m], shape [T, W, 3].
    """
    with matplotlib.rc_context(STYLE):
        columns = min(4, len(case.trajectories))
        rows = -(-len(case.trajectories) // columns)
        figure = Figure(figsize=(11, 0.8 + 2.4 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
        for ax, t, moved in zip(axes, case.trajectories, grasp.swapaxes(0, 1), strict=False):
            for c, (color, name) in enumerate(zip(COLORS, "xyz", strict=False)):
                ax.plot(t.t, 100 * t.displacement[:, c], ".", color=color, markersize=2.5)
                ax.plot(time, 100 * moved[:, c], color=color, linewidth=1.1, label=name)
            ax.set_title(f"{t.file}\n{t.profile.replace('_', ' ')}".strip())
        for ax in axes[len(case.trajectories) :]:
            ax.set_visible(False)
        figure.supxlabel("time [s]")
        figure.supylabel("displacement of the grasp point [cm]")
        figure.suptitle("measured (dots) and simulated with nominal springs (lines); bough identify learns the springs")
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside right upper")
    return figure
