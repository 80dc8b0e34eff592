"""What an identification costs against particles, trajectories and segments: wall time and world-steps, with a figure.

    python benchmarks/identification_cost.py --out DIR [--branches N] [--record FILE]

Every number is the median over N branches of the model's own structure (`learn/replay/simulated_case.py`),
identified with default settings but for what is varied. Prints the power of size that time grows with.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import measuring
import numpy as np
from bough.learn.inference.identify import Identification, Settings
from bough.learn.replay.simulated_case import Experiment, random_branch, write_simulated_case
from bough.learn.runs.threads import one_thread
from bough.sim.base.host import describe
from matplotlib.axes import Axes
from measuring import Figure

SIZES = {"particles": (32, 64, 128), "trajectories": (3, 6, 12), "segments": (1, 2, 3, 4)}
DEFAULT = {"particles": 64, "trajectories": 6, "segments": 3}


def identify_once(seed: int, particles: int, trajectories: int, segments: int) -> tuple[float, int]:
    """Return seconds and world-steps of learning one simulated branch."""
    rng = np.random.default_rng([seed, segments])
    meta = random_branch(rng, segments)
    radius = np.array([s["radius_base_m"] + s["radius_tip_m"] for s in meta["segments"]]) / 2
    length = np.array([s["length_m"] for s in meta["segments"]])
    stiffness = 5e8 * np.pi * radius**4 / (2 * length)
    with tempfile.TemporaryDirectory() as folder:
        case = write_simulated_case(
            Path(folder) / "case", meta, {"stiffness": stiffness, "damping": 0.02 * stiffness}, Experiment(samples=120),
            trajectories=trajectories, seed=seed,
        )  # fmt: skip
        work = Identification(case, Settings(particles=particles))
        began = time.perf_counter()
        with one_thread():
            work.learn(list(range(trajectories)), "posterior")
    return time.perf_counter() - began, work.world_steps


def grown(name: str, branches: int, ax: Axes) -> dict[str, Any]:
    """Measure one of `SIZES` and draw it: medians of time and world-steps, and the power that time grows with."""
    sizes = SIZES[name]
    runs = [[identify_once(s, **(DEFAULT | {name: n})) for s in range(branches)] for n in sizes]
    seconds, steps = np.median(np.array(runs, dtype=float), axis=1).T
    power = float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])
    print(f"{name:13s} {sizes}  seconds {np.round(seconds, 2)}  time grows with power {power:.2f}", flush=True)
    ax.plot(sizes, seconds, "o", color="#0072B2")
    line = np.array([0.0, max(sizes)])
    ax.plot(line, np.polyval(np.polyfit(sizes, seconds, 1), line), color="#BBBBBB")
    ax.set(xlabel=name, ylabel="time of an identification [s]", xlim=(0, None), ylim=(0, None))
    return {"size": sizes, "seconds": seconds.tolist(), "world_steps": steps.tolist(), "power": power}


def figures(found: dict[str, dict[str, Any]]) -> list[Figure]:
    """Return the time at every size, and the powers."""
    times = [
        Figure(f"{size} {name}", "time", seconds, "s")
        for name, f in found.items()
        for size, seconds in zip(f["size"], f["seconds"], strict=True)
    ]
    return [*times, *(Figure(name, "power", f["power"]) for name, f in found.items())]


def measured(options: argparse.Namespace) -> list[Figure]:
    """Measure all sizes; write numbers and figure."""
    identify_once(0, 32, 2, 1)  # compile
    options.out.mkdir(parents=True, exist_ok=True)
    figure, axes = plt.subplots(1, 3, figsize=(9, 3), layout="constrained")
    found = {name: grown(name, options.branches, ax) for ax, name in zip(axes, SIZES, strict=True)}
    figure.savefig(options.out / "identification_cost.png", dpi=150)
    (options.out / "identification_cost.json").write_text(json.dumps({"machine": describe(), **found}, indent=1) + "\n")
    return figures(found)


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    found = measuring.parser_of(__doc__)
    found.add_argument("--out", type=Path, required=True)
    found.add_argument("--branches", type=int, default=3)
    return found


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "identification_cost"))
