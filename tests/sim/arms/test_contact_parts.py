"""Contact's step in three kernels and by teams of threads, as on a GPU, run on a CPU: the bits of the one kernel."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import warp as wp
from bough.sim.arms.simulator import ArmSimulator
from bough.sim.base.host import num_cores
from bough.sim.base.thread_pool import Launches, recorded
from bough.sim.engine import launcher
from oracles.contact_case import LAWS, act, bits, busy, give, same

ALL = {"arm_arm": True, "branch_branch": True}


def stepped(sim: ArmSimulator, steps: int) -> list[np.ndarray]:
    """Return what busy steps leave; in one of them some world has ten contacts and more."""
    assert max(act(sim, steps, look=lambda sim: int(sim._touch.count.max()))) >= 10
    return bits(sim)


def split(monkeypatch) -> None:
    """Let every group of what is made from here on have a scratch row of its own, as on a GPU."""
    monkeypatch.setattr(launcher, "rows_by_group", lambda device: True)


@pytest.mark.parametrize("options", [{}, {"contacts": ALL}, {"substeps": 3}], ids=["arm", "all", "substeps"])
def test_three_kernels_have_the_bits_of_one(options, monkeypatch):
    """Step 24 worlds by one kernel and by three: arm, branches, forces and torques keep their bits."""
    one = busy(24, **options)
    split(monkeypatch)
    three = busy(24, **options)
    same(stepped(one, 96), stepped(three, 96))


def test_three_kernels_have_the_bits_of_one_beside_laws(monkeypatch):
    """Step 8 worlds whose branches obey laws, one of them of the time: the same bits."""
    laws = {"effects": tuple(LAWS), "substeps": 2}
    one = busy(8, **laws)
    split(monkeypatch)
    three = busy(8, **laws)
    for sim in (one, three):
        give(sim.effects)
        act(sim, 48)
    same(bits(one), bits(three))


def in_threads(parts: list, groups: int) -> Callable[[], None]:
    """Return what launches kernels one after the other, those of teams by a thread of the operating system each."""

    def share(kernel, inputs: list, thread: int) -> Launches:
        return Launches([recorded(kernel, (groups, 1), [*inputs[:-2], thread, inputs[-1]], "cpu", 1)])

    def together(shares: list[Launches]) -> None:
        workers = [threading.Thread(target=own, daemon=True) for own in shares]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join(timeout=60.0)
            assert not worker.is_alive(), "a team's threads wait for each other in vain"

    turns: list[Callable[[], None]] = []
    for kernel, team, inputs in parts:
        launcher.load(kernel.module, wp.get_device("cpu"), 1)
        if team is None:
            turns.append(Launches([recorded(kernel, groups, inputs, "cpu", 1)]))
        else:
            turns.append(partial(together, [share(kernel, inputs, k) for k in range(team)]))
    return lambda: [turn() for turn in turns]


def spoil(sim: ArmSimulator) -> None:
    """Overwrite what a solve works in: whatever it reads it must have written."""
    for name in ("branch", "total", "arm", "free", "velocity", "n", "f", "alpha", "accel"):
        sim._touch._space_fields[name].torch.fill_(float("nan"))
    for name in ("matrix", "right"):
        wp.to_torch(sim._touch._space[name]).fill_(float("nan"))
    wp.to_torch(sim._touch._space["pressing"]).fill_(-1)


@pytest.mark.skipif(num_cores() < 2, reason="threads of a team wait for each other without sleep")
def test_a_team_of_two_threads_finds_the_bits_of_one(monkeypatch):
    """Step 24 worlds by one thread a world and by two that write, wait and read as a warp's do: the same bits."""
    split(monkeypatch)
    one = busy(24, contacts=ALL)
    monkeypatch.setattr(launcher, "team_of", lambda device: 2)
    monkeypatch.setattr(launcher.Launcher, "prepare_parts", lambda self, parts: in_threads(parts, self.model.groups))
    two = busy(24, contacts=ALL)
    for sim in (one, two):
        spoil(sim)
    same(stepped(one, 72), stepped(two, 72))
