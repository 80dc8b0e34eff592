"""``bough simulate CASE``: a case's branch or joints under its recorded forces, by nominal springs or by a model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..learn.cases.case import BranchCase, JointCase, load_case
from ..sim.base.console import shown, start_warp, warn
from ..sim.base.errors import InputError
from ..sim.base.files import output_folder
from .exit_codes import ExitCode
from .simulate import Simulate, check, report

if TYPE_CHECKING:
    from ..learn.inference.replayed import Replayed
    from ..learn.systems.model_file import Model


def simulate_case(options: Simulate) -> int:
    """Simulate one world per recording, write the trajectory and its figure, say so; return the exit code.

    Beside what a file's trajectory holds there is ``grasp_displacement`` [T, W, 3], the displacement of the grasp point
    [m]. With a model the RMSE in the recordings that it was not fitted to is printed, as `bough diagnose` claims it.

    Raises:
        InputError: A faulty case, one of joints without a model, an option that a case decides itself, a folder that
            cannot be written.
    """
    check(options)
    _refuse_start(options)
    with output_folder(options.out) as folder:
        case = load_case(options.source)
        if isinstance(case, JointCase) and options.model is None:
            allowed = "--model model.yaml with a case of joints, or branch-gap-case/1"
            raise InputError(options.source / "meta.yaml", "format", "joint-gap-case/1 without a model", allowed)
        for line in case.warnings:
            warn(line)
        start_warp()
        from ..learn.systems.model_file import model_of  # torch and Warp, after what is quick to refuse

        model = None if options.model is None else model_of(options.model, case)
        if isinstance(case, JointCase):
            assert model is not None
            return _joints(options, case, model, folder)
        return _branch(options, case, model, folder)


def _branch(options: Simulate, case: BranchCase, model: Model | None, folder: Path) -> int:
    from ..learn.replay.case_replay import case_figure, replay
    from ..learn.systems.model_file import BranchModel

    assert model is None or isinstance(model, BranchModel)
    trajectory, grasp = replay(case, options.stepping, seconds=options.seconds, model=model)
    trajectory.save(folder / "trajectory.npz", grasp_displacement=grasp)
    named = "" if model is None else model.name
    case_figure(case, trajectory.time, grasp, named).savefig(folder / "trajectory.png", dpi=150)
    if model is not None:
        _missed(case, model)
    return report(options, trajectory)


def _joints(options: Simulate, case: JointCase, model: Model, folder: Path) -> int:
    from ..learn.inference.replayed_figure import replayed_figure, save_replayed
    from ..learn.systems.joint_file import JointModel

    if options.seconds is not None:
        raise InputError("--seconds", "", f"{options.seconds:g}", "not with a case of joints, which is replayed whole")
    assert isinstance(model, JointModel)
    case = model.as_fitted(case)
    seen = _missed(case, model)
    save_replayed(folder / "trajectory.npz", case, seen)
    replayed_figure(case, seen, model.name).savefig(folder / "trajectory.png", dpi=150)
    count = len(seen.recordings)
    print(f"{count} recording{'s' * (count > 1)} simulated: {shown(options.out)}/trajectory.npz, trajectory.png")
    return ExitCode.DONE


def _missed(case: BranchCase | JointCase, model: Model) -> Replayed:
    """Print what a model misses of the recordings held out, and return what it simulates of all."""
    from ..learn.inference.replayed import replay_model
    from ..learn.inference.report import unit_of

    if not model.claimed:
        warn(f"{model.name}: the effects are the nearest that a diagnosis found; it does not claim them")
    seen = replay_model(case, model)
    files = ", ".join(case.trajectories[j].file for j in seen.test)
    apart = "not used in its fit" if set(seen.test).isdisjoint(seen.train) else "the only recording"
    print(f"held-out RMSE {seen.rms:.3g} {unit_of(case)} ({files}, {apart})")
    return seen


def _refuse_start(options: Simulate) -> None:
    given = {"--qpos": options.qpos, "--worlds": options.worlds, "--bend": options.bend or None}
    for name, value in given.items():
        if value is not None:
            allowed = "only with a file: a case starts at rest, one world for each recording"
            raise InputError(name, "", str(value), allowed)
    if options.effect:
        raise InputError("--effect", "", options.effect[0], "only with a file: a case's effects stand in --model")
