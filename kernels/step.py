"""Kernels that advance worlds in time."""

from functools import cache, lru_cache
from types import SimpleNamespace

import warp as wp

from .articulated import advance, advance_loaded
from .layout import layout_of
from .real import SOURCE

__all__ = ["step_kernels"]


@cache
def step_kernels(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return the kernels ``step`` and ``step_loaded`` for a lane width and precision.

    Both take ``substeps`` steps of ``h`` [s] in every group ``first + tid``. ``row`` is the scratch row to work in
    when threads take turns in one (CPU); -1 gives every group its own (GPU).
    """
    t = layout_of(width, precision)
    Model, State, Load, Scratch = t.Model, t.State, t.Load, t.Scratch

    @wp.kernel(enable_backward=False, module="unique")
    def step(
        m: Model, x_in_out: State, s_out: Scratch, first: int, row: int, substeps: int, h: wp.float64, bound: wp.float64
    ):
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        for _k in range(substeps):
            advance(e, r, m, x_in_out, s_out, h, bound)

    @wp.kernel(enable_backward=False, module="unique")
    def step_loaded(
        m: Model,
        x_in_out: State,
        u_in: Load,
        s_out: Scratch,
        first: int,
        row: int,
        substeps: int,
        h: wp.float64,
        bound: wp.float64,
    ):
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        for _k in range(substeps):
            advance_loaded(e, r, m, x_in_out, u_in, s_out, h, bound)

    return SimpleNamespace(step=step, step_loaded=step_loaded)
