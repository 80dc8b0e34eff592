"""Clouds of points from frames and masks: de-projected, cut to the box, the arm cut out, thinned."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...sim.arms.arm import Arm, arm_capsules
from ...sim.base.rotation import quat_rotate
from ...sim.base.types import Array
from ...sim.cameras.label import Label
from ...sim.cameras.stereo import StereoDepth
from .calibration import Rig
from .frames import Clouds, Frame

Points = NDArray[np.float32]


def deprojected(frame: Frame, mask: NDArray[np.bool_]) -> Array:
    """Return the points of masked pixels [H, W] in the base frame [m], [N, 3]: z ((u - cx)/fx, (v - cy)/fy, 1)."""
    fx, fy, cx, cy = frame.intrinsics
    v, u = np.nonzero(mask)
    z = frame.depth[v, u].astype(np.float64)
    seen = np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=1)
    return np.asarray(frame.position) + quat_rotate(np.asarray(frame.rotation), seen)


def beside(points: Array, start: Array, end: Array, radius: Array) -> Array:
    """Return the distance of points [N, 3] from the nearest of capsules [C], negative inside [m], [N]."""
    out = np.full(len(points), np.inf)
    for a, b, r in zip(start, end, radius, strict=True):
        axis = b - a
        along = np.clip((points - a) @ axis / max(float(axis @ axis), 1e-12), 0.0, 1.0)
        out = np.minimum(out, np.linalg.norm(points - a - along[:, None] * axis, axis=1) - r)
    return out


def capsules_at(arm: Arm, q: Array) -> tuple[Array, Array, Array]:
    """Return the capsules of an arm at joint positions [rad]: ends [C, 3], [C, 3] and greatest radii [C] [m]."""
    start, end = arm_capsules(arm, q)
    return start, end, np.concatenate([arm.base_radius, arm.tree.shape_radius.max(axis=1)])


def thinned(points: Array, grain: float) -> Points:
    """Return the mean of the points in each cell of a grid [m], float32 [M, 3]: equal areas have equally many then."""
    if not len(points):
        return np.zeros((0, 3), np.float32)
    cell = np.floor(points / grain).astype(np.int64)
    _, index = np.unique(cell, axis=0, return_inverse=True)
    index = index.ravel()
    count = np.bincount(index)
    mean = np.stack([np.bincount(index, points[:, k]) / count for k in range(3)], axis=1)
    return mean.astype(np.float32)


def cloud_of(
    frame: Frame, labels: NDArray[np.uint8], rig: Rig, body: tuple[Array, Array, Array] | None
) -> tuple[Array, Array]:  # fmt: skip
    """Return the points of one frame on branches and on the line that are in the box and not on the arm [m].

    Args:
        frame: The frame.
        labels: `Label` of its pixels, [H, W].
        rig: What counts.
        body: Capsules of the arm when the frame was taken, as `capsules_at` returns them; None for no arm.
    """
    near = (frame.depth > 0) & (frame.depth <= rig.farthest)
    return tuple(  # type: ignore[return-value]
        _kept(deprojected(frame, near & (labels == kind)), frame, rig, body) for kind in (Label.BRANCH, Label.LINE)
    )


def _kept(points: Array, frame: Frame, rig: Rig, body: tuple[Array, Array, Array] | None) -> Array:
    points = points[((points >= rig.box_low) & (points <= rig.box_high)).all(axis=1)]
    away = np.linalg.norm(points - frame.position, axis=1)
    margin = rig.margin + 3.0 * StereoDepth().deviation(1.0) * away**2
    keep = np.ones(len(points), bool) if rig.ground is None else points[:, 2] > rig.ground + margin
    if body is not None:
        keep &= beside(points, *body) > margin
    return points[keep]


def joined(parts: Sequence[tuple[float, Array, Array]], grain: float) -> Clouds:
    """Return the clouds of several cameras as one, as old as the oldest.

    Args:
        parts: Time [s], points on branches and points on the line [m] of each camera.
        grain: Edge of the cells that points are thinned to one in [m].
    """
    branches, line = (thinned(np.concatenate([part[k] for part in parts]), grain) for k in (1, 2))
    return Clouds(min(part[0] for part in parts), branches, line)


def contract(points: NDArray[np.float32], count: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return ``count`` of some points [N, 3], as a `perception.sensor.Sensor` has of every cloud; none of none.

    Without repetition where there are enough, else each at least once.
    """
    if len(points) >= count:
        return points[rng.choice(len(points), count, replace=False)]
    if not len(points):
        return points
    return points[np.concatenate([np.arange(len(points)), rng.integers(0, len(points), count - len(points))])]
