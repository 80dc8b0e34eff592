"""Measure world-steps per second of bough and of C MuJoCo, interleaved in one run.

    python benchmarks/tree.py [--quick] [--seed N] [--record FILE]

Ternary trees of 13, 40 and 121 links on ball joints, dt = 1/240 s, every world with parameters of its own, K = 120, 40,
14, 5, 5 N m/rad by level and D = K / 10; then forests in which every tree has its own topology. Both engines step the
same trees from the same bent start, with one thread each, timed by the processor time they take (the two-thread row by
wall clock). Rows of one table are measured in turn, several times over. A run with a number that is not finite, a
quaternion off unit length, a frozen world, or body positions that differ between the engines is refused.

Exits with 1 if a run is invalid or a bound of `declared` is missed.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import measuring
import numpy as np
from bough.sim.base import host
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.trees.tree import Joint, Tree
from measuring import Figure, InvalidRunError, beside, in_turn, ratios
from oracles import mujoco_tree
from oracles.random_tree import random_qpos, random_tree
from ternary import DT, ternary_tree

BEND = 0.1  # rad, of every joint at the start
MEGABYTE = 2.0**20


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


# ---- engines -------------------------------------------------------------------------------------------------------


def lanes_text(width: int) -> str:
    """Say how many worlds a thread takes at once."""
    return f"{width} lanes" if width > 1 else "one world per thread"


def bough_row(trees: Sequence[Tree], starts: Sequence[np.ndarray], width: int, threads: int = 1) -> Row:
    """Make the row of bough with ``width`` worlds per thread."""
    simulator = Simulator(Model(trees, width=width), dt=DT, threads=threads)
    simulator.state.set_qpos(starts)
    simulator.refresh()
    simulator.mark_start()

    def run(steps: int) -> None:
        simulator.reset()
        simulator.step(steps)

    name = lanes_text(width) + (f", {threads} threads" if threads > 1 else "")
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
    speeds = in_turn([lambda row=row: _speed(row) for row in rows], rounds)
    return [Result(row, speed) for row, speed in zip(rows, speeds, strict=True)]


def _speed(row: Row) -> float:
    speed = row.worlds * row.steps / timed(row)
    row.finite = row.check()
    return speed


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
        trees, ratio = r.row.trees, ratios(r.speed, results[0].speed)
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
    """Return the widths to measure: one world per thread, and what this machine's registers hold."""
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


def thread_figures(trees: list[Tree], options: argparse.Namespace) -> list[Figure]:
    """Measure two threads against one by wall clock; nothing where there is one core."""
    if host.num_cores() < 2:
        print("\nOne core: two threads are not measured.")
        return []
    rng = np.random.default_rng(options.seed)
    starts = [random_qpos(rng, t, BEND) for t in trees]
    rows = [bough_row(trees, starts, host.simd_width(), threads) for threads in (1, 2)]
    for row in rows:
        row.wall = True
    one, two = measure(rows, options.rounds, 2 * options.seconds)
    gain = ratios(two.speed, one.speed)
    print(f"\nTwo threads, {trees[0].num_links} links, {len(trees)} worlds, wall clock")
    for r in (one, two):
        print(f"  {r.row.engine:32s} {r.median / 1e3:10.1f} k  {min(r.speed) / 1e3:.1f} - {max(r.speed) / 1e3:.1f}")
    load = os.getloadavg()[0]  # above one, someone else has used the second core
    print(f"  gain {statistics.median(gain):.2f}, {min(gain):.2f} - {max(gain):.2f}; load average {load:.1f}")
    return [Figure("two threads", "gain", statistics.median(gain), "", (min(gain), max(gain)))]


def memory(order: int = 3, worlds: int = 6144) -> Figure:
    """Return the memory [MiB] of state, parameters and scratch of a large batch, summed over its arrays."""
    tree = ternary_tree(order, np.random.default_rng(0))
    total = Simulator(Model([tree] * worlds, width=host.simd_width())).nbytes / MEGABYTE
    print(f"\nState, parameters and scratch of {worlds} worlds of {tree.num_links} links: {total:.1f} MiB")
    return Figure(f"{worlds} worlds of {tree.num_links} links", "memory", total, "MiB")


def figures(case: str, results: Sequence[Result]) -> list[Figure]:
    """Return the figures of a table: MuJoCo's row, then those of bough beside it; and how many topologies it had."""
    base, trees = results[0], results[1].row.trees
    rows = [beside(case, r.row.engine, r.speed, "world-steps/s", base.speed) for r in results[1:]]
    counts = [Figure(case, "topologies", topologies(trees)), Figure(case, "worlds", len(trees))]
    return [beside(case, base.row.engine, base.speed, "world-steps/s"), *rows, *counts]


def measured(options: argparse.Namespace) -> list[Figure]:
    """Measure everything and print it."""
    options.worlds, options.rounds, options.seconds = (128, 5, 0.1) if options.quick else (512, 9, 0.3)
    print(f"medians of {options.rounds} interleaved rounds")
    widths, lanes, found = lane_widths(), host.simd_width(), []
    rng = np.random.default_rng(options.seed)
    for order in (2, 3, 4):
        trees = [ternary_tree(order, rng) for _ in range(options.worlds)]
        n = trees[0].num_links
        results = table(f"Ternary tree of {n} links, worlds of one topology", trees, widths, options, 8)
        found += figures(f"{n} links", results)
        found += thread_figures(trees, options) if order == 3 else []
    mixed = [ternary_tree(3, rng, cull=0.15) for _ in range(options.worlds)]
    found += figures("culled trees", table("Culled ternary trees, mixed topologies", mixed, [1, lanes], options, 32))
    wild = [random_tree(rng, int(rng.integers(2, 61)), joints=(Joint.SPHERICAL,), damping_ratio=(0.5, 2.0),
                        stiffness=(1.0, 20.0)) for _ in range(options.worlds)]  # fmt: skip
    title = "Random trees of 2 to 60 links, nothing in common"
    found += figures("random trees", table(title, wild, [1, lanes], options, 32, angle=0.02))
    return [*found, memory()]


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    return measuring.quick_and_seed(__doc__, "5 rounds of 0.1 s on 128 worlds instead of 9 of 0.3 s")


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "tree"))
