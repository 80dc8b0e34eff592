"""Figures of chapter 3's reproduction: plain arrays in, a `matplotlib.figure.Figure` out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from ....sim.base.types import Array
from ...inference.predict import Prediction
from ...reports.figures import ALARM, FAINT, MEASURED, MODEL, NOISE, WIDTH
from ...reports.figures import styled as styled

THESIS = "#CC79A7"
"""Colour of the thesis's own numbers."""
_COLOURS = (MODEL, NOISE, ALARM, "#56B4E9", "#E69F00", THESIS, MEASURED, "#8C6D31")


@styled
def baseline_figure(
    t: Array, truth: Array, groups: Mapping[str, Mapping[str, tuple[Array, Array]]], *, width: Mapping[str, float]
) -> Figure:
    """Draw the 95 % bands of several methods about the truth (figure 3.5), each kind of start on rows of its own.

    Args:
        t: Times [s], shape [T].
        truth: True vertical displacement of one unseen trajectory [m], shape [T].
        groups: Low and high end by kind of start and method, shapes [T].
        width: Mean width of each band over all unseen trajectories [m] by title, kind of start and method.
    """
    columns = 4
    places = [(sum(-(-len(g) // columns) for g in list(groups.values())[:n]) + k // columns, k % columns, name, band)
              for n, group in enumerate(groups.values()) for k, (name, band) in enumerate(group.items())]  # fmt: skip
    rows = places[-1][0] + 1
    figure = Figure(figsize=(WIDTH, 0.5 + 3.0 * rows), layout="constrained")
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=[2.0, 1.0] * rows)
    for i, j, name, (low, high) in places:
        upper, lower = figure.add_subplot(grid[2 * i, j]), figure.add_subplot(grid[2 * i + 1, j])
        upper.fill_between(t, 100 * low, 100 * high, color=FAINT, linewidth=0)
        upper.plot(t, 100 * truth, color=ALARM, linewidth=1.0)
        upper.set_title(f"{name}\nwidth {1000 * width[name]:.2f} mm", fontsize=9)
        upper.tick_params(labelbottom=False)
        lower.fill_between(t, 1000 * (low - truth), 1000 * (high - truth), color=FAINT, linewidth=0)
        lower.axhline(0.0, color=ALARM, linewidth=1.0)
        lower.set_xlabel("time [s]")
        lower.locator_params(axis="y", nbins=4)
        if j == 0:
            upper.set_ylabel("vertical [cm]")
            lower.set_ylabel("less truth\n[mm]")
    return figure


@styled
def calls_figure(
    panels: Mapping[str, Mapping[str, tuple[Sequence[float], Sequence[float], Sequence[float]]]], *, reference: float
) -> Figure:
    """Draw distance to the posterior and interval width over simulator calls, one row for each kind of start.

    Args:
        panels: By kind of start and method, calls, energy distance in that of exact draws, and interval width [m].
        reference: Largest R-hat of the chains that distances are taken to.
    """
    figure = Figure(figsize=(WIDTH, 0.9 + 3.0 * len(panels)), layout="constrained")
    for k, ((title, curves), (left, right)) in enumerate(
        zip(panels.items(), figure.subplots(len(panels), 2, squeeze=False, sharex=True), strict=True)
    ):
        for (name, (calls, distance, width)), colour in zip(curves.items(), _COLOURS, strict=False):
            style, thousand = "s--" if "MH" in name else "o-", np.asarray(calls) / 1000
            left.plot(thousand, distance, style, color=colour, markersize=4, label=name if k == 0 else None)
            right.plot(thousand, 1000 * np.asarray(width), style, color=colour, markersize=4)
        left.axhline(1.0, color="#888888", linewidth=0.8, linestyle=":")
        left.set(yscale="log", ylabel="energy distance\n[that of exact draws]")
        right.set(yscale="log", ylabel="95 % interval width [mm]")
        left.set_title(f"{title} (reference: R-hat {reference:.3g})", fontsize=9)
        right.set_title(title, fontsize=9)
    for ax in (left, right):
        ax.set_xlabel("simulator calls [thousands]")
    figure.legend(loc="outside upper center", ncols=4)
    return figure


@styled
def joint_figure(rows: Sequence[tuple[str, Array, Array]], truth: Array, names: Sequence[str]) -> Figure:
    """Draw stiffness against damping of every branch without and with the inequality prior (figure 3.6).

    Args:
        rows: Title, particles without and particles with the prior, in SI units, shapes [P, 2 R].
        truth: True values, shape [2 R].
        names: Names of the R branches.
    """
    count = len(names)
    figure = Figure(figsize=(WIDTH, 0.5 + 2.9 * len(rows)), layout="constrained")
    axes = figure.subplots(len(rows), count, squeeze=False)
    for (title, without, with_prior), line in zip(rows, axes, strict=True):
        for i, ax in enumerate(line):
            ax.plot(without[:, i], without[:, count + i], "o", color=FAINT, markersize=5, label="SVGD")
            ax.plot(with_prior[:, i], with_prior[:, count + i], "o", color=MODEL, markersize=4, alpha=0.8,
                    label="NNSVGD")  # fmt: skip
            ax.plot(truth[i], truth[count + i], "*", color=ALARM, markersize=11, label="truth")
            ax.set(xscale="log", yscale="log", xlim=(4, 250), ylim=(4, 250))
            ax.set_title(f"{names[i]}, {title}", fontsize=9)
            ax.set_xlabel("K [N m/rad]")
        line[0].set_ylabel("D [N m s/rad]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


@styled
def sweep_figure(
    kt: Sequence[float], width: Array, nll: Array, without: Array, iterations: Sequence[int],
    letter: Mapping[str, Sequence[tuple[float, float, float]]],
) -> Figure:  # fmt: skip
    """Draw what the prior gains over temperature and, for SVGD by the letter of the thesis, over iterations.

    Args:
        kt: Temperatures.
        width: Width without over width with the prior, shape [branches, temperatures].
        nll: The same ratio of the negative log-likelihoods.
        without: Width without the prior [m], same shape.
        iterations: Numbers of iterations.
        letter: By label, the ratio of widths at each with the ends of its interval.
    """
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    one, two, three = figure.subplots(1, 3)
    one.plot(kt, 100 * without.T, color=FAINT, linewidth=0.8)
    one.plot(kt, 100 * np.median(without, 0), "o-", color=MODEL, label="SVGD, median")
    one.axhline(19.0, color=THESIS, linestyle="--", label="thesis, kT 1/100")
    one.set(xscale="log", yscale="log", ylabel="95 % width without prior [cm]", xlabel="temperature kT")
    two.plot(kt, width.T, color=FAINT, linewidth=0.8)
    two.plot(kt, np.median(width, 0), "o-", color=MODEL, label="width, median")
    two.plot(kt, np.median(nll, 0), "s-", color=NOISE, label="NLL, median")
    two.axhline(0.19 / 0.11, color=THESIS, linestyle="--", label="thesis, width")
    two.axhline(3050.7 / 2268.1, color=THESIS, linestyle=":", label="thesis, NLL")
    two.set(xscale="log", ylabel="without / with the prior", xlabel="temperature kT")
    for k, ((name, ratios), colour) in enumerate(zip(letter.items(), _COLOURS, strict=False)):
        middle, low, high = np.array(ratios).T
        high = np.where(np.isfinite(high), high, middle)
        at = np.asarray(iterations) * (1.0 + 0.03 * (k - 1))  # beside each other
        three.errorbar(at, middle, (middle - np.where(low > 0.0, low, middle), high - middle), fmt="o-", color=colour,
                       label=name, capsize=2, markersize=4)  # fmt: skip
    three.axhline(0.19 / 0.11, color=THESIS, linestyle="--", label="thesis")
    three.axhline(1.0, color="#888888", linewidth=0.8, linestyle=":")
    three.set(ylabel="width without / with the prior", xlabel="iterations, by the letter")
    for ax in (one, two, three):
        ax.legend(fontsize=7.5, loc="upper left")
        low, high = ax.get_ylim()
        # room for the legend above what is drawn
        ax.set_ylim(low, high * (high / low) ** 0.3 if ax.get_yscale() == "log" else high + 0.35 * (high - low))
    return figure


@styled
def bars_and_bands_figure(
    labels: Sequence[str], width: Array, outside: Array, shown: Sequence[tuple[str, Prediction]], *, unit: str
) -> Figure:
    """Draw interval width and share outside by study, and three predicted trajectories of some (figures 3.7 to 3.9).

    Args:
        labels: Of the studies.
        width: Mean width of the 95 % interval [m].
        outside: Share of measured points outside, in [0, 1].
        shown: Label and prediction of the studies whose trajectories are drawn.
        unit: What the labels are.
    """
    figure = Figure(figsize=(WIDTH, 2.8 + 1.9 * len(shown)), layout="constrained")
    grid = figure.add_gridspec(1 + len(shown), 6)
    wide, out = figure.add_subplot(grid[0, :3]), figure.add_subplot(grid[0, 3:])
    wide.bar(labels, 100 * width, color=MODEL)
    wide.set(ylabel="95 % width [cm]", xlabel=unit)
    out.bar(labels, 100 * outside, color=NOISE)
    out.axhline(5.0, color="#888888", linestyle=":")
    out.set(ylabel="points outside [%]", xlabel=unit)
    for i, (label, p) in enumerate(shown):
        for j in range(3):
            ax = figure.add_subplot(grid[1 + i, 2 * j : 2 * j + 2])
            ax.fill_between(p.t[j], 100 * p.low[j][:, 2], 100 * p.high[j][:, 2], color=FAINT, linewidth=0)
            ax.plot(p.t[j], 100 * p.measured[j][:, 2], color=ALARM, linewidth=0.9)
            ax.set_title(f"{label}, trajectory {j + 1}", fontsize=9)
            if j == 0:
                ax.set_ylabel("vertical [cm]")
            if i == len(shown) - 1:
                ax.set_xlabel("time [s]")
    return figure


@styled
def cost_figure(costs: Mapping[str, tuple[Array, Array, Array]]) -> Figure:
    """Draw wall time and rollouts of an iteration over its sizes, with straight lines through them.

    Args:
        costs: By what grows, sizes, seconds and rollouts, shapes [N].
    """
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    for ax, (name, (size, seconds, rollouts)) in zip(figure.subplots(1, len(costs)), costs.items(), strict=True):
        line = np.linspace(0, size.max(), 50)
        ax.plot(line, 1000 * np.polyval(np.polyfit(size, seconds, 1), line), color=FAINT)
        ax.plot(size, 1000 * seconds, "o", color=MODEL, label="time")
        ax.set(xlabel=f"{name}", ylabel="time of an iteration [ms]", xlim=(0, None), ylim=(0, None))
        other = ax.twinx()
        other.plot(size, rollouts, "x", color=NOISE, label="rollouts")
        other.set(ylim=(0, None))
        other.grid(visible=False)
        other.set_ylabel("rollouts (x)")
    return figure
