"""Embedding and occlusion of clouds that come from outside: points [batch, N, 3] in any strides, masks [batch, N].

Equations in `embedding` and `nearest`. Points lie one after the other, so 8 or 16 of them are gathered into lanes.
"""

from functools import cache
from typing import Any

import warp as wp

from ..lanes.across import below, cosine_pi, lane_sum, sine_pi
from ..lanes.real import REAL_OF_WIDTH, SOURCE, add, fma, mul, real, real_type, sub
from .embedding import part_turn, write_feature
from .nearest import squared

__all__ = ["count_pairs_kernel", "embed_points_kernel"]

F = wp.float32


@wp.func
def coordinates(points: wp.array3d(dtype=wp.float32), b: int, n: int, axis: int, like: F):
    """Coordinate ``axis`` of points n, n + 1, ... of cloud b; 0 beyond the last."""
    return points[b, n, axis]


@wp.func
def weights(mask: wp.array2d(dtype=wp.bool), masked: int, b: int, n: int, count: int, like: F):
    """1 for points n, n + 1, ... of cloud b that count, 0 for those masked and beyond the last."""
    if masked == 0:
        return 1.0
    return wp.where(mask[b, n], 1.0, 0.0)


def _gather(width: int, value: str) -> str:
    """C++ that fills lanes from memory at a stride, one point a lane."""
    return (
        f"wp::vec_t<{width},float> o; int left=count-n;"
        f"if(left>={width}) {{ for(int i=0;i<{width};++i) o.c[i]={value}; }}"
        f"else {{ for(int i=0;i<{width};++i) o.c[i]=i<left ? {value} : 0.0f; }} return o;"
    )


_POINT = "*(const float*)((const char*)points.data+b*points.strides[0]+(n+i)*points.strides[1]+axis*points.strides[2])"
_MASK = "(!masked||*(const bool*)((const char*)mask.data+b*mask.strides[0]+(n+i)*mask.strides[1])?1.0f:0.0f)"

for _W in (8, 16):
    V = wp.types.vector(_W, F)
    Lanes = REAL_OF_WIDTH[_W]

    @wp.func_native(_gather(_W, _POINT))
    def _coordinates(points: wp.array3d(dtype=wp.float32), b: int, n: int, axis: int, count: int, like: V) -> V: ...

    @wp.func_native(_gather(_W, _MASK))
    def _weights(mask: wp.array2d(dtype=wp.bool), masked: int, b: int, n: int, count: int, like: V) -> V: ...

    @wp.func
    def coordinates(points: wp.array3d(dtype=wp.float32), b: int, n: int, axis: int, like: Lanes):
        """Coordinate ``axis`` [m] of points n, n + 1, ... of cloud b, a point a lane; 0 beyond the last."""
        return type(like)(_coordinates(points, b, n, axis, points.shape[1], like.v))

    @wp.func
    def weights(mask: wp.array2d(dtype=wp.bool), masked: int, b: int, n: int, count: int, like: Lanes):
        """1 for points n, n + 1, ... of cloud b that count, a point a lane; 0 for those masked and beyond the last."""
        return type(like)(_weights(mask, masked, b, n, count, like.v))


del V, Lanes


@wp.func(inline=True)
def embed_frequency(
    f: int, b: int, points_in: wp.array3d(dtype=wp.float32), mask_in: wp.array2d(dtype=wp.bool), masked: int,
    waves_in: wp.array(dtype=wp.vec3), scale: float, embedding_out: wp.array2d(dtype=wp.float32),
):  # fmt: skip
    """Write the feature of frequency f of cloud b, point after point."""
    weight = wp.float32(0.0)
    s2 = wp.float32(0.0)
    sc = wp.float32(0.0)
    for n in range(points_in.shape[1]):
        m = weights(mask_in, masked, b, n, points_in.shape[1], weight)
        turn = part_turn(waves_in[f], points_in[b, n, 0], points_in[b, n, 1], points_in[b, n, 2])
        s = sine_pi(turn)
        ms = m * s
        weight = weight + m
        s2 = fma(ms, s, s2)
        sc = fma(ms, cosine_pi(turn), sc)
    write_feature(s2, sc, weight, scale, b, 2 * f, embedding_out)


@wp.func(inline=True)
def embed_lanes(
    b: int, width: int, points_in: wp.array3d(dtype=wp.float32), mask_in: wp.array2d(dtype=wp.bool), masked: int,
    waves_in: wp.array(dtype=wp.vec3), scale: float, row: int, sum_out: Any,
    embedding_out: wp.array2d(dtype=wp.float32),
):  # fmt: skip
    """Write the features of all frequencies of cloud b, ``width`` points at a time."""
    count = points_in.shape[1]
    zero = real(0.0, sum_out[row, 0])
    total = zero
    for r in range(2 * waves_in.shape[0]):
        sum_out[row, r] = zero
    for chunk in range((count + width - 1) // width):
        n = chunk * width
        x = coordinates(points_in, b, n, 0, zero)
        y = coordinates(points_in, b, n, 1, zero)
        z = coordinates(points_in, b, n, 2, zero)
        m = weights(mask_in, masked, b, n, count, zero)
        total = total + m
        for r in range(waves_in.shape[0]):
            turn = part_turn(waves_in[r], x, y, z)
            s = sine_pi(turn)
            ms = m * s
            sum_out[row, 2 * r] = fma(ms, s, sum_out[row, 2 * r])
            sum_out[row, 2 * r + 1] = fma(ms, cosine_pi(turn), sum_out[row, 2 * r + 1])
    weight = lane_sum(total)
    for r in range(waves_in.shape[0]):
        s2 = lane_sum(sum_out[row, 2 * r])
        sc = lane_sum(sum_out[row, 2 * r + 1])
        write_feature(s2, sc, weight, scale, b, 2 * r, embedding_out)


@cache
def embed_points_kernel(width: int = 1) -> Any:
    """Return the kernel that embeds clouds [batch, N, 3] into [batch, 2 R].

    On a CPU a thread takes a cloud, and its sums [rows, 2 R] lie in row ``row``; on a GPU thread (r, cloud) takes one
    frequency, and row is -1 - r. ``waves_in`` [R] are the frequencies over 2 pi [1/m].
    """
    Real, W = real_type(width), width

    @wp.kernel(enable_backward=False, module="unique")
    def embed_points(
        points_in: wp.array3d(dtype=wp.float32), mask_in: wp.array2d(dtype=wp.bool), masked: int,
        waves_in: wp.array(dtype=wp.vec3), first: int, row: int, sum_out: wp.array2d(dtype=Real),
        embedding_out: wp.array2d(dtype=wp.float32),
    ):  # fmt: skip
        """Write the features of cloud b: of frequency f on a GPU, of all frequencies on a CPU."""
        tag = SOURCE  # noqa: F841
        f, i = wp.tid()
        b = first + i
        scale = wp.sqrt(1.0 / float(waves_in.shape[0]))
        if wp.static(W == 1):
            embed_frequency(f, b, points_in, mask_in, masked, waves_in, scale, embedding_out)
        else:
            embed_lanes(b, W, points_in, mask_in, masked, waves_in, scale, row, sum_out, embedding_out)

    return embed_points


@cache
def count_pairs_kernel(width: int = 1) -> Any:
    """Return the kernel that counts pairs with d2 < limit of clouds [batch, N, 3] and [batch, M, 3] up to ``most``.

    Thread (t, cloud) takes every T-th point of the first cloud from t; ``count_out`` [batch, T].
    """
    Real, W = real_type(width), width

    @wp.kernel(enable_backward=False, module="unique")
    def count_pairs(
        a_in: wp.array3d(dtype=wp.float32), a_mask: wp.array2d(dtype=wp.bool), a_masked: int,
        b_in: wp.array3d(dtype=wp.float32), b_mask: wp.array2d(dtype=wp.bool), b_masked: int,
        limit: float, most: int, first: int, like: wp.array(dtype=Real), count_out: wp.array2d(dtype=int),
    ):  # fmt: skip
        """Write how many pairs with d2 < ``limit`` thread t finds between clouds e, up to ``most``."""
        tag = SOURCE  # noqa: F841
        t, i = wp.tid()
        e = first + i
        total = wp.int32(0)
        zero = real(0.0, like[0])
        bound = real(limit, zero)
        others = b_in.shape[1]
        for chunk in range((others + W - 1) // W):
            if total < most:
                n = chunk * W
                x = coordinates(b_in, e, n, 0, zero)
                y = coordinates(b_in, e, n, 1, zero)
                z = coordinates(b_in, e, n, 2, zero)
                m = weights(b_mask, b_masked, e, n, others, zero)
                hits = zero
                for p in range(t, a_in.shape[1], count_out.shape[1]):
                    if weights(a_mask, a_masked, e, p, a_in.shape[1], 0.0) > 0.0:
                        d2 = squared(x - a_in[e, p, 0], y - a_in[e, p, 1], z - a_in[e, p, 2])
                        hits = fma(m, below(d2, bound), hits)
                total = total + int(lane_sum(hits))
        count_out[e, t] = wp.min(total, most)

    return count_pairs
