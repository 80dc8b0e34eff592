"""The figure of a simulated motion, drawn without pyplot's global state."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from .pose import quat_rotate
from .trajectory import Trajectory, own_bodies
from .tree import Array, Tree

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
"""Colour-blind safe (Okabe and Ito)."""

STYLE: dict[Any, Any] = {
    "font.size": 10, "axes.titlesize": 10, "legend.fontsize": 9, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": "#E6E6E6", "grid.linewidth": 0.6, "axes.edgecolor": "#888888",
    "axes.axisbelow": True, "legend.frameon": False, "savefig.facecolor": "white", "axes.formatter.useoffset": False,
}  # fmt: skip
_INSTANTS = 9


def trajectory_figure(tree: Tree, trajectory: Trajectory) -> Figure:
    """Draw the bodies that move most over time, and the first world's tree at a few instants.

    With several worlds the line is the first world and the band reaches over all.

    Args:
        tree: The tree of every world.
        trajectory: Its motion.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11, 5.4), layout="constrained")
        grid = figure.add_gridspec(2, 2, width_ratios=(1.5, 1.0))
        upper = figure.add_subplot(grid[0, 0])
        lower = figure.add_subplot(grid[1, 0], sharex=upper)
        pos = trajectory.body_pos.astype(np.float64)
        shift = pos - pos[:1]
        most = np.argsort(-np.linalg.norm(shift[:, 0], axis=-1).max(axis=0), kind="stable")[: len(COLORS)]
        worlds = pos.shape[1]
        for color, b in zip(COLORS, most, strict=False):
            name = trajectory.body_name[b]
            _curve(upper, trajectory.time, np.linalg.norm(shift[:, :, b], axis=-1), color, name)
            _curve(lower, trajectory.time, shift[:, :, b, 2], color, name)
        upper.set_title("bodies that move most" + (f": line world 0, band all {worlds} worlds" if worlds > 1 else ""))
        upper.set_ylabel("distance from start [m]")
        lower.set_ylabel("height over start [m]")
        lower.set_xlabel("time [s]")
        upper.tick_params(labelbottom=False)
        handles, names = upper.get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower left", ncols=len(COLORS))
        _instants(figure.add_subplot(grid[:, 1]), tree, trajectory)
    return figure


def _curve(ax: Axes, time: Array, values: Array, color: str, label: str) -> None:
    """Draw one quantity [T, W]."""
    if values.shape[1] > 1:
        ax.fill_between(time, values.min(axis=1), values.max(axis=1), color=color, alpha=0.08, linewidth=0)
    ax.plot(time, values[:, 0], color=color, linewidth=1.3, label=label)


def _instants(ax: Axes, tree: Tree, trajectory: Trajectory) -> None:
    """Draw the first world's links from the side at a few instants, from pale to dark."""
    chosen = np.unique(np.linspace(0, len(trajectory.time) - 1, _INSTANTS).round().astype(int))
    start, end, radius = _segments(tree, trajectory, chosen)
    across = _widest_direction(np.concatenate([start, end], axis=1))
    flat = np.stack([np.stack([p @ across, p[..., 2]], axis=-1) for p in (start, end)], axis=2)
    shades = matplotlib.colormaps["Blues"](np.linspace(0.25, 0.95, len(chosen)))
    width = np.clip(4.0 * radius / max(radius.max(), 1e-9), 0.7, None)
    for k, color in enumerate(shades):
        ax.add_collection(LineCollection(list(flat[k]), colors=[color], linewidths=width, capstyle="round"))
    ax.autoscale_view()
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_title(f"world 0 from the side, {trajectory.time[0]:g} s (pale) to {trajectory.time[-1]:.3g} s (dark)")
    ax.set_xlabel("across [m]")
    ax.set_ylabel("height [m]")


def _segments(tree: Tree, trajectory: Trajectory, chosen: Array) -> tuple[Array, Array, Array]:
    """Start and end [K, S, 3] and radius [S] of the first world's capsules at some instants.

    A tree without capsules is drawn from each body's origin to its parent's.
    """
    pos = trajectory.body_pos[chosen, 0].astype(np.float64)
    quat = trajectory.body_quat[chosen, 0].astype(np.float64)
    bodies = own_bodies(tree)
    if len(tree.shape_link):
        b = np.searchsorted(bodies, tree.shape_link)
        ends = [pos[:, b] + quat_rotate(quat[:, b], p) for p in (tree.shape_start, tree.shape_end)]
        return ends[0], ends[1], tree.shape_radius.mean(axis=1)
    above = [_body_above(tree, int(link), bodies) for link in bodies]
    ground = np.zeros_like(pos[:, :1])
    ends_above = np.concatenate([pos, ground], axis=1)[:, above]  # -1: the world's origin
    return ends_above, pos, np.ones(len(bodies))


def _body_above(tree: Tree, link: int, bodies: Array) -> int:
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
