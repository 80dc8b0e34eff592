"""Measure what effects cost in the step of a forest, beside the plain step, interleaved in one run.

    python benchmarks/effects.py [--quick] [--seed N] [--record FILE]

Ternary trees of 40 links on ball joints, dt = 1/240 s, every world with springs and effects of its own, one thread.
Rows: the plain step, the plain step under a (zero) load, and steps built with effects, neutral and at work. Every row
is measured twice: a call of ``step`` for each step, and one for all of them; values are taken over once a call. Steps
built with effects at their neutral values must end on the plain step's bits. Exits with 1 if they do not, or if a world
is lost.
"""

from __future__ import annotations

import argparse
import statistics
import sys

import measuring
import numpy as np
import torch
from bough.sim.base import host
from bough.sim.engine.forest_effects import forest_laws
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.trees.tree import Tree
from measuring import Figure, InvalidRunError, ratios
from oracles.random_tree import random_qpos
from ternary import DT, ternary_tree
from tree import BEND, Result, Row, check_bough, lanes_text, measure

#: A value [low, high] of every parameter that the rows switch on.
VALUES = {
    "dry_friction": {"torque_Nm": (0.005, 0.05)},
    "cubic_stiffness": {"cubic_radm2": (0.5, 2.0)},
    "viscoelastic_sls": {"share": (0.1, 0.3), "relaxation_s": (0.1, 1.0)},
    "quadratic_drag": {"coefficient_kgpm3": (0.5, 2.0)},
    "steady_wind": {"pressure_x_Pa": (-5.0, 5.0)},
    "tip_mass": {"mass_kg": (0.001, 0.01)},
}


def with_capsules(tree: Tree) -> Tree:
    """Return the tree with a capsule along every link, for the wind to blow at."""
    n, end = tree.num_links, 2.0 * tree.com
    radius = 0.03 * 0.6**tree.level
    return tree.with_(shape_link=np.arange(n), shape_start=np.zeros((n, 3)), shape_end=end,
                      shape_radius=np.stack([radius, radius], axis=1))  # fmt: skip


def randomise(simulator: Simulator, seed: int) -> None:
    """Give every world and joint values of its own."""
    generator = torch.Generator(simulator.state.fault_link.device).manual_seed(seed)
    for name, box in VALUES.items():
        for parameter, (low, high) in box.items():
            if name in simulator.effects:
                simulator.effects[name][parameter].uniform_(low, high, generator=generator)


def make(label: str, trees: list[Tree], starts, width: int, names=(), on: bool = False, loaded: bool = False) -> Row:
    """Make a row; its steps are taken in one call, or in a call each where the label ends in ``each``."""
    simulator = Simulator(Model(trees, width=width), dt=DT, threads=1, effects=names)
    simulator.state.set_qpos(starts)
    simulator.refresh()
    simulator.mark_start()
    if loaded:
        _ = simulator.load
    if on:
        randomise(simulator, 0)

    def run(steps: int) -> None:
        simulator.reset()
        for _ in range(steps if label.endswith("each") else 1):
            simulator.step(1 if label.endswith("each") else steps)

    return Row(label, trees, len(trees), run, lambda: check_bough(simulator), simulator)


def rows(trees: list[Tree], starts, width: int, how: str) -> list[Row]:
    """Make the rows of one table."""
    out = [make(f"plain{how}", trees, starts, width), make(f"plain, loaded{how}", trees, starts, width, loaded=True)]
    for name in VALUES:
        out += [make(f"{name} {'on' if on else 'off'}{how}", trees, starts, width, (name,), on) for on in (False, True)]
    every = tuple(forest_laws())
    out.append(make(f"all {len(every)}, none on{how}", trees, starts, width, every))
    out.append(make(f"all {len(every)}, these {len(VALUES)} on{how}", trees, starts, width, every, on=True))
    return out


def check_neutral(rows: list[Row], steps: int = 48) -> None:
    """Raise `InvalidRunError` unless effects at neutral values leave the plain step's bits."""
    for row in rows:
        row.run(steps)
    first = rows[0].simulator
    for row in rows[1:]:
        same = torch.equal(row.simulator.state.coordinate.torch, first.state.coordinate.torch)
        if same != (" on" not in row.engine or "none on" in row.engine):
            raise InvalidRunError(f"{row.engine}: the plain step's bits: {same}")


def show(case: str, results: list[Result]) -> list[Figure]:
    """Print a line a row and return the figures: the plain step's speed, times of a step over the plain one's."""
    plain, found = results[0].speed, []
    for r in results:
        slower = ratios(plain, r.speed)
        found.append(Figure(case, r.row.engine, statistics.median(slower), "", (min(slower), max(slower))))
        print(f"  {r.row.engine:34s} {r.median / 1e3:10.1f} {statistics.median(slower):8.2f} x   "
              f"{min(slower):.2f} - {max(slower):.2f}")  # fmt: skip
    return [measuring.beside(case, f"speed of {results[0].row.engine}", plain, "world-steps/s"), *found]


def measured(options: argparse.Namespace) -> list[Figure]:
    """Measure every table and print it."""
    worlds, rounds, seconds = (128, 5, 0.1) if options.quick else (512, 9, 0.3)
    rng = np.random.default_rng(options.seed)
    trees = [with_capsules(ternary_tree(3, rng)) for _ in range(worlds)]
    starts = [random_qpos(rng, t, BEND) for t in trees]
    print(f"one thread; {worlds} worlds of {trees[0].num_links} links")
    found = []
    for width in (1, host.simd_width()):
        for how in ("", ", each"):
            table = rows(trees, starts, width, how)
            check_neutral(table)
            print(f"\n{lanes_text(width)}{how}: k world-steps/s, time over the plain step's, min - max")
            found += show(lanes_text(width), measure(table, rounds, seconds))
    return found


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    return measuring.quick_and_seed(__doc__, "5 rounds of 0.1 s on 128 worlds instead of 9 of 0.3 s")


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "effects"))
