"""Kernel mean embeddings by random Fourier features (Rahimi and Recht 2007; thesis eq. 5.3).

    mu(P) = 1/N sum_i 1/sqrt(R) [cos w_1.x_i, sin w_1.x_i, ..., cos w_R.x_i, sin w_R.x_i],   w_r ~ N(0, 1/gamma^2)

so that <mu(P), mu(Q)> approaches the mean of exp(-|x - y|^2 / (2 gamma^2)) over pairs as R grows. Kernels take w / 2:
with h = w.x / 2 less the nearest multiple of pi,

    cos w.x = 1 - 2 sin^2 h,   sin w.x = 2 sin h cos h

hold whatever the multiple was, and each costs one fused addition to its sum. Sums run over the points in memory order
in every lane, then over the lanes: the same bits every run.
"""

from functools import cache
from typing import Any

import warp as wp

from .lanes import lane_sum, short_cosine, short_sine, turned
from .point_cloud import BRANCHES, NUM_CLOUDS, cloud_types
from .real import SOURCE, add, fma, mul, real, sub

__all__ = ["embed_clouds_kernel"]


@wp.func
def half_phase(w: wp.vec3, x: Any, y: Any, z: Any):
    """w.x less the nearest multiple of pi."""
    return turned(fma(z, real(w[2], z), fma(y, real(w[1], y), x * w[0])))


@wp.func
def write_feature(
    s2: float, sc: float, weight: float, scale: float, world: int, column: int, observation_out: wp.array2d(dtype=float)
):
    """Write the means of cos and sin, sums of sin^2 h and sin h cos h being given; 0 for no points."""
    share = wp.where(weight > 0.0, scale / weight, 0.0)
    observation_out[world, column] = share * (weight - 2.0 * s2)
    observation_out[world, column + 1] = share * (2.0 * sc)


@cache
def embed_clouds_kernel(width: int = 1) -> Any:
    """Return the kernel that embeds the sampled clouds into columns of the observation, thread (world, cloud, r).

    ``half`` [R] are the frequencies over 2 [rad/m]; ``column`` [4] the first columns of robot, target, branches and the
    branches near the target, -1 where not wanted.
    """
    t = cloud_types(width)
    Clouds, W = t.Clouds, width

    @wp.kernel(enable_backward=False, module="unique")
    def embed(
        c_in: Clouds, half: wp.array(dtype=wp.vec3), column: wp.array(dtype=int), first: int,
        observation_out: wp.array2d(dtype=wp.float32),
    ):  # fmt: skip
        tag = SOURCE  # noqa: F841
        i = wp.int32(0)
        k = wp.int32(0)
        f = wp.int32(0)
        if wp.static(W > 1):
            i, k, f = wp.tid()
        else:
            f, k, i = wp.tid()  # neighbouring threads are neighbouring worlds
        w = first + i
        wave = half[f]
        scale = wp.sqrt(1.0 / float(half.shape[0]))
        whole = column[k]
        part = wp.where(k == BRANCHES, column[NUM_CLOUDS], -1)
        if whole < 0 and part < 0:
            return
        s2 = real(0.0, c_in.near[w, 0])
        sc = s2
        near = s2
        near_s2 = s2
        near_sc = s2
        chunks = c_in.point.shape[3]
        if part < 0:
            for j in range(chunks):
                h = half_phase(wave, c_in.point[w, k, 0, j], c_in.point[w, k, 1, j], c_in.point[w, k, 2, j])
                s = short_sine(h)
                s2 = fma(s, s, s2)
                sc = fma(s, short_cosine(h), sc)
        else:
            for j in range(chunks):
                h = half_phase(wave, c_in.point[w, k, 0, j], c_in.point[w, k, 1, j], c_in.point[w, k, 2, j])
                s = short_sine(h)
                q = short_cosine(h)
                m = c_in.near[w, j]
                ms = m * s
                s2 = fma(s, s, s2)
                sc = fma(s, q, sc)
                near = near + m
                near_s2 = fma(ms, s, near_s2)
                near_sc = fma(ms, q, near_sc)
        present = float(c_in.present[w, k])
        if whole >= 0:
            weight = present * float(chunks * W)
            write_feature(lane_sum(s2), lane_sum(sc), weight, scale, w, whole + 2 * f, observation_out)
        if part >= 0:
            weight = present * lane_sum(near)
            write_feature(lane_sum(near_s2), lane_sum(near_sc), weight, scale, w, part + 2 * f, observation_out)

    return embed
