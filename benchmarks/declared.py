"""Every benchmark: what it measures, beside which peer, what it must keep to, how it is run.

This is the one place that `run.py`, the benchmarks themselves, the pages' tables and the tests read.
"""

from __future__ import annotations

from dataclasses import dataclass

#: Effects that the benchmark of probing hides, and among which both designs look.
PROBED = ("dry_friction", "quadratic_drag", "viscoelastic_sls", "hysteresis_boucwen", "bilinear_stiffness",
          "anisotropic_stiffness")  # fmt: skip


@dataclass(frozen=True)
class Bound:
    """What a figure must keep to.

    Attributes:
        case: The figure's case.
        what: The figure's quantity.
        of: Which of its numbers: "value", or the "ratio" to the peer's.
        least: Lower bound, if there is one.
        most: Upper bound, if there is one.
        unit: Unit of the two, for the page.
        lanes: Machines it is for, by the lanes they have; None for all.
        cores: Cores a machine must have for it to apply.
    """

    case: str
    what: str
    of: str = "value"
    least: float | None = None
    most: float | None = None
    unit: str = ""
    lanes: int | None = None
    cores: int = 1

    def text(self) -> str:
        """Say it in words."""
        limits = [f"at least {self.least:g}"] if self.least is not None else []
        limits += [f"at most {self.most:g}"] if self.most is not None else []
        unit = f" {self.unit}" if self.unit else " times the peer's" if self.of == "ratio" else ""
        where = ", of two cores" if self.cores > 1 else ""
        return f"{self.case}, {self.what}: {' and '.join(limits)}{unit}{where}"


@dataclass(frozen=True)
class Benchmark:
    """A benchmark as it is declared.

    Attributes:
        name: What it is called.
        measures: What it measures, in a sentence.
        peer: What it is measured beside, in the same run; None where there is none.
        script: The file, from this folder on, whose ``measured`` gives the figures.
        arguments: Options of the script; ``{out}`` is a folder for what it writes.
        quick: Options that make it quick instead, to try it.
        bounds: What its figures must keep to.
        unbound: Why it has no bound, where it has none.
        minutes: About how long it takes on two idle cores.
        device: "cpu" or "gpu".
    """

    name: str
    measures: str
    peer: str | None
    script: str
    minutes: float
    arguments: tuple[str, ...] = ()
    quick: tuple[str, ...] = ("--quick",)
    bounds: tuple[Bound, ...] = ()
    unbound: str | None = None
    device: str = "cpu"


def _wide(case: str, what: str, least: dict[int, float]) -> tuple[Bound, ...]:
    """Bound the ratio of a machine's widest row; ``{lanes}`` in case or quantity is its number of lanes."""
    return tuple(Bound(case.format(lanes=n), what.format(lanes=n), "ratio", least=x, lanes=n) for n, x in least.items())


def _tree_bounds() -> tuple[Bound, ...]:
    sizes = [f"{n} links" for n in (13, 40, 121)]
    return (
        *(Bound(size, "one world per thread", "ratio", least=3.0) for size in sizes),
        *(b for size in sizes for b in _wide(size, "{lanes} lanes", {16: 30.0, 8: 18.0})),
        *_wide("culled trees", "{lanes} lanes", {16: 8.0, 8: 8.0}),
        Bound("two threads", "gain", least=1.7, cores=2),
        Bound("6144 worlds of 40 links", "memory", most=256.0, unit="MiB"),
    )


def _perception_bounds(embedding: float, others: float) -> tuple[Bound, ...]:
    # float32 distances round differently: a pair of the 200 at the threshold may count here and not there
    apart = {"embedding": 2e-6, "occlusion": 1.5 / 200, "nearest": 1e-6, "margin": 0.0}
    return (
        Bound("embedding", "time", "ratio", least=embedding),
        *(Bound(stage, "time", "ratio", least=others) for stage in ("occlusion", "nearest", "margin")),
        *(Bound(stage, "difference from torch", most=most) for stage, most in apart.items()),
    )


def _accuracy_bounds(rest_mm: float) -> tuple[Bound, ...]:
    return (
        Bound("all trees", "median ratio of errors", most=1.05),
        Bound("all trees", "ratio of errors that 95 % keep to", most=1.5),
        Bound("all trees", "frozen worlds", most=0.0),
        Bound("where MuJoCo blows up", "furthest from an equilibrium", most=rest_mm, unit="mm"),
    )


_CALIBRATION = (
    Bound("ranks", "least p", least=0.01),
    Bound("normal scores", "least p", least=0.01),
    Bound("stiffness inside its 95 % interval", "lowest joint", least=0.90),
    Bound("stiffness inside its 95 % interval", "highest joint", most=0.98),
    Bound("other simulator", "covered", least=0.92, most=0.98),
    Bound("other simulator", "median error of K at 3 % noise", most=0.10),
    Bound("grasp moved", "lowest coverage", least=0.90),
    Bound("grasp moved", "highest coverage", most=0.99),
    Bound("noise of the force", "lowest coverage", least=0.90),
    Bound("noise of the force", "highest coverage", most=0.99),
    Bound("noise of the force", "least widening", least=1.0),
)

_CONTACT = (
    Bound("one world per thread", "speed", "ratio", least=4.0),
    *_wide("{lanes} lanes", "speed", {16: 12.0, 8: 12.0}),
)

_SCENES = (
    Bound("4096 scenes", "lost", most=0.0),
    Bound("4096 scenes", "not finite", most=0.0),
    Bound("4096 scenes", "with a full buffer", most=0.0),
    Bound("scenes that start without overlap", "deepest", most=30.0, unit="mm"),
)

_SCALE = (
    Bound("all sizes", "longest build", most=120.0, unit="s"),
    Bound("all sizes", "most memory", most=3.0, unit="GiB"),
    Bound("all sizes", "furthest from their median speed", most=0.25),
    Bound("all sizes", "perception at the last", most=0.40),
    Bound("all sizes", "lost", most=0.0),
)

_IDENTIFICATION = (
    Bound("median", "held-out error", "ratio", least=1.0),
    Bound("median", "coverage further from 95 % than sysid's", most=0.0, unit="%"),
    Bound("median", "time", "ratio", least=1.0),
)

_POINTS = "512 points per cloud, microseconds per world and step of each stage of perception"
_TORCH = "torch, and a PointNet++ encoder"

BENCHMARKS = (
    Benchmark(
        "tree", "World-steps per second of ball-jointed trees and forests on one core; what two threads gain; memory.",
        "C MuJoCo", "tree", 3, bounds=_tree_bounds(),
    ),
    Benchmark(
        "contact", "World-steps per second of an arm that sweeps through trees; its penetrations and forces.",
        "C MuJoCo", "contact", 1, bounds=_CONTACT,
    ),
    Benchmark(
        "contact_random", "Random scenes of arm, tree, line and ground, 1000 steps under random actions: what is lost.",
        None, "contact", 1, ("--random",), ("--random",), bounds=_SCENES,
    ),
    Benchmark(
        "effects", "Time of a forest's step with effects over that of the plain step.",
        "the plain step", "effects", 5,
        unbound="a cost that one chooses; what must hold, the same bits while effects are neutral, stops the run",
    ),
    Benchmark(
        "perception", f"{_POINTS}, on one core.", _TORCH, "perception", 1, ("--device", "cpu"),
        ("--device", "cpu", "--worlds", "64", "--rounds", "3"), bounds=_perception_bounds(1.0, 10.0),
    ),
    Benchmark(
        "perception_gpu", f"{_POINTS}, on a GPU.", _TORCH, "perception", 2, ("--device", "cuda:0", "--worlds", "4096"),
        ("--device", "cuda:0", "--worlds", "64", "--rounds", "3"), bounds=_perception_bounds(5.0, 5.0), device="gpu",
    ),
    Benchmark(
        "scale", "The power-line task with 64 to 6144 worlds: building, memory, steps per second, perception's share.",
        None, "scale", 2, ("--out", "{out}"), ("--out", "{out}", "--worlds", "64", "256", "--seconds", "2"),
        bounds=_SCALE,
    ),
    Benchmark(
        "view", "A page of 64 moving trees: CPU time of server and of headless Chromium a frame.",
        None, "view", 2, (), ("--quick",),
        bounds=(Bound("64 trees of 40 links", "CPU of the server a frame", most=33.0, unit="ms"),),
    ),
    Benchmark(
        "robot", "The arm's service: periods of its loop alone and with many clients, time to standstill.",
        None, "robots/robot", 3, (), ("--quick",),
        bounds=(
            Bound("alone", "99th percentile of the period", most=20.0, unit="ms"),
            Bound("busy", "99th percentile of the period", most=20.0, unit="ms", cores=2),
            Bound("client killed", "time to standstill", most=150.0, unit="ms"),
        ),
    ),
    Benchmark(
        "probing", "Recordings that `bough probe` and a fixed set of eight pulls need to name a hidden effect.",
        None, "robots/probing", 25, ("--segments", "2", "--effects", *PROBED),
        ("--quick", "--segments", "1", "--effects", "quadratic_drag", "dry_friction"),
        unbound="it compares three designs of an experiment; fewer recordings are better",
    ),
    Benchmark(
        "cameras", "Clouds of one to three simulated D405s, with and without leaves, beside the kernel's own sampling.",
        "a second draw of the kernel", "robots/cameras", 2,
        bounds=(Bound("3 cameras", "occlusion", most=0.25), Bound("mask BRANCH", "found", least=0.9)),
    ),
    Benchmark(
        "deploy", "A trained policy end to end on the twin, behind the guard, in the scenes of its task's own test.",
        "the same policy in its task, with perfect clouds and forces", "robots/deploy", 15, (), ("--quick",),
        bounds=(Bound("end to end", "points lost", most=10.0, unit="points"),),
    ),
    Benchmark(
        "accuracy", "Error of 60 random trees' motion, float32, against a converged MuJoCo run.",
        "C MuJoCo at the same step", "accuracy", 4, (), ("--trees", "10"), bounds=_accuracy_bounds(0.1),
    ),
    Benchmark(
        "accuracy_float64", "The same in float64.",
        "C MuJoCo at the same step", "accuracy", 5, ("--precision", "64"), ("--precision", "64", "--trees", "10"),
        bounds=_accuracy_bounds(0.01),
    ),
    Benchmark(
        "identification", "Held-out error, coverage and time of identifying ten branches that MuJoCo simulated.",
        "mujoco.sysid", "identification", 2, ("--out", "{out}"), ("--out", "{out}", "--cases", "3"),
        bounds=_IDENTIFICATION,
    ),
    Benchmark(
        "identification_cost", "Time of an identification over segments, trajectories and particles.",
        None, "identification_cost", 3, ("--out", "{out}"), ("--out", "{out}", "--branches", "1"),
        unbound="it tells how cost grows, on whatever machine",
    ),
    Benchmark(
        "calibration", "Whether posteriors are as wide as they should be, on 642 branches whose truth is known.",
        "the uniform distribution", "calibration", 50, ("--out", "{out}"), ("--out", "{out}", "--branches", "4"),
        bounds=_CALIBRATION,
    ),
    Benchmark(
        "gpu", "Checks against the CPU, then world-steps per second of trees and of the arm's task, and its training.",
        "the CPU's results", "gpu", 9, ("--out", "{out}"), ("--out", "{out}", "--quick"),
        bounds=(Bound("all sections", "failed", most=0.0),), device="gpu",
    ),
)  # fmt: skip


def named(name: str) -> Benchmark:
    """Return a benchmark by its name; raises KeyError for one that is not declared."""
    return {b.name: b for b in BENCHMARKS}[name]
