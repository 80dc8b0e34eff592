"""Measure the error of bough beside that of C MuJoCo on random trees, both against a converged MuJoCo run.

    python benchmarks/accuracy.py [--trees N] [--seed N] [--precision 32|64] [--record FILE]

Trees of 1 to 121 links, ball and hinge joints mixed, branching 1 to 4, stiffness 1 to 300 N m/rad, one damping ratio a
tree from 0.01 to 2 (half of the trees by each link's own inertia, half by what it carries), a bent start; 2 s at
1/240 s. Errors are rms over bodies and time, of body origins. Where MuJoCo's implicitfast blows up, bough must stay
bounded, and come to rest at an equilibrium: Newton's method on MuJoCo's static forces, from where bough rests, must not
move. Trees that still swing after two minutes are given strong dampers and more time; those that rest elsewhere
than a MuJoCo run with small steps and strong dampers does are counted (soft trees buckle and have several equilibria).

Exits with 1 if a bound of `declared` is missed.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

import measuring
import mujoco
import numpy as np
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.trees.tree import Tree
from measuring import Figure, InvalidRunError
from oracles.mujoco_tree import compiled, converged, equilibrium, trajectory
from oracles.random_tree import random_qpos, random_tree
from rich.console import Console
from rich.progress import track
from rich.table import Table

DT, STEPS = 1.0 / 240.0, 480
SIZES = (1, 2, 3, 5, 9, 13, 20, 40, 80, 121)
# m: a tree rests that moves less than this in ten seconds; soft trees creep for minutes, and what they move in ten
# seconds is a small part of what is left
REST = {32: 2e-6, 64: 1e-9}
STRONG = 0.2  # s: damper over spring that lets any tree come to rest


@dataclass
class Outcome:
    """What one tree gave.

    Errors [m] of both engines, None for MuJoCo where it blows up; for those trees, whether bough came to rest with the
    tree's own dampers, how far from an equilibrium it rests [m] (None where
    it never does), and whether MuJoCo's small steps end there too.
    """

    tree: Tree
    zeta: float
    ours: float
    theirs: float | None
    implicit: int
    frozen: bool
    rested: bool = False
    apart: float | None = None
    same: bool = False


def cases(seed: int, count: int):
    """Yield (tree, damping ratio, start) of ``count`` random trees."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        n = int(rng.choice(SIZES))
        tree, zeta = random_tree(rng, n), 10.0 ** rng.uniform(-2.0, np.log10(2.0))
        arm = tree.com - tree.anchor
        moved = np.trace(tree.inertia, axis1=1, axis2=2) / 2 + tree.mass * np.sum(arm**2, axis=1)
        if k % 2:
            for i in range(n - 1, 0, -1):
                moved[tree.parent[i]] += moved[i] + 0.05 * tree.mass[i]
        stiffness = 10.0 ** rng.uniform(0.0, np.log10(300.0), n)
        tree = tree.with_(stiffness=stiffness, damping=2.0 * zeta * np.sqrt(stiffness * moved))
        yield tree, zeta, random_qpos(rng, tree, 0.25)


def started(tree: Tree, start: np.ndarray, precision: int) -> Simulator:
    """Make a simulator of one world at its start."""
    simulator = Simulator(Model([tree], precision=precision), dt=DT, threads=1)
    simulator.state.set_qpos(start)
    simulator.refresh()
    return simulator


def recorded(simulator: Simulator) -> np.ndarray:
    """Body positions [STEPS, L, 3]."""
    out = []
    for _ in range(STEPS):
        simulator.step()
        out.append(simulator.observe()[0][0].numpy().copy())
    return np.array(out)


def rms(a: np.ndarray, b: np.ndarray) -> float:
    """Root mean square distance [m] of bodies over time."""
    return float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=-1))))


def one_case(tree: Tree, zeta: float, start: np.ndarray, precision: int) -> Outcome | None:
    """Run both engines; None where the converged run does not exist."""
    truth = converged(tree, start, DT, STEPS)
    if truth is None:
        return None
    simulator = started(tree, start, precision)
    damping = simulator.model.gather(simulator._damping.numpy())[:, 0]
    ours, theirs = recorded(simulator), trajectory(tree, start, DT, STEPS)
    implicit, frozen = int((damping > tree.damping * (1 + 1e-6)).sum()), bool(simulator.state.faults())
    if theirs is not None:
        return Outcome(tree, zeta, rms(ours, truth), rms(theirs, truth), implicit, frozen)
    rested = at_rest(simulator, 120.0)
    if not rested:
        damping, stiffness = simulator.model.arrays["damping"].torch, simulator.model.arrays["stiffness"].torch
        damping.add_(stiffness, alpha=STRONG)
        simulator.refresh()
    rests = rested or at_rest(simulator, 600.0)
    alive = not simulator.state.faults()  # a frozen world is still, but not at rest
    apart, same = equilibria(simulator) if rests and alive else (None, False)
    rested = rested and alive
    return Outcome(tree, zeta, rms(ours, truth), None, implicit, not alive, rested, apart, same)


def at_rest(simulator: Simulator, longest: float) -> bool:
    """Step until no body moves more than `REST` in ten seconds, ``longest`` seconds at most."""
    for _ in range(round(longest / 10.0)):
        before = simulator.observe()[0].clone()
        simulator.step(round(10.0 / DT))
        if (simulator.observe()[0] - before).abs().max() < REST[simulator.model.precision]:
            return True
    return False


def equilibria(simulator: Simulator) -> tuple[float, bool]:
    """Return the distance [m] of a pose from the next equilibrium, and whether MuJoCo ends at that one too.

    The distance is infinite where Newton's method finds none.
    """
    tree = simulator.model.trees[0]
    position, qpos = simulator.observe()[0][0].numpy(), simulator.state.qpos()[0]
    model, data = compiled(tree.with_(damping=tree.damping + STRONG * tree.stiffness), DT / 8)
    mujoco.mj_step(model, data, 8 * 240 * 10)
    here, there = (_equilibrium(tree, q) for q in (qpos, data.qpos))
    apart = np.inf if here is None else float(np.abs(here - position).max())
    return apart, there is not None and bool(np.abs(there - position).max() < 1e-3)


def _equilibrium(tree: Tree, qpos: np.ndarray) -> np.ndarray | None:
    try:
        return equilibrium(tree, qpos)
    except RuntimeError:
        return None


def report(outcomes: list[Outcome], precision: int, console: Console) -> list[Figure]:
    """Print the tables and return the figures."""
    stable = [o for o in outcomes if o.theirs is not None and o.theirs > 0]
    rest = [o for o in outcomes if o.theirs is None]
    names = ("links", "trees", "MuJoCo stable", "with implicit springs", "ratio, median", "worst", "error, median (mm)")
    table = Table(*names, title="rms error of bough over that of C MuJoCo, dt = 1/240 s, 2 s")
    for low, high in ((1, 3), (4, 13), (14, 40), (41, 121)):
        here = [o for o in outcomes if low <= o.tree.num_links <= high]
        good = [o for o in stable if low <= o.tree.num_links <= high]
        r = [o.ours / o.theirs for o in good]
        cells = [f"{np.median(r):.3f}", f"{max(r):.3f}", f"{1e3 * np.median([o.ours for o in good]):.3g}"] if r else []
        table.add_row(f"{low}-{high}", str(len(here)), str(len(good)), str(sum(o.implicit > 0 for o in good)), *cells)
    console.print(table)
    print_outliers(outcomes, precision, console)
    return [*_errors(outcomes, stable), *_rests(rest, console)]


def print_outliers(outcomes: list[Outcome], precision: int, console: Console) -> None:
    """Print the trees that froze, rest far from an equilibrium, or have half as much error again as MuJoCo's."""
    bound = 1e-5 if precision == 64 else 1e-4
    for k, o in enumerate(outcomes):
        if o.frozen or (o.apart or 0.0) > bound or (o.theirs and o.ours > 1.5 * o.theirs):
            what = "frozen" if o.frozen else f"{1e3 * (o.apart or 0.0):.3g} mm from an equilibrium"
            if o.theirs is not None:
                what = f"error {1e3 * o.ours:.3g} mm beside {1e3 * o.theirs:.3g} mm"
            console.print(f"tree {k}, {o.tree.num_links} links, damping ratio {o.zeta:.3g}: {what}")


def _errors(outcomes: list[Outcome], stable: list[Outcome]) -> list[Figure]:
    ratio, every = np.array([o.ours / o.theirs for o in stable]), "all trees"
    return [
        Figure(every, "number", len(outcomes)),
        Figure(every, "median ratio of errors", float(np.median(ratio))),
        Figure(every, "ratio of errors that 95 % keep to", float(np.quantile(ratio, 0.95))),
        Figure(every, "frozen worlds", sum(o.frozen for o in outcomes)),
    ]


def _rests(rest: list[Outcome], console: Console) -> list[Figure]:
    own, settled, same = (
        sum(flags) for flags in ([o.rested for o in rest], [o.apart is not None for o in rest], [o.same for o in rest])
    )
    console.print(
        f"MuJoCo blows up on {len(rest)} trees. bough brings {own} of them to rest within two minutes with their own "
        f"dampers, {settled} with stronger ones, {same} of these where MuJoCo with small steps rests."
    )
    furthest, where = max((o.apart for o in rest if o.apart is not None), default=0.0), "where MuJoCo blows up"
    if np.isinf(furthest):
        raise InvalidRunError("a tree rests where Newton's method finds no equilibrium")
    counts = {"trees": len(rest), "at rest with their own dampers": own, "at rest": settled, "where MuJoCo rests": same}
    return [
        *(Figure(where, name, count) for name, count in counts.items()),
        Figure(where, "furthest from an equilibrium", 1e3 * furthest, "mm"),
    ]


def measured(options: argparse.Namespace) -> list[Figure]:
    """Run all trees and print what they gave."""
    console, outcomes = Console(), []
    for case in track(cases(options.seed, options.trees), "trees", options.trees, console=Console(stderr=True)):
        outcome = one_case(*case, options.precision)
        if outcome is None:
            console.print(f"{case[0].num_links} links: no converged MuJoCo run, left out")
        else:
            outcomes.append(outcome)
    return report(outcomes, options.precision, console)


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    found = measuring.parser_of(__doc__)
    found.add_argument("--trees", type=int, default=60, help="number of random trees")
    found.add_argument("--seed", type=int, default=0, help="seed of all trees and starts")
    found.add_argument("--precision", type=int, choices=(32, 64), default=32, help="of bough")
    return found


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, lambda o: "accuracy" if o.precision == 32 else "accuracy_float64"))
