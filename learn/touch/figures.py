"""Figures of a test of touch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ...sim.base.types import Array
from ..reports.figures import ALARM, FAINT, MEASURED, MODEL, WIDTH, styled
from .scores import Detection, Told, pooled, roc

_GRID = np.linspace(0.0, 1.0, 201)


def _curve(told: Sequence[Told]) -> Array:
    wrong, found, _ = roc(*pooled(told, certain=True))
    out: Array = np.interp(_GRID, wrong, found)
    return out


@styled
def roc_figure(told: Sequence[Told], threshold: float) -> Figure:
    """Draw the ROC with its interval over recordings, and where the threshold is."""
    figure = Figure(figsize=(5.0, 4.4), layout="constrained")
    ax = figure.subplots()
    rng = np.random.default_rng(0)
    again = [_curve([told[k] for k in rng.integers(0, len(told), len(told))]) for _ in range(200)]
    low, high = np.quantile(np.array(again), [0.025, 0.975], axis=0)
    ax.fill_between(100 * _GRID, 100 * low, 100 * high, color=MODEL, alpha=0.2, linewidth=0, label="95 % interval")
    ax.plot(100 * _GRID, 100 * _curve(told), color=MODEL, label="pooled")
    probability, contact = pooled(told, certain=True)
    said = probability > threshold
    ax.plot(100 * said[contact == 0].mean(), 100 * said[contact == 1].mean(), "o", color=ALARM,
            label=f"threshold {threshold:.2f}")  # fmt: skip
    ax.plot([0, 100], [0, 100], "--", color=FAINT, label="chance")
    ax.set_xlabel("told contact where there is none [% of rows]")
    ax.set_ylabel("contact found [% of rows]")
    ax.legend(loc="lower right")
    return figure


@styled
def spread_figure(told: Sequence[Told], threshold: float) -> Figure:
    """Draw every recording's specificity and recall, each in ascending order."""
    figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
    for ax, label, name in zip(figure.subplots(1, 2), (0, 1), ("free rows", "rows with contact"), strict=True):
        rows = [t.rows(True) for t in told]
        right = sorted(float(np.mean((p[y == label] > threshold) == label)) for p, y in rows if (y == label).any())
        ax.bar(np.arange(len(right)), 100 * np.array(right), color=MODEL, width=0.9)
        ax.set_ylim(0, 100)
        ax.set_xlabel(f"{len(right)} recordings, worst first")
        ax.set_ylabel(f"{name} told right [%]")
    return figure


@styled
def delay_figure(found: Sequence[Detection]) -> Figure:
    """Draw the share of contacts that were told within a time."""
    figure = Figure(figsize=(5.0, 3.2), layout="constrained")
    ax = figure.subplots()
    delays = np.sort([d.delay for d in found if d.delay is not None])
    share = 100 * np.arange(len(delays) + 1) / max(len(found), 1)
    end = max(1.0, float(delays[-1]) if len(delays) else 1.0)
    ax.step(np.concatenate([[0.0], delays, [end]]), np.append(share, share[-1]), where="post", color=MODEL)
    ax.set_ylim(0, 100)
    ax.set_xlabel("time since contact began [s]")
    ax.set_ylabel(f"told, of {len(found)} contacts [%]")
    return figure


@styled
def trace_figure(told: Sequence[Told], threshold: float) -> Figure:
    """Draw torques and probability of the recordings with contact told best, in the middle and worst."""
    touched = [t for t in told if (t.recording.contact == 1).any()]
    order = sorted(touched, key=lambda t: -float(np.mean((t.probability > threshold) == t.recording.contact)))
    chosen = [order[k] for k in sorted({0, len(order) // 2, len(order) - 1})]
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    axes = figure.subplots(2, len(chosen), squeeze=False, sharex="col", height_ratios=(2, 1))
    for (upper, lower), t in zip(axes.T, chosen, strict=True):
        r = t.recording
        for ax in (upper, lower):
            ax.fill_between(r.time, 0, 1, where=r.contact == 1, transform=ax.get_xaxis_transform(), color=FAINT,
                            alpha=0.4, linewidth=0, step="mid")  # fmt: skip
        upper.plot(r.time, r.torque - np.median(r.torque, axis=0), linewidth=0.8)
        upper.set_title(r.name if len(r.name) < 34 else f"...{r.name[-30:]}", fontsize=9)
        lower.plot(r.time, t.probability, color=MEASURED)
        lower.axhline(threshold, color=ALARM, linewidth=0.8)
        lower.set_ylim(0, 1)
        lower.set_xlabel("time [s]")
    axes[0, 0].set_ylabel("torques about their\nmedian, all joints")
    axes[1, 0].set_ylabel("probability")
    return figure
