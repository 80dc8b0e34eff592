"""An arm of capsules, branches and a line in random worlds, as the sensor takes them, with no simulator."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import warp as wp


@dataclass
class PointScene:
    """Warp arrays for the sensor and the same numbers in NumPy."""

    capsules: SimpleNamespace
    line: SimpleNamespace
    ee: wp.array
    start: np.ndarray  # [worlds, S, 3]
    end: np.ndarray
    radius: np.ndarray  # [worlds, S]


def point_scene(worlds: int, *, arm: int = 7, branches: int = 24, absent: float = 0.0, seed: int = 0) -> PointScene:
    """Make worlds whose branches lie about the line, some with the arm near it too.

    Args:
        worlds: Number of worlds.
        arm: Arm capsules, a chain from the origin.
        branches: Branch capsules of a world.
        absent: Share of branch capsules of radius 0.
        seed: Of everything.
    """
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(worlds, arm, 3)) + np.array([0.8, 0.0, 0.6])
    steps *= 0.15 / np.linalg.norm(steps, axis=-1, keepdims=True)
    ends = np.cumsum(steps, axis=1)
    middle = np.array([0.7, 0.0, 0.5]) + 0.25 * rng.normal(size=(worlds, branches, 3))
    half = 0.12 * rng.normal(size=(worlds, branches, 3))
    start = np.concatenate([ends - steps, middle - half], axis=1).astype(np.float32)
    end = np.concatenate([ends, middle + half], axis=1).astype(np.float32)
    radius = rng.uniform(0.008, 0.04, (worlds, arm + branches)).astype(np.float32)
    radius[:, arm:][rng.random((worlds, branches)) < absent] = 0.0
    line_start = (np.array([0.6, -0.8, 0.55]) + 0.1 * rng.normal(size=(worlds, 3))).astype(np.float32)
    line_end = line_start + np.array([0.1, 1.6, 0.05], np.float32)
    return PointScene(
        SimpleNamespace(
            start=wp.array(start, dtype=wp.vec3), end=wp.array(end, dtype=wp.vec3), radius=wp.array(radius), num_arm=arm
        ),
        SimpleNamespace(start=wp.array(line_start, dtype=wp.vec3), end=wp.array(line_end, dtype=wp.vec3)),
        wp.array(ends[:, -1].astype(np.float32), dtype=wp.vec3), start, end, radius,
    )  # fmt: skip


def squared_distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return d2 [..., N, M] of points [..., N, 3] and [..., M, 3] as kernels define it: float32, two fused additions.

    A fused addition rounds once. In 80-bit numbers the product is exact and the sum has 11 bits more than a double.
    """
    x, y, z = (a[..., :, None, k].astype(np.float32) - b[..., None, :, k].astype(np.float32) for k in range(3))
    wide = (y.astype(np.longdouble) * y + (x * x).astype(np.longdouble)).astype(np.float32)
    return (z.astype(np.longdouble) * z + wide.astype(np.longdouble)).astype(np.float32)


def top_pairs_score(d2: np.ndarray, pairs: int, threshold: float) -> float:
    """Return the thesis's occlusion (5.4-5.6) of one pair of clouds: sort all distances, look at the k smallest."""
    closest = np.sort(d2.ravel())[:pairs]
    return float(np.count_nonzero(closest < np.float32(threshold) * np.float32(threshold))) / pairs


def embedding(points: np.ndarray, frequencies: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """Return mean embeddings [..., 2 R] of clouds [..., N, 3] in float64, eq. 5.3 as it is written."""
    phase = np.einsum("...nk,rk->...nr", points.astype(np.float64), frequencies.astype(np.float64))
    weight = np.ones(points.shape[:-1]) if mask is None else mask.astype(np.float64)
    share = weight / np.maximum(weight.sum(-1, keepdims=True), 1.0)
    means = [np.einsum("...n,...nr->...r", share, f(phase)) for f in (np.cos, np.sin)]
    return np.stack(means, axis=-1).reshape(*points.shape[:-2], -1) / np.sqrt(len(frequencies))
