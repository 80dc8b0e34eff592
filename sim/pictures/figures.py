"""The figure of a simulated motion, drawn without pyplot's global state."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ..base.rotation import quat_rotate
from ..base.types import Array, IntArray
from ..engine.trajectory import Trajectory, own_bodies
from ..trees.tree import Tree

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
"""Colour-blind safe (Okabe and Ito)."""

STYLE: dict[Any, Any] = {
    "font.size": 10, "axes.titlesize": 10, "legend.fontsize": 9, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": "#E6E6E6", "grid.linewidth": 0.6, "axes.edgecolor": "#888888",
    "axes.axisbelow": True, "legend.frameon": False, "savefig.facecolor": "white", "axes.formatter.useoffset": False,
}  # fmt: skip
_INSTANTS = 9
_MOST_LINES = 100


def trajectory_figure(tree: Tree, trajectory: Trajectory) -> Figure:
    """Draw how far the ends of bodies move, and the first world's tree at instants between which it moves alike.

    Of one world the five ends that move most are drawn; of several the one that moves most in world 0, in all worlds.

    Args:
        tree: The tree of every world.
        trajectory: Its motion.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11, 5.4), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.5, 1.0))
        upper = figure.add_subplot(grid[0, 0])
        lower = figure.add_subplot(grid[1, 0], sharex=upper)
        shift, names = _shifts(tree, trajectory)
        distance = np.linalg.norm(shift, axis=-1)
        scale, unit = (1e3, "mm") if distance.max() < 0.02 else (1.0, "m")
        lines = _worlds if shift.shape[1] > 1 else _bodies
        lines(upper, trajectory.time, scale * distance, names)
        lines(lower, trajectory.time, scale * shift[..., 2], names)
        upper.set_ylabel(f"distance from start [{unit}]")
        lower.set_ylabel(f"height over start [{unit}]")
        lower.set_xlabel("time [s]")
        upper.tick_params(labelbottom=False)
        figure.legend(*upper.get_legend_handles_labels(), loc="outside lower left", ncols=len(COLORS))
        _instants(figure.add_subplot(grid[:, 1]), tree, trajectory)
    return figure


def _shifts(tree: Tree, trajectory: Trajectory) -> tuple[Array, list[str]]:
    """Shift since the start of the ends that move most in world 0 [T, W, up to 5, 3], and their names, most first.

    The end of a body is the far end of its last capsule, or its origin where it has none.
    """
    bodies, local = own_bodies(tree), np.zeros((len(trajectory.body_name), 3))
    local[np.searchsorted(bodies, tree.shape_link)] = tree.shape_end
    first = _ends(trajectory, slice(0, 1), slice(None), local)[:, 0]
    most: IntArray = np.argsort(-np.linalg.norm(first - first[:1], axis=-1).max(axis=0), kind="stable")[: len(COLORS)]
    ends = _ends(trajectory, slice(None), most, local[most])
    return ends - ends[:1], [trajectory.body_name[b] for b in most]


def _ends(trajectory: Trajectory, worlds: slice, bodies: slice | IntArray, local: Array) -> Array:
    """Points given in the bodies' frames [B, 3], in the world [m], shape [T, W, B, 3]."""
    pos, quat = (a[:, worlds][:, :, bodies].astype(np.float64) for a in (trajectory.body_pos, trajectory.body_quat))
    return pos + quat_rotate(quat, local)


def _bodies(ax: Axes, time: Array, values: Array, names: list[str]) -> None:
    """Draw one quantity [T, 1, B], a line a body."""
    for b, (name, color) in enumerate(zip(names, COLORS, strict=False)):
        ax.plot(time, values[:, 0, b], color=color, linewidth=1.4, label=f"end of {name}")


def _worlds(ax: Axes, time: Array, values: Array, names: list[str]) -> None:
    """Draw one quantity [T, W, B] of the first body, a line a world."""
    drawn = min(values.shape[1], _MOST_LINES)
    ax.plot(time, values[:, 1:drawn, 0], color="#999999", alpha=0.45, linewidth=0.6)
    ax.plot([], [], color="#999999", label=f"worlds 1 to {drawn - 1}")
    ax.plot(time, values[:, 0, 0], color=COLORS[0], linewidth=1.8, label=f"world 0: end of {names[0]}")


def _instants(ax: Axes, tree: Tree, trajectory: Trajectory) -> None:
    """Draw the first world's links from the side, from pale to dark, over the other worlds at their start."""
    start, end, radius = _segments(tree, trajectory, _moments(trajectory), np.zeros(1, np.int64))
    across = _widest_direction(np.concatenate([start, end], axis=1))
    width = np.clip(4.0 * radius / max(radius.max(), 1e-9), 0.7, None)
    others = np.arange(1, min(trajectory.body_pos.shape[1], _MOST_LINES))
    if len(others):
        behind = _segments(tree, trajectory, np.zeros(1, np.int64), others)[:2]
        lines = np.stack([np.stack([p @ across, p[..., 2]], axis=-1) for p in behind], axis=-2)
        ax.add_collection(LineCollection(list(lines.reshape(-1, 2, 2)), colors="#BBBBBB", linewidths=0.4))
    shades = matplotlib.colormaps["Blues"](np.linspace(0.3, 0.95, len(start)))
    for a, b, color in zip(start, end, shades, strict=True):
        lines = np.stack([np.stack([p @ across, p[:, 2]], axis=-1) for p in (a, b)], axis=1)
        ax.add_collection(LineCollection(list(lines), colors=[color], linewidths=width, capstyle="round"))
    ax.autoscale_view()
    ax.set_aspect("equal", adjustable="datalim")
    over = "\nover the start of the others (gray)" if len(others) else ""
    ax.set_title(f"world 0 from the side, 0 s (pale) to {trajectory.time[-1]:.3g} s (dark){over}")
    ax.set_xlabel("across [m]")
    ax.set_ylabel("height [m]")


def _moments(trajectory: Trajectory) -> IntArray:
    """Return the indices of instants between which the first world moves equally far, both ends included."""
    steps = np.linalg.norm(np.diff(trajectory.body_pos[:, 0].astype(np.float64), axis=0), axis=-1).mean(axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    inner = np.searchsorted(way, np.linspace(0.0, way[-1], _INSTANTS)[1:-1])
    return np.unique([0, *inner, len(way) - 1])


def _segments(tree: Tree, trajectory: Trajectory, times: IntArray, worlds: IntArray) -> tuple[Array, Array, Array]:
    """Start and end [K, S, 3] and radius [S] of the capsules of worlds at times; one of the two has length one.

    A tree without capsules is drawn from each body's origin to its parent's.
    """
    pos = trajectory.body_pos[times, worlds].astype(np.float64)
    quat = trajectory.body_quat[times, worlds].astype(np.float64)
    bodies = own_bodies(tree)
    if len(tree.shape_link):
        b = np.searchsorted(bodies, tree.shape_link)
        ends = [pos[:, b] + quat_rotate(quat[:, b], p) for p in (tree.shape_start, tree.shape_end)]
        return ends[0], ends[1], tree.shape_radius.mean(axis=1)
    above = [_body_above(tree, int(link), bodies) for link in bodies]
    ground = np.zeros_like(pos[:, :1])
    ends_above = np.concatenate([pos, ground], axis=1)[:, above]  # -1: the world's origin
    return ends_above, pos, np.ones(len(bodies))


def _body_above(tree: Tree, link: int, bodies: IntArray) -> int:
    """Index of the body that a body hangs on, -1 for the world."""
    parent = int(tree.parent[link])
    while parent >= 0 and parent not in bodies:
        parent = int(tree.parent[parent])
    return int(np.searchsorted(bodies, parent)) if parent >= 0 else -1


def _widest_direction(points: Array) -> Array:
    """Horizontal unit direction [3] along which points [K, S, 3] spread most."""
    flat = points[..., :2].reshape(-1, 2)
    direction = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)[2][0]
    return np.array([*(direction * (1.0 if direction[0] >= 0 else -1.0)), 0.0])
