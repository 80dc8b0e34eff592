"""``bough simulate``: simulate the tree of a file and record where its bodies are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import tyro

from ..sim.base.console import shown, start_warp, tell, warn
from ..sim.base.errors import InputError, check_seed
from ..sim.base.files import check_output, output_folder, read_text
from ..sim.engine.stepping import Stepping
from ..sim.formats.load import load_mechanism
from .base.exit_codes import ExitCode

if TYPE_CHECKING:
    from ..learn.cases.case import BranchCase, JointCase
    from ..learn.inference.replayed import Replayed
    from ..learn.systems.model_file import Model
    from ..sim.base.types import Array
    from ..sim.engine.simulator import Simulator
    from ..sim.engine.trajectory import Trajectory
    from ..sim.formats.import_mjcf import Mechanism

MOST_SUBSTEPS = 10_000
"""Equal parts of a step: with more, a second at the default step takes hours, and smaller --dt is what is meant."""
_ALLOWED = "an MJCF file (.xml, .mjcf), a URDF file (.urdf), a MuJoCo model (.mjb) or a case folder"


@dataclass(frozen=True)
class Simulate:
    """Simulate the tree of an MJCF or URDF file, or a case's branch under its recorded forces.

    Writes trajectory.npz (time [T], body_name [B], body_pos [T, W, B, 3], body_quat [T, W, B, 4]; the first time is the
    start; and the bodies' capsules, for bough view) and trajectory.png. Of a case of joints, which needs --model, it
    holds channel [C], simulated and measured [T, R, C]. With --model the RMSE in the recordings that it was not fitted
    to is printed. Exit code 0: done; 2: bad input, nothing written; 3: written, but every world was frozen.

    Attributes:
        source: MJCF file (.xml), URDF file (.urdf), compiled MuJoCo model (.mjb) or case folder. A case's branch has
            nominal springs, those of beams of green wood, and one world per recording.
        out: Folder to write to.
        model: model.yaml with the springs, dampers and effects of a case's branch, instead of nominal springs, or of
            its joints. It is replayed as bough diagnose does, at the case's time step.
        seconds: Simulated time; 2 s for a file, the length of the recordings for a case.
        dt: Step [s]; there are round(seconds / dt) of them.
        substeps: Substeps per step.
        qpos: Start pose: joint coordinates in MuJoCo's order, as text (one row per world, or one for all) or .npy.
        bend: Start with every joint turned at random, by this standard deviation [rad], in each world anew.
        worlds: Number of copies of the tree; as many as the rows of --qpos, or 1.
        precision: Bits per number: 64 to compare with MuJoCo, 32 for speed.
        device: Warp device, such as cpu or cuda:0; Warp's first choice if not given.
        seed: Seed of --bend.
        effect: An effect that acts in all worlds alike, NAME:PARAMETER=VALUE[,PARAMETER=VALUE...] in SI units, such as
            dry_friction:torque_Nm=0.05; once for each effect. Laws at joints act at all of them, tip_mass at all tips.
        ignore: What of a file may be left out that bough does not simulate, such as limits,contacts,actuators; all
            stands for everything. A file with more is refused by name. What was left out is printed, and kept in
            trajectory.npz.
        dump_faults: Write the last hundred states of every world of a file's tree that is frozen into this folder, a
            file each for bough replay.
        json: Print worlds, steps, errors and what was left out as JSON instead of a sentence.
    """

    source: tyro.conf.Positional[Path]
    out: Path
    model: Path | None = None
    seconds: float | None = None
    dt: float = 1.0 / 240.0
    substeps: int = 1
    qpos: Path | None = None
    bend: float = 0.0
    worlds: int | None = None
    precision: Literal[32, 64] = 64
    device: str | None = None
    seed: int = 0
    effect: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    ignore: str = ""
    dump_faults: Path | None = None
    json: bool = False

    @property
    def ignored(self) -> tuple[str, ...]:
        """Words of --ignore."""
        return tuple(word.strip() for word in self.ignore.split(",") if word.strip())

    @property
    def stepping(self) -> Stepping:
        """How the worlds are stepped."""
        return Stepping(self.dt, self.substeps, self.precision, self.device)

    def run(self) -> int:
        """Simulate a file, say what was written and return 0, or 3 where no world reached the end."""
        trajectory, left_out = simulate_file(self)
        return report(self, trajectory, {"left_out": left_out})


def report(options: Simulate, trajectory: Trajectory, errors: Mapping[str, Any] = MappingProxyType({})) -> int:
    """Print the last line of the command, or its JSON with a model's errors; return its exit code."""
    worlds = trajectory.body_pos.shape[1]
    frozen = int(sum(math.isfinite(t) for t in trajectory.frozen_time))
    lost = f", {frozen} frozen" if frozen else ""
    bodies, steps, seconds = len(trajectory.body_name), len(trajectory.time) - 1, float(trajectory.time[-1])
    said = f"{_count(worlds, 'world')} of {_count(bodies, 'body', 'bodies')}{lost}, {seconds:.4g} s in {steps} steps"
    result = {"out": str(options.out), "worlds": worlds, "bodies": bodies, "frozen": frozen, "seconds": seconds,
              "steps": steps, **errors}  # fmt: skip
    tell(f"{said}: {shown(options.out)}/trajectory.npz, trajectory.png", result, options.json)
    return ExitCode.NOT_TRUSTED if frozen == worlds else ExitCode.DONE


def _count(n: int, one: str, many: str = "") -> str:
    return f"{n} {one if n == 1 else many or one + 's'}"


def simulate_file(options: Simulate) -> tuple[Trajectory, list[str]]:
    """Simulate the tree of an MJCF or URDF file and write the trajectory and its figure, whole or not at all.

    Returns:
        The motion, and what of the file was left out.

    Raises:
        InputError: An option out of range, a file that cannot be read or simulated, a folder that cannot be written.
    """
    import numpy as np

    check(options)
    if options.model is not None:
        raise InputError("--model", "", str(options.model), "only with a case folder")
    if options.dump_faults is not None:
        check_output(options.dump_faults)
    with output_folder(options.out) as folder:
        mechanism = load_mechanism(options.source, _ALLOWED, ignore=options.ignored)
        for line in mechanism.ignored:
            warn(f"{options.source}: left out: {line}")
        steps = options.stepping.steps(2.0 if options.seconds is None else options.seconds)
        options.stepping.check_memory(steps, options.worlds or 1, mechanism.tree.num_links)
        rows = start_rows(options, mechanism)
        start_warp()
        from ..sim.engine.effect_words import read_effects
        from ..sim.engine.prepare import make_simulator  # Warp, after what is quick to refuse

        effects = read_effects(options.effect)
        simulator = make_simulator(
            options.stepping, mechanism.tree, mechanism.gravity, len(rows), effects, mechanism.friction
        )
        _set_start(options, simulator, rows)
        advise(options, simulator)
        from ..sim.engine.trajectory import record
        from ..sim.pictures.figures import trajectory_figure

        last = None if options.dump_faults is None else simulator.keep_last()
        trajectory = record(simulator, steps)
        further = {"left_out": np.array(mechanism.ignored)} if mechanism.ignored else {}
        trajectory.save(folder / "trajectory.npz", mechanism.tree, **further)
        trajectory_figure(mechanism.tree, trajectory).savefig(folder / "trajectory.png", dpi=150)
        if last is not None and options.dump_faults is not None:
            with output_folder(options.dump_faults) as faults:
                last.write(faults)
    return trajectory, mechanism.ignored


def advise(options: Simulate, simulator: Simulator) -> None:
    """Say in one line when springs are too stiff for the step, which damps fast motion (`kernels.tree.stability`)."""
    held = simulator.implicit_worlds()
    if held:
        step = simulator.dt / simulator.substeps
        warn(
            f"{options.source}: {_count(held, 'world')}: a step of {step:.2g} s does not resolve the stiffest springs; "
            "their fast motion is damped, the equilibrium stays; --substeps resolves more"
        )


def check(options: Simulate) -> None:
    """Raise `InputError` for an option out of range."""

    def need(ok: bool, option: str, found: object, allowed: str) -> None:
        """Raise `InputError` that names the option unless ``ok``."""
        if not ok:
            raise InputError(option, "", str(found), allowed)

    def positive(x: float | None) -> bool:
        """Return whether a number is finite and above 0, or not given."""
        return x is None or (math.isfinite(x) and x > 0)

    need(positive(options.seconds), "--seconds", options.seconds, "a time above 0")
    need(positive(options.dt), "--dt", options.dt, "a time above 0")
    need(1 <= options.substeps <= MOST_SUBSTEPS, "--substeps", options.substeps, f"1 to {MOST_SUBSTEPS}")
    need(options.worlds is None or options.worlds >= 1, "--worlds", options.worlds, "1 or more")
    need(0.0 <= options.bend <= math.pi, "--bend", options.bend, "0 to pi")
    check_seed("", options.seed)
    faults = options.dump_faults
    need(faults is None or not options.source.is_dir(), "--dump-faults", f"{faults} with a case", "a tree's file")
    whole = not options.ignored or not options.source.is_dir()
    need(whole, "--ignore", f"{options.ignore} with a case", "a tree's file")
    need(options.qpos is None or options.bend == 0.0, "--bend", f"{options.bend:g} and --qpos", "one of the two")


# ---- the start ---------------------------------------------------------------------------------------------------


def start_rows(options: Simulate, mechanism: Mechanism) -> Array:
    """Return the start of every world in MuJoCo's order, shape [W, nq].

    Raises:
        InputError: The file of --qpos cannot be read, or does not fit the tree or --worlds.
    """
    import numpy as np

    if options.qpos is None:
        rows = _bent(options, mechanism) if options.bend else mechanism.qpos0[None]
    else:
        rows = read_qpos(options.qpos, mechanism.tree.num_coordinates)
    worlds = len(rows) if options.worlds is None else options.worlds
    if len(rows) not in (1, worlds):
        raise InputError(options.qpos or "--qpos", "", f"{len(rows)} rows", f"1, or --worlds {worlds}")
    return np.broadcast_to(rows, (worlds, rows.shape[1]))


def _bent(options: Simulate, mechanism: Mechanism) -> Array:
    """Turn every joint of every world's start by a normally distributed angle, ball joints about a random axis."""
    import numpy as np

    from ..sim.base.rotation import axis_angle_quat, quat_multiply
    from ..sim.trees.pose import coordinate_start
    from ..sim.trees.tree import Joint

    tree, rows = mechanism.tree, np.tile(mechanism.qpos0, (options.worlds or 1, 1))
    first = coordinate_start(tree)
    ball, hinge = (np.flatnonzero(tree.joint == kind) for kind in (Joint.SPHERICAL, Joint.REVOLUTE))
    for world, row in enumerate(rows):
        rng = np.random.default_rng(np.random.SeedSequence(options.seed, spawn_key=(world,)))
        axis = rng.standard_normal((tree.num_links, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        angle = options.bend * rng.standard_normal(tree.num_links)
        row[first[hinge]] += angle[hinge]
        entries = first[ball, None] + np.arange(4)
        row[entries] = quat_multiply(row[entries], axis_angle_quat(axis[ball], angle[ball]))
    return rows


def read_qpos(path: Path, width: int) -> Array:
    """Read joint coordinates: ``.npy`` of shape [nq] or [W, nq], or text with one row per line (# starts a comment).

    Text may also hold one number per line, for one world.

    Args:
        path: The file.
        width: Numbers per row, nq.

    Returns:
        Shape [W, nq].

    Raises:
        InputError: The file cannot be read; names the row that has another length or no finite number.
    """
    import numpy as np

    rows = _npy_rows(path) if path.suffix == ".npy" else _text_rows(path)
    if width > 1 and len(rows) == width and all(len(r) == 1 for _, r in rows):
        rows = [("", [r[0] for _, r in rows])]
    for place, row in rows:
        if len(row) != width:
            raise InputError(
                path, place, f"{len(row)} numbers", f"{width} (w x y z per ball joint, 1 per hinge or slide)"
            )
        bad = [x for x in row if not math.isfinite(x)]
        if bad:
            raise InputError(path, place, str(bad[0]), "finite numbers")
    if not rows:
        raise InputError(path, "", "no numbers", f"{width} in a row, a row for all worlds or for each")
    return np.array([row for _, row in rows])


def _text_rows(path: Path) -> list[tuple[str, list[float]]]:
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise InputError(path, f"line {number}", str(error).rsplit(": ", 1)[-1], "numbers") from None
        if values:
            rows.append((f"line {number}", values))
    return rows


def _npy_rows(path: Path) -> list[tuple[str, list[float]]]:
    import numpy as np

    from ..sim.base.archive import read_array

    allowed = "a NumPy array of real numbers, shape [nq] or [worlds, nq]"
    values = read_array(path, allowed)
    if values.dtype.kind not in "fiu" or values.ndim not in (1, 2):
        raise InputError(path, "", f"{values.dtype} of shape {values.shape}", allowed)
    return [(f"row {k}", row.tolist()) for k, row in enumerate(np.atleast_2d(values.astype(np.float64)))]


def _set_start(options: Simulate, simulator: Simulator, rows: Array) -> None:
    try:
        simulator.state.set_qpos(rows)
    except InputError as error:
        raise InputError(options.qpos or options.source, error.place, error.found, error.allowed) from None
    simulator.refresh()


# ---- cases -----------------------------------------------------------------------------------------------------------


def simulate_case(options: Simulate) -> int:
    """Simulate one world per recording, write the trajectory and its figure, say so; return the exit code.

    Beside what a file's trajectory holds there is ``grasp_displacement`` [T, W, 3], the displacement of the grasp point
    [m]. With a model the RMSE in the recordings that it was not fitted to is printed, as `bough diagnose` claims it.

    Raises:
        InputError: A faulty case, one of joints without a model, an option that a case decides itself, a folder that
            cannot be written.
    """
    from ..learn.cases.case import JointCase, load_case

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
            return _case_joints(options, case, model, folder)
        return _case_branch(options, case, model, folder)


def _case_branch(options: Simulate, case: BranchCase, model: Model | None, folder: Path) -> int:
    from ..learn.replay.case_replay import case_figure, replay
    from ..learn.systems.branch import BranchSystem
    from ..learn.systems.model_file import BranchModel

    assert model is None or isinstance(model, BranchModel)
    trajectory, grasp = replay(case, options.stepping, seconds=options.seconds, model=model)
    trajectory.save(folder / "trajectory.npz", BranchSystem(case).tree, grasp_displacement=grasp)
    named = "" if model is None else model.name
    case_figure(case, trajectory.time, grasp, named).savefig(folder / "trajectory.png", dpi=150)
    return report(options, trajectory, {} if model is None else _missed(options, case, model)[1])


def _case_joints(options: Simulate, case: JointCase, model: Model, folder: Path) -> int:
    from ..learn.inference.replayed_figure import replayed_figure, save_replayed
    from ..learn.systems.joint_file import JointModel

    if options.seconds is not None:
        raise InputError("--seconds", "", f"{options.seconds:g}", "not with a case of joints, which is replayed whole")
    assert isinstance(model, JointModel)
    case = model.as_fitted(case)
    seen, errors = _missed(options, case, model)
    save_replayed(folder / "trajectory.npz", case, seen)
    replayed_figure(case, seen, model.name).savefig(folder / "trajectory.png", dpi=150)
    count = len(seen.recordings)
    said = f"{count} recording{'s' * (count > 1)} simulated: {shown(options.out)}/trajectory.npz, trajectory.png"
    tell(said, {"out": str(options.out), "recordings": count, **errors}, options.json)
    return ExitCode.DONE


def _missed(options: Simulate, case: BranchCase | JointCase, model: Model) -> tuple[Replayed, dict[str, Any]]:
    """Return what a model simulates of all recordings and misses of those held out, and print that for people."""
    from ..learn.inference.replayed import replay_model
    from ..learn.inference.report import spoken, unit_of

    if not model.claimed:
        warn(f"{model.name}: the effects are the nearest that a diagnosis found; it does not claim them")
    seen = replay_model(case, model)
    files = [case.trajectories[j].file for j in seen.test]
    apart = "not used in its fit" if set(seen.test).isdisjoint(seen.train) else "the only recording"
    if not options.json:
        print(f"held-out RMSE {seen.rms:.3g} {spoken(unit_of(case))} ({', '.join(files)}, {apart})")
    return seen, {"held_out_rmse": float(seen.rms), "unit": unit_of(case), "held_out": files}


def _refuse_start(options: Simulate) -> None:
    given = {"--qpos": options.qpos, "--worlds": options.worlds, "--bend": options.bend or None}
    for name, value in given.items():
        if value is not None:
            allowed = "only with a file: a case starts at rest, one world for each recording"
            raise InputError(name, "", str(value), allowed)
    if options.effect:
        raise InputError("--effect", "", options.effect[0], "only with a file: a case's effects stand in --model")
