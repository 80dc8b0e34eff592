"""Training as processes: killed at any moment and gone on with, and several that learn one policy."""

import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from bough.cli.train import Train
from bough.learn.runs.folder import MODEL, RunFolder
from bough.learn.tasks.ppo_settings import PRESETS
from oracles.reach.task import registry
from oracles.reach.train import TINY

TRAIN = Path(__file__).resolve().parents[2] / "oracles" / "reach" / "train.py"
GRADIENTS = Path(__file__).resolve().parents[2] / "oracles" / "reach" / "gradients.py"


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    """Take the preset that the processes take."""
    monkeypatch.setitem(PRESETS, "cpu", TINY)


def start(*arguments: object, launcher: tuple[str, ...] = ()) -> subprocess.Popen:
    """Start training in a process of its own."""
    command = [sys.executable, *launcher, *map(str, arguments)]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            text=True)  # fmt: skip


def train(out: Path, iterations: int, **options) -> None:
    """Train in this process."""
    assert Train("reach", out, iterations=iterations, **options).run(registry()) == 0


def bits(folder: Path, name: str = MODEL) -> bytes:
    """Return the newest checkpoint's file of a state, which holds every bit of it."""
    return (RunFolder(folder).newest().path / f"{name}.pt").read_bytes()


def assert_same_end(folder: Path, other: Path) -> None:
    """Compare parameters, optimiser, task and random numbers of two runs to the last bit."""
    for name in (MODEL, "rank-0"):
        assert bits(folder, name) == bits(other, name), name


def test_killed_at_a_random_moment_and_resumed(tmp_path):
    """Kill a run after a random time, go on with it, and end with the bits of the run that nobody killed."""
    out, wait = tmp_path / "killed", random.SystemRandom().uniform(0.0, 2.0)
    process = start(TRAIN, "reach", "--out", out, "--iterations", 100_000)
    until = time.monotonic() + 60.0
    while not RunFolder(out).newest() and time.monotonic() < until and process.poll() is None:
        time.sleep(0.02)
    time.sleep(wait)
    assert process.poll() is None, process.communicate()
    process.send_signal(signal.SIGKILL)
    process.communicate()
    rows, saved = len(RunFolder(out).metrics()), RunFolder(out).newest().check("reach", 1)
    print(f"killed {wait:.3f} s after the first checkpoint, in iteration {rows + 1}, checkpoint of {saved}")
    assert saved >= 2
    train(out, saved + 3, resume=True)
    train(tmp_path / "whole", saved + 3)
    assert_same_end(out, tmp_path / "whole")
    assert len(RunFolder(out).metrics()) == saved + 3


def test_killed_while_a_checkpoint_is_written(tmp_path):
    """Keep the checkpoint before, though half of the next is on the disk, and go on from it.

    A checkpoint is five files, each with an fsync, and one of its folder; before the first, config.json is written.
    The tenth is therefore of the second checkpoint's network.
    """
    out = tmp_path / "killed"
    process = start(TRAIN, "--die-in-save", 10, "reach", "--out", out, "--iterations", 5)
    process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL
    (part,) = (out / "checkpoints").glob(".*.part")
    assert part.name == ".000004.part" and (part / "model.pt").stat().st_size == 100
    assert RunFolder(out).newest().check("reach", 1) == 2
    train(out, 5, resume=True)
    train(tmp_path / "whole", 5)
    assert_same_end(out, tmp_path / "whole")
    assert [p.name for p in (out / "checkpoints").iterdir()] == ["000005"]


# ---- several processes -----------------------------------------------------------------------------------------------


def torchrun(*arguments: object) -> subprocess.CompletedProcess:
    """Run a script in two processes on this machine."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    launcher = ("-m", "torch.distributed.run", "--nproc-per-node=2", "--master-addr=127.0.0.1", f"--master-port={port}")
    command = [sys.executable, *launcher, *map(str, arguments)]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=120, check=False,
                          env=environment)  # fmt: skip


def test_two_processes_learn_one_policy(tmp_path):
    """Average the gradients of different worlds, keep parameters and normalisers equal, and go on to the same bits."""
    done = torchrun(GRADIENTS, tmp_path)
    assert done.returncode == 0, done.stderr
    first, second = (torch.load(tmp_path / f"rank-{r}.pt", weights_only=True) for r in (0, 1))
    assert len(first["before"]) == len(second["before"]) == 2 * 20  # iterations x epochs x mini-batches
    for a, b, after_a, after_b in zip(first["before"], second["before"], first["after"], second["after"], strict=True):
        assert not torch.equal(a, b)  # other worlds, other gradients
        mean = ((a.double() + b.double()) / 2).float()
        # A float32 sum of two and an exact half: within a rounding of the float64 mean.
        torch.testing.assert_close(after_a, mean, rtol=1e-6, atol=1e-12)
        assert torch.equal(after_a, after_b)
    assert first["networks"].keys() == second["networks"].keys()
    for name, value in first["networks"].items():
        assert torch.equal(value, second["networks"][name]), name
    assert int(first["networks"]["actor.obs_normalizer.count"]) == 2 * 2 * 8 * 32  # samples of both processes
    rows = RunFolder(tmp_path / "run").metrics()
    assert [row["steps"] for row in rows] == [2 * 8 * 32, 2 * 2 * 8 * 32]
    for name in (MODEL, "rank-0", "rank-1"):  # cut after the first iteration and gone on with, against at one go
        assert bits(tmp_path / "run", name) == bits(tmp_path / "cut", name)
