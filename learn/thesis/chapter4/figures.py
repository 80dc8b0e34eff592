"""Figures of chapter 4's reproduction: plain numbers in, a `matplotlib.figure.Figure` out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ....sim.base.types import Array
from ....sim.scenes.scene import fork_height, rest_capsules
from ....sim.trees.tree import Tree
from ...reports.figures import ALARM, FAINT, MEASURED, MODEL, NOISE, WIDTH, styled
from ..common.interval import Interval

Numbers = Mapping[str, Mapping[str, Interval]]
_COLOURS = (FAINT, "#56B4E9", MODEL, NOISE, ALARM, "#CC79A7", "#F0E442", "#E69F00", "#000000")


@styled
def patterns_figure(panels: Mapping[str, Numbers], marks: Mapping[str, tuple[str, Sequence[float]]]) -> Figure:
    """Draw numbers of policies by occlusion pattern, one panel each, bars with intervals over seeds.

    Args:
        panels: By the label of the axis: by policy, by pattern.
        marks: By the label of the axis: what another's figures are called, and one for every pattern.
    """
    figure = Figure(figsize=(WIDTH, 2.6 * len(panels)), layout="constrained")
    for ax, (label, numbers) in zip(figure.subplots(len(panels), 1, squeeze=False)[:, 0], panels.items(), strict=True):
        _bars(ax, numbers)
        ax.set_ylabel(label)
        if label in marks:
            name, values = marks[label]
            ax.plot(np.arange(len(values)), values, "D", color=MEASURED, markersize=5, label=name)
        ax.set_ylim(0.0, 105.0 if label.startswith("success") else None)  # Student's intervals of shares reach beyond
    figure.legend(*_legend(figure), loc="outside upper center", ncols=4)
    return figure


@styled
def groups_figure(panels: Mapping[str, Mapping[str, Interval]]) -> Figure:
    """Draw some numbers of few runs side by side: one panel each, a bar a run.

    Args:
        panels: By the label of the axis: by run.
    """
    figure = Figure(figsize=(WIDTH, 2.8), layout="constrained")
    for ax, (label, values) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
        for k, (value, colour) in enumerate(zip(values.values(), _COLOURS[: len(values)], strict=True)):
            ax.bar(k, value.mean, 0.7, yerr=_half(value), color=colour, ecolor=MEASURED)
        ax.set_xticks(range(len(values)), [name.replace(", ", ",\n") for name in values])
        ax.set_ylabel(label)
    return figure


@styled
def forests_figure(success: Array, names: Sequence[str]) -> Figure:
    """Draw success by the forest of training (columns) and of the test (rows) [%], [F, F]."""
    figure = Figure(figsize=(4.4, 4.0), layout="constrained")
    ax = figure.subplots()
    ax.imshow(success, cmap="Blues", vmin=0.0, vmax=100.0)
    for (row, column), value in np.ndenumerate(success):
        ax.text(column, row, f"{value:.1f}", ha="center", va="center", color="white" if value > 60 else MEASURED)
    ax.set_xticks(range(len(names)), names)
    ax.set_yticks(range(len(names)), names)
    ax.set_xlabel("trained among")
    ax.set_ylabel("tested among")
    ax.grid(visible=False)
    return figure


@styled
def trees_figure(rows: Mapping[str, Sequence[Tree]]) -> Figure:
    """Draw trees as they have grown, seen from the side, without most of the trunk: a row for every name."""
    count = max(map(len, rows.values()))
    figure = Figure(figsize=(WIDTH, WIDTH / count * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), count, squeeze=False)
    for row, (name, trees) in zip(panels, rows.items(), strict=True):
        row[0].set_ylabel(name)
        for ax, tree in zip(row, trees, strict=False):
            _tree(ax, tree)
    return figure


@styled
def roc_figure(kinds: Mapping[str, Mapping[str, Any]], thesis: Mapping[str, tuple[float, ...]]) -> Figure:
    """Draw the ROC of every classifier, and the one point of it that the author tells (specificity, recall in %)."""
    figure = Figure(figsize=(5.0, 4.4), layout="constrained")
    ax = figure.subplots()
    for (name, found), colour in zip(kinds.items(), (MODEL, ALARM), strict=False):
        wrong, right = np.array(found["curve"])
        ax.plot(100 * wrong, 100 * right, color=colour, label=f"{name}, here: AUC {found['auc'][0]:.3f}")
        _, area, specificity, recall = thesis[name]
        ax.plot(100 - specificity, recall, "D", color=colour, label=f"{name}, author: AUC {area:.3f}")
    ax.plot([0, 100], [0, 100], "--", color=FAINT)
    ax.set_xlabel("told contact where there is none [% of rows]")
    ax.set_ylabel("contact found [% of rows]")
    ax.legend(loc="lower right")
    return figure


def _bars(ax: Axes, numbers: Numbers) -> None:
    width = 0.8 / len(numbers)
    for k, ((name, values), colour) in enumerate(zip(numbers.items(), _COLOURS[: len(numbers)], strict=True)):
        place = np.arange(len(values)) + (k - 0.5 * (len(numbers) - 1)) * width
        means = [v.mean for v in values.values()]
        ax.bar(place, means, width, yerr=[_half(v) for v in values.values()], color=colour, ecolor=MEASURED, label=name)
    ax.set_xticks(range(len(values)), list(values))


def _half(value: Interval) -> float:
    """Half of an interval, 0 where there is none."""
    return value.high - value.mean if value.high == value.high else 0.0


def _legend(figure: Figure) -> tuple[list[Any], list[str]]:
    """Return what all panels show, each once."""
    found: dict[str, Any] = {}
    for ax in figure.axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)


def _tree(ax: Axes, tree: Tree) -> None:
    start, end, radius = rest_capsules(tree)
    lines = np.stack([start, end], axis=1)[:, :, [0, 2]]
    ax.add_collection(LineCollection(list(lines), linewidths=np.clip(60.0 * radius, 0.3, 4.0), colors="#6B4F3A"))
    ax.autoscale_view()
    ax.set_ylim(bottom=0.7 * fork_height(tree))
    ax.set_aspect("equal")
    for side in ax.spines.values():
        side.set_visible(False)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.grid(visible=False)
