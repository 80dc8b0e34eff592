"""Kernel mean embeddings by random Fourier features (Rahimi and Recht 2007; thesis eq. 5.3).

    mu(P) = 1/N sum_i 1/sqrt(R) [cos w_1.x_i, sin w_1.x_i, ..., cos w_R.x_i, sin w_R.x_i],   w_r ~ N(0, 1/gamma^2)

so that <mu(P), mu(Q)> approaches the mean of exp(-|x - y|^2 / (2 gamma^2)) over pairs as R grows. Kernels take
w / 2 pi: with r = w.x / 2 pi less the nearest whole number,

    cos w.x = 1 - 2 sin^2(pi r),   sin w.x = 2 sin(pi r) cos(pi r)

hold whatever the number was, that subtraction is exact, and each costs one fused addition to its sum. Sums run over the
points in memory order in every lane, then over the lanes: the same bits every run.
"""

from functools import cache
from typing import Any

import warp as wp

from ..lanes.across import cosine_pi, lane_sum, sine_pi
from ..lanes.real import SOURCE, add, fma, mul, real, round_, sub
from .cloud import BRANCHES, NUM_CLOUDS, cloud_types, side

__all__ = ["embed_clouds_kernel"]


@wp.func
def part_turn(wave: wp.vec3, x: Any, y: Any, z: Any):
    """wave.(x, y, z) less the nearest whole number."""
    turns = fma(z, real(wave[2], z), fma(y, real(wave[1], y), x * wave[0]))
    return turns - round_(turns)


@wp.func
def write_feature(
    s2: float, sc: float, weight: float, scale: float, world: int, column: int, observation_out: wp.array2d(dtype=float)
):
    """Write the means of cos and sin, sums of sin^2 and sin cos of pi r being given; 0 for no points."""
    share = wp.where(weight > 0.0, scale / weight, 0.0)
    observation_out[world, column] = share * (weight - 2.0 * s2)
    observation_out[world, column + 1] = share * (2.0 * sc)


@wp.func
def sum_features(x: Any, y: Any, z: Any, wave: wp.vec3):
    """Sums of sin^2 and sin cos of pi r over chunks of points."""
    s2 = real(0.0, x[0])
    sc = s2
    j = wp.int32(0)
    while j < x.shape[0]:
        r = part_turn(wave, x[j], y[j], z[j])
        s = sine_pi(r)
        s2 = fma(s, s, s2)
        sc = fma(s, cosine_pi(r), sc)
        j = j + 1
    return s2, sc


@wp.func
def sum_marked_features(x: Any, y: Any, z: Any, mark: Any, wave: wp.vec3):
    """Sums of sin^2 and sin cos of pi r over chunks of points, and over those that are marked."""
    s2 = real(0.0, x[0])
    sc = s2
    marked_s2 = s2
    marked_sc = s2
    j = wp.int32(0)
    while j < x.shape[0]:
        r = part_turn(wave, x[j], y[j], z[j])
        s = sine_pi(r)
        c = cosine_pi(r)
        ms = mark[j] * s
        s2 = fma(s, s, s2)
        sc = fma(s, c, sc)
        marked_s2 = fma(ms, s, marked_s2)
        marked_sc = fma(ms, c, marked_sc)
        j = j + 1
    return s2, sc, marked_s2, marked_sc


@wp.func
def count_marked(mark: Any):
    """Sum of all marks."""
    total = real(0.0, mark[0])
    j = wp.int32(0)
    while j < mark.shape[0]:
        total = total + mark[j]
        j = j + 1
    return lane_sum(total)


@wp.func(inline=True)
def embed_cloud(
    w: int, k: int, row: int, t: int, team: int, width: int, whole: int, part: int, c: Any,
    waves_in: wp.array(dtype=wp.vec3), observation_out: wp.array2d(dtype=wp.float32),
):  # fmt: skip
    """Write every ``team``-th feature of cloud k in columns from ``whole``, of marked points in those from ``part``."""
    x = c.point[row, k, 0]
    y = c.point[row, k, 1]
    z = c.point[row, k, 2]
    mark = c.near[row]
    scale = wp.sqrt(1.0 / float(waves_in.shape[0]))
    present = float(c.present[row, k])
    weight = present * float(x.shape[0] * width)
    if part < 0:
        for f in range(t, waves_in.shape[0], team):
            s2, sc = sum_features(x, y, z, waves_in[f])
            write_feature(lane_sum(s2), lane_sum(sc), weight, scale, w, whole + 2 * f, observation_out)
    else:
        marked = present * count_marked(mark)
        for f in range(t, waves_in.shape[0], team):
            s2, sc, marked_s2, marked_sc = sum_marked_features(x, y, z, mark, waves_in[f])
            write_feature(lane_sum(marked_s2), lane_sum(marked_sc), marked, scale, w, part + 2 * f, observation_out)
            if whole >= 0:
                write_feature(lane_sum(s2), lane_sum(sc), weight, scale, w, whole + 2 * f, observation_out)


@cache
def embed_clouds_kernel(width: int = 1) -> Any:
    """Return the kernel that embeds the sampled clouds into columns of the observation, threads as in `sample_kernel`.

    Of ``waves_in`` [R], the frequencies over 2 pi [1/m], a thread takes every ``team``-th from t: one on a GPU, all on
    a CPU, where a thread's beginning costs as much as some frequencies. ``column`` [4] are the first columns of robot,
    target, branches and the branches near the target, -1 where not wanted.
    """
    t = cloud_types(width)
    Clouds, W, S = t.Clouds, width, side(width)

    @wp.kernel(enable_backward=False, module="unique")
    def embed(
        c_in: Clouds, waves_in: wp.array(dtype=wp.vec3), column: wp.array(dtype=int), first: int, first_row: int,
        count: int, team: int, observation_out: wp.array2d(dtype=wp.float32),
    ):  # fmt: skip
        """Write the features of cloud k of a world, every ``team``-th from t, into the columns that are wanted."""
        tag = SOURCE  # noqa: F841
        g, k, t, lane = wp.tid()
        i = g * S + lane
        if i >= count:
            return
        w = first + i
        row = first_row + i
        whole = column[k]
        part = wp.where(k == BRANCHES, column[NUM_CLOUDS], -1)
        if whole < 0 and part < 0:
            return
        embed_cloud(w, k, row, t, team, W, whole, part, c_in, waves_in, observation_out)

    return embed
