"""How worlds are stepped, and whether that fits into memory; known before Warp is there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from ..base.errors import InputError
from ..base.host import check_memory

_WORLD_BYTES = 3000  # of host memory a link while its model is built (2835 measured with 4000 trees of 17 links)


@dataclass(frozen=True)
class Stepping:
    """How worlds are stepped.

    Attributes:
        dt: Step [s].
        substeps: Equal parts that every step is taken in.
        precision: Bits of a number.
        device: Warp device; None takes Warp's first choice.
    """

    dt: float = 1.0 / 240.0
    substeps: int = 1
    precision: Literal[32, 64] = 64
    device: str | None = None

    def steps(self, seconds: float) -> int:
        """Return the number of steps in a time, round(seconds / dt).

        Raises:
            InputError: It is zero or beyond all numbers.
        """
        if not math.isfinite(seconds / self.dt):
            raise InputError("--seconds", "", f"{seconds:g} s in steps of {self.dt:g} s", "a finite number of steps")
        steps = round(seconds / self.dt)
        if steps < 1:
            raise InputError("--dt", "", f"{self.dt:g} s", f"a step no longer than the {seconds:g} s to be simulated")
        return steps

    def check_memory(self, steps: int, worlds: int, links: int) -> None:
        """Raise `InputError` if the worlds and their trajectory cannot fit into the machine's memory."""
        trajectory = 7 * (self.precision // 8) * (steps + 1) * worlds * links
        what = f"{worlds} worlds of {links} links at {steps + 1:.6g} times"
        check_memory("--worlds, --seconds, --dt", what, float(trajectory + _WORLD_BYTES * worlds * links))
