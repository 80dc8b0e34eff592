"""``bough replay``: step a frozen world again and show how its fault arose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ..sim.base.console import start_warp, tell
from ..sim.base.errors import InputError
from .base.exit_codes import ExitCode

if TYPE_CHECKING:
    from ..sim.engine.last_states import Fault
    from ..sim.engine.replay_fault import Replay as Replayed

SHOWN = 12
"""Moments before the fault that are printed, the first of all beside them."""


@dataclass(frozen=True)
class Replay:
    """Step a world that was frozen again, from the first of its last states, and print how its fault arose.

    Prints the fastest joint and the energy before every step, then in which step and quantity the world was lost.
    Exit code 0: as it was; 3: the replay came to another end than the world did.

    Attributes:
        file: A file that bough simulate --dump-faults wrote.
        json: Print where the world was lost as JSON instead of a sentence.
    """

    file: tyro.conf.Positional[Path]
    json: bool = False

    def run(self) -> int:
        """Replay the file, print what happened and return the exit code."""
        if not self.file.exists():  # said before Warp is there
            raise InputError(self.file, "", "no such file", "a file that bough simulate --dump-faults wrote")
        start_warp()
        from ..sim.engine.last_states import Fault
        from ..sim.engine.replay_fault import replay

        fault = Fault.read(self.file)
        found = replay(fault)
        same = found.tick == fault.fault_tick and found.link == fault.link
        result = {"as_it_was": same, "substep": found.tick, "joint_of": found.link, "quantity": found.quantity,
                  "quantity_of": found.place}  # fmt: skip
        tell("\n".join([*_table(found), _end(fault, found)]), result, self.json)
        return ExitCode.DONE if same else ExitCode.NOT_TRUSTED


def _table(found: Replayed) -> list[str]:
    """Return a line a moment, the first and the last ones."""
    moments = found.moments if len(found.moments) <= SHOWN else [found.moments[0], *found.moments[1 - SHOWN :]]
    lines = ["    time [s]  fastest joint         speed  kinetic [J]   energy [J]  from kept"]
    for m in moments:
        kinetic, energy = m.energy
        lines.append(f"{m.time:12.6g}  {m.link[:16]:<16}{m.speed:11.4g}{kinetic:13.4g}{energy:13.4g}{m.astray:11.2g}")
    return lines


def _end(fault: Fault, found: Replayed) -> str:
    """Return in one sentence how it ended."""
    world = f"world {int(fault.arrays['world'])}"
    if found.tick is None:
        return f"{world} was not lost again: memories of effects begin empty in a replay."
    time = found.tick * float(fault.arrays["dt"]) / int(fault.arrays["substeps"])
    lost = f"{world} was lost at {time:.6g} s, substep {found.tick}, in the joint of link {found.link}: "
    if not found.quantity:
        return f"{lost}it would have been faster than {found.max_speed:.4g} a second."
    return f"{lost}the {found.quantity} of link {found.place} was no longer finite."
