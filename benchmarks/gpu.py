"""Check and measure bough on a GPU: one command, under nine minutes, no network.

    python benchmarks/gpu.py --out DIR [--device cuda:0] [--quick] [--only SECTION ...] [--record FILE]

Writes ``gpu.json`` and ``gpu.md`` to DIR after every section, so that a run that is cut short leaves what it had.
Exits with 1 if a check failed. Needs NumPy, torch, Warp and, for the last check, Newton; runs from a checkout that is
not installed. ``--device cpu --quick`` tries the script itself in a minute.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp

SIZES = {2: 13, 3: 40, 4: 121}  # links of a ternary tree, by order


def load_bough() -> None:
    """Import bough from the checkout this file is in, where it is not installed."""
    if importlib.util.find_spec("bough") is not None:
        return
    root = Path(__file__).resolve().parent.parent
    spec = importlib.util.spec_from_file_location("bough", root / "__init__.py", submodule_search_locations=[str(root)])
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["bough"] = module
    spec.loader.exec_module(module)


load_bough()
import gpu_arm  # noqa: E402  (this and all below need bough)
import measuring  # noqa: E402
from bough.sim.engine.model import Model  # noqa: E402
from bough.sim.engine.simulator import Simulator  # noqa: E402
from bough.sim.trees.tree import Tree  # noqa: E402
from measuring import Figure  # noqa: E402
from ternary import DT, ternary_tree  # noqa: E402

# ---- worlds ------------------------------------------------------------------------------------------------------


def forest(order: int, worlds: int, *, drop: float = 0.0, distinct: int = 256) -> list[Tree]:
    """Make a tree a world, ``distinct`` of them different."""
    rng = np.random.default_rng(order)
    trees = [ternary_tree(order, rng, drop) for _ in range(min(worlds, distinct))]
    return [trees[w % len(trees)] for w in range(worlds)]


def simulator(trees: list[Tree], device: str, *, substeps: int = 1, precision: int = 32) -> Simulator:
    """Make a simulator with one world per thread, as a GPU has it."""
    return Simulator(Model(trees, device=device, precision=precision, width=1), dt=DT, substeps=substeps)


def bent(trees: list[Tree]) -> list[np.ndarray]:
    """Turn every ball joint by up to 0.2 rad: ``qpos`` of every world."""
    out = []
    for world, tree in enumerate(trees):
        q = np.random.default_rng(world).normal(0.0, 0.05, (tree.num_links, 4))
        q[:, 0] = 1.0
        out.append((q / np.linalg.norm(q, axis=1, keepdims=True)).ravel())
    return out


def moved(trees: list[Tree], device: str, steps: int, precision: int = 32) -> np.ndarray:
    """Return positions [worlds, links, 3] after steps from a bent start."""
    sim = simulator(trees, device, precision=precision)
    sim.state.set_qpos(bent(trees))
    sim.step(steps)
    return sim.observe()[0].cpu().numpy().astype(np.float64)


# ---- checks ------------------------------------------------------------------------------------------------------


def check_accuracy(device: str, quick: bool) -> dict[str, Any]:
    """Compare a second's motion with the CPU's: float64 to round-off, float32 as near the truth as the CPU's is."""
    trees, steps = forest(3, 8, drop=0.3), 24 if quick else 240
    truth = moved(trees, "cpu", steps, 64)
    double = np.abs(moved(trees, device, steps, 64) - truth).max()
    own, cpu = (np.abs(moved(trees, d, steps) - truth).max() for d in (device, "cpu"))
    found = {"float64_max_m": double, "float32_max_m": own, "cpu_float32_max_m": cpu}
    return found | {"ok": bool(double < 1e-9 and own < 3.0 * cpu + 1e-6)}


def check_torch_views(device: str, quick: bool) -> dict[str, Any]:
    """Keep pointers over 1000 steps and resets; let kernels see what torch writes; free memory stays as it is."""
    sim = simulator(forest(3, 64), device)
    sim.step()
    sim.observe()
    views = [sim.state.coordinate.torch, sim.state.velocity.torch, sim.position, sim.rotation, sim.load.force.torch]
    pointers = [v.data_ptr() for v in views]
    everyone = torch.ones(64, dtype=torch.bool, device=sim.position.device)
    sim.step()
    sim.reset(everyone)
    wp.synchronize_device(device)
    free = _free(device)
    for step in range(1000):
        sim.step()
        if step % 100 == 0:
            sim.reset(everyone)
    wp.synchronize_device(device)
    allocated = free - _free(device)
    same = pointers == [v.data_ptr() for v in views]
    before = sim.observe()[0].clone()
    sim.state.coordinate.torch[..., 1, :] = torch.tensor([0.0, 1.0, 0.0, 0.0], device=before.device)
    seen = bool((sim.observe()[0] - before)[:, 2:].abs().max() > 0.1)
    return {
        "same_pointers": same,
        "torch_write_seen": seen,
        "allocated_bytes": allocated,
        "ok": same and seen and not allocated,
    }


def _free(device: str) -> int:
    return torch.cuda.mem_get_info(torch.device(device))[0] if "cuda" in device else 0


def check_graph(device: str, quick: bool) -> dict[str, Any]:
    """Replay four steps five times as a graph: the bits of twenty steps."""
    trees, out = forest(3, 64, drop=0.2), []
    for replayed in (False, True):
        sim = simulator(trees, device)
        sim.state.set_qpos(bent(trees))
        replay = sim.capture(4)
        for _ in range(5):
            if replayed:
                replay()
            else:
                sim.step(4)
        out.append(sim.observe()[0].cpu().numpy().copy())
    return {"ok": bool((out[0] == out[1]).all())}


def check_worlds(device: str, quick: bool) -> dict[str, Any]:
    """Step a world alone, in a batch and beside a world of NaN: the same bits; the guard names the bad one."""
    trees = forest(3, 96, drop=0.2)
    sim = simulator(trees, device)
    sim.state.set_qpos(bent(trees))
    sim.step(20)
    batch = sim.observe()[0].cpu().numpy().copy()
    alone = simulator(trees[5:6], device)
    alone.state.set_qpos(bent(trees)[5:6])
    alone.step(20)
    n = trees[5].num_links
    same = bool((alone.observe()[0].cpu().numpy()[0, :n] == batch[5, :n]).all())
    sick = simulator(trees, device)
    sick.state.set_qpos(bent(trees))
    sick.state.velocity.torch[7] = float("nan")
    sick.step(20)
    others = np.arange(96) != 7
    untouched = bool((sick.observe()[0].cpu().numpy()[others] == batch[others]).all())
    flagged = [fault[0] for fault in sick.state.faults()]
    return {"alone": same, "untouched": untouched, "flagged": flagged, "ok": same and untouched and flagged == [7]}


def check_looking(device: str, quick: bool) -> dict[str, Any]:
    """Compare energies, momenta and probe points with the CPU's in float64."""
    trees = forest(3, 8, drop=0.3)
    found = []
    for where in (device, "cpu"):
        sim = simulator(trees, where, precision=64)
        sim.state.set_qpos(bent(trees))
        sim.step(10)
        position, velocity = sim.probes([[(t.num_links - 1, np.array([0.0, 0.0, 0.1]))] for t in trees]).read()
        found.append([*sim.energy(), position.cpu().numpy(), velocity.cpu().numpy()])
    worst = max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(*found, strict=True))
    return {"relative": worst, "ok": worst < 1e-8}


def check_newton(device: str, quick: bool) -> dict[str, Any]:
    """Step a Newton model on the device, captured as a graph: the joints of the same steps on the CPU."""
    if importlib.util.find_spec("newton") is None:
        return {"ok": True, "skipped": "Newton is not installed"}
    from bough.sim.newton.bridge import to_newton
    from bough.sim.newton.solver import BoughSolver

    found = []
    for where in (device, "cpu"):
        model = to_newton(forest(3, 16), device=where)
        solver, a, b = BoughSolver(model), model.state(), model.state()
        solver.step(a, b, None, None, DT)
        a = model.state()
        with wp.ScopedCapture(device=where) as scope:
            solver.step(a, b, None, None, DT)
            solver.step(b, a, None, None, DT)
        for _ in range(12):
            wp.capture_launch(scope.graph)
        found.append(a.joint_q.numpy())
    worst = float(np.abs(found[0] - found[1]).max())
    return {"joint_q_max": worst, "ok": worst < 1e-4}


CHECKS: dict[str, Callable[[str, bool], dict[str, Any]]] = {
    "accuracy": check_accuracy,
    "torch views": check_torch_views,
    "graph": check_graph,
    "worlds": check_worlds,
    "looking": check_looking,
    "newton": check_newton,
}

#: The arm among branches; its training comes last, with the time that is left.
ARM: dict[str, Callable[[str, bool], dict[str, Any]]] = {
    "arm, steps": gpu_arm.check_arm_step,
    "arm, contact": gpu_arm.check_contact,
    "arm, copies": gpu_arm.check_copies,
    "arm, planning": gpu_arm.check_planning,
    "arm, shares": gpu_arm.measure_shares,
    "arm, embedding": gpu_arm.measure_embedding,
}

#: What ``--only`` may name.
SECTIONS = (*CHECKS, *ARM, "speed", "training")


# ---- speed -------------------------------------------------------------------------------------------------------


def measure(order: int, worlds: int, substeps: int, device: str, quick: bool, drop: float = 0.0) -> dict[str, Any]:
    """Replay a graph of steps: world-steps per second (median and spread of five), memory, finite worlds."""
    trees = forest(order, worlds, drop=drop)
    begun, free = time.perf_counter(), _free(device)
    sim = simulator(trees, device, substeps=substeps)
    _bend(sim.state.coordinate.torch)
    steps = 8
    replay = sim.capture(steps)
    replay()
    wp.synchronize_device(device)
    built = time.perf_counter() - begun
    again = _repeats(replay, device, 0.02 if quick else 0.3)
    rates = sorted(worlds * steps * again / _timed(replay, device, again) for _ in range(5))
    finite = int(torch.isfinite(sim.observe()[0]).all(dim=-1).all(dim=-1).sum())
    return {
        "links": SIZES[order] if drop == 0 else f"{min(t.num_links for t in trees)}-{max(t.num_links for t in trees)}",
        "worlds": worlds,
        "substeps": substeps,
        "world_steps_per_s": rates[2],
        "spread": [rates[0], rates[-1]],
        "finite_worlds": finite,
        "bytes_state_parameters_scratch": sim.nbytes,
        "device_bytes": free - _free(device),
        "build_s": built,
        "ok": finite == worlds and not sim.state.faults(),
    }


def _bend(coordinate: torch.Tensor) -> None:
    """Turn every ball joint by some 0.1 rad, on the device: filling thousands of worlds from the host is slow."""
    torch.manual_seed(0)
    turned = coordinate + 0.05 * torch.randn_like(coordinate)
    coordinate.copy_(turned / turned.norm(dim=-1, keepdim=True))


def _timed(replay: Callable[[], None], device: str, count: int) -> float:
    begun = time.perf_counter()
    for _ in range(count):
        replay()
    wp.synchronize_device(device)
    return time.perf_counter() - begun


def _repeats(replay: Callable[[], None], device: str, seconds: float) -> int:
    return max(1, round(seconds / max(_timed(replay, device, 2) / 2, 1e-6)))


def plan(quick: bool) -> list[tuple[int, int, int, float]]:
    """List order, worlds, substeps and drop of every run, the telling ones first."""
    if quick:
        return [(2, 16, 1, 0.0), (2, 16, 4, 0.0), (2, 16, 1, 0.2)]
    counts = (4096, 16384, 1024, 256)
    plain = [(order, worlds, 1, 0.0) for worlds in counts for order in (3, 2, 4)]
    mixed = [(order, 4096, 1, 0.2) for order in (3, 4)]
    return [*plain[:3], *mixed, *plain[3:], *((order, worlds, 4, 0.0) for worlds in counts for order in (3, 2, 4))]


# ---- report ------------------------------------------------------------------------------------------------------


def machine(device: str) -> dict[str, Any]:
    """Describe processor, GPU and versions."""
    found = {"device": str(wp.get_device(device).name), **measuring.versions(), **measuring.machine()}
    if "cuda" in device:
        d = wp.get_device(device)
        found |= {"arch": d.arch, "memory_bytes": d.total_memory, "multiprocessors": d.sm_count}
    return found


def markdown(report: dict[str, Any]) -> str:
    """Render the report as tables."""
    lines = ["# bough on " + report["machine"]["device"], ""]
    lines += [f"- {key}: {value}" for key, value in report["machine"].items()]
    lines += ["", "| check | passed | found |", "| --- | --- | --- |"]
    for name, found in report["checks"].items():
        rest = ", ".join(f"{k} {_short(v)}" for k, v in found.items() if k != "ok")
        lines.append(f"| {name} | {'yes' if found['ok'] else 'NO'} | {rest} |")
    lines += ["", "| links | worlds | substeps | world-steps/s | spread | finite | MiB | build s |"]
    lines += ["| --- | --- | --- | --- | --- | --- | --- | --- |"]
    for run in report["speed"]:
        low, high = run["spread"]
        row = [run["links"], run["worlds"], run["substeps"], _short(run["world_steps_per_s"])]
        row += [f"{_short(low)} to {_short(high)}", run["finite_worlds"]]
        row += [f"{run['bytes_state_parameters_scratch'] / 2**20:.1f}", f"{run['build_s']:.1f}"]
        lines.append("| " + " | ".join(map(str, row)) + " |")
    for name, found in report["arm"].items():
        lines += ["", f"| {name} | |", "| --- | --- |", *(f"| {k} | {_short(v)} |" for k, v in found.items())]
    lines += [f"\nNot run for lack of time: {report['left_out']}."] if report["left_out"] else []
    return "\n".join(lines) + "\n"


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def save(report: dict[str, Any], out: Path) -> None:
    """Write both files."""
    text = json.dumps(report, indent=2, default=float)
    (out / "gpu.json").write_text(text + "\n", encoding="utf-8")
    (out / "gpu.md").write_text(markdown(report), encoding="utf-8")


def guarded(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Run a section; an error is a failed check, and the rest still runs."""
    begun = time.perf_counter()
    try:
        found = work()
    except Exception:
        traceback.print_exc()
        found = {"ok": False, "error": traceback.format_exc().strip().splitlines()[-1]}
    return found | {"seconds": round(time.perf_counter() - begun, 2)}


def sections(options: argparse.Namespace, report: dict[str, Any]) -> None:
    """Run every section and save the report after each; what time does not allow is named in ``left_out``."""
    begun = time.perf_counter()
    wanted = set(options.only or SECTIONS)
    for kind, work in (("checks", CHECKS), ("arm", ARM)):
        for name, section in work.items():
            if name not in wanted:
                continue
            report[kind][name] = guarded(lambda section=section: section(options.device, options.quick))
            print(name, report[kind][name], flush=True)
            save(report, options.out)
    for order, worlds, substeps, drop in plan(options.quick) if "speed" in wanted else []:
        name = f"{'mixed ' if drop else ''}{SIZES[order]} links x {worlds}, substeps {substeps}"
        if time.perf_counter() - begun > options.budget / 2:  # the other half is for training
            report["left_out"].append(name)
            continue
        run = guarded(lambda o=order, w=worlds, s=substeps, d=drop: measure(o, w, s, options.device, options.quick, d))
        print(name, run, flush=True)
        (report["speed"].append(run | {"name": name}) if "error" not in run else report["checks"].update({name: run}))
        save(report, options.out)
    if "training" not in wanted:
        return
    left = options.budget - (time.perf_counter() - begun)
    training = guarded(lambda: gpu_arm.measure_training(options.device, options.quick, left, options.out / "run"))
    report["arm"]["training"] = training
    print("training", training, flush=True)
    save(report, options.out)


def measured(options: argparse.Namespace) -> list[Figure]:
    """Run everything; return the speeds, the arm's numbers, and how many sections failed."""
    options.out.mkdir(parents=True, exist_ok=True)
    report: dict[str, Any] = {"machine": machine(options.device), "checks": {}, "arm": {}, "speed": [], "left_out": []}
    sections(options, report)
    failed = sum(not r["ok"] for r in (*report["checks"].values(), *report["arm"].values(), *report["speed"]))
    arm = [(name, key, x) for name, found in report["arm"].items() for key, x in found.items()]
    return [
        *(Figure(r["name"], "speed", r["world_steps_per_s"], "world-steps/s", tuple(r["spread"]))
          for r in report["speed"]),
        *(Figure(name, key, x) for name, key, x in arm if _is_number(x)),
        Figure("all sections", "failed", failed),
    ]  # fmt: skip


def _is_number(x: Any) -> bool:
    """Whether it is a finite number: a policy that never succeeded has some that are not."""
    return isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    found = measuring.parser_of(__doc__)
    found.add_argument("--out", type=Path, required=True, help="folder for gpu.json and gpu.md")
    found.add_argument("--device", default="cuda:0", help="Warp device")
    found.add_argument("--quick", action="store_true", help="tiny sizes, to try the script")
    found.add_argument("--only", nargs="+", choices=SECTIONS, metavar="SECTION", help=f"of {', '.join(SECTIONS)}")
    found.add_argument("--budget", type=float, default=460.0, help="seconds; measuring takes half, training the rest")
    return found


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "gpu"))
