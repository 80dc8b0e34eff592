"""Copy every world of one batch into many worlds of another, link by link."""

from typing import Any

import warp as wp

__all__ = ["copy_links"]


@wp.kernel(enable_backward=False)
def copy_links(
    slot_in: wp.array2d(dtype=int),
    place_in: wp.array2d(dtype=int),
    rows: int,
    field_in: wp.array4d(dtype=Any),
    field_out: wp.array4d(dtype=Any),
):
    """field_out[slot, place] <- field_in[slot_in, place_in] in every component of every row; nothing where it is -1.

    Fields are [groups, rows * stride, components, lanes], slot = group * lanes + lane, stride the places of a row;
    ``slot_in`` and ``place_in`` are [slots, stride] of the field that is written.
    """
    slot, place = wp.tid()
    source = slot_in[slot, place]
    if source < 0:
        return
    from_lanes = field_in.shape[3]
    lanes = field_out.shape[3]
    from_stride = field_in.shape[1] // rows
    stride = field_out.shape[1] // rows
    for row in range(rows):
        for c in range(field_out.shape[2]):
            field_out[slot // lanes, row * stride + place, c, slot % lanes] = field_in[
                source // from_lanes, row * from_stride + place_in[slot, place], c, source % from_lanes]  # fmt: skip
