"""Pictures that show whether a calibration and masks are right: masks over colour, and the cloud beside the arm."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from ...sim.arms.arm import Arm
from ...sim.base.types import Array
from ...sim.cameras.label import Label
from .calibration import Rig
from .clouds import capsules_at
from .frames import Clouds, Frame

TINTS = {Label.BRANCH: (30, 120, 255), Label.LINE: (255, 220, 0), Label.LEAF: (60, 220, 60)}
"""Colours of masks, sRGB."""

ARM_TINT, HOLE = (255, 0, 200), (0, 0, 0)
"""Colours of the arm's outline and of what has no depth."""

_ALONG, _AROUND = 24, 24  # points on a capsule, of the arm's outline


def masked(frame: Frame, labels: NDArray[np.uint8], body: tuple[Array, Array, Array] | None) -> NDArray[np.uint8]:
    """Return a picture with its masks over it, beside its depth, [H, 2 W, 3].

    Branches are blue, the line yellow, leaves green. Dots of magenta are on the surface of the arm's capsules where the
    calibration and the joints put it: they must cover the arm that is seen. Depth goes from white, near, to dark, far.

    Args:
        frame: The picture.
        labels: `Label` of its pixels, [H, W].
        body: Capsules of the arm then, as `learn.cameras.clouds.capsules_at` returns them; None for no arm.
    """
    out = frame.colour.astype(np.float64)
    for kind, tint in TINTS.items():
        out[labels == kind] = 0.35 * out[labels == kind] + 0.65 * np.array(tint)
    has = frame.depth > 0
    far = float(np.percentile(frame.depth[has], 98)) if has.any() else 1.0
    depth = np.repeat(np.where(has, 255.0 - 205.0 * np.clip(frame.depth / far, 0, 1), HOLE[0])[..., None], 3, axis=2)
    if body is not None:
        for v, u in _dots(frame, body):
            out[v, u] = depth[v, u] = ARM_TINT
    return np.concatenate([out, depth], axis=1).astype(np.uint8)


def _dots(frame: Frame, body: tuple[Array, Array, Array]) -> NDArray[np.int64]:
    """Return rows and columns of the pixels that show points of the arm's surface, [N, 2]."""
    from ...sim.base.rotation import quat_rotate

    points = np.concatenate([_surface(*capsule) for capsule in zip(*body, strict=True)])
    turn = np.asarray(frame.rotation) * [1, -1, -1, -1]
    x, y, z = quat_rotate(turn, points - frame.position).T
    fx, fy, cx, cy = frame.intrinsics
    ahead = z > 0.02
    v, u = (np.round(f * a[ahead] / z[ahead] + c).astype(int) for f, a, c in ((fy, y, cy), (fx, x, cx)))
    height, width = frame.depth.shape
    inside = (v >= 0) & (v < height) & (u >= 0) & (u < width)
    return np.stack([v[inside], u[inside]], axis=1)


def _surface(start: Array, end: Array, radius: float) -> Array:
    """Return points on the side of a capsule [m], [N, 3]."""
    axis = end - start
    axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
    first = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    first /= np.linalg.norm(first)
    angle = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)[:, None]
    ring = radius * (np.cos(angle) * first + np.sin(angle) * np.cross(axis, first))
    along = np.linspace(0, 1, _ALONG)[:, None, None] * (end - start)
    return np.asarray((start + along + ring).reshape(-1, 3))


def save_masks(path: Path, pictures: Sequence[NDArray[np.uint8]]) -> None:
    """Write pictures of several cameras below each other as PNG."""
    width = max(p.shape[1] for p in pictures)
    rows = [np.pad(p, ((0, 4), (0, width - p.shape[1]), (0, 0))) for p in pictures]
    PIL.Image.fromarray(np.concatenate(rows)).save(path, format="PNG")


def save_cloud(path: Path, clouds: Clouds, rig: Rig, arm: Arm | None, q: Array | None) -> None:
    """Write clouds, arm and cameras as seen from above and from two sides, as PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 5.4), layout="constrained")
    for k, (across, up) in enumerate(((0, 1), (0, 2), (1, 2))):
        axes = figure.add_subplot(1, 3, k + 1)
        for points, colour, name in ((clouds.branches, "#1e78ff", "branches"), (clouds.line, "#d9a400", "line")):
            axes.scatter(points[:, across], points[:, up], s=3, color=colour, label=f"{name}: {len(points)} points")
        if arm is not None and q is not None:
            _draw_arm(axes, capsules_at(arm, q), across, up)
        for camera in rig.cameras:
            pose = camera.pose(None)
            if pose is not None:
                axes.plot(pose[0][across], pose[0][up], "k^")
                axes.annotate(camera.name, (pose[0][across], pose[0][up]), textcoords="offset points", xytext=(5, 5))
        axes.set(xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]", aspect="equal",
                 title=("from above", "along y", "along x")[k])  # fmt: skip
        axes.grid(alpha=0.3)
    figure.axes[0].legend(loc="best")
    figure.savefig(path, dpi=100)


def _draw_arm(axes: object, body: tuple[Array, Array, Array], across: int, up: int) -> None:
    for start, end, radius in zip(*body, strict=True):
        axes.plot([start[across], end[across]], [start[up], end[up]], color="0.6", lw=max(2.0, 180 * radius),  # type: ignore[attr-defined]
                  solid_capstyle="round", zorder=0)  # fmt: skip
