"""Measure world-steps per second of an arm that sweeps through trees, of bough and of C MuJoCo, interleaved in one run.

    python benchmarks/contact.py [--quick] [--random] [--seed N] [--record FILE]

A Jaco 2 sweeps through ternary trees of 40 ball-jointed capsules, every world with a tree and target speeds of its own
(random, up to 2.4 rad/s at joint 1, tip up to 1.5 m/s), dt = 1/240 s, one second a run. MuJoCo: arm and tree in one
model, only the arm touches the branches, Newton solver, implicitfast, with its default contacts (time constant 20 ms)
and with the stiffest ones its step allows (2 dt). Both engines start from the same state and are timed by processor
time, in turn, several times over; penetrations are taken from a run of their own, step by step, of the same worlds.

A run with a number that is not finite, a lost world, a full contact buffer, deeper penetrations than MuJoCo's, or a
mean force more than 15 % off that of MuJoCo with a thirty-second of the step is refused. ``--random`` steps 4096 random
scenes 1000 times instead and counts what was lost. Exits with 1 if a run is invalid or a bound of `declared` is missed.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import measuring
import mujoco
import numpy as np
import torch
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.simulator import ArmSimulator
from bough.sim.base import host
from bough.sim.trees.tree import Tree
from measuring import Figure, InvalidRunError, beside, in_turn, ratios
from oracles import contact_case, mujoco_arm

DT = contact_case.DT
STEPS = 240
#: Steps of the reference for the mean force to one of a run.
FINER = 32
#: Nothing is limited: MuJoCo clips a servo's torque by what the step before asks for, and loses light joints by that.
FAST = contact_case.free_arm(velocity_limit=10.0, torque_limit=1000.0)
START = contact_case.STRETCHED + np.array([-0.7, 0, 0, 0, 0, 0])


@dataclass
class Row:
    """One engine: ``run`` takes all its worlds through a sweep, ``look`` returns (depth [m], force [N]) of every step.

    Both arrays are [steps, worlds]; only the worlds that all engines have in common are looked at.
    """

    engine: str
    worlds: int
    run: Callable[[], None]
    look: Callable[[], tuple[np.ndarray, np.ndarray]]
    speed: list[float] = field(default_factory=list)
    depth: np.ndarray | None = None
    force: np.ndarray | None = None
    contacts: float = 0.0
    ours: bool = False


# ---- engines -------------------------------------------------------------------------------------------------------


def bough_row(trees: Sequence[Tree], targets: np.ndarray, sample: int, width: int) -> Row:
    """Make the row of bough with ``width`` worlds per thread, on one thread."""
    sim = contact_case.simulator(trees, FAST, q=START, width=width, contacts={"capacity": 64})
    goal = torch.as_tensor(targets, dtype=torch.float32)

    def start() -> None:
        sim.reset()
        sim.target.copy_(goal)

    def run() -> None:
        start()
        sim.step(STEPS)
        check(sim)

    def look() -> tuple[np.ndarray, np.ndarray]:
        start()
        depth, force, count = [], [], 0.0
        for _ in range(STEPS):
            sim.step()
            depth.append(sim.depth[:sample].numpy().copy())
            force.append(sim.arm_force[:sample].sum(dim=1).norm(dim=1).numpy().copy())
            count += float(sim._touch.count.float().mean()) / STEPS
        check(sim)
        row.contacts = count
        return np.array(depth), np.array(force)

    row = Row(f"{width} lanes" if width > 1 else "one world per thread", len(trees), run, look, ours=True)
    return row


def check(sim: ArmSimulator) -> None:
    """Raise `InvalidRunError` unless all worlds are there and finite, and no contact was left out."""
    if sim.faults():
        raise InvalidRunError(f"{len(sim.faults())} lost worlds, first: {sim.faults()[0]}")
    if int(sim.overflow.sum()):
        raise InvalidRunError(f"{int(sim.overflow.sum())} contacts without room")
    finite = torch.isfinite(sim.q).all() and torch.isfinite(sim.qd).all()
    if not finite or not all(np.isfinite(q).all() for q in sim.state.qpos()):
        raise InvalidRunError("numbers that are not finite")


def mujoco_row(trees: Sequence[Tree], targets: np.ndarray, time_constant: float) -> Row:
    """Make the row of C MuJoCo; its worlds are stepped in turn, each in one call of C."""
    worlds = [mujoco_arm.compiled(FAST, t, time_constant=time_constant) for t in trees]
    for model, data in worlds:
        model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL  # its default, and the faster one
        data.qpos[:6] = START
    starts = [data.qpos.copy() for _, data in worlds]

    def start() -> None:
        for (model, data), q, v in zip(worlds, starts, targets, strict=False):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.ctrl[:] = q, v

    def run() -> None:
        start()
        for model, data in worlds:
            mujoco.mj_step(model, data, STEPS)
            if not np.isfinite(data.qpos).all() or data.warning.number.any():
                raise InvalidRunError("MuJoCo lost a world")

    def look() -> tuple[np.ndarray, np.ndarray]:
        start()
        depth, force = np.zeros((STEPS, len(worlds))), np.zeros((STEPS, len(worlds)))
        for k in range(STEPS):
            for w, (model, data) in enumerate(worlds):
                mujoco.mj_step(model, data)
                total, deep = mujoco_arm.contact_forces(model, data)
                depth[k, w], force[k, w] = max(deep, default=0.0), np.linalg.norm(total)
                row.contacts += data.ncon / STEPS / len(worlds)
        return np.maximum(depth, 0.0), force

    row = Row(f"C MuJoCo, {1e3 * time_constant:.3g} ms", len(worlds), run, look)
    return row


def converged_force(trees: Sequence[Tree], targets: np.ndarray) -> float:
    """Return MuJoCo's mean contact force [N] over the sweep at a thirty-second of the step, with contacts as stiff.

    At 1/240 s its contacts are either soft or lose the branch, so its mean force there is no reference.
    """
    dt, forces = DT / FINER, []
    for tree, target in zip(trees, targets, strict=False):
        model, data = mujoco_arm.compiled(FAST, tree, dt=dt, time_constant=2 * dt)
        data.qpos[:6], data.ctrl[:] = START, target
        for _ in range(STEPS * FINER):
            mujoco.mj_step(model, data)
            forces.append(np.linalg.norm(mujoco_arm.contact_forces(model, data)[0]))
    return float(np.mean(forces))


# ---- measuring -----------------------------------------------------------------------------------------------------


def measure(rows: Sequence[Row], rounds: int) -> None:
    """Time the rows in turn, ``rounds`` times over, and look at each once."""
    for row in rows:
        row.depth, row.force = row.look()
        row.run()
    for row, speed in zip(rows, in_turn([lambda row=row: _speed(row) for row in rows], rounds), strict=True):
        row.speed = speed


def _speed(row: Row) -> float:
    begin = time.process_time()
    row.run()
    return row.worlds * STEPS / (time.process_time() - begin)


def report(rows: Sequence[Row]) -> None:
    """Print one line a row; ratios are those of the first row."""
    print(
        "  engine                worlds contacts   k world-steps/s, min - max        ratio, min - max        "
        "depth [mm] mean  99 %   max   mean force [N]"
    )
    for row in rows:
        ratio = ratios(row.speed, rows[0].speed)
        deep = 1e3 * row.depth[row.depth > 0]
        print(
            f"  {row.engine:22s} {row.worlds:5d} {row.contacts:8.2f} {statistics.median(row.speed) / 1e3:9.1f} "
            f"{min(row.speed) / 1e3:8.1f} - {max(row.speed) / 1e3:<8.1f} {statistics.median(ratio):7.2f} x "
            f"{min(ratio):6.2f} - {max(ratio):<6.2f}         {deep.mean():8.3f} {np.quantile(deep, 0.99):6.3f} "
            f"{deep.max():6.3f} {row.force.mean():10.2f}"
        )


def refuse(rows: Sequence[Row], converged: float) -> None:
    """Raise `InvalidRunError` where bough penetrates deeper than MuJoCo or its mean force is not the converged one."""
    base, ours = rows[0], [r for r in rows if r.ours]
    for row in ours:
        for name, value in (("mean", np.mean), ("99 %", lambda d: np.quantile(d, 0.99)), ("max", np.max)):
            mine, theirs = value(row.depth[row.depth > 0]), value(base.depth[base.depth > 0])
            if mine > theirs:
                raise InvalidRunError(f"{row.engine}: {name} depth {1e3 * mine:.2f} mm, MuJoCo's {1e3 * theirs:.2f} mm")
        mine = row.force.mean()
        if abs(mine / converged - 1.0) > 0.15:
            raise InvalidRunError(f"{row.engine}: mean force {mine:.2f} N, converged {converged:.2f} N")


def figures(row: Row, base: Row) -> list[Figure]:
    """Return the figures of a row: its speed beside the first row's, depths, contacts and force."""
    deep, name = 1e3 * row.depth[row.depth > 0], row.engine
    return [
        beside(name, "speed", row.speed, "world-steps/s", base.speed),
        Figure(name, "contacts near", row.contacts),
        Figure(name, "mean depth", float(deep.mean()), "mm"),
        Figure(name, "99 % of depths", float(np.quantile(deep, 0.99)), "mm"),
        Figure(name, "greatest depth", float(deep.max()), "mm"),
        Figure(name, "mean force", float(row.force.mean()), "N"),
    ]


def compare(options: argparse.Namespace) -> list[Figure]:
    """Measure all rows and print them."""
    options.worlds, options.rounds = (64, 3) if options.quick else (128, 9)
    print(f"medians of {options.rounds} interleaved rounds")
    rng = np.random.default_rng(options.seed)
    trees = [contact_case.ternary(rng) for _ in range(options.worlds)]
    targets = rng.uniform(-0.3, 0.3, (options.worlds, 6))
    targets[:, 0] = rng.uniform(1.6, 2.4, options.worlds)
    sample = 16
    rows = [mujoco_row(trees[:sample], targets, c) for c in (0.02, 2 * DT)]
    rows += [bough_row(trees, targets, sample, width) for width in sorted({1, host.simd_width()})]
    measure(rows, options.rounds)
    print(f"\nJaco 2 through trees of {trees[0].num_links} links, {STEPS} steps of 1/240 s")
    report(rows)
    converged = converged_force(trees[:sample], targets)
    print(f"  mean force of MuJoCo at 1/{round(FINER / DT)} s: {converged:.2f} N")
    refuse(rows, converged)
    found = [f for row in rows for f in figures(row, rows[0])]
    return [*found, Figure("C MuJoCo, converged", "mean force", converged, "N")]


# ---- random scenes -------------------------------------------------------------------------------------------------


def random_simulator(rng: np.random.Generator, worlds: int) -> tuple[ArmSimulator, np.ndarray]:
    """Make random scenes; return them at their start, and which of them are without overlap there, shape [worlds]."""
    few = [contact_case.ternary(rng, order=int(rng.integers(2, 4))) for _ in range(64)]
    trees, q = [], []
    for w in range(worlds):
        angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(0.35, 0.6)
        place = few[w % 64].position.copy()
        place[few[w % 64].parent < 0] = (far * np.cos(angle), far * np.sin(angle), rng.uniform(-0.2, 0.1))
        trees.append(few[w % 64].with_(position=place))
        q.append(np.r_[rng.uniform(-3, 3), rng.uniform(2.0, 4.6), rng.uniform(1.5, 4.7), rng.uniform(-3, 3, 3)])
    room = {"capacity": 64, "ground": -0.3}
    sim = contact_case.simulator(trees, q=np.array(q), width=host.simd_width(), contacts=room)
    angle = torch.as_tensor(rng.uniform(0, np.pi, worlds))
    along = torch.stack([angle.cos(), angle.sin(), torch.full_like(angle, 0.1)], dim=1).float()
    middle = torch.as_tensor(rng.uniform([-0.5, -0.5, 0.1], [0.5, 0.5, 1.1], (worlds, 3))).float()
    sim.line_start.copy_(middle - along)
    sim.line_end.copy_(middle + along)
    sim.line_mask.copy_(torch.as_tensor(rng.integers(0, 2, worlds)))
    sim.step()
    clear = sim.depth.numpy() == 0.0
    sim.reset()
    return sim, clear


def random_scenes(options: argparse.Namespace, worlds: int = 4096, steps: int = 1000) -> list[Figure]:
    """Step random scenes under random actions; print what was lost, left out or deep.

    Trees stand anywhere around the arm, line and ground are there, arms start anywhere: those that start without any
    overlap are judged by their depth, all by being finite.
    """
    sim, clear = random_simulator(np.random.default_rng(options.seed), worlds)
    deepest, unsettled, busy = np.zeros(worlds), 0, 0
    limit = torch.as_tensor(jaco2().velocity_limit, dtype=torch.float32)
    generator = torch.Generator().manual_seed(options.seed)
    begin = time.perf_counter()
    for k in range(steps):
        if k % 24 == 0:
            sim.target.copy_((2.0 * torch.rand((worlds, 6), generator=generator) - 1.0) * limit)
        sim.step()
        deepest = np.maximum(deepest, sim.depth.numpy())
        busy += int((sim._touch.count > 0).sum())
        unsettled += int(sim.unsettled.sum())
    spent = time.perf_counter() - begin
    finite = torch.isfinite(sim.q).all(dim=1).numpy() & np.array([np.isfinite(p).all() for p in sim.state.qpos()])
    print(f"{worlds} random scenes x {steps} steps in {spent:.0f} s: {len(sim.faults())} lost, {int(finite.sum())} "
          f"finite, {int((sim.overflow > 0).sum())} with a full buffer; {int(clear.sum())} started without overlap, "
          f"their deepest penetrations: median {1e3 * np.median(deepest[clear]):.2f}, 99 % "
          f"{1e3 * np.quantile(deepest[clear], 0.99):.2f}, max {1e3 * deepest[clear].max():.2f} mm; "
          f"{busy / steps / worlds:.1%} of steps have something near, {unsettled / max(busy, 1):.3%} of those were not "
          "settled after the last repeat")  # fmt: skip
    every, free, deep = f"{worlds} scenes", "scenes that start without overlap", 1e3 * deepest[clear]
    return [
        Figure(every, "lost", len(sim.faults())), Figure(every, "not finite", worlds - int(finite.sum())),
        Figure(every, "with a full buffer", int((sim.overflow > 0).sum())),
        Figure(every, "steps near something not settled", unsettled / max(busy, 1)), Figure(every, "time", spent, "s"),
        Figure(free, "number", int(clear.sum())), Figure(free, "deepest", float(deep.max()), "mm"),
        Figure(free, "depth that 99 % keep to", float(np.quantile(deep, 0.99)), "mm"),
    ]  # fmt: skip


def measured(options: argparse.Namespace) -> list[Figure]:
    """Compare engines, or step random scenes."""
    return random_scenes(options) if options.random else compare(options)


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    found = measuring.quick_and_seed(__doc__, "3 rounds of 64 worlds instead of 9 of 128")
    found.add_argument("--random", action="store_true", help="4096 random scenes x 1000 steps instead")
    return found


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, lambda o: "contact_random" if o.random else "contact"))
