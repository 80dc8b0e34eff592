"""Check that posteriors are as wide as they should be: ranks of the truth, and coverage of what was not seen.

    python benchmarks/calibration.py --out DIR [--branches N] [--seed N] [--jobs N] [--record FILE]

Four studies, each unit of which is one branch, identified with default settings (``ranks``: with 48 particles):

- ``ranks``: simulation-based calibration (Talts et al. 2018). Branches of the model's own structure, three segments on
  ball joints; springs and dampers drawn from the prior that inference is given too: Young's modulus log-normal about
  500 MPa, a factor of four within two deviations; relaxation time D / K log-normal about 20 ms, a factor of e within
  two. Pushes do not depend on the truth. The rank of the truth among the particles is then uniform for every
  parameter. As many branches of one and of two segments count for the intervals of K alone.
- ``others``: 30 branches that C MuJoCo simulated with three links a segment and wood that bends between them; 1, 3 and
  5 % noise; one to three segments. Coverage of held-out displacement, error of K.
- ``grasp``: learnt from pushes at 0.9 of the last segment's length, tested at 0.5 and 0.75.
- ``force``: noise of the force of 0.5 to 10 % of its rms, the same branches at every level.

Two statistics of the truth: the share of particles below it (ranks), and the normal distribution function of its
distance from the particles' mean in their deviations, which is what the reported intervals are made of. Both are held
against the uniform distribution by Kolmogorov and Smirnov's test, every parameter by itself.

Every unit is one line of DIR/units.jsonl, appended when it is done: the same command continues where it was stopped.
When all are done, calibration.json and two figures are written. Exits with 1 if a bound of `declared` is missed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib
import measuring
import numpy as np
import torch
from bough.learn.cases.case import BranchCase, load_case
from bough.learn.inference.identify import Identification, Settings, run
from bough.learn.inference.posterior import Posterior
from bough.learn.priors.prior import Prior
from bough.learn.replay.simulated_case import Experiment, random_branch, static_force, write_simulated_case
from bough.learn.reports.figures import ALARM, FAINT, MODEL, NOISE, png
from bough.learn.runs.threads import one_thread
from bough.learn.systems.branch import BranchSystem
from bough.learn.systems.system import free_of
from bough.sim.base.host import describe, num_cores
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from measuring import Figure
from oracles.branch_case import make_branch_case
from rich.console import Console
from rich.progress import track
from scipy.special import ndtr
from scipy.stats import chi2, kstest

Unit = dict[str, Any]
LOG_YOUNG, LOG_RELAXATION = 0.7, 0.5
"""Prior deviations of log K and of log D / K."""
OTHERS, BRANCHES = 30, 6
"""Cases of another simulator; branches of the two studies of robustness."""
FORCE_NOISE = (0.005, 0.05, 0.1)
GRASPS = (0.5, 0.75)
BINS = 16
Z95 = 1.959963984540054


class SpringPrior(Prior):
    """Log-normal springs and relaxation times D / K, all independent; theta holds R log K, then R log D.

    Args:
        centre: Logarithms of typical springs, then of typical dampers, shape [2 R].
    """

    centre: torch.Tensor

    def __init__(self, centre: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("centre", centre)

    def forward(self, theta: torch.Tensor) -> torch.Tensor:
        """Return the log density, shape [...]."""
        spring, damper = (theta - self.centre).chunk(2, -1)
        return -0.5 * ((spring / LOG_YOUNG) ** 2 + ((damper - spring) / LOG_RELAXATION) ** 2).sum(-1)

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a theta, shape [2 R]."""
        spring, relaxation = rng.normal(size=(2, len(self.centre) // 2)) * [[LOG_YOUNG], [LOG_RELAXATION]]
        return self.centre.numpy() + np.concatenate([spring, spring + relaxation])


def prior_of(meta: dict[str, Any]) -> SpringPrior:
    """Return the prior of a branch, about the typical values of `BranchSystem`."""
    length, a, b = (np.array([s[k] for s in meta["segments"]]) for k in ("length_m", "radius_base_m", "radius_tip_m"))
    spring = BranchSystem.TYPICAL_YOUNG * np.pi * ((a + b) / 2.0) ** 4 / (2.0 * length)
    return SpringPrior(torch.as_tensor(np.log(np.concatenate([spring, spring * BranchSystem.TYPICAL_RELAXATION]))))


def springs(theta: np.ndarray) -> dict[str, np.ndarray]:
    """Return K and D of a theta, shapes [R]."""
    stiffness, damping = np.split(np.exp(theta), 2)
    return {"stiffness": stiffness, "damping": damping}


def standing(posterior: Posterior, truth: np.ndarray) -> Unit:
    """Return where the truth [n] (free coordinates) stands among the particles: ranks and normal scores."""
    particles = posterior.free.numpy()
    return {
        "rank": (particles < truth).sum(0).tolist(),
        "z": ((truth - particles.mean(0)) / particles.std(0, ddof=1)).tolist(),
        "deviation": particles.std(0, ddof=1).tolist(),
        "particles": len(particles),
        "converged": posterior.convergence.converged,
        "agreement": posterior.agreement,
    }


def ranks(folder: Path, index: int, segments: int, rng: np.random.Generator) -> Unit:
    """Identify a branch drawn from the prior, with that prior, from four pushes of 64 samples."""
    meta = random_branch(rng, segments)
    prior = prior_of(meta)
    theta = prior.draw(rng)
    truth, grasp = springs(theta), (segments - 1, 0.9 * meta["segments"][-1]["length_m"])
    # the force that would move the typical branch by 3 cm, whatever the truth
    typical = static_force(meta, np.exp(prior.centre.numpy()[:segments]), grasp, 0.03)
    moved = typical / static_force(meta, truth["stiffness"], grasp, 1.0)
    case = write_simulated_case(
        folder, meta, truth, Experiment(samples=64, deflection=moved), trajectories=4, seed=int(rng.integers(2**31))
    )
    work = Identification(case, Settings(seed=index, particles=48))
    work.prior = prior
    return {"truth": theta.tolist(), **standing(work.learn(list(range(4)), "posterior"), theta)}


def others(folder: Path, index: int, segments: int, rng: np.random.Generator) -> Unit:
    """Identify a branch of another simulator and predict the pushes held out."""
    noise = (0.01, 0.03, 0.05)[index // 3 % 3]
    truth = make_branch_case(folder, int(rng.integers(2**31)), segments=segments, noise=noise)
    case = load_case(folder)
    outcome = run(case, Settings(seed=index))
    middle = outcome.posterior.interval()[0][:segments]
    theta = free_of(outcome.posterior.parameters, torch.tensor([*truth["K"], *truth["D"]], dtype=torch.float64)).numpy()
    return {
        "noise": noise, "error": (middle / np.array(truth["K"]) - 1.0).tolist(), "ratio": outcome.ratio,
        "coverage": outcome.prediction.coverage, "width": outcome.prediction.width,
        **standing(outcome.posterior, theta),
    }  # fmt: skip


def grasp(folder: Path, index: int, segments: int, rng: np.random.Generator) -> Unit:
    """Learn from five pushes at 0.9 of the last segment, predict three each at 0.5 and 0.75."""
    places = [0.9] * 5 + [p for p in GRASPS for _ in range(3)]
    case, theta = _own_case(folder, segments, rng, Experiment(), places, int(rng.integers(2**31)))
    work = Identification(case, Settings(seed=index))
    posterior = work.learn(list(range(5)), "posterior")
    scores = {}
    for place in (0.9, *GRASPS):
        found = work.predict(posterior, [j for j, p in enumerate(places) if p == place])
        scores[f"{place:g}"] = {"coverage": found.coverage, "width": found.width}
    return {"by_place": scores, **standing(posterior, theta)}


def force(folder: Path, index: int, segments: int, rng: np.random.Generator) -> Unit:
    """Learn from five pushes and predict three, with more and more noise on the force."""
    scores, seed, stream = {}, int(rng.integers(2**31)), rng.bit_generator.state
    for level in FORCE_NOISE:
        rng.bit_generator.state = stream  # the same branch at every level
        experiment = Experiment(force_noise=level)
        case, theta = _own_case(folder / f"{level:g}", segments, rng, experiment, [0.9] * 8, seed)
        work = Identification(case, Settings(seed=index))
        posterior = work.learn(list(range(5)), "posterior")
        found = work.predict(posterior, [5, 6, 7])
        scores[f"{level:g}"] = {"coverage": found.coverage, "width": found.width, **standing(posterior, theta)}
    return {"by_level": scores}


def _own_case(
    folder: Path, segments: int, rng: np.random.Generator, experiment: Experiment, places: list[float], seed: int
) -> tuple[BranchCase, np.ndarray]:
    """Simulate a branch near the typical one; return it with its theta [2 R]."""
    meta = random_branch(rng, segments)
    centre = prior_of(meta).centre.numpy()
    theta = centre + 0.3 * rng.normal(size=len(centre))
    case = write_simulated_case(
        folder, meta, springs(theta), experiment, trajectories=len(places), seed=seed, grasps=places
    )
    return case, theta


STUDIES: dict[str, Callable[[Path, int, int, np.random.Generator], Unit]] = {
    "ranks": ranks, "others": others, "grasp": grasp, "force": force,
}  # fmt: skip


def plan(branches: int, seed: int) -> list[Unit]:
    """Return every unit, the studies interleaved: study, index, number of segments and seed."""
    sizes = {
        "ranks": [3] * branches + [1, 2] * branches, "others": [1 + i % 3 for i in range(OTHERS)],
        "grasp": [1 + i % 3 for i in range(BRANCHES)], "force": [1 + i % 3 for i in range(BRANCHES)],
    }  # fmt: skip
    units = [
        (i / len(every), {"study": study, "index": i, "segments": segments, "seed": seed})
        for study, every in sizes.items()
        for i, segments in enumerate(every)
    ]
    return [unit for _, unit in sorted(units, key=lambda pair: pair[0])]


def carry_out(unit: Unit) -> Unit:
    """Do one unit in a folder of its own."""
    clock, study = time.perf_counter(), unit["study"]
    rng = np.random.default_rng([unit["seed"], list(STUDIES).index(study), unit["index"]])
    with tempfile.TemporaryDirectory() as folder, one_thread():
        found = STUDIES[study](Path(folder) / "case", unit["index"], unit["segments"], rng)
    return unit | found | {"seconds": time.perf_counter() - clock}


def _own_core(cores: Any) -> None:
    """Keep a worker on a core of its own: two simulators that each take all cores wait for one another."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[cores.get()]})


def missing(units: list[Unit], done: list[Unit]) -> list[Unit]:
    """Return the units that no line belongs to."""
    known = {_key(u) for u in done}
    return [u for u in units if _key(u) not in known]


def _key(unit: Unit) -> tuple[Any, ...]:
    return tuple(unit[k] for k in ("study", "index", "segments", "seed"))


def results(units: list[Unit], jobs: int) -> Iterator[Unit]:
    """Carry out units in worker processes and yield them as they are done."""
    context = multiprocessing.get_context("spawn")
    cores = context.SimpleQueue()
    for k in range(jobs):
        cores.put(k % num_cores())
    with context.Pool(jobs, _own_core, (cores,)) as pool:
        yield from pool.imap_unordered(carry_out, units)


def read_lines(path: Path) -> list[Unit]:
    """Return the units done so far; a last line that a kill cut short is dropped from the file."""
    if not path.exists():
        return []
    whole = [line for line in path.read_text().splitlines(keepends=True) if line.endswith("\n")]
    path.write_text("".join(whole))
    return [json.loads(line) for line in whole]


def summary(done: list[Unit]) -> dict[str, Any]:
    """Return the numbers of all studies."""
    by = {study: [u for u in done if u["study"] == study] for study in STUDIES}
    return {
        "ranks": _rank_numbers([u for u in by["ranks"] if u["segments"] == 3]),
        "stiffness": _interval_numbers(by["ranks"]),
        "others": _other_numbers(by["others"]),
        "grasp": _level_numbers([u["by_place"] for u in by["grasp"]]),
        "force": _level_numbers([u["by_level"] for u in by["force"]]),
        "seconds": sum(u["seconds"] for u in done),
        "machine": describe(),
    }


def _rank_numbers(units: list[Unit]) -> dict[str, Any]:
    """Test the uniformity of every parameter, base first, springs then dampers."""
    rank, z = (np.array([u[k] for u in units]) for k in ("rank", "z"))
    particles = units[0]["particles"]
    out = {}
    for k in range(rank.shape[1]):
        name = f"{'KD'[k // 3]}{k % 3 + 1}"
        spread = (rank[:, k] + 0.5) / (particles + 1)  # the middle of each rank's share
        expected = len(units) / BINS
        counts = np.histogram(spread, BINS, (0.0, 1.0))[0]
        out[name] = {
            "p_rank_ks": float(kstest(spread, "uniform").pvalue),
            "p_rank_chi2": float(chi2.sf(((counts - expected) ** 2 / expected).sum(), BINS - 1)),
            "p_normal_ks": float(kstest(ndtr(z[:, k]), "uniform").pvalue),
            "z_mean": float(z[:, k].mean()), "z_deviation": float(z[:, k].std()),
            "inside_95": float((np.abs(z[:, k]) <= Z95).mean()),
        }  # fmt: skip
    return {"branches": len(units), "converged": float(np.mean([u["converged"] for u in units])), "parameters": out}


def _interval_numbers(units: list[Unit]) -> dict[str, Any]:
    """Share of the 95 % intervals of every joint's K that hold the truth, by number of segments."""
    inside = {r: np.abs([u["z"][:r] for u in units if u["segments"] == r]) <= Z95 for r in (1, 2, 3)}
    each = {str(r): x.mean(0).tolist() for r, x in inside.items()}
    return {"by_joint": each, "all": float(np.concatenate([x.ravel() for x in inside.values()]).mean())}


def _other_numbers(units: list[Unit]) -> dict[str, Any]:
    coverage = np.array([u["coverage"] for u in units])
    middle = np.concatenate([np.abs(u["error"]) for u in units if u["noise"] == 0.03])
    return {
        "cases": len(units), "mean_coverage": float(coverage.mean()), "lowest": float(coverage.min()),
        "highest": float(coverage.max()), "median_error_of_K_at_3_percent": float(np.median(middle)),
        "by_noise": _mean_coverage(units, "noise"), "by_segments": _mean_coverage(units, "segments"),
    }  # fmt: skip


def _mean_coverage(units: list[Unit], key: str) -> dict[str, float]:
    values = sorted({u[key] for u in units})
    return {f"{v:g}": float(np.mean([u["coverage"] for u in units if u[key] == v])) for v in values}


def _level_numbers(units: list[dict[str, Unit]]) -> dict[str, Any]:
    """Mean coverage and the median width relative to the first level, by level."""
    first = next(iter(units[0]))
    return {
        level: {
            "coverage": float(np.mean([u[level]["coverage"] for u in units])),
            "lowest": float(min(u[level]["coverage"] for u in units)),
            "highest": float(max(u[level]["coverage"] for u in units)),
            "relative_width": float(np.median([u[level]["width"] / u[first]["width"] for u in units])),
        }
        for level in units[0]
    }


def figures(s: dict[str, Any]) -> list[Figure]:
    """Return the numbers of all studies as figures."""
    parameters = s["ranks"]["parameters"]
    out = [Figure(f"parameter {name}", key, value) for name, p in parameters.items() for key, value in p.items()]
    out += [Figure(case, "least p", min(p[key] for p in parameters.values()))
            for case, key in (("ranks", "p_rank_ks"), ("normal scores", "p_normal_ks"))]  # fmt: skip
    by_joint, inside = s["stiffness"]["by_joint"], "stiffness inside its 95 % interval"
    joints = {f"{r} segments, joint {k + 1}": x for r, shares in by_joint.items() for k, x in enumerate(shares)}
    out += [Figure(inside, what, x) for what, x in joints.items()]
    out += [Figure(inside, "lowest joint", min(joints.values())), Figure(inside, "highest joint", max(joints.values()))]
    out += [*_other_figures(s["others"]), *_level_figures("grasp moved", s["grasp"])]
    widths = [v["relative_width"] for v in s["force"].values()]
    widening = min(b / a for a, b in itertools.pairwise(widths))
    return [*out, *_level_figures("noise of the force", s["force"]),
            Figure("noise of the force", "least widening", widening)]  # fmt: skip


def _other_figures(s: dict[str, Any]) -> list[Figure]:
    case = "other simulator"
    split = {f"{name} {key}": x for key in ("noise", "segments") for name, x in s[f"by_{key}"].items()}
    return [
        Figure(case, "covered", s["mean_coverage"], range=(s["lowest"], s["highest"])),
        *(Figure(case, f"covered, {name}", x) for name, x in split.items()),
        Figure(case, "median error of K at 3 % noise", s["median_error_of_K_at_3_percent"]),
    ]


def _level_figures(case: str, levels: dict[str, Any]) -> list[Figure]:
    """Coverage and relative width at every level, and the ends of the mean coverages."""
    mean = [v["coverage"] for v in levels.values()]
    return [
        *(Figure(case, f"covered at {k}", v["coverage"], range=(v["lowest"], v["highest"])) for k, v in levels.items()),
        *(Figure(case, f"relative width at {k}", v["relative_width"]) for k, v in levels.items()),
        Figure(case, "lowest coverage", min(mean)), Figure(case, "highest coverage", max(mean)),
    ]  # fmt: skip


def rank_figure(units: list[Unit]) -> Drawing:
    """Draw histograms of ranks and the difference of their distribution from the uniform one, with 99 % bands."""
    rank, z = (np.array([u[k] for u in units]) for k in ("rank", "z"))
    figure = Drawing(figsize=(11.0, 8.0), layout="constrained")
    axes = figure.subplots(4, 3, sharey="row")
    for k in range(6):
        row, column = 2 * (k // 3), k % 3
        spread = (rank[:, k] + 0.5) / (units[0]["particles"] + 1)
        _histogram(axes[row, column], spread, f"{'KD'[k // 3]} of joint {k % 3 + 1}")
        _difference(axes[row + 1, column], [(spread, "ranks", MODEL), (ndtr(z[:, k]), "normal scores", NOISE)])
    for row in range(4):
        axes[row, 0].set_ylabel("branches" if row % 2 == 0 else "distribution − uniform")
    axes[1, 2].legend(loc="lower right")
    for axis in axes[3]:
        axis.set_xlabel("rank of the truth among the particles")
    return figure


def _histogram(axis: Axes, spread: np.ndarray, title: str) -> None:
    expected = len(spread) / BINS
    band = 2.576 * np.sqrt(expected * (1.0 - 1.0 / BINS))
    axis.axhspan(expected - band, expected + band, color=FAINT, alpha=0.4, lw=0)
    axis.hist(spread, BINS, (0.0, 1.0), color=MODEL, rwidth=0.9)
    axis.set_title(title)


def _difference(axis: Axes, lines: list[tuple[np.ndarray, str, str]]) -> None:
    count = len(lines[0][0])
    bound = 1.628 / np.sqrt(count)  # Kolmogorov's 99 % point
    axis.axhspan(-bound, bound, color=FAINT, alpha=0.4, lw=0)
    for values, name, color in lines:
        x = np.sort(values)
        axis.step(np.r_[0.0, x, 1.0], np.r_[0.0, np.arange(1, count + 1) / count - x, 0.0], color=color, label=name)


def coverage_figure(done: list[Unit]) -> Drawing:
    """Draw the coverage of held-out displacement in every case of the other three studies."""
    figure = Drawing(figsize=(11.0, 3.6), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    by = {study: [u for u in done if u["study"] == study] for study in STUDIES}
    columns = [
        ("other simulator", "noise of the motion", 0.92, 0.98, [(f"{100 * u['noise']:g} %", u) for u in by["others"]]),
        ("learnt at 0.9", "grasp point, share of length", 0.90, 0.99,
         [(p, v) for u in by["grasp"] for p, v in u["by_place"].items()]),
        ("noise of the force", "share of the force's rms", 0.90, 0.99,
         [(f"{100 * float(n):g} %", v) for u in by["force"] for n, v in u["by_level"].items()]),
    ]  # fmt: skip
    for axis, (title, label, low, high, points) in zip(axes, columns, strict=True):
        _strip(axis, [(name, v["coverage"]) for name, v in points], low, high)
        axis.set_title(title)
        axis.set_xlabel(label)
    axes[0].set_ylabel("held-out displacement inside 95 %")
    return figure


def _strip(axis: Axes, points: list[tuple[str, float]], low: float, high: float) -> None:
    names = sorted({name for name, _ in points}, key=lambda n: float(n.split()[0]))
    axis.axhspan(low, high, color=FAINT, alpha=0.4, lw=0)
    axis.axhline(0.95, color=FAINT)
    for k, name in enumerate(names):
        y = np.array([value for n, value in points if n == name])
        axis.plot(k + np.linspace(-0.15, 0.15, len(y)), y, "o", ms=4, color=MODEL, alpha=0.7)
        axis.plot([k - 0.25, k + 0.25], [y.mean()] * 2, color=ALARM, lw=2)
    axis.set_xticks(range(len(names)), names)


def measured(options: argparse.Namespace) -> list[Figure]:
    """Run what is missing, then write numbers and figures."""
    options.out.mkdir(parents=True, exist_ok=True)
    lines = options.out / "units.jsonl"
    units, done = plan(options.branches, options.seed), read_lines(lines)
    todo = missing(units, done)
    with lines.open("a") as file:
        for unit in track(results(todo, options.jobs), "identifying", total=len(todo)):
            file.write(json.dumps(unit) + "\n")
            file.flush()
    wanted = {_key(u) for u in units}
    return _conclude(options.out, [u for u in read_lines(lines) if _key(u) in wanted])


def _conclude(out: Path, done: list[Unit]) -> list[Figure]:
    found = summary(done)
    (out / "calibration.json").write_text(json.dumps(found, indent=1))
    style: dict[Any, Any] = {"axes.spines.top": False, "axes.spines.right": False, "font.size": 9}
    with matplotlib.rc_context(style):
        three = [u for u in done if u["study"] == "ranks" and u["segments"] == 3]
        (out / "calibration_ranks.png").write_bytes(png(rank_figure(three)))
        (out / "calibration_coverage.png").write_bytes(png(coverage_figure(done)))
    Console().print_json(json.dumps(found))
    return figures(found)


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    found = measuring.parser_of(__doc__)
    found.add_argument("--out", type=Path, required=True)
    found.add_argument("--branches", type=int, default=200)
    found.add_argument("--seed", type=int, default=0)
    found.add_argument("--jobs", type=int, default=2)
    return found


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "calibration"))
