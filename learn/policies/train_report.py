"""The learning curve, and the page about a training run."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...sim.base.files import output_folder
from ...sim.base.types import Array
from ...sim.wood.effects import sentence as effects_sentence
from ..reports.figures import FAINT, MODEL, WIDTH, styled
from ..reports.page import KeyNumber, ReportContent, ReportFigure, number, write_report
from ..runs.folder import CONFIG, METRICS_FILE, RunFolder
from ..tasks.measures import Label, label_of, measures_of

CURVE = "learning.png"
LAST = 0.1
"""Share of the iterations, the last ones, that "at the end" means."""
Rows = Sequence[dict[str, float | None]]


def at_the_end(rows: Rows, name: str) -> float:
    """Return the mean of a metric over the episodes of the last tenth of the iterations, NaN if none ended there."""
    last = rows[-max(1, round(LAST * len(rows))) :] if rows else []
    pairs = [(row["episodes"] or 0.0, row.get(name)) for row in last]
    weights = np.array([w for w, v in pairs if v is not None])
    values = np.array([v for _, v in pairs if v is not None])
    return float(weights @ values / weights.sum()) if weights.sum() else float("nan")


def sentence(folder: RunFolder) -> str:
    """Return in one sentence what a run has come to."""
    rows, config = folder.metrics(), folder.config()
    steps = f"{rows[-1]['steps']:,.0f}".replace(",", " ")
    ends = {name: at_the_end(rows, name) for name in ("return", "success")}
    says = f"return {number(ends['return'])}, success {100 * ends['success']:.1f} %"
    if not np.isfinite(ends["return"]):
        says = "no episode has ended yet"
    return f"{config['task']['name']}: {len(rows)} iterations, {steps} steps, {says} in training."


def plain(folder: RunFolder) -> str:
    """Return in a sentence for everybody how far the policy has come; `sentence` says it in numbers."""
    rows, name = folder.metrics(), folder.config()["task"]["name"]
    success = at_the_end(rows, "success")
    if not np.isfinite(success):
        return f"{name}: nothing can be said yet, since no attempt has ended."
    if success == 0.0:
        return f"{name}: not learnt. Of the last attempts in training none succeeded."
    return f"{name}: of the last attempts in training {100.0 * success:.0f} in 100 succeeded."


def _commands(folder: RunFolder) -> list[tuple[str, str]]:
    """Return what to do next with a run."""
    run = shlex.quote(str(folder.path.resolve()))
    name = folder.config()["task"]["name"]
    return [
        (f"bough evaluate {run}", "tests the policy in worlds that it has not seen"),
        (f"bough play {run} --out film", "films it"),
        (f"bough view {run}", "shows it in the browser"),
        (f"bough train {name} --out {run} --resume --iterations {2 * len(folder.metrics())}", "trains twice as long"),
    ]


def write(folder: RunFolder) -> Path:
    """Write ``learning.png`` and ``report.html`` into the folder of a run; return the page's path."""
    with output_folder(folder.path) as work:
        page = write_report(work, content(folder)).name
    return folder.path / page


def content(folder: RunFolder) -> ReportContent:
    """Return what the page says."""
    rows, config = folder.metrics(), folder.config()
    name = config["task"]["name"]
    return ReportContent(
        title=f"Training of {name}",
        headline=plain(folder),
        precisely=sentence(folder),
        commands=_commands(folder),
        status="good" if at_the_end(rows, "success") > 0.0 else "warning",
        numbers=_numbers(rows),
        figures=[ReportFigure(CURVE, learning_figure(rows), _CAPTION)],
        details=_details(config),
        further=[
            (METRICS_FILE, "the numbers of every iteration"),
            (CONFIG, "settings, versions and state of the sources"),
            ("docs/train.md", "what the files hold and how runs go on"),
        ],
    )


_CAPTION = (
    "Means over the episodes that ended in an iteration (faint) and over a tenth of the run (blue). Actions are "
    "sampled and the worlds are those of training; bough evaluate tells what the policy does in others."
)


@styled
def learning_figure(rows: Rows) -> Figure:
    """Draw all metrics of the task over the steps."""
    names = measures_of(rows)
    height = max(1, -(-len(names) // 2))
    figure = Figure(figsize=(WIDTH, 2.5 * height), layout="constrained")
    panels = figure.subplots(height, 2, sharex=True, squeeze=False)
    for axes, name in zip(panels.flat, names, strict=False):
        label = label_of(name)
        _curve(axes, rows, name, label.scale)
        axes.set_ylabel(label.axis)
    for axes in panels.flat[len(names) :]:
        axes.remove()
    for axes in panels[-1]:
        axes.set_xlabel("steps of all worlds [millions]")
    return figure


def _curve(axes: Axes, rows: Rows, name: str, scale: float) -> None:
    known = [(row["steps"] or 0.0, row["episodes"] or 0.0, v) for row in rows if (v := row.get(name)) is not None]
    if not known:
        return
    steps, weights, values = np.array(known).T
    axes.plot(1e-6 * steps, scale * values, color=FAINT, linewidth=0.8)
    axes.plot(1e-6 * steps, scale * _smooth(values, weights, max(1, len(rows) // 10)), color=MODEL)


def _smooth(values: Array, weights: Array, width: int) -> Array:
    """Return means over up to ``width`` values, the present one the last, weighted by episodes."""
    total, weight = np.cumsum(values * weights), np.cumsum(weights)
    total[width:], weight[width:] = total[width:] - total[:-width], weight[width:] - weight[:-width]
    return np.asarray(total / np.maximum(weight, 1.0))


def _numbers(rows: Rows) -> list[KeyNumber]:
    seconds = sum((row["collect_seconds"] or 0.0) + (row["learn_seconds"] or 0.0) for row in rows)
    learn = sum(row["learn_seconds"] or 0.0 for row in rows)
    steps = rows[-1]["steps"] or 0.0
    last = f"Mean over the episodes of the last {100 * LAST:.0f} % of the iterations, with sampled actions."
    return [
        *(_number(rows, label_of(name), name, last) for name in measures_of(rows)),
        KeyNumber("Contacts without room", sum(row.get("contacts_without_room") or 0.0 for row in rows), "",
                  "Contacts that a world's buffer had no room for; nothing held the branches apart there."),
        KeyNumber("Time", seconds / 60.0, "min", "Spent in iterations, without building the worlds."),
        KeyNumber("Speed", steps / max(seconds, 1e-9), "steps/s", "Steps of all worlds, learning included."),
        KeyNumber("Learning", 100 * learn / max(seconds, 1e-9), "%", "Share of that time for the update."),
    ]  # fmt: skip


def _number(rows: Rows, label: Label, name: str, last: str) -> KeyNumber:
    return KeyNumber(label.name, label.scale * at_the_end(rows, name), label.unit, label.says or last)


def _details(config: dict[str, Any]) -> dict[str, object]:
    ppo = {name: ", ".join(map(str, v)) if isinstance(v, list) else v for name, v in config["ppo"].items()}
    source = config["source"].get("commit", "not in a repository")
    changed = " with changes" if config["source"].get("changed") else ""
    return {
        "task": f"{config['task']['name']}, version {config['task']['version']}",
        "observation groups": ", ".join(config["task"]["settings"].get("groups", ())),
        **_wood(config["task"]["settings"].get("scene", {})),
        **ppo,
        **{name: config[name] for name in ("seed", "device", "processes", "started")},
        **config["versions"],
        "source": f"{source}{changed}",
        **config["machine"],
    }


def _wood(scene: dict[str, Any]) -> dict[str, str]:
    """Return the rows on the wood that a run was given and on its effects, none where it was given none."""
    rows, effects = scene.get("wood", ()), scene.get("effects", ())
    said = [f"{1e-9 * young:.3g} GPa, {time:.3g} s at {1e3 * radius:.3g} mm" for radius, young, time in rows]
    out = {"wood (Young's modulus, relaxation time at radius)": "; ".join(said)} if said else {}
    return out | ({"effects": effects_sentence(tuple(map(tuple, effects)))} if effects else {})
