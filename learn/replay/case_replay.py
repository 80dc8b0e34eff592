"""A case's branch simulated under its recorded forces, with nominal springs or a model: measured and simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import matplotlib
import numpy as np
import torch
from matplotlib.figure import Figure

from ...sim.base.errors import InputError
from ...sim.base.rotation import quat_rotate
from ...sim.base.types import Array
from ...sim.engine.model import Model
from ...sim.engine.prepare import make_simulator
from ...sim.engine.simulator import Simulator
from ...sim.engine.stepping import Stepping
from ...sim.engine.trajectory import Trajectory, record
from ...sim.pictures.figures import COLORS, STYLE
from ..cases.case import BranchCase
from ..systems.branch import BranchSystem, Unknowns
from ..systems.model_file import BranchModel, blown_by
from .recording import Recording, recordings
from .rollout import Rollout


def replay(
    case: BranchCase, stepping: Stepping, *, seconds: float | None = None, model: BranchModel | None = None
) -> tuple[Trajectory, Array]:
    """Simulate one world per recording from rest; return it and the grasp points' displacement [m], shape [T, W, 3].

    Springs are those that `BranchSystem` takes for typical. A ``model`` is replayed as identification and diagnosis do,
    at their time step, and recorded at the sampling times.

    Raises:
        InputError: --seconds is longer than the recordings, or an option does not fit.
    """
    longest = min(float(t.t[-1]) for t in case.trajectories)
    seconds = longest if seconds is None else seconds
    if seconds > longest:
        raise InputError("--seconds", "", f"{seconds:g}", f"at most {longest:g}, the length of the recordings")
    if model is not None:
        return _with_model(case, model, stepping, seconds)
    system = BranchSystem(case)
    steps = stepping.steps(seconds)
    stepping.check_memory(steps, len(case.trajectories), system.tree.num_links)
    simulator = make_simulator(stepping, system.tree, system.gravity, len(case.trajectories))
    trajectory = record(simulator, steps, drive=Push(simulator, case, recordings(case)))
    return trajectory, grasp_displacement(case, trajectory)


def _with_model(case: BranchCase, model: BranchModel, stepping: Stepping, seconds: float) -> tuple[Trajectory, Array]:
    """Replay a model as identification does, recorded at the sampling times."""
    chosen = recordings(blown_by(model, case))
    rollout = Rollout(case, chosen, 1, unknowns=Unknowns(effects=model.effects), track=bool(model.effects))
    count = round(seconds / case.dt) + 1
    grasp = rollout(torch.tensor(model.values[None]))[0, :, :count, :3].double().cpu().numpy().swapaxes(0, 1)
    if model.effects:
        return _tracked(case, rollout, count), grasp
    tree = rollout.system.tree.with_(stiffness=model.stiffness, damping=model.damping)
    steps = replace(stepping, dt=case.dt, substeps=rollout.substeps)
    simulator = make_simulator(steps, tree, rollout.system.gravity, len(case.trajectories))
    return record(simulator, count - 1, drive=Push(simulator, case, recordings(case))), grasp


def _tracked(case: BranchCase, rollout: Rollout, count: int) -> Trajectory:
    """Return the bodies' poses in the first samples of a rollout that tracked its joints' coordinates."""
    poses = rollout.coordinates()[0, :, :count]
    worlds = Model([rollout.system.tree] * len(case.trajectories), gravity=rollout.system.gravity, width=1,
                   device=rollout.device)  # fmt: skip
    seen = Simulator(worlds, dt=case.dt)
    frames = []
    for k in range(count):
        seen.state.coordinate.torch[:, 0] = poses[:, k]
        frames.append([part.cpu().numpy().copy() for part in seen.observe()])
    pos, quat = (np.stack(part) for part in zip(*frames, strict=True))
    first = rollout.system.first if isinstance(rollout.system, BranchSystem) else 0
    time: Array = case.dt * np.arange(count, dtype=np.float64)
    return Trajectory(time, list(case.segment_name), pos[:, :, first:], quat[:, :, first:],
                      _lost(rollout, len(case.trajectories)))  # fmt: skip


def _lost(rollout: Rollout, worlds: int) -> Array:
    """Return when each recording's world was frozen [s], NaN where it was not, shape [W]."""
    out = np.full(worlds, np.nan)
    for world, _, tick in rollout.simulator.state.faults():
        out[min(world // rollout.model.width, worlds - 1)] = tick * rollout.simulator.dt / rollout.substeps
    return out


@dataclass
class Push:
    """Writes the recorded force on every world's grasp point, linear between the samples.

    Args:
        simulator: One world per recording.
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


def case_figure(case: BranchCase, time: Array, grasp: Array, named: str = "") -> Figure:
    """Draw the measured (dots) and the simulated (lines) displacement of the grasp point, one panel per recording.

    Args:
        case: The case, W recordings.
        time: Times of the simulation [s], shape [T].
        grasp: Simulated displacement [m], shape [T, W, 3].
        named: Name of the model; empty for nominal springs.
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
        figure.suptitle(
            "measured (dots) and simulated (lines)"
            + (f" by the model {named}" if named else " with nominal springs; bough identify learns the springs")
        )
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside right upper")
    return figure
