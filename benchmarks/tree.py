"""Measure world-steps per second of bough and of C MuJoCo, interleaved in one run.

    python benchmarks/tree.py [--quick] [--seed N]

Ternary trees of 13, 40 and 121 links on ball joints, dt = 1/240 s, every world with parameters of its own, K = 120, 40,
14, 5, 5 N m/rad by level and D = K / 10; then forests in which every tree has its own topology. Both engines step the
same trees from the same bent start, with one thread each, timed by the processor time they take (the two-thread row by
wall clock). Rows of one table are measured in turn, several times over. A run with a number that is not finite, a
quaternion off unit length, a frozen world, or body positions that differ between the engines is refused.

Exits with 1 if a run is invalid or a ratio misses its bound.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import warp as wp
from bough.sim.base import host
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.trees.tree import Joint, Tree, capsule_inertia

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
from oracles import mujoco_tree
from oracles.random_tree import random_qpos, random_tree

DT = 1.0 / 240.0
STIFFNESS = np.array([120.0, 40.0, 14.0, 5.0, 5.0])
BEND = 0.1  # rad, of every joint at the start
MEGABYTE = 2.0**20


class InvalidRunError(RuntimeError):
    """A measurement that must not be reported."""


@dataclass
class Row:
    """One engine on one set of trees.

    ``run`` steps all its worlds from their start, ``check`` counts the finite ones and raises `InvalidRunError`.
    """

    engine: str
    trees: Sequence[Tree]
    worlds: int
    run: Callable[[int], None]
    check: Callable[[], int]
    simulator: Simulator | None = None
    wall: bool = False
    steps: int = 1
    finite: int = 0


@dataclass(frozen=True)
class Result:
    """World-steps per second of a row in every round, shape [rounds]."""

    row: Row
    speed: list[float]

    @property
    def median(self) -> float:
        """Median over the rounds."""
        return statistics.median(self.speed)


# ---- trees ---------------------------------------------------------------------------------------------------------


def ternary_tree(order: int, rng: np.random.Generator, cull: float = 0.0) -> Tree:
    """Make a ternary tree of capsule links with masses and springs varied by 10 %, numbered depth first.

    Args:
        order: Levels beyond the trunk; 2, 3, 4 make 13, 40, 121 links.
        rng: Source of the variation.
        cull: Chance that a fork lacks a link, with all that it would carry.
    """
    parent, level, turn = [], [], []
    todo = [(-1, 0, 0)]
    while todo:
        above, depth, side = todo.pop()
        parent.append(above)
        level.append(depth)
        turn.append(side)
        if depth < order:
            todo += [(len(parent) - 1, depth + 1, k) for k in range(3) if rng.random() >= cull]
    return _capsules(f"ternary-{order}", np.array(parent), np.array(level), np.array(turn), rng)


def _capsules(name: str, parent: np.ndarray, level: np.ndarray, side: np.ndarray, rng: np.random.Generator) -> Tree:
    n = len(parent)
    vary = rng.uniform(0.9, 1.1, (4, n))
    length, radius = 0.6 * 0.7**level * vary[0], 0.03 * 0.6**level * vary[1]
    mass = 700.0 * np.pi * radius**2 * length * vary[2]
    moments = np.array([(a, a, b) for a, b in map(capsule_inertia, mass, radius, length)])
    about, tilt = 2 * np.pi * side / 3, np.where(level > 0, np.radians(35.0), 0.0)
    w, s = np.cos(tilt / 2), np.sin(tilt / 2)
    stiffness = STIFFNESS[level] * vary[3]
    return Tree(
        name=name, link_name=[f"link{i}" for i in range(n)], parent=parent, joint=np.full(n, Joint.SPHERICAL),
        position=np.where((parent >= 0)[:, None], length[parent][:, None] * [0.0, 0.0, 1.0], 0.0),
        rotation=np.stack([w, s * np.cos(about), s * np.sin(about), np.zeros(n)], axis=1), mass=mass,
        com=np.outer(length / 2, [0.0, 0.0, 1.0]), inertia=moments[:, :, None] * np.eye(3), stiffness=stiffness,
        damping=stiffness / 10.0, level=level,
    )  # fmt: skip


# ---- engines -------------------------------------------------------------------------------------------------------


def bough_row(trees: Sequence[Tree], starts: Sequence[np.ndarray], width: int, threads: int = 1) -> Row:
    """Make the row of bough with ``width`` worlds a thread."""
    simulator = Simulator(Model(trees, width=width), dt=DT, threads=threads)
    simulator.state.set_qpos(starts)
    simulator.refresh()
    simulator.mark_start()

    def run(steps: int) -> None:
        simulator.reset()
        simulator.step(steps)

    name = f"bough, {width} a thread" + (f", {threads} threads" if threads > 1 else "")
    return Row(name, trees, len(trees), run, lambda: check_bough(simulator), simulator)


def check_bough(simulator: Simulator) -> int:
    """Count the finite worlds; raise `InvalidRunError` unless all are finite, alive and on unit quaternions."""
    faults, qpos = simulator.state.faults(), simulator.state.coordinate.numpy()
    if faults:
        raise InvalidRunError(f"{len(faults)} frozen worlds, first: {faults[0]}")
    sound = np.isfinite(qpos).all(axis=(1, 2)) & np.isfinite(simulator.state.velocity.numpy()).all(axis=(1, 2))
    finite = int(sound[simulator.model.world_slot].sum())
    if finite < simulator.model.num_worlds:
        raise InvalidRunError(f"{finite} finite worlds of {simulator.model.num_worlds}")
    ball = simulator.model.links.kind == Joint.SPHERICAL
    length = np.linalg.norm(simulator.model.gather(qpos)[ball], axis=1)
    if np.abs(length - 1.0).max() > 1e-5:
        raise InvalidRunError(f"a quaternion of length {length[np.abs(length - 1).argmax()]}")
    return finite


class MujocoWorlds:
    """Several worlds of C MuJoCo, stepped in turn."""

    def __init__(self, trees: Sequence[Tree], starts: Sequence[np.ndarray]) -> None:
        self.worlds = [mujoco_tree.compiled(t, DT) for t in trees]
        self.starts = starts

    def run(self, steps: int) -> None:
        """Put every world back to its start and take ``steps`` steps, all in one call of C."""
        for (model, data), start in zip(self.worlds, self.starts, strict=True):
            data.qpos[:], data.qvel[:] = start, 0.0
            mujoco_tree.mujoco.mj_step(model, data, steps)

    def check(self) -> int:
        """Count the finite worlds; raise `InvalidRunError` unless all are."""
        finite = sum(bool(np.isfinite(d.qpos).all() and np.isfinite(d.qvel).all()) for _, d in self.worlds)
        if finite < len(self.worlds):
            raise InvalidRunError(f"{finite} finite worlds of {len(self.worlds)} in MuJoCo")
        return finite

    def positions(self) -> list[np.ndarray]:
        """Body positions [L, 3] of every world."""
        for model, data in self.worlds:
            mujoco_tree.mujoco.mj_kinematics(model, data)
        return [data.xpos[1:].copy() for _, data in self.worlds]


def mujoco_row(trees: Sequence[Tree], starts: Sequence[np.ndarray]) -> tuple[Row, MujocoWorlds]:
    """Make the row of C MuJoCo."""
    worlds = MujocoWorlds(trees, starts)
    return Row("C MuJoCo", trees, len(trees), worlds.run, worlds.check), worlds


# ---- measuring -----------------------------------------------------------------------------------------------------


def timed(row: Row) -> float:
    """Seconds that one run of a row takes: of processor time, or by wall clock."""
    clock = time.perf_counter if row.wall else time.process_time
    start = clock()
    row.run(row.steps)
    return clock() - start


def measure(rows: Sequence[Row], rounds: int, seconds: float) -> list[Result]:
    """Measure rows in turn, ``rounds`` times over; every run takes about ``seconds`` and is checked."""
    for row in rows:
        row.run(2)
        row.steps = 8
        row.steps = max(8, round(8 * seconds / max(timed(row), 1e-4)))
    speeds: list[list[float]] = [[] for _ in rows]
    for _ in range(rounds):
        for row, speed in zip(rows, speeds, strict=True):
            speed.append(row.worlds * row.steps / timed(row))
            row.finite = row.check()
    return [Result(row, speed) for row, speed in zip(rows, speeds, strict=True)]


def ratios(result: Result, base: Result) -> list[float]:
    """Ratios to another row, round by round."""
    return [a / b for a, b in zip(result.speed, base.speed, strict=True)]


def compare_positions(simulator: Simulator, chosen: Sequence[int], worlds: MujocoWorlds, steps: int = 48) -> float:
    """Return the rms distance [m] of bodies between the engines after ``steps`` steps.

    Raises:
        InvalidRunError: It is above a millimetre: the engines did not simulate the same trees.
    """
    simulator.reset()
    simulator.step(steps)
    worlds.run(steps)
    position = simulator.observe()[0].numpy()
    apart = [position[w, : len(x)] - x for w, x in zip(chosen, worlds.positions(), strict=True)]
    rms = float(np.sqrt(np.mean(np.sum(np.concatenate(apart) ** 2, axis=1))))
    if not rms < 1e-3:
        raise InvalidRunError(f"bodies of the two engines are {1e3 * rms:.2f} mm apart after {steps} steps")
    return rms


def print_rows(results: Sequence[Result]) -> None:
    """Print one line a row; ratios are those of the first row, MuJoCo's."""
    for r in results:
        trees, ratio = r.row.trees, ratios(r, results[0])
        links = statistics.mean(t.num_links for t in trees)
        dofs = statistics.mean(t.num_dofs for t in trees)
        print(
            f"  {r.row.engine:24s} {links:6.1f} {dofs:7.1f} {r.row.worlds:6d} {r.row.finite:6d} "
            f"{topologies(trees):6d} {r.median / 1e3:10.1f} {min(r.speed) / 1e3:9.1f} - {max(r.speed) / 1e3:<9.1f} "
            f"{statistics.median(ratio):6.2f} x  {min(ratio):6.2f} - {max(ratio):.2f}"
        )


def topologies(trees: Sequence[Tree]) -> int:
    """Count the different topologies."""
    return len({t.parent.tobytes() for t in trees})


HEADER = (
    "  engine                    links     dof worlds finite topol.  k world-steps/s, min - max        "
    "  ratio to MuJoCo, min - max"
)


# ---- the tables ----------------------------------------------------------------------------------------------------


def lane_widths() -> list[int]:
    """Return the widths to measure: one world a thread, and what this machine's registers hold."""
    return [1, 8, 16] if host.simd_width() == 16 else [1, 8]


def table(
    title: str, trees: list[Tree], widths: Sequence[int], options: argparse.Namespace, sample: int, angle: float = BEND
) -> list[Result]:
    """Measure MuJoCo on ``sample`` of the trees, and bough on all of them at the given widths."""
    rng = np.random.default_rng(options.seed)
    starts = [random_qpos(rng, t, angle) for t in trees]
    by_size = np.argsort([t.num_links for t in trees], kind="stable")
    chosen = by_size[np.linspace(0, len(trees) - 1, 2 * sample + 1).astype(int)[1::2]].tolist()
    base, worlds = mujoco_row([trees[w] for w in chosen], [starts[w] for w in chosen])
    rows = [bough_row(trees, starts, width) for width in widths]
    apart = compare_positions(rows[-1].simulator, chosen, worlds)
    results = measure([base, *rows], options.rounds, options.seconds)
    print(f"\n{title} (engines {1e6 * apart:.2f} um apart after 0.2 s)\n{HEADER}")
    print_rows(results)
    return results


def thread_table(trees: list[Tree], options: argparse.Namespace) -> float | None:
    """Measure two threads against one by wall clock; None where there is one core."""
    if host.num_threads() < 2:
        print("\nOne core: two threads are not measured.")
        return None
    rng = np.random.default_rng(options.seed)
    starts = [random_qpos(rng, t, BEND) for t in trees]
    rows = [bough_row(trees, starts, host.simd_width(), threads) for threads in (1, 2)]
    for row in rows:
        row.wall = True
    one, two = measure(rows, options.rounds, 2 * options.seconds)
    gain = ratios(two, one)
    print(f"\nTwo threads, {trees[0].num_links} links, {len(trees)} worlds, wall clock")
    for r in (one, two):
        print(f"  {r.row.engine:32s} {r.median / 1e3:10.1f} k  {min(r.speed) / 1e3:.1f} - {max(r.speed) / 1e3:.1f}")
    load = os.getloadavg()[0]  # above one, someone else has used the second core
    print(f"  gain {statistics.median(gain):.2f}, {min(gain):.2f} - {max(gain):.2f}; load average {load:.1f}")
    return statistics.median(gain)


def memory(order: int = 3, worlds: int = 6144) -> float:
    """Print and return the memory [MiB] of state, parameters and scratch of a large batch, summed over its arrays."""
    tree = ternary_tree(order, np.random.default_rng(0))
    total = Simulator(Model([tree] * worlds, width=host.simd_width())).nbytes / MEGABYTE
    print(f"\nState, parameters and scratch of {worlds} worlds of {tree.num_links} links: {total:.1f} MiB")
    return total


def best_of(results: Sequence[Result], engine: str) -> float:
    """Median ratio to MuJoCo of the row whose name starts with ``engine``."""
    found = next(r for r in results if r.row.engine.startswith(engine))
    return statistics.median(ratios(found, results[0]))


def run(options: argparse.Namespace) -> bool:
    """Measure everything, print the verdicts, return whether all bounds are kept."""
    widths, lanes = lane_widths(), host.simd_width()
    verdicts: list[tuple[str, float, float, bool]] = []
    lane_bound = 30.0 if lanes == 16 else 18.0
    rng = np.random.default_rng(options.seed)
    for order in (2, 3, 4):
        trees = [ternary_tree(order, rng) for _ in range(options.worlds)]
        n = trees[0].num_links
        results = table(f"Ternary tree of {n} links, worlds of one topology", trees, widths, options, 8)
        verdicts.append((f"{n} links, one world a thread", best_of(results, "bough, 1 a"), 3.0, True))
        verdicts.append((f"{n} links, {lanes} lanes", best_of(results, f"bough, {lanes} a"), lane_bound, True))
        if order == 3:
            gain = thread_table(trees, options)
    mixed = [ternary_tree(3, rng, cull=0.15) for _ in range(options.worlds)]
    results = table("Culled ternary trees, mixed topologies", mixed, [1, lanes], options, 32)
    verdicts.append(("mixed topologies", best_of(results, f"bough, {lanes} a"), 8.0, True))
    wild = [random_tree(rng, int(rng.integers(2, 61)), joints=(Joint.SPHERICAL,), damping_ratio=(0.5, 2.0),
                        stiffness=(1.0, 20.0)) for _ in range(options.worlds)]  # fmt: skip
    table("Random trees of 2 to 60 links, nothing in common", wild, [1, lanes], options, 32, angle=0.02)
    if gain is not None:
        verdicts.append(("two threads against one", gain, 1.7, True))
    verdicts.append(("memory of 6144 worlds of 40 links [MiB]", memory(), 256.0, False))
    return print_verdicts(verdicts)


def print_verdicts(verdicts: Sequence[tuple[str, float, float, bool]]) -> bool:
    """Print (what, value, bound, whether the bound is a lower one) and return whether all are kept."""
    print("\nBounds")
    kept = []
    for name, value, bound, lower in verdicts:
        kept.append(value >= bound if lower else value <= bound)
        sign = ">=" if lower else "<="
        print(f"  {'pass' if kept[-1] else 'FAIL'}  {name:44s} {value:8.2f}  {sign} {bound:g}")
    return all(kept)


def main() -> int:
    """Parse options, run, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="5 rounds of 0.1 s on 128 worlds instead of 9 of 0.3 s")
    parser.add_argument("--seed", type=int, default=0, help="seed of all trees and starts")
    options = parser.parse_args()
    quick = options.quick
    options.worlds, options.rounds, options.seconds = (128, 5, 0.1) if quick else (512, 9, 0.3)
    wp.config.log_level = wp.LOG_WARNING
    look = host.describe()
    print(f"{look['cpu']}, {look['cores']} cores, {host.simd_width()} lanes; Warp {wp.__version__}, "
          f"MuJoCo {mujoco_tree.mujoco.__version__}; medians of {options.rounds} interleaved rounds")  # fmt: skip
    try:
        return 0 if run(options) else 1
    except InvalidRunError as error:
        print(f"invalid run: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
