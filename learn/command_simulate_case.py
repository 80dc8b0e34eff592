"""``bough simulate CASE``: a case's branch with nominal springs under its recorded forces."""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure

from ..sim import rotation
from ..sim.command_simulate import Simulate, check, make_simulator, report, steps_of
from ..sim.console import start_warp, warn
from ..sim.errors import InputError
from ..sim.figures import COLORS, STYLE
from ..sim.files import output_folder
from ..sim.pose import quat_rotate
from ..sim.simulator import Simulator
from ..sim.trajectory import Trajectory, record
from ..sim.tree import Array
from .case import BranchCase, load_case
from .plant import BranchPlant
from .rollout import Recording, recordings


def simulate_case(options: Simulate) -> int:
    """Simulate one world a recording, write the trajectory and its figure, say so; return the exit code.

    Beside what a file's trajectory holds there is ``grasp_displacement`` [T, W, 3], the displacement of the grasp point
    [m].

    Raises:
        InputError: A faulty case, one of joints, an option that a case decides itself, a folder that cannot be written.
    """
    check(options)
    _refuse_start(options)
    with output_folder(options.out) as folder:
        start_warp()
        case = load_case(options.source)
        if not isinstance(case, BranchCase):
            allowed = "branch-gap-case/1; bough identify takes both forms"
            raise InputError(options.source / "meta.yaml", "format", "joint-gap-case/1", allowed)
        for line in case.warnings:
            warn(line)
        trajectory = _simulate(options, case)
        grasp = grasp_displacement(case, trajectory)
        trajectory.save(folder / "trajectory.npz", grasp_displacement=grasp)
        case_figure(case, trajectory.time, grasp).savefig(folder / "trajectory.png", dpi=150)
    return report(options, trajectory)


def _refuse_start(options: Simulate) -> None:
    given = {"--qpos": options.qpos, "--worlds": options.worlds, "--bend": options.bend or None}
    for name, value in given.items():
        if value is not None:
            allowed = "only with a file: a case starts at rest, one world for each recording"
            raise InputError(name, "", str(value), allowed)


def _simulate(options: Simulate, case: BranchCase) -> Trajectory:
    longest = min(float(t.t[-1]) for t in case.trajectories)
    seconds = longest if options.seconds is None else options.seconds
    if seconds > longest:
        raise InputError("--seconds", "", f"{seconds:g}", f"at most {longest:g}, the length of the recordings")
    plant = BranchPlant(case)
    steps = steps_of(options, seconds)
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
        local = rotation.rotate(rotation.conjugate(model.links.frame[first]), point - model.links.anchor[first])
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
            ax.set_title(f"{t.file} {t.profile}".strip().replace("_", " "))
        for ax in axes[len(case.trajectories) :]:
            ax.set_visible(False)
        figure.supxlabel("time [s]")
        figure.supylabel("displacement of the grasp point [cm]")
        figure.suptitle("measured (dots) and simulated with nominal springs (lines); bough identify learns the springs")
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside right upper")
    return figure
