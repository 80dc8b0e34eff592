"""Identify the same measured branches with bough and with mujoco.sysid, one after the other, and set them side by side.

    python benchmarks/identification.py [--cases N] [--seed N] [--out DIR] [--record FILE]

Cases come from `tests/oracles/branch_case.py`: C MuJoCo, more links than either model has, R = 1, 2, 3 segments, 1, 3
and 5 % noise. Both are given the same recordings to learn from and the same ones held out (bough's split), the same
start (`BranchSystem`'s typical springs), the same box, the same step, the same noise estimated from the data:
displacement and velocity of the grasp point. Both learn K and D of every joint. Both identify one more case before the
clock runs.

What mujoco.sysid is given (its `sysid` extra, all threads):

- R rigid segments on ball joints (bough's MJCF), springs wound up until the given pose is at rest, as they are in the
  simulation that made the data. The model is compiled once; its `build_model` hook writes K, D and the winding.
- Logarithms of K and D as parameters, so that their box can be as wide as bough's and Gauss-Newton is well scaled.
- Its optimizer `scipy_parallel_fd` with `x_scale="jac"` (trust region, finite differences rolled out in parallel), from
  one start; bough's way of starting is part of bough. sysid's default `mujoco` ends at the same optimum here, but takes
  up to four times as long on three segments.
- Where a trial blows up, which stops sysid with an error, a residual that is not finite, so that the trial is rejected.
- A `modify_residual` hook: residuals over the noise, and predictions taken at the very sample times (by default sysid
  labels a sensor reading with the time one step later, and scales by the signal instead of the noise).
- 95 % intervals of held-out displacement: the covariance of `calculate_intervals` carried through a finite-difference
  Jacobian of the prediction, plus the measured noise; and, in a second column, plus the noise that sysid itself takes
  for granted there, the rms residual.

Seconds are those of `bough identify` with report and figures, and of sysid from model to held-out intervals. Held-out
rms and coverage are over displacements; the error of K is the median over joints. Exits with 1 if a bound of `declared`
is missed: the median rms of bough is larger, its coverage further from 95 % than either of sysid's, or its median time
longer.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import io
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import measuring
import mujoco
import numpy as np
from bough.learn.cases.case import BranchCase, BranchTrajectory, load_case
from bough.learn.cases.noise import estimate_noise
from bough.learn.inference.identify import Settings, identify
from bough.learn.systems.branch import BranchSystem
from bough.sim.base.extras import install_hint
from bough.sim.base.files import output_folder
from bough.sim.base.host import describe
from bough.sim.formats.export_mjcf import to_mjcf
from measuring import Figure, InvalidRunError
from mujoco import minimize, sysid
from oracles.branch_case import make_branch_case
from oracles.mujoco_tree import OFF
from rich.console import Console
from rich.progress import track
from rich.table import Table

NOISE = (0.01, 0.03, 0.05)
Z95 = 1.959963984540054
# sysid's own intervals: noise as measured; noise as its residuals have it
PEERS = ("sysid", "sysid_residual")


@dataclass
class Score:
    """What one program made of one case.

    Attributes:
        rms: Held-out displacement, measured minus predicted [m].
        coverage: Shares of held-out displacements inside the 95 % interval, by kind of interval.
        error: Relative error of every joint's K.
        seconds: Wall time.
        details: What else it says.
    """

    rms: float
    coverage: dict[str, float]
    error: list[float]
    seconds: float
    details: dict[str, Any]

    @property
    def middle_error(self) -> float:
        """Median over joints of the error's size."""
        return float(np.median(np.abs(self.error)))


@dataclass
class Pair:
    """One case and what both made of it."""

    seed: int
    segments: int
    noise: float
    bough: Score
    sysid: Score


def with_bough(folder: Path, truth: dict, seed: int) -> tuple[Score, dict]:
    """Identify a case with bough: its score and its report."""
    with tempfile.TemporaryDirectory() as out:
        clock = time.perf_counter()
        identify(folder, out, Settings(seed=seed))
        seconds = time.perf_counter() - clock
        report = json.loads((Path(out) / "report.json").read_text())
    learnt = [report["parameters"][f"stiffness {n}"]["median"] for n in truth["branch"]["names"]]
    kept = {k: report[k] for k in ("seconds", "world_steps", "misfit_over_noise", "interval_95_width_m")}
    score = Score(report["rms_misfit_m"], {"bough": report["coverage_95"]}, _errors(learnt, truth), seconds, kept)
    return score, report


def _errors(learnt: list[float], truth: dict) -> list[float]:
    return (np.array(learnt) / np.array(truth["K"]) - 1.0).tolist()


class SysidBranch:
    """A branch as mujoco.sysid sees it.

    Args:
        case: The case.
        sigma: Noise of displacement [m] and velocity [m/s], shape [6].
    """

    def __init__(self, case: BranchCase, sigma: np.ndarray) -> None:
        self.case, self.sigma = case, sigma
        system = BranchSystem(case)
        self.steps = int(np.ceil(case.dt / system.substep - 1e-9))
        tree = system.tree.with_(preload=np.zeros_like(system.tree.preload))
        self.spec = mujoco.MjSpec.from_string(to_mjcf(tree, gravity=case.gravity, timestep=case.dt / self.steps))
        self.spec.option.disableflags |= int(OFF)
        self._add_grasp(tree.link_name)
        self.model = self.spec.compile()
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        self.load = data.qfrc_bias.reshape(-1, 3).copy()
        self.start = sysid.create_initial_state(self.model, data.qpos)
        self.params = sysid.ParameterDict()
        for p in system.parameters:
            self.params.add(sysid.Parameter(p.name, p.start, p.free(p.low), p.free(p.high)))

    def _add_grasp(self, names: list[str]) -> None:
        """Give the model a force on the grasp point, in world axes, and sensors of its position and velocity."""
        link, point = self.case.grasp
        self.spec.body(names[link]).add_site(name="grasp", pos=point)
        self.spec.worldbody.add_site(name="origin")
        for name, axis in zip("xyz", np.eye(3), strict=True):
            actuator = self.spec.add_actuator(name=name, target="grasp", refsite="origin", gear=[*axis, 0.0, 0.0, 0.0])
            actuator.trntype = mujoco.mjtTrn.mjTRN_SITE
        for name, kind in (("at", mujoco.mjtSensor.mjSENS_FRAMEPOS), ("speed", mujoco.mjtSensor.mjSENS_FRAMELINVEL)):
            self.spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="grasp")

    def build(self, params: Any, _spec: Any) -> mujoco.MjModel:
        """Return the model with springs and dampers, wound up to carry the branch."""
        model = copy.copy(self.model)
        stiffness, damping = np.split(np.exp(params.as_vector()), 2)
        model.jnt_stiffness[:] = stiffness
        model.dof_damping[:] = np.repeat(damping, 3)
        for i, turn in enumerate(self.load / stiffness[:, None]):
            angle = np.linalg.norm(turn)
            axis = turn / angle if angle > 0 else np.array([1.0, 0.0, 0.0])
            mujoco.mju_axisAngle2Quat(model.qpos_spring[4 * i : 4 * i + 4], axis, angle)
        return model

    def residual(self, which: list[int]) -> Callable[[np.ndarray, Any], Any]:
        """Return sysid's residual function, (measured - predicted) / noise, of some recordings."""
        chosen = [self.case.trajectories[j] for j in which]
        sequences = sysid.ModelSequences(
            self.case.name, self.spec, [t.file for t in chosen], [self.start] * len(chosen),
            [self._control(t) for t in chosen],
            [sysid.TimeSeries(t.t, np.hstack([t.displacement, t.velocity])) for t in chosen],
        )  # fmt: skip
        return sysid.build_residual_fn(
            models_sequences=[sequences], build_model=self.build, modify_residual=self._weigh, resample_true=False
        )

    def _control(self, trajectory: BranchTrajectory) -> Any:
        """Force in the middle of every step; two more steps than samples need, one of which sysid drops."""
        force = np.where(trajectory.no_contact[:, None], 0.0, trajectory.force)
        step = self.case.dt / self.steps
        times = step * np.arange((len(force) - 1) * self.steps + 2)
        return sysid.TimeSeries(times, np.stack([np.interp(times + step / 2, trajectory.t, f) for f in force.T], 1))

    def _weigh(self, _params: Any, predicted: Any, measured: Any, *_args: Any, **_kwargs: Any) -> Any:
        """Compare at the sample times: row k of the sensors belongs to the state before step k."""
        sampled = predicted.data[:: self.steps].copy()
        sampled[:, :3] -= sampled[0, :3]
        out = sysid.TimeSeries(measured.times, sampled, measured.signal_mapping)
        return (measured.data - sampled) / self.sigma, out, measured


def with_sysid(case: BranchCase, train: list[int], test: list[int], truth: dict) -> Score:
    """Identify a case with mujoco.sysid and predict what was held out."""
    clock = time.perf_counter()
    noise = estimate_noise(case)
    sigma = np.repeat([np.sqrt(np.mean(v**2)) for v in (noise.displacement, noise.velocity)], 3)
    branch = SysidBranch(case, sigma)
    learn = branch.residual(train)
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        best, result = sysid.optimize(branch.params, _guarded(learn), "scipy_parallel_fd", verbose=False, x_scale="jac")
    left = learn(result.x, best)[0]
    covariance, _ = sysid.calculate_intervals(left, result.jac)
    scale = float(np.mean(np.concatenate(left) ** 2))
    residual, spread = _predict(branch.residual(test), best, result.x, covariance)
    coverage = {
        name: float(np.mean(np.abs(residual) <= Z95 * np.sqrt(spread + noise_variance)))
        for name, noise_variance in zip(PEERS, (1.0, scale), strict=True)
    }
    seconds = time.perf_counter() - clock
    rms = float(np.sqrt(np.mean((residual * sigma[:3]) ** 2)))
    width = float(np.mean(2.0 * Z95 * np.sqrt(spread + 1.0) * sigma[:3]))
    details = {
        "ended": printed.getvalue().strip().splitlines()[-2:], "mean_square_residual": scale,
        "interval_95_width_m": width, "parameters": dict(zip(best.keys(), np.exp(result.x).tolist(), strict=True)),
    }  # fmt: skip
    return Score(rms, coverage, _errors(np.exp(result.x[: len(truth["K"])]).tolist(), truth), seconds, details)


def _guarded(residual: Callable[[np.ndarray, Any], Any]) -> Callable[[np.ndarray, Any], Any]:
    """Return a residual function that is infinite where the simulation blows up.

    `mujoco.rollout` then repeats its last state, and sysid refuses the clock that stands still.
    """

    def guarded(x: np.ndarray, params: Any) -> Any:
        try:
            return residual(x, params)
        except ValueError as error:
            if "strictly increasing" not in str(error):
                raise
            return [np.full((1, *x.shape[1:]), np.inf)], [], []

    return guarded


def _predict(function: Any, params: Any, x: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Held-out displacement over the noise: residual and variance of the prediction, both of shape [N, 3]."""

    def flat(at: np.ndarray) -> np.ndarray:
        return np.concatenate(function(at, params.copy())[0])

    column = x.reshape(-1, 1)
    residual = flat(column)
    slope, _ = minimize.jacobian_fd(flat, column, residual, np.finfo(np.float64).eps ** 0.5, 0)
    variance = np.einsum("np,pq,nq->n", slope, covariance, slope)
    return residual.reshape(-1, 6)[:, :3], variance.reshape(-1, 6)[:, :3]


def compare(folder: Path, seed: int, segments: int, noise: float, **options: Any) -> Pair:
    """Make a case and identify it with both."""
    truth = make_branch_case(folder, seed, segments=segments, noise=noise, **options)
    ours, report = with_bough(folder, truth, seed)
    train, test = ([j - 1 for j in report["trajectories"][k]] for k in ("train", "test"))
    case = load_case(folder)
    assert isinstance(case, BranchCase)
    return Pair(seed, segments, noise, ours, with_sysid(case, train, test, truth))


def cases(seed: int, count: int) -> list[tuple[int, int, float]]:
    """Seed, segments and noise of ``count`` cases: every R at every noise, over and over."""
    return [(1000 * seed + k, 1 + k % 3, NOISE[k // 3 % 3]) for k in range(count)]


HEAD = (
    "R", "noise [%]", "rms bough [mm]", "rms sysid [mm]", "ratio", "covers bough [%]", "covers sysid [%]",
    "with residual noise [%]", "K error bough [%]", "K error sysid [%]", "bough [s]", "sysid [s]", "ratio of times",
)  # fmt: skip


def row(p: Pair) -> list[float]:
    """Return the numbers of one line of the table."""
    a, b = p.bough, p.sysid
    covers = [100 * a.coverage["bough"], *(100 * b.coverage[k] for k in PEERS)]
    errors = [100 * a.middle_error, 100 * b.middle_error]
    return [p.segments, 100 * p.noise, 1e3 * a.rms, 1e3 * b.rms, a.rms / b.rms, *covers, *errors,
            a.seconds, b.seconds, a.seconds / b.seconds]  # fmt: skip


def figures(rows: list[list[float]]) -> list[Figure]:
    """Return the figures of every case, by its number, and of the medians."""
    out = [f for k, r in enumerate(rows) for f in _figures(f"case {k + 1}", r)]
    m = np.median(rows, axis=0).tolist()
    off = [abs(x - 95.0) for x in m[5:8]]
    further = Figure("median", "coverage further from 95 % than sysid's", off[0] - min(off[1:]), "%")
    return [*out, *_figures("median", m)[2:], further]


def _figures(case: str, r: list[float]) -> list[Figure]:
    return [
        Figure(case, "segments", r[0]), Figure(case, "noise", r[1], "%"),
        Figure(case, "held-out error", r[2], "mm", peer=r[3], ratio=r[3] / r[2]),
        Figure(case, "covered", r[5], "%", peer=r[6]), Figure(case, "error of K", r[8], "%", peer=r[9]),
        Figure(case, "time", r[10], "s", peer=r[11], ratio=r[11] / r[10]),
    ]  # fmt: skip


def lines_of(rows: list[list[float]]) -> list[list[str]]:
    """Return the table as text, medians last."""
    shown = [[f"{r[0]:.0f}", f"{r[1]:.0f}", *(f"{v:.3g}" for v in r[2:])] for r in rows]
    return [*shown, ["median", "", *(f"{v:.3g}" for v in np.median(rows, axis=0)[2:])]]


def write(out: Path, pairs: list[Pair], seed: int) -> None:
    """Write identification.json and identification.md, whole or not at all."""
    rows = [row(p) for p in pairs]
    text = ["| " + " | ".join(line) + " |" for line in (HEAD, ["--:"] * len(HEAD), *lines_of(rows))]
    machine = {**describe(), "mujoco": mujoco.__version__}
    with output_folder(out) as folder:
        (folder / "identification.md").write_text("\n".join([*text, "", f"{machine}, seed {seed}", ""]))
        content = {"seed": seed, "machine": machine, "cases": [asdict(p) for p in pairs]}
        (folder / "identification.json").write_text(json.dumps(content, indent=1) + "\n")


def measured(options: argparse.Namespace) -> list[Figure]:
    """Identify all cases with both and print the table."""
    if not hasattr(sysid, "default_report"):  # it swallows its own failed imports, and this one is its last
        raise InvalidRunError(f"mujoco.sysid lacks packages that it needs: {install_hint('sysid')}")
    chosen = cases(options.seed, options.cases)
    with tempfile.TemporaryDirectory() as folder:
        compare(Path(folder) / "warm", 999_999, 1, 0.03, samples=60)
        pairs = [compare(Path(folder) / f"case_{c[0]}", *c) for c in track(chosen, "identifying")]
    rows = [row(p) for p in pairs]
    table = Table(*HEAD, title="one line a case, medians last")
    for line in lines_of(rows):
        table.add_row(*line)
    Console(width=170).print(table)
    worse, slower = (sum(r[k] > 1.0 for r in rows) for k in (4, 12))
    print(f"of {len(rows)} cases the held-out error is larger in {worse}, the time longer in {slower}")
    if options.out:
        write(options.out, pairs, options.seed)
    return figures(rows)


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    found = measuring.parser_of(__doc__)
    found.add_argument("--cases", type=int, default=10)
    found.add_argument("--seed", type=int, default=0)
    found.add_argument("--out", type=Path, help="folder for the table (Markdown) and all numbers (JSON)")
    return found


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "identification"))
