"""Keep the last states of every world in a ring on the device, so that a fault can be looked at afterwards."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.real import SOURCE

__all__ = ["keep_kernels"]


@cache
def keep_kernels(precision: int = 32) -> SimpleNamespace:
    """Return ``keep`` (over [groups, places + 1]) and ``turn`` (over [groups]) for a precision.

    The ring has ``size`` entries; entry n of group g is row n * groups + g of the outputs. ``written`` [groups] counts
    what was kept, so that nothing of where the next state goes comes from the host. A frozen world keeps what it had.
    """
    Scalar: Any = wp.float64 if precision == 64 else wp.float32

    @wp.kernel(enable_backward=False, module="unique")
    def keep(
        size: int, groups: int, written: wp.array(dtype=int), tick: wp.array(dtype=int),
        alive_in: wp.array4d(dtype=Scalar), coordinate_in: wp.array4d(dtype=Scalar),
        velocity_in: wp.array4d(dtype=Scalar), tick_out: wp.array2d(dtype=int),
        coordinate_out: wp.array4d(dtype=Scalar), velocity_out: wp.array4d(dtype=Scalar),
    ):  # fmt: skip
        """Write the state at place i of the alive worlds of group g into the ring's present entry."""
        tag = SOURCE  # noqa: F841
        g, i = wp.tid()
        row = (written[g] % size) * groups + g
        for k in range(tick_out.shape[1]):
            if alive_in[g, 0, 0, k] > Scalar(0.0):
                if i == 0:
                    tick_out[row, k] = tick[g]
                for c in range(4):
                    coordinate_out[row, i, c, k] = coordinate_in[g, i, c, k]
                for c in range(3):
                    velocity_out[row, i, c, k] = velocity_in[g, i, c, k]

    @wp.kernel(enable_backward=False, module="unique")
    def turn(written: wp.array(dtype=int)):
        """Move the ring on by one entry."""
        tag = SOURCE  # noqa: F841
        g = wp.tid()
        written[g] = written[g] + 1

    return SimpleNamespace(keep=keep, turn=turn)
