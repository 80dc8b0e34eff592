"""Measure what perception costs per world and step, beside torch and a PointNet++ encoder, interleaved in one run.

    python benchmarks/perception.py [--worlds N] [--rounds N] [--device cpu|cuda:0] [--figure FILE.png] [--record FILE]

512 points per cloud, R = 8, k = 200, noise on, random worlds: some occluded fully, some in part, some not at all; the
arm near the line in some. Torch does the same on the same points with its vectorised operations: matmul, sin and cos,
mean; cdist and topk. On a CPU both have one thread and are timed by the processor time they take; on a GPU by wall
clock after a synchronisation. Rows are measured in turn, several times over; medians are printed.

The PointNet++ encoder is PyTorch Geometric's (`PointNetConv`, the sizes of its classification example), if that is
installed, else the same set abstraction in plain torch (`learn.thesis.chapter5.pointnet`). Farthest point sampling is
left out of both (every second and every fourth point is a centre instead) and neighbours are the 32 nearest, found by
torch: a lower bound of its cost. torch-cluster, which would do both, has no wheel for this torch.

With ``--figure`` the error of inner products against the RBF kernel over R is drawn as well.

Exits with 1 if a bound of `declared` is missed: how much faster than torch, and how far results may differ from its.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import measuring
import numpy as np
import torch
import warp as wp
from bough.learn.thesis.chapter5.pointnet import PointNet, layers, neighbours
from bough.perception import embed
from bough.perception.sensor import COLUMNS, STAGES, Sensor
from bough.sim.base.console import start_warp
from bough.sim.base.thread_pool import Job, Launches, run
from measuring import Figure, in_turn
from oracles.point_scene import point_scene

REPEATS = 8  # of a launch, timed together
LEARNT_CLOUDS = {"cpu": 16, "cuda": 256}  # worlds that the slow PointNet++ encoder is timed on


def make_sensor(worlds: int, device: str) -> tuple[Sensor, torch.Tensor]:
    """Return a sensor of random worlds and the observation that it writes into."""
    with wp.ScopedDevice(device):
        scene = point_scene(worlds, branches=40, seed=1)
        away = np.linspace(0.0, 0.9, worlds)[:, None] * np.array([-1.0, 0.0, 0.3])
        ends = {n: wp.array(getattr(scene.line, n).numpy() + away.astype(np.float32), dtype=wp.vec3)
                for n in ("start", "end")}  # fmt: skip
        sensor = Sensor(scene.capsules, SimpleNamespace(**ends), scene.ee, device=device, threads=1)
    sensor.max_noise.fill_(0.02)
    observation = torch.full((worlds, 88), float("nan"), device=wp.device_to_torch(sensor.device))
    sensor.bind(observation)
    sensor.update()
    return sensor, observation


# ---- torch on the same points ------------------------------------------------------------------------------------


def torch_rows(sensor: Sensor) -> dict[str, Callable[[], torch.Tensor]]:
    """Return what torch does instead of each kernel, on contiguous copies [worlds, N, 3] of the clouds."""
    points, near = sensor.clouds()
    robot, target, branches = (points[:, k].mT.contiguous() for k in range(3))
    near, s = near.contiguous(), sensor.settings
    hand = wp.to_torch(sensor._ee)[:, None].contiguous()
    waves = sensor.frequencies.T.contiguous()

    def features(points: torch.Tensor) -> torch.Tensor:
        phase = points @ waves
        return torch.stack([phase.cos(), phase.sin()], dim=-1).flatten(-2) / s.features**0.5

    def embedding() -> torch.Tensor:
        whole = features(branches)
        zoomed = (whole * near[..., None]).sum(1) / near.sum(1).clamp(min=1.0)[:, None]
        return torch.cat([whole.mean(1), zoomed, features(target).mean(1), features(robot).mean(1)], dim=-1)

    def occlusion() -> torch.Tensor:
        distances = torch.cdist(branches, target, compute_mode="donot_use_mm_for_euclid_dist").flatten(1)
        return (distances.topk(s.pairs, largest=False, sorted=False).values < s.threshold).float().mean(1)

    def nearest() -> torch.Tensor:
        return torch.cdist(hand, branches, compute_mode="donot_use_mm_for_euclid_dist")[:, 0].topk(5, largest=False)[0]

    def margin() -> torch.Tensor:
        distances = torch.cdist(robot, target, compute_mode="donot_use_mm_for_euclid_dist").flatten(1)
        return (distances.topk(5, largest=False).values.mean(1) < s.margin).float()

    return {"embedding": embedding, "occlusion": occlusion, "nearest": nearest, "margin": margin}


def differences(
    sensor: Sensor, observation: torch.Tensor, rows: dict[str, Callable[[], torch.Tensor]]
) -> dict[str, float]:
    """Return the greatest difference of each result from torch's."""
    first = COLUMNS["wbr"]
    ours = {"embedding": observation[:, first : first + 64], "occlusion": observation[:, COLUMNS["occlusion"]],
            "nearest": sensor.distances, "margin": observation[:, COLUMNS["breach"]]}  # fmt: skip
    return {name: float((ours[name] - row()).abs().max()) for name, row in rows.items()}


# ---- PointNet++ --------------------------------------------------------------------------------------------------


def pointnet_of_library(device: torch.device) -> Callable[[torch.Tensor], torch.Tensor]:
    """Return the encoder of PyTorch Geometric's `PointNetConv`; raises ImportError where that is not installed."""
    from torch_geometric.nn import PointNetConv

    sizes = ((3, 64, 64, 128), (131, 128, 128, 256))
    levels = [PointNetConv(layers(*size), add_self_loops=False).to(device) for size in sizes]
    last = layers(259, 256, 512, 1024).to(device)

    @torch.no_grad()
    def encode(points: torch.Tensor) -> torch.Tensor:
        features = None
        for level, step in zip(levels, (2, 4), strict=True):
            batch, count = points.shape[:2]
            centres, index = neighbours(points, step)
            source = (index + count * torch.arange(batch, device=device)[:, None, None]).flatten()
            goal = torch.arange(batch * centres.shape[1], device=device).repeat_interleave(index.shape[2])
            into = None if features is None else (features, None)
            features = level(into, (points.flatten(0, 1), centres.flatten(0, 1)), torch.stack([source, goal]))
            points = centres
        return last(torch.cat([features.unflatten(0, points.shape[:2]), points], dim=-1)).amax(1)

    return encode


def pointnet(device: torch.device) -> tuple[str, Callable[[torch.Tensor], torch.Tensor]]:
    """Return the encoder that can be had, on the device, and whose it is."""
    try:
        return "PyTorch Geometric", pointnet_of_library(device)
    except ImportError:
        return "plain torch", torch.no_grad()(PointNet().to(device))


# ---- measuring ---------------------------------------------------------------------------------------------------


def repeated(launch: Any) -> Callable[[], object]:
    """Return what runs a launch `REPEATS` times: on a CPU in one call, so that no interpreter is timed."""
    launches = [launch] * REPEATS
    if launch.device.is_cuda:
        return Launches(launches)
    job = Job(launches)
    return lambda: run([job])


def stages(plan: list[list[Callable[[], object]]], clock: Callable[[], float]) -> dict[str, float]:
    """Return the seconds of each stage in one update: block by block, as an update goes, each stage timed by itself."""
    taken = dict.fromkeys(STAGES, 0.0)
    for block in plan:
        for name, launches in zip(STAGES, block, strict=True):
            start = clock()
            launches()
            taken[name] += (clock() - start) / REPEATS
    return taken


def timed(row: Callable[[], object], clock: Callable[[], float], repeats: int) -> float:
    """Return the seconds of one call, of ``repeats`` in a row."""
    start = clock()
    for _ in range(repeats):
        row()
    return (clock() - start) / repeats


def measure(
    plan: list[list[Callable[[], object]]],
    rows: dict[str, Callable[[], object]],
    rounds: int,
    clock: Callable[[], float],
) -> dict[str, list[float]]:
    """Return the seconds of each stage and each row in every round, taken in turn after a round that warms up."""
    work: list[Callable[[], Any]] = [lambda: stages(plan, clock)]
    work += [lambda row=row, n=1 if "PointNet" in name else 5: timed(row, clock, n) for name, row in rows.items()]
    in_turn(work, 1)
    ours, *theirs = in_turn(work, rounds)
    return {s: [taken[s] for taken in ours] for s in STAGES} | dict(zip(rows, theirs, strict=True))


def gpu_clock() -> float:
    """Return the time when the GPU has done what it was given."""
    wp.synchronize()
    return time.perf_counter()


def figure_of(case: str, us: list[float], theirs: list[float] | None) -> Figure:
    """Make the figure of a stage: microseconds per world and step, beside the peer's; less is better."""
    found = measuring.beside(case, "time", us, "us")
    if theirs is None:
        return found
    over, peer = measuring.ratios(theirs, us), statistics.median(theirs)
    return replace(found, peer=peer, ratio=peer / found.value, ratio_range=(min(over), max(over)))


def report(us: dict[str, list[float]], source: str) -> list[Figure]:
    """Print microseconds per world; return them as figures."""
    found = [figure_of(stage, us[stage], us.get(f"torch {stage}")) for stage in STAGES]
    print("| per world and step [us] | bough | torch | ratio |\n|---|---|---|---|")
    for f in found:
        print(f"| {f.case} | {f.value:.2f} | " + (f"{f.peer:.1f} | {f.ratio:.0f} |" if f.peer and f.ratio else "| |"))
    whole = Figure("all", "time", sum(f.value for f in found), "us")
    learnt = figure_of("embedding, PointNet++", us["embedding"], [4 * t for t in us["PointNet++"]])
    print(f"| all | {whole.value:.1f} | | |")
    print(f"| PointNet++ of {source}, four clouds | | {learnt.peer:.0f} | {learnt.ratio:.0f} |")
    return [*found, whole, learnt]


def draw_figure(path: Path) -> None:
    """Draw the rms error of inner products of embeddings against the mean of the RBF kernel over pairs of points."""
    from matplotlib.figure import Figure

    generator = torch.Generator().manual_seed(0)
    x, y = (torch.randn(200, 64, 3, generator=generator) * 0.5 + 0.7 * torch.randn(200, 1, 3, generator=generator)
            for _ in range(2))  # fmt: skip
    exact = torch.exp(-(torch.cdist(x.double(), y.double()) ** 2) / 2).mean((1, 2))
    counts = [2**k for k in range(1, 12)]
    errors = [torch.stack([(embed(x, features=r, seed=s) * embed(y, features=r, seed=s)).sum(1) - exact
                           for s in range(30)]).square().mean().sqrt() for r in counts]  # fmt: skip
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
    ax = figure.add_subplot()
    ax.loglog(counts, errors, "o-", color="#0072B2", label="rms error over 200 pairs of clouds, 30 draws")
    line = np.array(counts, float)
    ax.loglog(line, 1 / np.sqrt(2 * line), "--", color="#888888", label=r"bound for single points, $1/\sqrt{2R}$")
    ax.loglog(line, float(errors[4]) * np.sqrt(counts[4] / line), ":", color="#D55E00", label=r"slope $1/\sqrt{R}$")
    ax.set(xlabel="frequencies R", ylabel="error of the inner product")
    ax.legend(frameon=False)
    figure.savefig(path, dpi=130)
    slope = np.polyfit(np.log(counts), np.log([float(e) for e in errors]), 1)[0]
    print(f"error falls as R^{slope:.3f}; wrote {path}")


def compared(sensor: Sensor, observation: torch.Tensor, rows: dict[str, Callable[[], torch.Tensor]]) -> list[Figure]:
    """Say how far the results are from torch's, and what the worlds are like."""
    found = differences(sensor, observation, rows)
    worlds, occlusion = len(observation), float(sensor.occlusion.mean())
    print(f"{worlds} worlds, mean occlusion {occlusion:.2f}, in breach {sensor.breach.mean():.2f}")
    print("greatest differences from torch:", ", ".join(f"{k} {v:.1e}" for k, v in found.items()))
    return [
        *(Figure(stage, "difference from torch", apart) for stage, apart in found.items()),
        Figure("worlds", "number", worlds), Figure("worlds", "mean occlusion", occlusion),
    ]  # fmt: skip


def measured(options: argparse.Namespace) -> list[Figure]:
    """Compare results with torch's, then times."""
    torch.set_num_threads(1)
    sensor, observation = make_sensor(options.worlds, options.device)
    rows = torch_rows(sensor)
    found = compared(sensor, observation, rows)
    clouds = sensor.clouds()[0]
    source, encode = pointnet(clouds.device)
    few = clouds[: LEARNT_CLOUDS[clouds.device.type], 2].mT.contiguous()
    plan = [[repeated(c) for c in block] for block in sensor.plan(split=False)[0]]
    timed_rows: dict[str, Callable[[], object]] = {f"torch {name}": row for name, row in rows.items()}
    timed_rows["PointNet++"] = lambda: encode(few)
    clock = gpu_clock if options.device.startswith("cuda") else time.process_time
    taken = measure(plan, timed_rows, options.rounds, clock)
    worlds = {name: len(few) if name == "PointNet++" else options.worlds for name in taken}
    found += report({name: [1e6 * t / worlds[name] for t in times] for name, times in taken.items()}, source)
    if options.figure:
        draw_figure(options.figure)
    return found


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    start_warp()
    found = measuring.parser_of(__doc__)
    found.add_argument("--worlds", type=int, default=256)
    found.add_argument("--rounds", type=int, default=7)
    found.add_argument("--device", default="cuda:0" if wp.get_cuda_device_count() else "cpu")
    found.add_argument("--figure", type=Path)
    return found


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, lambda o: "perception" if o.device == "cpu" else "perception_gpu"))
