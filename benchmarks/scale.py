"""How the power-line task scales with the number of worlds: construction, memory, world-steps per second.

    python benchmarks/scale.py --out DIR [--worlds 64 256 1024 4096 6144] [--preset gpu] [--device cpu] [--record FILE]

Every size runs in a process of its own, so that its memory is its own. Writes scale.json, scale.md and scale.png. Exits
with 1 where a bound of `declared` is missed: seconds and memory of building, speeds near their median over all sizes,
perception's part of a policy step, no world lost.

A policy step is what training collects: the policy of the preset acts on what was observed (rsl-rl's `act`), and the
task steps. The share of perception in the task's step alone is printed beside it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import measuring
from measuring import Figure, InvalidRunError

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")

FLAT = 0.25  # the band that is drawn


def measure(worlds: int, preset: str, device: str, seconds: float) -> dict[str, Any]:
    """Build the task, then step it under random actions for a while; kernels are compiled before the clock starts."""
    import torch
    from bough.learn.policies.ppo_runner import Runner
    from bough.learn.runs.processes import Processes
    from bough.learn.tasks.clearing import make_task
    from bough.learn.tasks.ppo_settings import PRESETS as PPO
    from bough.learn.tasks.settings import PRESETS

    make_task("powerline", PRESETS[preset], num_envs=16, seed=1, device=device).step(torch.zeros(16, 6, device=device))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    begun = time.perf_counter()
    task = make_task("powerline", PRESETS[preset], num_envs=worlds, seed=0, device=device)
    build = time.perf_counter() - begun
    policy = Runner(task, replace(PPO[preset], num_envs=worlds), Processes(), lambda _iteration: None).alg
    generator = torch.Generator(device=device).manual_seed(0)
    seconds_of: dict[str, list[float]] = {"step": [], "sensing": [], "acting": []}
    task.step(task.actions)
    while len(seconds_of["step"]) < 3 or sum(seconds_of["step"]) < seconds:
        task.actions.uniform_(-1.0, 1.0, generator=generator)
        seconds_of["step"].append(timed(lambda: task.step(task.actions), device))
        seconds_of["sensing"].append(timed(task.sensor.update, device))
    observed = task.get_observations()
    with torch.inference_mode():
        for _ in range(20):
            seconds_of["acting"].append(timed(lambda: policy.act(observed), device))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    step, look, act = (statistics.median(taken) for taken in seconds_of.values())
    links = sum(t.num_links for t in task.simulator.model.trees) / worlds
    return {
        "worlds": worlds, "links": links, "build_s": build, "process_gib": peak, "own_gib": peak - before,
        "simulator_mib": task.simulator.nbytes / 2**20, "policy_steps_per_s": worlds / step,
        "world_steps_per_s": worlds * task.cfg.physics_steps / step, "sensing": look / (act + step),
        "sensing_of_step": look / step,
        "lost": int(task.lost.sum()),
    }  # fmt: skip


def timed(work: Callable[[], object], device: str) -> float:
    """Return the seconds that something takes, waiting for a GPU."""
    import torch

    begun = time.perf_counter()
    work()
    if "cuda" in device:
        torch.cuda.synchronize()
    return time.perf_counter() - begun


def table(rows: list[dict[str, Any]]) -> str:
    """Return the rows in Markdown."""
    head = (
        "| worlds | links | built in [s] | memory of the process [GiB] | policy steps/s | world-steps/s | perception "
        "| of the task's step |"
    )
    lines = [head, "|---|---|---|---|---|---|---|---|"]
    for r in rows:
        lines.append(f"| {r['worlds']} | {r['links']:.0f} | {r['build_s']:.1f} | {r['process_gib']:.2f} | "
                     f"{r['policy_steps_per_s']:,.0f} | {r['world_steps_per_s']:,.0f} | "
                     f"{r['sensing']:.0%} | {r['sensing_of_step']:.0%} |")  # fmt: skip
    return "\n".join(lines)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw world-steps per second over the number of worlds, and the band of 25 %."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    worlds, speed = [r["worlds"] for r in rows], [r["world_steps_per_s"] / 1e3 for r in rows]
    middle = sorted(speed)[len(speed) // 2]
    figure, axes = plt.subplots(figsize=(5.6, 3.4), layout="constrained")
    axes.axhspan((1 - FLAT) * middle, (1 + FLAT) * middle, color="0.92", label="within 25 % of the median")
    axes.semilogx(worlds, speed, "o-", base=2, color="#1b6e3c")
    axes.set(xlabel="worlds", ylabel="thousand world-steps per second", ylim=(0, 1.4 * max(speed)))
    axes.set_xticks(worlds, [str(w) for w in worlds])
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def one_size(worlds: int, options: argparse.Namespace) -> dict[str, Any]:
    """Measure one size in a process of its own; raises `InvalidRunError` where that fails."""
    command = [sys.executable, __file__, "--one", "--out", str(options.out), "--worlds", str(worlds)]
    command += ["--preset", options.preset, "--device", options.device, "--seconds", str(options.seconds)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = [line for line in done.stdout.splitlines() if line.startswith("RESULT ")]
    if not found:
        raise InvalidRunError(done.stderr)
    return json.loads(found[0][7:])


#: Figures of a size: quantity, unit, and its name among what `measure` returns.
QUANTITIES = (
    ("links", "", "links"), ("built", "s", "build_s"), ("memory of the process", "GiB", "process_gib"),
    ("policy steps", "1/s", "policy_steps_per_s"), ("world-steps", "1/s", "world_steps_per_s"),
    ("perception", "", "sensing"), ("perception of the task's step", "", "sensing_of_step"), ("lost", "", "lost"),
)  # fmt: skip


def figures(rows: list[dict[str, Any]]) -> list[Figure]:
    """Return the figures of every size, and those of all sizes that are bounded."""
    speeds = sorted(r["world_steps_per_s"] for r in rows)
    middle, every = speeds[len(speeds) // 2], "all sizes"
    return [
        *(Figure(f"{r['worlds']} worlds", name, r[key], unit) for r in rows for name, unit, key in QUANTITIES),
        Figure(every, "longest build", max(r["build_s"] for r in rows), "s"),
        Figure(every, "most memory", max(r["process_gib"] for r in rows), "GiB"),
        Figure(every, "furthest from their median speed", max(abs(s / middle - 1.0) for s in speeds)),
        Figure(every, "perception at the last", rows[-1]["sensing"]),
        Figure(every, "lost", sum(r["lost"] for r in rows)),
    ]


def measured(options: argparse.Namespace) -> list[Figure]:
    """Run every size; write the table and the figure."""
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for worlds in options.worlds:
        rows.append(one_size(worlds, options))
        print(table(rows[-1:]).splitlines()[-1], flush=True)
    (options.out / "scale.json").write_text(json.dumps(rows, indent=2) + "\n")
    (options.out / "scale.md").write_text(table(rows) + "\n")
    draw(rows, options.out / "scale.png")
    return figures(rows)


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    found = measuring.parser_of(__doc__)
    found.add_argument("--out", type=Path, required=True)
    found.add_argument("--worlds", type=int, nargs="+", default=[64, 256, 1024, 4096, 6144])
    found.add_argument("--preset", default="gpu")
    found.add_argument("--device", default="cpu")
    found.add_argument("--seconds", type=float, default=6.0, help="stepping time of a size")
    found.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    return found


if __name__ == "__main__":
    if "--one" in sys.argv:
        one = parser().parse_args()
        print("RESULT", json.dumps(measure(one.worlds[0], one.preset, one.device, one.seconds)))
    else:
        sys.exit(measuring.main(parser(), measured, "scale"))
