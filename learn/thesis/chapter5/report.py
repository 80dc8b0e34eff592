"""What a reproduction of chapter 5 says: tables beside the thesis's numbers, pictures, and at which scale."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from ...policies.evaluate import Row
from ...reports.page import KeyNumber, ReportContent, ReportFigure, ReportTable
from ..common.interval import LEAST_SEEDS, Interval
from . import embedding, figures
from .findings import Findings
from .runs import (
    BASELINES,
    COLUMNS,
    MEDIAN_NOISE,
    REMOVED,
    TABLE_5_2,
    THESIS_ITERATIONS,
    THESIS_TRIALS,
    THESIS_WORLDS,
    Run,
    TableRow,
)

FINAL, MEDIAN = TABLE_5_2[-1], TABLE_5_2[-2]
"""Rows (f) and (e)."""
SUCCESS = "Test SR %"
_ADDED = (("local points, (b) over (a)", "a", "b"), ("touch, (c) over (b)", "b", "c"), ("KME, (d) over (b)", "b", "d"),
          ("KME with touch, (e) over (c)", "c", "e"), ("touch with KME, (e) over (d)", "d", "e"),
          ("less noise, (f) over (e)", "e", "f"))  # fmt: skip
_THESIS_5_3 = (
    ("thesis, PointNet++", 21.29, 0.7706, 1487.2, 1345.6, "1024 (at most)"),
    ("thesis, Point2Vec", 0.204, 0.0454, 75.2, 1379.6, "1024 (at most)"),
    ("thesis, KME", 0.0012, 0.0012, 27.5, 1449.9, "1024 (at most 6144)"),
)


def tables(found: Findings) -> dict[str, ReportTable]:
    """Return every table by the thesis's number."""
    return {
        "table_5_2": _table_5_2(found),
        "table_5_2_added": _added(found),
        "figure_5_4": _boxes(found),
        "figure_5_4_policies": _policies(found),
        "table_5_3": _table_5_3(found),
    }


def scale(found: Findings) -> str:
    """Return at which scale the runs are, in words."""
    o, ppo = found.options, found.options.ppo
    return (
        f"{ppo.num_envs} worlds and {ppo.iterations} iterations a policy with the preset {o.preset}, "
        f"{100 * o.share:.2g} % of the thesis's {THESIS_WORLDS} times {THESIS_ITERATIONS}"
    )


# ---- table 5.2 -----------------------------------------------------------------------------------------------------


def _table_5_2(found: Findings) -> ReportTable:
    rows: list[tuple[object, ...]] = []
    for row in TABLE_5_2:
        theirs = (_pair(*row.thesis[name]) for name in COLUMNS)
        noise = "-" if row.letter == "a" else row.run.noise
        rows.append((f"thesis, ({row.letter}) {row.label}", noise, f"{row.train_return:.1f}", THESIS_TRIALS, *theirs))
        rows.append(_measured(f"bough, ({row.letter}) {row.label}", found, row.run))
    for row in (MEDIAN, FINAL):
        for name in BASELINES:
            rows.append(_beside(f"bough, {name}, worlds of ({row.letter})", row.run.noise, found.rows[row.run][name]))
    note = (
        f"Ours: {scale(found)}; the rows cannot be expected to reach the thesis's. {_seeds(found)} Test columns are "
        f"over {found.options.sets} unseen test sets with all contacts on, the same for all; the thesis's and those of "
        "zero and random are mean and standard deviation over the sets. Train Rew is the mean of the last tenth of the "
        "training, with sampled actions. Rewards and steps depend on the length of an episode: the thesis's has 1000 "
        f"steps, ours {_episode(found)}. The thesis gives no d_max for (a); ours has the noise of the others, as its "
        "occlusion score comes from the same points. Steps in Succ are over the episodes that succeeded."
    )
    return ReportTable("Table 5.2: ablation", ("run", "d_max [m]", "Train Rew", "Trials", *COLUMNS), rows, note)


def _seeds(found: Findings) -> str:
    count = found.options.seeds
    if count == 1:
        return "Every policy is trained once, so its rows have no intervals, and no row is said to be above another."
    return f"Every policy is trained with {count} seeds: mean and 95 % interval over the seeds (Student's t)."


def _measured(label: str, found: Findings, run: Run) -> tuple[object, ...]:
    rows = found.trained(run)
    cells = (_over_seeds(found.mean(run, name)) for name in COLUMNS)
    return (label, run.noise, _over_seeds(found.train_return(run)), sum(row.trials for row in rows), *cells)


def _over_seeds(value: Interval) -> str:
    if math.isnan(value.mean) or math.isnan(value.low):
        return _pair(value.mean, math.nan)
    return f"{value.mean:.1f} ({value.low:.1f} to {value.high:.1f})"


def _beside(label: str, noise: float, row: Row) -> tuple[object, ...]:
    cells = (_pair(row.mean(name), row.spread(name)) for name in COLUMNS)
    return (label, noise, _pair(row.train_return, math.nan), row.trials, *cells)


def _pair(mean: float, spread: float) -> str:
    if math.isnan(mean):
        return "-"
    return f"{mean:.1f}" if math.isnan(spread) else f"{mean:.1f} ± {spread:.1f}"


def _episode(found: Findings) -> object:
    return found.config["task"]["settings"]["episode_steps"]


def _added(found: Findings) -> ReportTable:
    by_letter = {row.letter: row for row in TABLE_5_2}
    rows: list[tuple[object, ...]] = []
    for label, before, after in _ADDED:
        a, b = by_letter[before], by_letter[after]
        theirs = b.thesis[SUCCESS][0] - a.thesis[SUCCESS][0]
        low, high = (found.mean(row.run, SUCCESS) for row in (a, b))
        rows.append((label, f"{theirs:+.1f}", f"{high.mean - low.mean:+.1f}", _over_seeds(low), _over_seeds(high),
                     verdict(low, high)))  # fmt: skip
    note = (
        "Success gained in points, and the success of both rows [%]. A group helps, or harms, where the 95 % intervals "
        f"over seeds of both rows do not overlap, and each row has {LEAST_SEEDS} seeds or more; else nothing is said. "
        "The thesis trains every policy once."
    )
    header = ("added", "thesis [points]", "bough [points]", "before [%]", "after [%]", "helps")
    return ReportTable("Table 5.2: which groups help", header, rows, note)


def verdict(before: Interval, after: Interval) -> str:
    """Return whether a group helps or harms: a word only where both intervals are known and do not overlap."""
    if not before.apart(after):
        return "-"
    return "helps" if after.mean > before.mean else "harms"


# ---- figure 5.4 ----------------------------------------------------------------------------------------------------


def removal(found: Findings, column: str) -> dict[str, list[list[float]]]:
    """Return a column on the first test set by what is removed, the values of all seeds for every noise level."""
    levels = found.options.noise_levels
    return {name: [[row.sets[0][column] for row in found.trained(Run(left, n))] for n in levels]
            for name, left in REMOVED.items()}  # fmt: skip


def _boxes(found: Findings) -> ReportTable:
    data = {column: removal(found, column) for column in ("Test Rew", SUCCESS)}
    rows: list[tuple[object, ...]] = []
    for name in REMOVED:
        cells: list[str] = []
        for by_name in data.values():
            low, middle, high = np.percentile(by_name[name], (25, 50, 75))
            cells += [f"{middle:.1f}", f"{low:.1f} to {high:.1f}"]
        rows.append((name, *cells))
    note = (
        f"Over d_max {', '.join(f'{n:g}' for n in found.options.noise_levels)} m, {found.options.seeds} policies each, "
        "on one unseen test set; box: median and quartiles. In the thesis removing KME or touch hurts; a box here is "
        "of few policies and of several noise levels, so nothing is said of which is below which."
    )
    header = ("removed", "Test Rew, median", "quartiles", "Test SR %, median", "quartiles ")
    return ReportTable("Figure 5.4: single groups removed", header, rows, note)


def _policies(found: Findings) -> ReportTable:
    rows: list[tuple[object, ...]] = []
    for name, left_out in REMOVED.items():
        for noise in found.options.noise_levels:
            for seed, row in enumerate(found.trained(Run(left_out, noise)), found.options.seed):
                cells = (_pair(row.sets[0][column], math.nan) for column in COLUMNS)
                rows.append((name, noise, seed, _pair(row.train_return, math.nan), found.options.worlds, *cells))
    header = ("removed", "d_max [m]", "seed", "Train Rew", "Trials", *COLUMNS)
    return ReportTable("Figure 5.4: every policy on the first test set", header, rows)


# ---- table 5.3 -----------------------------------------------------------------------------------------------------


def _table_5_3(found: Findings) -> ReportTable:
    ppo, final = found.options.ppo, found.trained(FINAL.run)[0]
    seconds = {(t.name, t.worlds): t.seconds for t in found.times}
    many, one = embedding.WORLDS
    mean = (seconds[embedding.KERNELS, many], seconds[embedding.KERNELS, one])
    learnt = (seconds[embedding.LEARNT, many], seconds[embedding.LEARNT, one])
    steps = ppo.iterations * ppo.horizon
    longer = found.minutes[FINAL.run] + steps * (learnt[0] - mean[0]) * ppo.num_envs / many / 60.0
    rows: list[tuple[object, ...]] = [
        *_THESIS_5_3,
        ("bough, kernels", *mean, found.minutes[FINAL.run], _pair(final.train_return, math.nan), ppo.num_envs),
        ("bough, PointNet++ of plain torch", *learnt, f"{longer:.3g} (computed)", "-", "-"),
    ]
    timed = {t.worlds: t.clouds for t in found.times if t.name == embedding.LEARNT}
    note = (
        "Timing only: no encoder is trained here. "
        f"Wall time of the four embeddings of every world, once, on {_device(found)}; the kernels are "
        f"{learnt[0] / mean[0]:.3g} and {learnt[1] / mean[1]:.3g} times as fast as the encoder at {many} worlds and at "
        f"{one}. Train Time and Train Rew of the kernels are those of row (f), first seed: {scale(found)}. The thesis "
        "trains 250 epochs with 1024 worlds on an RTX 4090. PointNet++ is plain torch with random weights and without "
        f"farthest point sampling, a lower bound; {timed[many]} clouds are timed and the rest follows in proportion; "
        "its training time is computed from row (f)'s and the difference of the embeddings, not run, so there is no "
        "reward. Point2Vec is not on PyPI: its row is the thesis's alone."
    )
    header = ("embedding", "GF(1024) [s]", "GF(1) [s]", "Train Time [min]", "Train Rew", "worlds")
    return ReportTable("Table 5.3: time of the embeddings (timing only)", header, rows, note)


def _device(found: Findings) -> str:
    machine = found.config["machine"]
    return str(machine.get("gpu") or f"{machine['cores']} cores of {machine['cpu']}")


# ---- the page ------------------------------------------------------------------------------------------------------


def content(found: Findings) -> ReportContent:
    """Return what the page says."""
    cleared = _over_seeds(found.mean(FINAL.run, SUCCESS))
    beside = ", ".join(f"{n} {found.rows[FINAL.run][n].mean(SUCCESS):.1f} %" for n in BASELINES)
    thesis = FINAL.thesis[SUCCESS][0]
    return ReportContent(
        title="Chapter 5 again, in simulation",
        headline=f"All groups at d_max {FINAL.run.noise:g} m clear {cleared} % of unseen lines "
        f"({beside}; thesis {thesis:.1f} %), with {100 * found.options.share:.2g} % of the thesis's training.",
        status="good" if found.options.share >= 1.0 else "warning",
        numbers=_numbers(found),
        tables=list(tables(found).values()),
        figures=_figures(found),
        details=_details(found),
        further=[
            ("runs/NAME/report.html", "every training run; runs/NAME/evaluation.md: its tests"),
            ("tables.json", "all tables"),
            ("docs/chapter5.md", "what is compared with what, and how far a scale carries"),
        ],
    )


def _numbers(found: Findings) -> list[KeyNumber]:
    says = "thesis {:.1f} ± {:.1f}; row (f), mean over test sets and seeds."
    names = {"success": SUCCESS, "occlusion drop": "Occ Drop %", "steps inside the margin": "Touch %"}
    ours = {c: found.mean(FINAL.run, c).mean for c in names.values()}
    kept = [KeyNumber(label.capitalize(), ours[c], "%", says.format(*FINAL.thesis[c]).capitalize())
            for label, c in names.items()]  # fmt: skip
    minutes = sum(found.minutes.values())
    return [
        *kept,
        KeyNumber("Policies", len(found.rows), "", f"Trained one after another: {scale(found)}."),
        KeyNumber("Training", minutes, "min", "In iterations, all policies; building worlds and tests come on top."),
    ]


def _figures(found: Findings) -> list[ReportFigure]:
    o = found.options
    removed = figures.removal_figure(removal(found, "Test Rew"), removal(found, SUCCESS), o.noise_levels)
    return [
        ReportFigure("table_5_2.png", _rows_figure(found), f"Table 5.2 ({MEDIAN_NOISE:g} m, row f {FINAL.run.noise:g} "
                     "m); bars: mean and 95 % interval over seeds; the thesis's, and those of zero and random, mean "
                     "and standard deviation over the test sets. The thesis's are of another scale."),
        ReportFigure("figure_5_4.png", removed, "Figure 5.4: single groups of observations removed; a point is a "
                     "policy. Box: median and quartiles, whiskers to the ends."),
        ReportFigure("table_5_2_curves.png", figures.curves_figure(_curves(found)), "Training of the rows of table "
                     "5.2, first seed; means over a tenth of the run."),
    ]  # fmt: skip


def _rows_figure(found: Findings) -> Figure:
    shown = [*((f"({row.letter})", row, "trained") for row in TABLE_5_2), *((n, FINAL, n) for n in BASELINES)]

    def pairs(column: str) -> list[tuple[float, float]]:
        """Return mean and half-width of a column, a pair for each row that is shown."""
        return [_bar(found, row.run, policy, column) for _, row, policy in shown]

    def theirs(row: TableRow, policy: str) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Return the thesis's success and drop of occlusion of a trained row; None of a baseline."""
        return (row.thesis[SUCCESS], row.thesis["Occ Drop %"]) if policy == "trained" else None

    names, thesis = [name for name, _, _ in shown], [theirs(row, policy) for _, row, policy in shown]
    return figures.rows_figure(names, pairs(SUCCESS), pairs("Occ Drop %"), thesis)


def _bar(found: Findings, run: Run, policy: str, column: str) -> tuple[float, float]:
    """Return mean and half-width: of the interval over seeds, or of the spread over sets where there is no training."""
    if policy == "trained":
        value = found.mean(run, column)
        return value.mean, value.high - value.mean
    row = found.rows[run][policy]
    return row.mean(column), row.spread(column)


def _curves(found: Findings) -> dict[str, tuple[list[float], list[float], list[float]]]:
    return {f"({row.letter})": curve(found.metrics[row.run]) for row in TABLE_5_2}


def curve(rows: Sequence[Mapping[str, float | None]]) -> tuple[list[float], list[float], list[float]]:
    """Return iterations, return and success [%], means over the episodes of a tenth of the run up to each."""
    width = max(1, len(rows) // 10)
    out: tuple[list[float], list[float], list[float]] = ([], [], [])
    for k in range(len(rows)):
        part = [r for r in rows[max(0, k + 1 - width) : k + 1] if r["episodes"]]
        weight = sum(r["episodes"] or 0.0 for r in part)
        if weight:
            means = [sum((r["episodes"] or 0.0) * (r[n] or 0.0) for r in part) / weight for n in ("return", "success")]
            for column, value in zip(out, (k + 1.0, means[0], 100.0 * means[1]), strict=True):
                column.append(value)
    return out


def _details(found: Findings) -> dict[str, object]:
    o, config = found.options, found.config
    ppo = {name: ", ".join(map(str, v)) if isinstance(v, list) else v for name, v in config["ppo"].items()}
    options = {"preset": o.preset, "noise levels [m]": ", ".join(f"{n:g}" for n in o.noise_levels), "test sets": o.sets,
               "worlds a test set": o.worlds, "seeds": o.seeds, "first seed": o.seed, "device": o.device}  # fmt: skip
    minutes = {f"training {run.name} [min]": value for run, value in found.minutes.items()}
    seconds = {f"{name}, this time [s]": value for name, value in found.seconds.items()}
    changed = " with changes" if config["source"].get("changed") else ""
    source = f"{config['source'].get('commit', 'not in a repository')}{changed}"
    return {**options, **ppo, **minutes, **seconds, **config["versions"], "source": source, **config["machine"]}
