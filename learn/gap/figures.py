"""Figures of a diagnosis: measurement dark, base model vermilion, repaired model blue, noise green."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...sim.base.types import Array
from ..reports.figures import ALARM, FAINT, MEASURED, MODEL, NOISE, WIDTH, push_direction, styled
from .consistent import percent
from .decide import TIED
from .diagnosis import Share
from .where import CONTRAST

#: Longest name on an axis; most dots per curve; residual over noise from which bars are drawn on a logarithmic axis.
LONGEST, MOST_DOTS, SPREAD = 30, 2000, 30.0
BASE, BEST = "base model", "repaired model"
_HEAT = LinearSegmentedColormap.from_list("misfit", ["#FFFFFF", "#FBE3D2", ALARM, "#4A1D00"])


def short(name: str, longest: int = LONGEST) -> str:
    """Return a name of at most so many letters, its middle left out."""
    if len(name) <= longest:
        return name
    head = (longest - 1) // 2
    return f"{name[:head]}…{name[len(name) - (longest - 1 - head) :]}"


@styled
def course_figure(
    t: Sequence[Array], pressure: Sequence[Array], held: Sequence[NDArray[np.bool_]], titles: Sequence[str]
) -> Figure:  # fmt: skip
    """Draw the pressure of gusts that was read off some recordings over time, and when a gripper may have held.

    Args:
        t: Time of each recording [s], shapes [T].
        pressure: Pressure along x and y [Pa], shapes [T, 2].
        held: Whether the gripper may hold, shapes [T].
        titles: Name of each recording.
    """
    figure = Figure(figsize=(WIDTH, 1.0 + 1.5 * len(t)), layout="constrained")
    rows = figure.subplots(len(t), 1, sharey=True, squeeze=False)[:, 0]
    for ax, time, own, closed, title in zip(rows, t, pressure, held, titles, strict=True):
        ax.fill_between(time, 0, 1, where=closed, transform=ax.get_xaxis_transform(), color=FAINT, alpha=0.4,
                        linewidth=0, label="gripper may hold")  # fmt: skip
        for values, colour, name in zip(own.T, (MODEL, MEASURED), "xy", strict=True):
            ax.plot(time, values, color=colour, label=f"along {name}")
        ax.set_title(title)
        ax.set_ylabel("pressure [Pa]")
    figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    rows[-1].set_xlabel("time [s]")
    return figure


@styled
def heat_figure(
    base: Array, best: Array, edges: Array, *, titles: Sequence[str], noise: float, scatter: float | None = None,
) -> Figure:  # fmt: skip
    """Draw the residual as a share of the motion by recording and time window, base and repaired model on one scale.

    The scale ends at the noise, or at the least residual where the noise is far below all of them.

    Args:
        base: Of the base model, NaN past a recording's end, shape [R, W].
        best: Of the repaired model, shape [R, W].
        edges: Of the windows [s], shape [W + 1].
        titles: Name of each recording, length R.
        noise: Noise of the sensors as a share of the motion.
        scatter: Scatter of repeats as a share of the motion, which is named where it is above the noise; None where
            nothing was repeated.
    """
    count = len(base)
    figure = Figure(figsize=(WIDTH, 1.7 + 0.3 * max(count, 3)), layout="constrained")
    known = f"noise {percent(noise)}"
    if scatter is not None and scatter > noise:
        known += f", repeats differ by {percent(scatter)}"
    figure.suptitle(f"Residual as a share of the motion ({known})", fontsize=11)
    axes = figure.subplots(1, 2, sharey=True)
    low, top = heat_scale(np.concatenate([base, best]), noise)
    for ax, values, name in zip(axes, (base, best), (BASE, BEST), strict=True):
        ax.set_facecolor("#EEEEEE")
        drawn = ax.pcolormesh(edges, np.arange(count + 1) - 0.5, np.ma.masked_invalid(np.maximum(values, low)),
                              cmap=_HEAT, norm=LogNorm(low, top), edgecolors="white", linewidth=0.5)  # fmt: skip
        ax.set_title(name)
        ax.set_xlabel("time [s]")
        ax.grid(visible=False)
    axes[0].set_ylabel("recording")
    axes[0].set_yticks(range(count), [short(t) for t in titles])
    axes[0].invert_yaxis()
    bar = figure.colorbar(drawn, ax=axes, label="rms residual / rms motion", fraction=0.05)
    ticks = [m * 10.0**e for e in range(-9, 3) for m in (1, 2, 5) if low <= m * 10.0**e <= top]
    bar.set_ticks(ticks[:: 1 + len(ticks) // 8], labels=[percent(x) for x in ticks[:: 1 + len(ticks) // 8]])
    bar.ax.minorticks_off()
    return figure


def heat_scale(shares: Array, noise: float) -> tuple[float, float]:
    """Return both ends of the scale of residuals as shares of the motion, three decades apart at most."""
    top = max(float(np.nanmax(shares)), 1e-12)
    low = max(noise, float(np.nanmin(shares)), 1e-3 * top)
    return min(low, top), max(top, 4.0 * low)


@styled
def before_after_figure(
    t: Sequence[Array], measured: Sequence[Array], base: Sequence[Array], best: Sequence[Array], *,
    titles: Sequence[str], labels: Sequence[str],
) -> Figure:  # fmt: skip
    """Draw measured channels against both models, a row per recording and a column per channel.

    Args:
        t: Times of each of N recordings [s], shapes [T].
        measured: What was measured, shapes [T, C].
        base: Simulated by the base model, shapes [T, C].
        best: Simulated by the repaired model, shapes [T, C].
        titles: Name of each recording, length N.
        labels: Name and unit of each channel, length C.
    """
    figure = Figure(figsize=(WIDTH, 0.9 + 2.3 * len(t)), layout="constrained")
    axes = figure.subplots(len(t), len(labels), squeeze=False, sharex="row", sharey="row")
    for i, row in enumerate(axes):
        for c, ax in enumerate(row):
            few = len(t[i]) <= 400
            ax.plot(t[i], measured[i][:, c], "." if few else "-", color=MEASURED, markersize=3, linewidth=0.8,
                    label="measured")  # fmt: skip
            _both(ax, t[i], t[i], base[i][:, c], best[i][:, c])
            ax.set_title(short(titles[i], 28))
            ax.set_ylabel(labels[c])
            if i == len(t) - 1:
                ax.set_xlabel("time [s]")
    return _keyed(figure, axes[0, 0])


def _both(ax: Axes, x_base: Array, x_best: Array, base: Array, best: Array) -> None:
    ax.plot(x_base, base, color=ALARM, linestyle="--", linewidth=1.2, label=BASE)
    ax.plot(x_best, best, color=MODEL, linewidth=1.2, label=BEST)


def _keyed(figure: Figure, ax: Axes) -> Figure:
    """Put the key of a panel above the figure."""
    handles, names = ax.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=len(names), markerscale=2)
    return figure


@styled
def loops_figure(
    force: Sequence[Array], measured: Sequence[Array], base: Sequence[Array], best: Sequence[Array], *,
    titles: Sequence[str],
) -> Figure:  # fmt: skip
    """Draw force against displacement along the push, as measured and by both models.

    Args:
        force: Force of each of N recordings [N], shapes [T, 3].
        measured: Displacement [m], shapes [T, 3].
        base: Of the base model [m], shapes [T, 3].
        best: Of the repaired model [m], shapes [T, 3].
        titles: Name of each recording, length N.
    """
    columns = 2 if len(force) > 1 else 1
    rows = -(-len(force) // columns)
    figure = Figure(figsize=(WIDTH if columns > 1 else 5.5, 0.6 + 2.9 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.ravel()[len(force) :]:
        ax.set_visible(False)
    for ax, f, *moved, title in zip(axes.ravel(), force, measured, base, best, titles, strict=False):
        along = push_direction(f)
        x, x_base, x_best = (100.0 * m @ along for m in moved)
        ax.plot(x, f @ along, ".", color=MEASURED, markersize=3, label="measured")
        _both(ax, x_base, x_best, f @ along, f @ along)
        ax.set_title(short(title, 44))
        ax.set_xlabel("displacement along the push [cm]")
    for ax in axes[:, 0]:
        ax.set_ylabel("force [N]")
    return _keyed(figure, axes[0, 0])


@styled
def motion_figure(
    angle: Sequence[Array], rate: Sequence[Array], base: Sequence[Array], best: Sequence[Array], *,
    names: Sequence[str], units: tuple[str, str, str],
) -> Figure:  # fmt: skip
    """Draw the residuals of both models against coordinate and rate, a row per joint; empty arrays are left out.

    Args:
        angle: Coordinate of each of N joints over all recordings, shapes [T].
        rate: Its rate, shapes [T].
        base: Measured minus base model, shapes [T].
        best: Measured minus repaired model, shapes [T].
        names: Name of each joint, length N.
        units: Of coordinate, rate and residual.
    """
    figure = Figure(figsize=(WIDTH, 0.6 + 2.7 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), 2, squeeze=False, sharey="row")
    for row, *across, b, a, name in zip(axes, angle, rate, base, best, names, strict=True):
        row[0].set_ylabel(f"{short(name, 24)}\nresidual [{units[2]}]")
        for ax, x, what, unit in zip(row, across, ("coordinate", "rate"), units[:2], strict=True):
            ax.set_xlabel(f"{what} [{unit}]")
            ax.axhline(0.0, color="#888888", linewidth=0.8)
            every = slice(None, len(x), -(-len(b) // MOST_DOTS) or 1)
            for y, colour, label in ((b, ALARM, BASE), (a, MODEL, BEST)):
                ax.plot(x[every], y[every], ".", color=colour, markersize=2.5, alpha=0.5, label=label)
    return _keyed(figure, axes[0, 0])


@styled
def ranking_figure(names: Sequence[str], delta: Array, explained: Array) -> Figure:
    """Draw each model's difference of the information criterion, annotated with the share of the excess explained.

    Args:
        names: What each of N models adds, best first; empty for the base model.
        delta: Information criterion minus the preferred model's, shape [N].
        explained: Shares of the base model's excess chi-squared, shape [N].
    """
    figure = Figure(figsize=(WIDTH, 1.1 + 0.3 * len(names)), layout="constrained")
    ax = figure.subplots()
    at, length = np.arange(len(names)), np.maximum(np.asarray(delta, dtype=float), 0.0)
    first = int(np.abs(delta).argmin())
    colours = [MODEL if i == first else FAINT if name else ALARM for i, name in enumerate(names)]
    ax.barh(at, length, color=colours, height=0.7)
    for i, (x, share) in enumerate(zip(length, explained, strict=True)):
        text = ("preferred, " if i == first else "") + f"{share:.0%} explained"
        ax.annotate(text, (x, i), (5, 0), textcoords="offset points", va="center", fontsize=9, color=MEASURED)
    ax.set_yticks(at, [short(name, 44) or BASE for name in names])
    ax.invert_yaxis()
    ax.set_title("Information criterion of each model (shorter is better)")
    ax.set_xscale("symlog", linthresh=1.0)
    ax.set_xlim(0.0, 20.0 * max(10.0, float(length.max())))
    ax.set_xlabel(f"ΔIC to the preferred model (below {TIED:g}: indistinguishable)")
    ax.grid(visible=False, axis="y")
    return figure


@styled
def gap_figure(
    base: float, repaired: float, noise_floor: float, *, unit: str, scatter: float | None = None,
    name: str = "held-out RMSE",
) -> Figure:  # fmt: skip
    """Draw the error of both models, the noise floor, and how far repeats of one experiment differ, if any were made.

    Args:
        base: Of the base model.
        repaired: Of the repaired model.
        noise_floor: What noise alone leaves.
        unit: Of all.
        scatter: Scatter of repeats, None where nothing was repeated.
        name: What kind of error it is.
    """
    bars = [(BASE, base, ALARM), (BEST, repaired, MODEL), ("noise floor", noise_floor, NOISE)]
    if scatter is not None:
        bars.append(("scatter of repeats", scatter, FAINT))
    figure = Figure(figsize=(5.2, 1.1 + 0.3 * len(bars)), layout="constrained")
    ax = figure.subplots()
    ax.set_title(name[0].upper() + name[1:])
    labels, values, colours = zip(*bars, strict=True)
    ax.barh(labels, values, color=colours, height=0.65)
    for i, x in enumerate(values):
        ax.annotate(f"{x:.3g}", (x, i), (4, 0), textcoords="offset points", va="center", fontsize=9)
    ax.invert_yaxis()
    ax.set_xlim(0.0, 1.18 * max(*values, 1e-300))
    ax.set_xlabel(f"RMSE [{unit}]")
    ax.grid(visible=False, axis="y")
    return figure


@styled
def shares_figure(base: Sequence[Share], best: Sequence[Share]) -> Figure:
    """Draw residual over noise by part, one panel per kind; parts that only the base model has show that alone."""
    kinds = list(dict.fromkeys(s.by for s in base))
    groups = [[s for s in base if s.by == kind] for kind in kinds]
    after = {(s.by, s.part): s.ratio for s in best}
    heights = [len(g) + 0.6 for g in groups]
    figure = Figure(figsize=(WIDTH, 1.1 + 0.3 * sum(heights)), layout="constrained")
    axes = figure.subplots(len(groups), 1, squeeze=False, sharex=True, gridspec_kw={"height_ratios": heights})[:, 0]
    for ax, group in zip(axes, groups, strict=True):
        at = np.arange(len(group))
        ax.barh(at - 0.2, [s.ratio for s in group], color=ALARM, height=0.38, label=BASE)
        ax.barh(at + 0.2, [after.get((s.by, s.part), 0.0) for s in group], color=MODEL, height=0.38, label=BEST)
        ax.axvline(1.0, color=NOISE, linewidth=2, label="noise alone")
        ax.set_yticks(at, [short(s.part) for s in group])
        ax.set_ylim(len(group) - 0.4, -0.6)
        ax.set_ylabel(group[0].by, rotation=0, ha="right", va="center", fontweight="bold")
        ax.grid(visible=False, axis="y")
    figure.align_ylabels()
    largest = max((s.ratio for s in (*base, *best)), default=1.0)
    if largest > SPREAD:
        axes[0].set_xscale("log")
        axes[0].set_xlim(0.5, 2.0 * largest)
    axes[0].set_title("Residual by part of the motion")
    axes[-1].set_xlabel(f"rms residual / noise (above {CONTRAST}: more than noise)")
    return _keyed(figure, axes[0])
