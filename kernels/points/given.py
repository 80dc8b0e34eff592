"""Points of branches that were seen instead of drawn, put where drawn ones lie (`kernels.points.cloud`)."""

from functools import cache
from typing import Any

import warp as wp

from ..lanes.real import SOURCE
from .cloud import BRANCHES, Shapes, bound_chunks, bound_tile, cloud_types, mark_near

__all__ = ["given_kernel"]


@cache
def given_kernel(width: int = 1) -> Any:
    """Return the kernel that puts seen points into the branches' clouds, thread (world).

    ``point_in`` [worlds, 3, points] in m is copied to the bit; ``present_in`` [worlds] is 0 where nothing was seen.
    """
    t = cloud_types(width)
    Clouds, W = t.Clouds, width

    @wp.kernel(enable_backward=False, module="unique")
    def given(
        point_in: wp.array3d(dtype=wp.float32), present_in: wp.array(dtype=int), target_in: Shapes, zoom: float,
        first: int, first_row: int, c_out: Clouds,
    ):  # fmt: skip
        """Copy a world's seen points into its branches' cloud, note their bounds and mark those near the target."""
        tag = SOURCE  # noqa: F841
        i = wp.tid()
        w = first + i
        row = first_row + i
        for m in range(3):
            for p in range(point_in.shape[2]):
                c_out.flat[row, BRANCHES, m, p] = point_in[w, m, p]
        c_out.present[row, BRANCHES] = present_in[w]
        if wp.static(W > 1):
            bound_chunks(row, BRANCHES, W, c_out)
        else:
            for j in range(c_out.bound.shape[3]):
                bound_tile(row, BRANCHES, j, c_out)
        for j in range(c_out.point.shape[3]):
            mark_near(w, target_in, zoom, row, BRANCHES, j, c_out)

    return given
