"""What a GPU will run, tried without one: its memory order, its compiler."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import bough.kernels.tree.newton_exchange as newton_exchange
import bough.sim.engine.arrays as arrays
import numpy as np
import pytest
import torch
import warp as wp
from bough.kernels.contact.look import capsule_kernel
from bough.kernels.contact.reset_arm import reset_arm_kernel
from bough.kernels.contact.step import StepParts, contact_step_parts
from bough.kernels.tree.exchange import exchange_kernels
from bough.kernels.tree.rollout import rollout_kernels
from bough.sim.engine.forest_effects import forest_terms
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.newton.bridge import to_newton
from bough.sim.newton.solver import BoughSolver
from bough.sim.trees.tree import Joint
from oracles.random_tree import random_qpos, random_tree

ALL = (Joint.SPHERICAL, Joint.REVOLUTE, Joint.PRISMATIC, Joint.FIXED)


def _trees(seed=3, count=9):
    rng = np.random.default_rng(seed)
    return [random_tree(rng, int(n), joints=ALL, bent_rest=True, preloaded=True) for n in rng.integers(1, 12, count)]


def _everything(trees, width):
    """Pose, step under load, reset one world, probe: all that the arrays' memory order could spoil."""
    model = Model(trees, width=width, device="cpu")
    simulator = Simulator(model, dt=1 / 240)
    rng = np.random.default_rng(0)
    simulator.state.set_qpos([random_qpos(rng, t, 0.3) for t in trees])
    simulator.refresh()
    simulator.mark_start()
    simulator.load.force.torch[..., 1:, :] = torch.tensor([0.1, -0.2, 0.3])
    simulator.step(5)
    mask = torch.zeros(len(trees), dtype=torch.bool)
    mask[2] = True
    simulator.reset(mask)
    simulator.step(3)
    position, rotation = simulator.observe()
    out = {"position": position.clone(), "rotation": rotation.clone()}
    out["energy"], out["momentum"] = map(torch.from_numpy, simulator.energy())
    if width == 1:
        out["probe"], out["speed"] = simulator.probes([[(t.num_links - 1, np.ones(3))] for t in trees]).read()
    out |= {f"qpos {w}": torch.from_numpy(q) for w, q in enumerate(simulator.state.qpos())}
    return out | {f"qvel {w}": torch.from_numpy(q) for w, q in enumerate(simulator.state.qvel())}


@pytest.mark.parametrize("width", [1, 8])
def test_memory_order_of_a_gpu_gives_the_same_bits(monkeypatch, width):
    """Lay all arrays out link by link, as on a GPU: every pose, rate, probe and energy keeps its bits."""
    trees = _trees()
    here = _everything(trees, width)
    monkeypatch.setattr(arrays, "link_major", lambda device: True)
    there = _everything(trees, width)
    assert here.keys() == there.keys()
    for name, value in here.items():
        assert torch.equal(value, there[name]), name


def test_arrays_lie_link_by_link_on_a_gpu(monkeypatch):
    """Check the order the test above relies on: neighbours in memory are neighbouring worlds."""
    monkeypatch.setattr(arrays, "link_major", lambda device: True)
    array = arrays.LaneArray("Vec", groups=5, places=7, device="cpu")
    assert array.kernel.shape == (5, 7)
    assert array.kernel.strides == (12, 5 * 12)
    assert arrays.integer_array(np.zeros((5, 7), np.int64), "cpu").strides == (4, 5 * 4)


def test_newton_solver_keeps_its_bits_in_the_memory_order_of_a_gpu(monkeypatch):
    """Step a Newton model with arrays laid out link by link: Newton's own arrays keep their bits."""
    model, got = to_newton(_trees(), device="cpu"), []
    for flipped in (False, True):
        if flipped:
            monkeypatch.setattr(arrays, "link_major", lambda device: True)
        solver, state = BoughSolver(model), model.state()
        state.body_f.fill_(0.1)
        for _ in range(5):
            solver.step(state, state, None, None, 1 / 240)
        got.append(np.concatenate([state.joint_q.numpy(), state.joint_qd.numpy(), state.body_q.numpy().ravel()]))
    np.testing.assert_array_equal(*got)
    assert np.isfinite(got[0]).all()


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp for macOS is built without CUDA")
@pytest.mark.parametrize("kernel", [
    *vars(rollout_kernels(1, 32)).values(), newton_exchange.read_state, exchange_kernels(32).set_qpos,
])  # fmt: skip
def test_kernels_compile_for_a_gpu(kernel, tmp_path):
    """Compile the kernels that replay trajectories and serve Newton to an H200's machine code, without a GPU."""
    (binary,) = wp.compile_aot_module(kernel.module, arch=90, module_dir=tmp_path, use_ptx=False)
    assert binary.name.endswith(".sm90.cubin")
    assert binary.read_bytes()[:4] == b"\x7fELF"


def contact_with_laws():
    """Return what comes before contacts, with a law of every kind."""
    return contact_step_parts(6, forest_terms(("plastic_set", "steady_wind", "tip_mass"))[0]).approach


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp for macOS is built without CUDA")
@pytest.mark.parametrize("make", [
    *(lambda name=name: getattr(contact_step_parts(6), name) for name in StepParts._fields),
    contact_with_laws, lambda: capsule_kernel(1, 6), lambda: reset_arm_kernel(6),
], ids=[*(f"contact-{name}" for name in StepParts._fields), "contact-laws", "capsules", "reset"])  # fmt: skip
def test_kernels_of_the_arm_compile_for_a_gpu(make, tmp_path):
    """Compile contact's step for sm_90; it computes in float32 only, lengths of steps and world's clocks apart."""
    (file,) = wp.compile_aot_module(make().module, arch=90, module_dir=tmp_path, use_ptx=True)
    text = file.read_text()
    assert ".target sm_90" in text
    assert len(re.findall(r"(?:mul|fma|div|sqrt)\S*\.f64", text)) < 8


def test_the_gpu_benchmark_runs_on_a_cpu(tmp_path):
    """Run benchmarks/gpu.py in its smallest form: every check passes and every world stays finite."""
    script = Path(__file__).parents[3] / "benchmarks" / "gpu.py"
    command = [sys.executable, str(script), "--device", "cpu", "--quick", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads((tmp_path / "gpu.json").read_text())
    assert len(report["checks"]) == 6 and all(check["ok"] for check in report["checks"].values())
    assert list(report["arm"]) == [
        "arm, steps",
        "arm, contact",
        "arm, copies",
        "arm, planning",
        "arm, shares",
        "arm, embedding",
        "training",
    ]
    assert all(section["ok"] for section in report["arm"].values())
    assert [run["finite_worlds"] for run in report["speed"]] == [16, 16, 16]
    assert (tmp_path / "gpu.md").read_text().count("| yes |") == 6
