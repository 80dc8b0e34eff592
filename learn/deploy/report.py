"""What a run came to: shares with intervals, periods and ages, as JSON and as a page."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...sim.base.types import Array
from ..policies.tables import wilson
from ..reports.figures import MODEL, WIDTH, styled
from ..reports.page import KeyNumber, ReportContent, ReportFigure, ReportTable, number, write_report
from ..runs.folder import replace_text
from .log import LOG, read_run
from .loop import Episode

JSON, FORMAT = "run.json", "bough-run/1"
LATE = 0.020
"""What the 99th percentile of the loop's period is to stay under [s]."""


def summary(episodes: Sequence[Episode], about: dict[str, Any]) -> dict[str, Any]:
    """Return a run as plain values: success with Wilson's 95 % interval, periods, latencies, ages, every episode.

    Args:
        episodes: What was run.
        about: What else is to be told, plain.
    """
    known = [e for e in episodes if e.success is not None]
    truth = [bool(e.success) for e in known]
    share = float(np.mean(truth)) if truth else math.nan
    said = sum(e.seen for e in episodes)
    return {
        "format": FORMAT, **about, "episodes": len(episodes), "seen_done": said,
        "agreed": sum(e.seen == bool(e.success) for e in known),
        "success": None if not truth else share, "interval": list(wilson(share, len(truth))) if truth else [],
        "stopped": sum(e.ended not in ("done", "time") for e in episodes),
        "missed_ticks": sum(e.missed for e in episodes),
        "period_s": _spread([p for e in episodes for p in e.periods]),
        "latency_s": _spread([p for e in episodes for p in e.latencies]),
        "age_s": _spread([p for e in episodes for p in e.ages]), "load": os.getloadavg()[0],
        "each": [_plain(e) for e in episodes],
    }  # fmt: skip


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    low, late = np.percentile(values, (50, 99))
    return {"median": float(low), "p99": float(late), "max": float(np.max(values)), "count": len(values)}


def _plain(e: Episode) -> dict[str, Any]:
    return {"number": e.number, "seconds": round(e.seconds, 3), "seen": e.seen, "success": e.success, "ended": e.ended,
            "measures": {n: v for n, v in e.measures.items() if math.isfinite(v)}}  # fmt: skip


def sentence(result: dict[str, Any]) -> str:
    """Return a run in one sentence."""
    count, task = result["episodes"], result["task"]
    plural = "s" if count != 1 else ""
    if result["success"] is None:
        return f"{task}: {result['seen_done']} of {count} episode{plural} done as the arm saw it."
    low, high = (100.0 * x for x in result["interval"])
    done = round(result["success"] * count)
    share = f"{100.0 * result['success']:.0f} %, 95 %: {low:.0f} to {high:.0f}"
    return f"{task}: {done} of {count} episode{plural} succeeded ({share})."


def write(folder: Path, result: dict[str, Any]) -> Path:
    """Write ``run.json`` and ``report.html`` into a folder that holds the log; return the page's path."""
    replace_text(folder / JSON, json.dumps(result, indent=2, allow_nan=False) + "\n")
    return write_report(folder, content(folder, result))


def content(folder: Path, result: dict[str, Any]) -> ReportContent:
    """Return what the page says."""
    period, age = result["period_s"], result["age_s"]
    held = period is not None and period["p99"] < LATE
    log = read_run(folder)
    return ReportContent(
        title=f"A run of {result['task']} on {result['robot']}",
        headline=sentence(result),
        status="good" if (result["success"] or result["seen_done"]) and held else "warning",
        numbers=_numbers(result, period, age),
        tables=[_table(result)],
        figures=[ReportFigure("pace.png", pace_figure(log), _PACE), ReportFigure("way.png", way_figure(log), _WAY)],
        details={name: result[name] for name in ("policy", "iteration", "robot", "camera", "touch", "load")},
        further=[(LOG, "every tick that was answered, SI units"), (JSON, "all numbers of this page"),
                 ("docs/run.md", "what is compared with what")],
    )  # fmt: skip


def _numbers(result: dict[str, Any], period: dict[str, float] | None, age: dict[str, float] | None) -> list[KeyNumber]:
    out = [KeyNumber("Stopped", result["stopped"], "episodes", "Ended by a stop of the service: a torque, a touch.")]
    if period is not None:
        held = f"Between two answers; {1e3 * LATE:g} ms at most is 60 Hz held."
        out.append(KeyNumber("Period, 99 %", 1e3 * period["p99"], "ms", held))
        out.append(KeyNumber("Ticks missed", result["missed_ticks"], "", "Ticks of the service without an answer."))
    if age is not None:
        out.append(KeyNumber("Age, 99 %", 1e3 * age["p99"], "ms", "Of the clouds that an action was chosen by."))
    return out


def _table(result: dict[str, Any]) -> ReportTable:
    rows: list[tuple[object, ...]] = []
    for e in result["each"]:
        told = ", ".join(
            f"{name} {number(v)}" for name, v in e["measures"].items() if name not in ("return", "success")
        )
        truth = "-" if e["success"] is None else "yes" if e["success"] else "no"
        rows.append((e["number"], truth, "yes" if e["seen"] else "no", f"{e['seconds']:.1f}", e["ended"], told))
    return ReportTable("Episodes", ("scene", "done", "as seen", "seconds", "ended by", "measures"), rows,
                       "Done is the task's own measure of success in the twin; as seen is the arm's own.")  # fmt: skip


_PACE = "Time between two answers, time from a tick to its answer, and age of the clouds, all ticks of the run."
_WAY = "What the policy saw of its task, over the time of an episode: first episodes dark, later ones light."


@styled
def pace_figure(log: dict[str, Array]) -> Figure:
    """Draw how the loop kept its pace."""
    figure = Figure(figsize=(WIDTH, 2.4), layout="constrained")
    same = np.diff(log["episode"]) == 0
    period = np.diff(log["time_s"])[same]
    told = {"period [ms]": period, "latency [ms]": log["latency_s"], "age of clouds [ms]": log["age_s"]}
    for axes, (name, values) in zip(np.ravel(figure.subplots(1, 3)), told.items(), strict=True):
        finite = 1e3 * values[np.isfinite(values)]
        axes.hist(finite, bins=60, color=MODEL)
        axes.set_xlabel(name)
        axes.set_yscale("log" if len(finite) else "linear")
    return figure


@styled
def way_figure(log: dict[str, Array]) -> Figure:
    """Draw occlusion as it was seen, or the hand's distance from its target, of up to eight episodes."""
    figure = Figure(figsize=(WIDTH, 2.6), layout="constrained")
    axes = figure.subplots()
    name, label = ("distance_m", "distance from the target [m]") if np.isfinite(log["distance_m"]).any() else (
        "occlusion", "occlusion as seen")  # fmt: skip
    numbers = np.unique(log["episode"])[:8]
    for k, episode in enumerate(numbers):
        of = log["episode"] == episode
        axes.plot(log["time_s"][of] - log["time_s"][of][0], log[name][of], color=MODEL, alpha=1.0 - 0.8 * k / 8)
    axes.set_xlabel("time [s]")
    axes.set_ylabel(label)
    return figure
