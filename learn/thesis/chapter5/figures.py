"""Figures of chapter 5's reproduction: plain numbers in, a `matplotlib.figure.Figure` out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...reports.figures import ALARM, FAINT, MEASURED, MODEL, NOISE, WIDTH, styled
from ..chapter3.figures import THESIS

Pair = tuple[float, float]
Levels = Sequence[Sequence[float]]
_COLOURS = (FAINT, "#56B4E9", NOISE, ALARM, MODEL, MEASURED)


@styled
def rows_figure(
    names: Sequence[str], success: Sequence[Pair], drop: Sequence[Pair], thesis: Sequence[tuple[Pair, Pair] | None]
) -> Figure:
    """Draw success and occlusion drop of table 5.2, and the thesis's beside them.

    Args:
        names: Name of each row.
        success: Mean of the success of each row and half of its interval [%].
        drop: Those of the occlusion drop [%].
        thesis: The thesis's success and drop of each row; None for a row that it does not have.
    """
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    place = np.arange(len(names))
    for k, (ax, ours) in enumerate(zip(figure.subplots(1, 2), (success, drop), strict=True)):
        mean, spread = np.nan_to_num(np.array(ours)).T
        ax.bar(place - 0.2, mean, 0.38, yerr=spread, color=MODEL, ecolor=MEASURED, label="bough, this run")
        known = [(i, pair[k]) for i, pair in enumerate(thesis) if pair is not None]
        theirs = np.array([pair for _, pair in known])
        ax.bar([i + 0.2 for i, _ in known], theirs[:, 0], 0.38, yerr=theirs[:, 1], color=THESIS, ecolor=MEASURED,
               label="thesis, its scale")  # fmt: skip
        ax.axhline(0.0, color=MEASURED, linewidth=0.8)
        ax.set_xticks(place, names)
        ax.set_ylabel(("success [%]", "occlusion drop [%]")[k])
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


@styled
def curves_figure(curves: Mapping[str, tuple[Sequence[float], Sequence[float], Sequence[float]]]) -> Figure:
    """Draw return and success in training.

    Args:
        curves: By run: iterations, return and success [%] of the episodes that ended about each.
    """
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for (name, (iterations, returns, success)), colour in zip(curves.items(), _COLOURS, strict=True):
        left.plot(iterations, returns, color=colour, label=name)
        right.plot(iterations, success, color=colour)
    left.set_ylabel("return of an episode")
    right.set_ylabel("success [%]")
    for ax in (left, right):
        ax.set_xlabel("iterations")
    figure.legend(loc="outside upper center", ncols=len(curves))
    return figure


@styled
def removal_figure(reward: Mapping[str, Levels], success: Mapping[str, Levels], levels: Sequence[float]) -> Figure:
    """Draw test reward and success with one group of observations removed (figure 5.4).

    Args:
        reward: Test reward of every seed at each noise level, by what is removed.
        success: Success of every seed at each noise level, by what is removed [%].
        levels: d_max of each noise level [m].
    """
    figure = Figure(figsize=(WIDTH, 3.9), layout="constrained")
    for ax, (label, data) in zip(
        figure.subplots(1, 2), (("test reward", reward), ("test success [%]", success)), strict=True
    ):
        _boxes(ax, data, levels)
        ax.set_ylabel(label)
        ax.set_xlabel("removed")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(levels))
    return figure


def _boxes(ax: Axes, data: Mapping[str, Levels], levels: Sequence[float]) -> None:
    """Median and quartiles as in the thesis, whiskers to the ends, and every policy as a point."""
    names, values = list(data), [[v for seeds in by_level for v in seeds] for by_level in data.values()]
    made = ax.boxplot(values, whis=(0, 100), showfliers=False, widths=0.5, patch_artist=True)
    for patch, name in zip(made["boxes"], names, strict=True):
        patch.set(facecolor=MODEL if name == "none" else FAINT, alpha=0.45)
    for line in made["medians"]:
        line.set(color=ALARM, linewidth=1.8)
    shades = np.linspace(0.75, 0.0, len(levels))
    for k, (level, shade) in enumerate(zip(levels, shades, strict=True)):
        points = [(x, v) for x, by_level in enumerate(data.values(), 1) for v in by_level[k]]
        ax.plot(*zip(*points, strict=True), "o", color=str(shade), markersize=4, label=f"d_max {1000 * level:g} mm")
    ax.set_xticks(range(1, len(names) + 1), names)
