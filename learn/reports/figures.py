"""Figures of an identification, drawn without pyplot's global state.

Every function takes plain arrays and returns a `matplotlib.figure.Figure`; `png` turns one into bytes. Colours are the
colour-blind safe ones of Okabe and Ito: measurement dark, model blue, noise green, warning vermilion.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any, ParamSpec

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...sim.base.types import Array

MEASURED, MODEL, NOISE, ALARM, FAINT = "#333333", "#0072B2", "#009E73", "#D55E00", "#BBBBBB"
WIDTH = 9.0
"""Width of every figure [in]."""
MOST_PAIRS = 8
"""Number of parameters up to which pairs are drawn."""
_MARGINALS = "Posterior particles: median (95 % interval)"

_STYLE: dict[Any, Any] = {
    "font.size": 10, "axes.titlesize": 10, "axes.labelsize": 10, "legend.fontsize": 9, "xtick.labelsize": 9,
    "ytick.labelsize": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": "#E6E6E6", "grid.linewidth": 0.6, "axes.edgecolor": "#888888", "axes.axisbelow": True,
    "lines.linewidth": 1.4, "legend.frameon": False, "savefig.facecolor": "white", "axes.formatter.useoffset": False,
}  # fmt: skip
_P = ParamSpec("_P")


def styled(draw: Callable[_P, Figure]) -> Callable[_P, Figure]:
    """Draw with this module's style and leave the global one alone."""

    @wraps(draw)
    def drawn(*args: _P.args, **kwargs: _P.kwargs) -> Figure:
        """Draw the figure with this module's style."""
        with matplotlib.rc_context(_STYLE):
            return draw(*args, **kwargs)

    return drawn


def png(figure: Figure, dpi: int = 150) -> bytes:
    """Render a figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


@styled
def prediction_figure(
    t: Sequence[Array],
    measured: Sequence[Array],
    median: Sequence[Array],
    low: Sequence[Array],
    high: Sequence[Array],
    *,
    titles: Sequence[str],
    labels: Sequence[str],
) -> Figure:
    """Draw measured and predicted channels with the 95 % interval, a row per trajectory and a column per channel.

    Args:
        t: Times of each of N trajectories [s], shapes [T].
        measured: What was measured, shapes [T, C].
        median: Median of the prediction, shapes [T, C].
        low: Lower end of the 95 % interval, shapes [T, C].
        high: Upper end, shapes [T, C].
        titles: Name of each trajectory, length N.
        labels: Name and unit of each channel, length C, such as ``x [cm]``.
    """
    n, channels = len(t), len(labels)
    figure = Figure(figsize=(WIDTH, 0.9 + (2.6 if n == 1 else 1.75) * n), layout="constrained")
    axes = figure.subplots(n, channels, squeeze=False, sharex="row", sharey="row")
    for i, row in enumerate(axes):
        for c, ax in enumerate(row):
            ax.fill_between(
                t[i], low[i][:, c], high[i][:, c], color=MODEL, alpha=0.25, linewidth=0, label="95 % interval"
            )
            ax.plot(t[i], median[i][:, c], color=MODEL, label="predicted")
            few = len(t[i]) <= 400
            ax.plot(t[i], measured[i][:, c], "." if few else "-", color=MEASURED, markersize=2.5,
                    linewidth=0.8, label="measured")  # fmt: skip
            ax.set_title(titles[i])
            ax.set_ylabel(labels[c])
            if i == n - 1:
                ax.set_xlabel("time [s]")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=3)
    return figure


@styled
def posterior_figure(samples: Array, names: Sequence[str]) -> Figure:
    """Draw marginals with median and 95 % interval and, up to eight parameters, every pair.

    Args:
        samples: Particles, shape [P, n].
        names: Name and unit of each parameter, length n, such as ``K child [N m/rad]``.
    """
    n = samples.shape[1]
    if n > MOST_PAIRS:
        rows = -(-n // 4)
        figure = Figure(figsize=(WIDTH, 0.3 + 1.9 * rows), layout="constrained")
        figure.suptitle(_MARGINALS, fontsize=11)
        axes = figure.subplots(rows, 4, squeeze=False).ravel()
        for i, ax in enumerate(axes):
            _marginal(ax, samples[:, i], names[i]) if i < n else ax.set_visible(False)
        return figure
    figure = Figure(figsize=(WIDTH, 3.0 if n == 1 else WIDTH * (0.55 if n == 2 else 1.0)), layout="constrained")
    figure.suptitle(_MARGINALS, fontsize=11)
    axes = figure.subplots(n, n, squeeze=False, sharex="col")
    for i in range(n):
        for j in range(n):
            ax = axes[i, j]
            if j > i:
                ax.set_visible(False)
            elif j == i:
                _marginal(ax, samples[:, i], names[i] if i == n - 1 else "")
            else:
                _pair(ax, samples[:, j], samples[:, i])
                ax.set_xlabel(_wrapped(names[j]) if i == n - 1 else "", fontsize=8)
                ax.set_ylabel(_wrapped(names[i]) if j == 0 else "", fontsize=8)
                ax.tick_params(labelleft=j == 0)
            ax.locator_params(axis="x", nbins=4)
            ax.tick_params(axis="x", labelrotation=45 if n > 4 else 0)
    figure.align_ylabels()
    return figure


def _marginal(ax: Axes, x: Array, label: str) -> None:
    low, middle, high = np.quantile(x, [0.025, 0.5, 0.975])
    ax.hist(x, bins=min(30, max(8, len(x) // 6)), color=MODEL, alpha=0.55)
    ax.axvspan(low, high, color=MODEL, alpha=0.12, linewidth=0)
    ax.axvline(middle, color=MODEL)
    digits = max(3, 2 + int(np.floor(np.log10(max(abs(high), 1e-300))) - np.floor(np.log10(max(high - low, 1e-300)))))
    middle_text, low_text, high_text = (f"{v:#.{min(digits, 9)}g}".removesuffix(".") for v in (middle, low, high))
    ax.set_title(f"{middle_text}\n({low_text} to {high_text})", fontsize=9)
    ax.set_xlabel(_wrapped(label), fontsize=8)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    ax.locator_params(axis="x", nbins=3)


def _pair(ax: Axes, x: Array, y: Array) -> None:
    ax.plot(x, y, ".", color=MODEL, markersize=5, alpha=0.5, markeredgewidth=0)
    ax.text(0.97, 0.95, f"r = {np.corrcoef(x, y)[0, 1]:.2f}", transform=ax.transAxes, ha="right", va="top", fontsize=8,
            color="#555555")  # fmt: skip


def _wrapped(label: str) -> str:
    """Put each word of a name, and the unit, on its own line."""
    name, _, unit = label.partition(" [")
    return "\n".join([*name.split(), f"[{unit}" if unit else ""]).rstrip()


@styled
def convergence_figure(log_posterior: Array, mean: Array) -> Figure:
    """Draw the convergence of the particles.

    Args:
        log_posterior: Log posterior of every particle at every iteration, up to a constant, shape [I, P].
        mean: Mean over the particles of every coordinate, in posterior standard deviations, shape [I, D].
    """
    figure = Figure(figsize=(WIDTH, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    steps = np.arange(len(log_posterior))
    # a symmetric-log axis about the best value shows large early and small late changes
    below = np.maximum(np.nanmax(log_posterior) - log_posterior, 0.0)
    left.plot(steps, below, color=FAINT, linewidth=0.6)
    left.plot(steps, np.nanmedian(below, axis=1), color=MODEL, linewidth=2)
    left.set_yscale("symlog", linthresh=1.0)
    left.invert_yaxis()
    left.set_ylabel("best log posterior minus log posterior")
    left.set_title("Log posterior of the particles, median in blue")
    right.plot(steps, mean, linewidth=1.0)
    right.set_ylabel("particle mean\n[posterior standard deviations]")
    right.set_title("Mean of each coordinate")
    for ax in (left, right):
        ax.set_xlabel("iteration")
    return figure


@styled
def coverage_figure(nominal: Array, covered: Array) -> Figure:
    """Draw the coverage of central intervals against their nominal probability.

    Args:
        nominal: Nominal probabilities, shape [N].
        covered: Shares of held-out points inside, shape [N].
    """
    figure = Figure(figsize=(4.2, 3.8), layout="constrained")
    ax = figure.subplots()
    ax.plot([0, 100], [0, 100], color=NOISE, linestyle="--", label="ideal")
    ax.plot(100 * nominal, 100 * covered, color=MODEL, marker=".", label="held-out points")
    ax.set_title("Coverage of central intervals")
    ax.set_xlabel("nominal probability [%]")
    ax.set_ylabel("points inside [%]")
    ax.legend()
    return figure


@styled
def amplitude_figure(amplitude: Array, misfit: Array, noise_floor: float, *, label: str) -> Figure:
    """Draw RMSE against amplitude of the motion in time windows.

    Args:
        amplitude: Root mean square of what was measured in each window, shape [W].
        misfit: RMSE there, shape [W].
        noise_floor: RMSE of a perfect model.
        label: Unit of all.
    """
    figure = Figure(figsize=(4.6, 3.6), layout="constrained")
    ax = figure.subplots()
    ax.plot(amplitude, misfit, ".", color=MODEL, markersize=7, label="time windows, held out")
    ax.axhline(noise_floor, color=NOISE, linestyle="--", label="noise floor")
    ax.set_title("Error against amplitude")
    ax.set_xlabel(f"rms of the motion [{label}]")
    ax.set_ylabel(f"RMSE [{label}]")
    ax.set_ylim(bottom=0.0)
    ax.legend()
    return figure


@styled
def residual_figure(t: Sequence[Array], residual: Sequence[Array], sigma: Array, *, label: str) -> Figure:
    """Draw the residual against the noise: over time, as a histogram, and its autocorrelation.

    A residual that is noise stays in the green band, follows the green curve and has no autocorrelation. The title
    states the ratio of the two root mean squares, in vermilion if it exceeds 1.3.

    Args:
        t: Times of each of N trajectories [s], shapes [T].
        residual: Measured minus predicted, shapes [T, C].
        sigma: Noise of the channels, shape [C].
        label: Name and unit of the residual.
    """
    scaled = [r / sigma for r in residual]
    ratio = float(np.sqrt(np.mean(np.concatenate([s.ravel() for s in scaled]) ** 2)))
    figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
    colour = ALARM if ratio > 1.3 else MEASURED
    figure.suptitle(f"rms residual = {ratio:.2f} times the noise", color=colour, fontsize=12)
    grid = figure.add_gridspec(2, 2)
    _residual_in_time(figure.add_subplot(grid[0, :]), t, residual, sigma, colour, label)
    _residual_histogram(figure.add_subplot(grid[1, 0]), np.concatenate([s.ravel() for s in scaled]), colour)
    _autocorrelation(figure.add_subplot(grid[1, 1]), t, scaled, colour)
    return figure


def _residual_in_time(
    ax: Axes, t: Sequence[Array], residual: Sequence[Array], sigma: Array, colour: str, label: str
) -> None:
    """Draw all channels of consecutive trajectories over the 95 % interval of the noise."""
    start, band = 0.0, 1.96 * float(np.sqrt(np.mean(np.square(sigma))))
    ax.axhspan(-band, band, color=NOISE, alpha=0.25, linewidth=0, label="95 % interval of the noise")
    for i, (time, r) in enumerate(zip(t, residual, strict=True)):
        ax.plot(start + time - time[0], r, ".", color=colour, markersize=2, markeredgewidth=0)
        start += 1.06 * (time[-1] - time[0])
        if i < len(t) - 1:
            ax.axvline(start - 0.03 * (time[-1] - time[0]), color="#888888", linewidth=0.6)
    ax.set_xlabel("time, trajectories concatenated [s]")
    ax.set_ylabel(label)
    ax.legend(loc="upper right")


def _residual_histogram(ax: Axes, scaled: Array, colour: str) -> None:
    reach = min(max(4.0, float(np.quantile(np.abs(scaled), 0.999)) * 1.1), 60.0)
    ax.hist(
        scaled, bins=np.linspace(-reach, reach, 61).tolist(), density=True, color=colour, alpha=0.5, label="residual"
    )
    x = np.linspace(-reach, reach, 401)
    ax.plot(x, np.exp(-x * x / 2) / np.sqrt(2 * np.pi), color=NOISE, linewidth=2, label="standard normal (noise)")
    ax.set_ylim(top=1.4 * ax.get_ylim()[1])  # room for the key
    ax.set_xlabel("residual / noise")
    ax.set_ylabel("probability density")
    ax.legend(loc="upper right")


def _autocorrelation(ax: Axes, t: Sequence[Array], scaled: Sequence[Array], colour: str) -> None:
    lags = min(40, min(len(s) for s in scaled) // 2)
    power = sum(float(np.sum(s * s)) for s in scaled)
    values = [sum(float(np.sum(s[: len(s) - k] * s[k:])) for s in scaled) / power for k in range(1, lags + 1)]
    step = float(t[0][1] - t[0][0])
    bound = 1.96 / np.sqrt(sum(s.size for s in scaled))
    ax.axhspan(-bound, bound, color=NOISE, alpha=0.25, linewidth=0, label="95 % interval of white noise")
    ax.vlines(step * np.arange(1, lags + 1), 0, values, color=colour, linewidth=1.5)
    ax.axhline(0, color="#888888", linewidth=0.8)
    ax.set_ylim(min(-0.3, 1.1 * min(values)), 1.0)
    ax.set_xlabel("lag [s]")
    ax.set_ylabel("autocorrelation")
    ax.legend(loc="upper right")


@styled
def loop_figure(
    force: Sequence[Array], measured: Sequence[Array], predicted: Sequence[Array], *, titles: Sequence[str]
) -> Figure:
    """Draw force against displacement along each trajectory's main direction of force.

    Args:
        force: Force of each of N trajectories [N], shapes [T, 3].
        measured: Measured displacement [m], shapes [T, 3].
        predicted: Predicted displacement [m], shapes [T, 3].
        titles: Name of each trajectory, length N.
    """
    n = len(force)
    columns = min(n, 4)
    rows = -(-n // columns)
    figure = Figure(figsize=(WIDTH, 0.5 + 2.5 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for i, ax in enumerate(axes.ravel()):
        if i >= n:
            ax.set_visible(False)
            continue
        along = push_direction(force[i])
        ax.plot(100 * measured[i] @ along, force[i] @ along, ".", color=MEASURED, markersize=3, label="measured")
        ax.plot(100 * predicted[i] @ along, force[i] @ along, color=MODEL, linewidth=1, label="predicted")
        ax.set_title(titles[i])
        ax.locator_params(nbins=5)
    for ax in axes[:, 0]:
        ax.set_ylabel("force [N]")
    for i in range(max(0, n - columns), n):
        axes.ravel()[i].set_xlabel("displacement along the force [cm]")
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=2)
    return figure


def push_direction(force: Array) -> Array:
    """Return the unit direction in which a force [T, 3] mainly acts, towards its larger values, shape [3]."""
    along: Array = np.linalg.svd(force, full_matrices=False)[2][0]
    return along * (np.sign(np.sum((force @ along) ** 3)) or 1.0)
