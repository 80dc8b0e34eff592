"""Kernels that measure what passes through what: arm, branches, line and ground, of capsules where they lie.

Contact presses apart what it knows of. What it does not know of, or is too slow for, overlaps; these kernels find that
from the capsules alone, so that they judge any contact, or none.
"""

import warp as wp

__all__ = ["KINDS", "Bodies", "measure_overlaps", "note_apart"]

KINDS = ("arm and arm", "arm and branches", "arm and line", "branches and branches", "branches and line",
         "arm and ground", "branches and ground")  # fmt: skip
"""What may overlap, in the columns of `measure_overlaps`."""

TINY = wp.constant(1.0e-9)


@wp.struct
class Bodies:
    """Capsules of all worlds [worlds, C], the arm's first, radius 0 = none; the line's axis; the ground's height.

    ``link`` [arm capsules] is -1 for the arm's static base; ``pair`` [P, 2] are the arm's capsules that can meet.
    """

    start: wp.array2d(dtype=wp.vec3)
    end: wp.array2d(dtype=wp.vec3)
    radius: wp.array2d(dtype=wp.float32)
    line_start: wp.array(dtype=wp.vec3)
    line_end: wp.array(dtype=wp.vec3)
    line_radius: float
    foot: wp.array(dtype=wp.vec3)
    link: wp.array(dtype=int)
    pair: wp.array2d(dtype=int)


@wp.func
def gap_of(b: Bodies, w: int, i: int, j: int) -> float:
    """Gap of two capsules [m], negative where they overlap."""
    apart = wp.closest_point_edge_edge(b.start[w, i], b.end[w, i], b.start[w, j], b.end[w, j], TINY)[2]
    return apart - b.radius[w, i] - b.radius[w, j]


@wp.func
def line_gap(b: Bodies, w: int, i: int) -> float:
    """Gap of a capsule and the line [m]."""
    apart = wp.closest_point_edge_edge(b.start[w, i], b.end[w, i], b.line_start[w], b.line_end[w], TINY)[2]
    return apart - b.radius[w, i] - b.line_radius


@wp.func
def ground_gap(b: Bodies, w: int, i: int) -> float:
    """Gap of a capsule and the ground at the trunk's foot [m]."""
    return wp.min(b.start[w, i][2], b.end[w, i][2]) - b.radius[w, i] - b.foot[w][2]


@wp.kernel(enable_backward=False)
def note_apart(b: Bodies, apart_out: wp.array3d(dtype=wp.bool)):
    """Note which capsules are apart, on the diagonal whether they are above the ground: only such can come to overlap.

    A branch and the one that it grows from always overlap, and the trunk stands in the ground.
    """
    w, i, j = wp.tid()
    there = b.radius[w, i] > 0.0 and b.radius[w, j] > 0.0
    if i == j:
        apart_out[w, i, j] = there and ground_gap(b, w, i) > 0.0
    else:
        apart_out[w, i, j] = there and gap_of(b, w, i, j) > 0.0


@wp.kernel(enable_backward=False)
def measure_overlaps(
    b: Bodies, apart_in: wp.array3d(dtype=wp.bool), mask_in: wp.array(dtype=wp.bool), least: float,
    steps_out: wp.array2d(dtype=int), depth_out: wp.array2d(dtype=wp.float32),
):  # fmt: skip
    """Count, by `KINDS`, a step of a masked world in which something is deeper than ``least``; keep the deepest [m]."""
    w = wp.tid()
    if not mask_in[w]:
        return
    depth = wp.vector(dtype=wp.float32, length=7)
    arms = b.link.shape[0]
    for p in range(b.pair.shape[0]):
        depth[0] = wp.max(depth[0], -gap_of(b, w, b.pair[p, 0], b.pair[p, 1]))
    for i in range(b.radius.shape[1]):
        if b.radius[w, i] > 0.0:
            if i < arms:
                if b.link[i] >= 0:
                    depth[2] = wp.max(depth[2], -line_gap(b, w, i))
                if b.link[i] > 0:
                    depth[5] = wp.max(depth[5], -ground_gap(b, w, i))
            else:
                depth[4] = wp.max(depth[4], -line_gap(b, w, i))
                if apart_in[w, i, i]:
                    depth[6] = wp.max(depth[6], -ground_gap(b, w, i))
                for j in range(i):
                    if apart_in[w, i, j]:
                        kind = wp.where(j < arms, 1, 3)
                        depth[kind] = wp.max(depth[kind], -gap_of(b, w, i, j))
    for k in range(7):
        if depth[k] > least:
            steps_out[w, k] = steps_out[w, k] + 1
        depth_out[w, k] = wp.max(depth_out[w, k], depth[k])
