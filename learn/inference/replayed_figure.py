"""What a model simulates of joints, beside what was measured, as arrays and as a figure."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ...sim.pictures.figures import COLORS, STYLE
from ..cases.case import JointCase
from .replayed import Replayed

#: Most recordings and channels that are drawn.
RECORDINGS, CHANNELS = 8, 3


def save_replayed(path: Path, case: JointCase, seen: Replayed) -> None:
    """Write ``trajectory.npz``: time [T], channel [C], simulated and measured [T, R, C], NaN past a recording's end."""
    longest = max(seen.recordings, key=lambda r: len(r.t))
    simulated, measured = (np.full((len(longest.t), len(seen.recordings), seen.output.shape[-1]), np.nan) for _ in "ab")
    for j, r in enumerate(seen.recordings):
        simulated[: len(r.t), j], measured[: len(r.t), j] = seen.output[j, : len(r.t)], r.output
    channel = np.array([f"{o.quantity} {o.joint}" for o in case.channels])
    np.savez(path, time=longest.t, channel=channel, simulated=simulated, measured=measured)


def replayed_figure(case: JointCase, seen: Replayed, named: str) -> Figure:
    """Draw measured (dots) and simulated (lines) channels of the first recordings, one panel for each."""
    channels = list(range(min(seen.output.shape[-1], CHANNELS)))
    drawn = seen.recordings[:RECORDINGS]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11, 0.8 + 1.9 * len(drawn)), layout="constrained")
        axes = figure.subplots(len(drawn), 1, squeeze=False)[:, 0]
        for j, (ax, r) in enumerate(zip(axes, drawn, strict=True)):
            for c, color in zip(channels, COLORS, strict=False):
                o = case.channels[c]
                ax.plot(r.t, r.output[:, c], ".", color=color, alpha=0.25, markersize=6)
                ax.plot(r.t, seen.output[j, : len(r.t), c], color=color, linewidth=1.0, label=f"{o.quantity} {o.joint}")
            held = "held out" if j in seen.test else "fitted to"
            ax.set_title(f"{case.trajectories[j].file}, {held}")
        figure.supxlabel("time [s]")
        figure.supylabel("measured channels, SI units")
        figure.suptitle(f"measured (dots) and simulated (lines) by the model {named}")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper")
    return figure
