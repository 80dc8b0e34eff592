"""``bough train``, ``evaluate`` and ``play`` on the task of this folder: what a test runs as a process of its own.

The preset for the CPU is a tiny one there. ``--die-in-save N`` (before the command) kills the process in the middle of
its N-th write that is to be safe.
"""

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import tyro

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bough.cli.train import Train
from bough.learn.tasks.ppo_settings import PRESETS
from oracles.reach.task import registry

TINY = replace(PRESETS["cpu"], num_envs=8, horizon=8, hidden=(16,), checkpoint_every=2)


def short_run(out: Path, seed: int = 0) -> Path:
    """Train for two iterations into a folder and return it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "cpu", TINY)
        assert Train("reach", out, iterations=2, seed=seed).run(registry()) == 0
    return out


def die_in_save(number: int) -> None:
    """Kill this process when half of the N-th state is on its way to the disk."""
    write, left = os.fsync, [number]

    def fsync(handle):
        write(handle)
        left[0] -= 1
        if not left[0]:
            os.ftruncate(handle, 100)
            os.kill(os.getpid(), signal.SIGKILL)

    os.fsync = fsync


if __name__ == "__main__":
    arguments = sys.argv[1:]
    if arguments[0] == "--die-in-save":
        die_in_save(int(arguments[1]))
        del arguments[:2]
    PRESETS["cpu"] = TINY
    sys.exit(tyro.cli(Train, args=arguments).run(registry()))
