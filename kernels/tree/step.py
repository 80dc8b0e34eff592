"""Kernels that advance worlds in time."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.real import SOURCE
from .articulated import advance, advance_loaded
from .layout import layout_of
from .momentum import HELD, add_gravity, add_impulses, restore_momentum, sum_momentum

__all__ = ["step_kernels"]


@cache
def step_kernels(width: int = 1, precision: int = 32, free: bool = False) -> SimpleNamespace:
    """Return the kernels ``step`` and ``step_loaded`` for a lane width and precision.

    Both take ``substeps`` steps of ``h`` [s] in every group ``first + tid``. ``row`` is the scratch row to work in
    when threads take turns in one (CPU); -1 gives every group its own (GPU). With ``free`` the momentum of trees that
    nothing holds is kept (`momentum`); without, nothing of it is compiled.
    """
    t = layout_of(width, precision)
    return SimpleNamespace(step=_step_kernel(t, free), step_loaded=_loaded_kernel(t, free))


def _step_kernel(t: SimpleNamespace, free: bool) -> Any:
    """Kernel of worlds under gravity alone."""
    Model, State, Scratch = t.Model, t.State, t.Scratch

    @wp.kernel(enable_backward=False, module="unique")
    def step(
        m: Model, x_in_out: State, s_out: Scratch, first: int, row: int, substeps: int, h: wp.float64, bound: wp.float64
    ):
        """Advance a group by ``substeps`` steps of ``h`` [s] under gravity."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        for _k in range(substeps):
            if wp.static(free):
                if m.free[e] != HELD:
                    sum_momentum(e, r, m, x_in_out, s_out)
                    add_gravity(r, s_out, h)
            advance(e, r, m, x_in_out, s_out, h, bound)
            if wp.static(free):
                if m.free[e] != HELD:
                    restore_momentum(e, r, m, x_in_out, s_out)

    return step


def _loaded_kernel(t: SimpleNamespace, free: bool) -> Any:
    """Kernel of worlds under forces at points of the links and efforts at the joints."""
    Model, State, Load, Scratch = t.Model, t.State, t.Load, t.Scratch

    @wp.kernel(enable_backward=False, module="unique")
    def step_loaded(
        m: Model, x_in_out: State, u_in: Load, s_out: Scratch, first: int, row: int, substeps: int, h: wp.float64,
        bound: wp.float64,
    ):  # fmt: skip
        """Advance a group by ``substeps`` steps of ``h`` [s] under gravity and the load ``u_in``."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        for _k in range(substeps):
            if wp.static(free):
                if m.free[e] != HELD:
                    sum_momentum(e, r, m, x_in_out, s_out)
                    add_gravity(r, s_out, h)
                    add_impulses(e, r, m, u_in, s_out, h)
            advance_loaded(e, r, m, x_in_out, u_in, s_out, h, bound)
            if wp.static(free):
                if m.free[e] != HELD:
                    restore_momentum(e, r, m, x_in_out, s_out)

    return step_loaded
