"""``bough simulate CASE``: a case's branch with nominal springs under its recorded forces."""

from __future__ import annotations

from ..learn.cases.case import BranchCase, load_case
from ..sim.base.console import start_warp, warn
from ..sim.base.errors import InputError
from ..sim.base.files import output_folder
from .simulate import Simulate, check, report


def simulate_case(options: Simulate) -> int:
    """Simulate one world per recording, write the trajectory and its figure, say so; return the exit code.

    Beside what a file's trajectory holds there is ``grasp_displacement`` [T, W, 3], the displacement of the grasp point
    [m].

    Raises:
        InputError: A faulty case, one of joints, an option that a case decides itself, a folder that cannot be written.
    """
    check(options)
    _refuse_start(options)
    with output_folder(options.out) as folder:
        case = load_case(options.source)
        if not isinstance(case, BranchCase):
            allowed = "branch-gap-case/1; bough identify takes both forms"
            raise InputError(options.source / "meta.yaml", "format", "joint-gap-case/1", allowed)
        for line in case.warnings:
            warn(line)
        start_warp()
        from ..learn.replay.case_replay import case_figure, replay  # torch and Warp, after what is quick to refuse
        from ..learn.systems.model_file import model_of

        model = None if options.model is None else model_of(options.model, case)
        trajectory, grasp = replay(case, options.stepping, seconds=options.seconds, model=model)
        trajectory.save(folder / "trajectory.npz", grasp_displacement=grasp)
        case_figure(case, trajectory.time, grasp, "" if model is None else model.name).savefig(
            folder / "trajectory.png", dpi=150
        )
    return report(options, trajectory)


def _refuse_start(options: Simulate) -> None:
    given = {"--qpos": options.qpos, "--worlds": options.worlds, "--bend": options.bend or None}
    for name, value in given.items():
        if value is not None:
            allowed = "only with a file: a case starts at rest, one world for each recording"
            raise InputError(name, "", str(value), allowed)
    if options.effect:
        raise InputError("--effect", "", options.effect[0], "only with a file: a case's effects stand in --model")
