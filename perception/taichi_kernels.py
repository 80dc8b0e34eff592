"""Embedding and occlusion as Taichi kernels, for simulators written in Taichi.

They take what Taichi takes as an array: ``ti.ndarray``, torch tensors, NumPy arrays, contiguous float32. Call
``ti.init`` first; threads are Taichi's own. Every sum is taken by one thread in the order of the points: the
same bits every run. Needs the extra ``taichi``.
"""
# mypy: ignore-errors

import taichi as ti

_CLOUDS = ti.types.ndarray(dtype=ti.f32, ndim=3)
_MASK = ti.types.ndarray(dtype=ti.i32, ndim=2)
_TABLE = ti.types.ndarray(dtype=ti.f32, ndim=2)
_SCORES = ti.types.ndarray(dtype=ti.f32, ndim=1)


@ti.kernel
def embed(points: _CLOUDS, mask: _MASK, frequencies: _TABLE, out: _TABLE):
    """Write kernel mean embeddings, 1/(N sqrt(R)) sum_i [cos w_1.x_i, sin w_1.x_i, ...], as `bough.perception.embed`.

    Args:
        points: Clouds [batch, N, 3] in m.
        mask: 1 for points that count, else 0, int32 [batch, N]. A cloud without points embeds as zeros.
        frequencies: w_r, [R, 3] in rad/m.
        out: Embeddings [batch, 2 R].
    """
    for b, r in ti.ndrange(points.shape[0], frequencies.shape[0]):
        cosine, sine, count = 0.0, 0.0, 0
        for n in range(points.shape[1]):
            if mask[b, n] != 0:
                phase = (
                    frequencies[r, 0] * points[b, n, 0]
                    + frequencies[r, 1] * points[b, n, 1]
                    + frequencies[r, 2] * points[b, n, 2]
                )
                cosine += ti.cos(phase)
                sine += ti.sin(phase)
                count += 1
        scale = 1.0 / (ti.max(count, 1) * ti.sqrt(float(frequencies.shape[0])))
        out[b, 2 * r] = cosine * scale
        out[b, 2 * r + 1] = sine * scale


@ti.kernel
def occlusion(
    first: _CLOUDS,
    first_mask: _MASK,
    second: _CLOUDS,
    second_mask: _MASK,
    pairs: ti.i32,
    threshold: ti.f32,
    out: _SCORES,
):
    """Write min(k, number of pairs closer than the threshold) / k, as `bough.perception.occlusion`.

    Squared distances are compared in float32, as there; a pair whose distance is within rounding of the threshold may
    count here and not there.

    Args:
        first: Clouds [batch, N, 3] in m, of what occludes.
        first_mask: 1 for points of ``first`` that count, else 0, int32 [batch, N].
        second: Clouds [batch, M, 3] in m, of what is to be seen.
        second_mask: The same for ``second``, int32 [batch, M].
        pairs: Number k of closest pairs.
        threshold: Distance d_th [m].
        out: Scores [batch] from 0 to 1.
    """
    for b in range(first.shape[0]):
        count = 0
        for n in range(first.shape[1]):
            if first_mask[b, n] != 0 and count < pairs:
                for m in range(second.shape[1]):
                    x = first[b, n, 0] - second[b, m, 0]
                    y = first[b, n, 1] - second[b, m, 1]
                    z = first[b, n, 2] - second[b, m, 2]
                    if second_mask[b, m] != 0 and x * x + y * y + z * z < threshold * threshold:
                        count += 1
        out[b] = ti.min(count, pairs) / float(pairs)
