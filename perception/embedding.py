"""Embedding and occlusion of any torch clouds, without a simulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import torch
import warp as wp

from ..kernels.lanes.real import real_type
from ..kernels.points.tensors import count_pairs_kernel, embed_points_kernel
from ..sim.base.errors import InputError
from ..sim.base.host import num_threads, simd_width
from ..sim.base.thread_pool import recorded, together
from .frequencies import draw_frequencies

#: Clouds a CPU thread should have at least: handing over to another costs some 50 microseconds.
_FEWEST = 16
_TEAM = 32  # GPU threads that share a pair of clouds


def embed(
    points: torch.Tensor,
    frequencies: torch.Tensor | None = None,
    mask: torch.Tensor | None = None,
    *,
    features: int = 8,
    bandwidth: float = 1.0,
    seed: int = 0,
) -> torch.Tensor:
    """Return kernel mean embeddings of point clouds, 1/(N sqrt(R)) sum_i [cos w_1.x_i, sin w_1.x_i, ...].

    Float32 points are read where they lie, whatever their strides; gradients do not flow.

    Args:
        points: Clouds [..., N, 3] in m, on a CPU or a GPU.
        frequencies: w_r, [R, 3] in rad/m; None draws ``features`` of them with ``bandwidth`` [m] and ``seed``, those
            of a `Sensor` with the same settings.
        mask: True for points that count, [..., N]; None counts all. A cloud without points embeds as zeros.
        features: Number R of frequencies to draw.
        bandwidth: gamma of the kernel exp(-|x - y|^2 / (2 gamma^2)) [m].
        seed: Seed of the frequencies.

    Returns:
        Embeddings [..., 2 R], float32, cos before sin for each frequency.

    Raises:
        InputError: Shapes that do not fit.
    """
    device = _device_of(points)
    flat, array = _cloud("points", points)
    marks = _marks("mask", mask, points, device)
    waves = _waves(frequencies, features, bandwidth, seed, device)
    width = 1 if device.is_cuda else simd_width()
    count, kernel = int(waves.shape[0]), embed_points_kernel(width)
    out = torch.empty((flat.shape[0], 2 * count), dtype=torch.float32, device=points.device)
    into = wp.from_torch(out)

    def record(first: int, clouds: int, row: int) -> Any:
        """Record the launch that embeds ``clouds`` clouds from ``first`` on, with sums in scratch row ``row``."""
        inputs = [array, marks, int(mask is not None), waves, first, row, _sums(width, count, str(device)), into]
        return recorded(kernel, (count if width == 1 else 1, clouds), inputs, device)

    _launch(record, flat.shape[0], device)
    return out.reshape(*points.shape[:-2], 2 * count)


def occlusion(
    first: torch.Tensor,
    second: torch.Tensor,
    *,
    pairs: int = 200,
    threshold: float = 0.10,
    first_mask: torch.Tensor | None = None,
    second_mask: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return the occlusion score of two clouds: of their ``pairs`` closest pairs, the share closer than ``threshold``.

    That is min(k, number of pairs closer than the threshold) / k; distances are compared by squares in float32.

    Args:
        first: Clouds [..., N, 3] in m, of what occludes.
        second: Clouds [..., M, 3] in m, of what is to be seen.
        pairs: Number k of closest pairs.
        threshold: Distance d_th [m].
        first_mask: True for points of ``first`` that count, [..., N].
        second_mask: True for points of ``second`` that count, [..., M].

    Returns:
        Scores [...] from 0 to 1, float32.

    Raises:
        InputError: Shapes that do not fit, ``pairs`` or ``threshold`` not above zero.
    """
    if not (pairs > 0 and threshold > 0):
        raise InputError("occlusion", "pairs, threshold", f"{pairs}, {threshold}", "numbers above zero")
    if first.shape[:-2] != second.shape[:-2]:
        found = f"[{_text(first.shape)}] and [{_text(second.shape)}]"
        raise InputError("occlusion", "shapes", found, "[..., N, 3] and [..., M, 3]")
    device = _device_of(first)
    (a_flat, a), (_, b) = _cloud("first", first), _cloud("second", second)
    a_mask, b_mask = _marks("first_mask", first_mask, first, device), _marks("second_mask", second_mask, second, device)
    width, limit = 1 if device.is_cuda else simd_width(), np.float32(threshold)
    count = torch.empty((a_flat.shape[0], _TEAM if width == 1 else 1), dtype=torch.int32, device=first.device)
    into, like = wp.from_torch(count), wp.zeros(1, dtype=real_type(width), device=device)
    masked = [int(m is not None) for m in (first_mask, second_mask)]

    def record(start: int, clouds: int, _row: int) -> Any:
        """Record the launch that counts the near pairs of ``clouds`` clouds from ``start`` on."""
        inputs = [a, a_mask, masked[0], b, b_mask, masked[1], float(limit * limit), pairs, start, like, into]
        dim = (count.shape[1], clouds)
        return recorded(count_pairs_kernel(width), dim, inputs, device)

    _launch(record, a_flat.shape[0], device)
    return (count.sum(1).clamp(max=pairs).to(torch.float32) / pairs).reshape(first.shape[:-2])


# ---- tensors as kernels take them --------------------------------------------------------------------------------


def _device_of(tensor: torch.Tensor) -> Any:
    wp.init()
    return wp.device_from_torch(tensor.device)


def _text(shape: Sequence[int]) -> str:
    return ", ".join(map(str, shape))


def _cloud(name: str, points: torch.Tensor) -> tuple[torch.Tensor, Any]:
    """Clouds [batch, N, 3] as a view where strides allow it, for torch and for Warp."""
    if points.ndim < 2 or points.shape[-1] != 3:
        raise InputError("perception", name, f"shape [{_text(points.shape)}]", "[..., N, 3]")
    flat = points.detach().to(torch.float32).reshape(int(np.prod(points.shape[:-2])), *points.shape[-2:])
    return flat, wp.from_torch(flat, dtype=wp.float32)


def _marks(name: str, mask: torch.Tensor | None, points: torch.Tensor, device: Any) -> Any:
    """Mask [batch, N] as Warp takes it; one that is not read for None."""
    if mask is None:
        return _no_mask(str(device))
    if mask.shape != points.shape[:-1]:
        allowed = f"[{_text(points.shape[:-1])}], one a point"
        raise InputError("perception", name, f"shape [{_text(mask.shape)}]", allowed)
    flat = mask.to(device=points.device, dtype=torch.bool).reshape(-1, mask.shape[-1])
    return wp.from_torch(flat, dtype=wp.bool)


@lru_cache
def _no_mask(device: str) -> wp.array:
    return wp.zeros((1, 1), dtype=wp.bool, device=device)


def _waves(frequencies: torch.Tensor | None, features: int, bandwidth: float, seed: int, device: Any) -> Any:
    """Frequencies over 2 pi as kernels take them [1/m]."""
    if frequencies is None:
        return _drawn(features, bandwidth, seed, str(device))
    if frequencies.ndim != 2 or frequencies.shape[1] != 3 or not len(frequencies):
        raise InputError("embed", "frequencies", f"shape [{_text(frequencies.shape)}]", "[R, 3]")
    waves = frequencies.detach().to(device=wp.device_to_torch(device), dtype=torch.float64) / (2 * np.pi)
    return wp.from_torch(waves.float(), dtype=wp.vec3)


@lru_cache
def _drawn(features: int, bandwidth: float, seed: int, device: str) -> wp.array:
    waves = draw_frequencies(features, bandwidth, seed).astype(float) / (2 * np.pi)
    return wp.array(waves, dtype=wp.vec3, device=device)


@lru_cache
def _sums(width: int, features: int, device: str) -> wp.array:
    """Rows for the sums of each thread, a page apart so that threads do not share cache lines."""
    rows = 1 if width == 1 else num_threads()
    return wp.zeros((rows, 2 * features + 4096 // (4 * width)), dtype=real_type(width), device=device)


def _launch(record: Callable[[int, int, int], Any], clouds: int, device: Any) -> None:
    """Launch over all clouds, split over CPU threads where that pays."""
    threads = 1 if device.is_cuda or device.is_capturing else max(1, min(num_threads(), clouds // _FEWEST))
    cuts = np.linspace(0, clouds, threads + 1).astype(int).tolist()
    parts = [record(a, b - a, i) for i, (a, b) in enumerate(pairwise(cuts)) if b > a]
    if parts:
        together([[part] for part in parts])()
