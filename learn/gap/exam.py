"""How often a diagnosis is right: cases with effects hidden by another simulator, graded against their answers."""

from __future__ import annotations

import json
import multiprocessing
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.progress import Progress

from ...sim.base.errors import InputError
from ..cases.case import load_case
from ..hidden import NAMES, Spec, exam_plan, hide
from ..reports.figures import png
from ..runs.threads import one_thread
from .diagnose import find_missing
from .diagnosis import Settings
from .run import Run

#: Wanted at 1, 3 and 5 % noise (issue's table): (criterion, bounds, whether more is better).
WANTED = (
    ("right name first, visible single effects", (0.92, 0.88, 0.78), True),
    ("right name in the reported set", (0.97, 0.95, 0.90), True),
    ("wrong name asserted, all cases", (0.05, 0.05, 0.08), False),
    ("false alarm on null", (0.05, 1 / 30, 1 / 30), False),
    ("outside the list: unknown", (0.85, 0.80, 0.60), True),
    ("pairs: both named", (0.60, 0.55, 0.40), True),
    ("pairs: at least one and none wrong", (0.85, 0.80, 0.70), True),
    ("right joint, given the right name", (0.90, 0.90, 0.80), True),
    ("held-out gap shrinks by (median)", (6.0, 4.0, 3.0), True),
    ("gap after over noise floor (median)", (1.5, 1.3, 1.3), False),
)
LEVELS = (0.01, 0.03, 0.05)


def hold(
    out: Path, *, cases: int, noise: float, seed: int, jobs: int, hard: bool = False, held_back: bool = False
) -> str:
    """Hold an exam and return its table; see `cli.diagnose.Exam`.

    Raises:
        InputError: A number cannot be.
    """
    for name, value, low in (("cases", cases, 1), ("jobs", jobs, 1)):
        if value < low:
            raise InputError("exam", f"--{name}", str(value), f"{low} or more")
    if not 0.0 < noise < 1.0:
        raise InputError("exam", "--noise", f"{noise:g}", "a share of the rms, 0 to 1")
    out.mkdir(parents=True, exist_ok=True)
    place = out / "results.jsonl"
    done = [json.loads(line) for line in place.read_text().splitlines()] if place.exists() else []
    plan = exam_plan(cases, seed, noise=noise, hard=hard, held_back=held_back)
    todo = [(k, s) for k, s in enumerate(plan) if k not in {d["case"] for d in done}]
    with Progress() as bar, multiprocessing.get_context("spawn").Pool(jobs) as pool:
        task = bar.add_task("exam", total=cases, completed=cases - len(todo))
        for result in pool.imap_unordered(sit, todo):
            with place.open("a") as file:
                file.write(json.dumps(result) + "\n")
            done.append(result)
            bar.advance(task)
    done = [d for d in done if d["case"] < cases]
    table = grades(done)
    (out / "exam.json").write_text(json.dumps({"noise": noise, "seed": seed, "grades": table}, indent=1) + "\n")
    (out / "confusion.png").write_bytes(confusion_figure(done))
    text = as_text(table, noise)
    (out / "exam.md").write_text(text + "\n")
    return text


def sit(item: tuple[int, Spec]) -> dict[str, Any]:
    """Hide one case, diagnose it, and return answer and verdict."""
    number, spec = item
    with tempfile.TemporaryDirectory() as folder, one_thread():
        answer = hide(Path(folder) / "case", **spec.options)
        found = find_missing(load_case(Path(folder) / "case"), Run(Settings(particles=0)))
    verdict = found.verdict_file()
    verdict["case"] = number
    keys = ("null", "out_of_library", "effects", "equivalents", "weak", "visible_gap", "measurement_gap")
    truth = {k: answer[k] for k in keys}
    return {"case": number, "kind": spec.kind, "noise": spec.noise, "seed": spec.seed, "truth": truth,
            "verdict": verdict, "seconds": found.seconds["total"],
            "reduced_chi2": found.ranking[0].reduced_chi2, "base_reduced_chi2": found.base_reduced_chi2,
            "motion": found.motion}  # fmt: skip


def grades(results: Sequence[dict[str, Any]]) -> dict[str, tuple[float | None, int]]:
    """Return every criterion's value and from how many cases it is, None where there is none."""
    kinds = {k: [r for r in results if r["kind"] == k] for k in ("null", "single", "pair", "outside")}
    visible, pairs = ([r for r in kinds[k] if r["truth"]["visible_gap"] > r["noise"]] for k in ("single", "pair"))
    outside = [r for r in kinds["outside"] if r["truth"]["visible_gap"] > r["noise"]]
    shrunk = [r["verdict"]["gap"] for r in (*visible, *pairs)
              if r["verdict"]["gap"]["base"] > 3.0 * r["verdict"]["gap"]["noise_floor"]]  # fmt: skip
    named = [r for r in visible if _right_first(r) and r["truth"]["effects"][0]["joint"] is not None]
    values = (
        _share(visible, _right_first),
        _share(visible, _in_set),
        _share(results, _asserts_wrong),
        _share(kinds["null"], lambda r: r["verdict"]["verdict"] != "none"),
        _share(outside, lambda r: r["verdict"]["verdict"] == "unknown"),
        _share(pairs, _both),
        _share(pairs, lambda r: bool(_names(r)) and not _asserts_wrong(r)),
        _share(named, _joint_right),
        _median([g["base"] / g["repaired"] for g in shrunk]),
        _median([g["repaired"] / g["noise_floor"] for g in shrunk]),
    )
    return {name: value for (name, _, _), value in zip(WANTED, values, strict=True)}


def _share(cases: Sequence[dict[str, Any]], holds: Callable[[dict[str, Any]], bool]) -> tuple[float | None, int]:
    return (sum(map(holds, cases)) / len(cases) if cases else None), len(cases)


def _median(values: Sequence[float]) -> tuple[float | None, int]:
    return (float(np.median(values)) if values else None), len(values)


def _names(result: dict[str, Any]) -> list[str]:
    return [e["name"] for e in result["verdict"]["effects"]]


def _accepted(result: dict[str, Any]) -> set[str]:
    truth = result["truth"]
    names = {e["name"] for e in truth["effects"]}
    return names | {n for e in names for n in truth["equivalents"].get(e, [])}


def _is_right(result: dict[str, Any], name: str) -> bool:
    return name in _accepted(result)


def _right_first(result: dict[str, Any]) -> bool:
    return any(_is_right(result, n) for n in _names(result)[:1])


def _in_set(result: dict[str, Any]) -> bool:
    reported = {*_names(result), *(n for v in result["verdict"]["alternatives"].values() for n in v)}
    return bool(reported & _accepted(result))


def _asserts_wrong(result: dict[str, Any]) -> bool:
    return any(not _is_right(result, n) for n in _names(result))


def _both(result: dict[str, Any]) -> bool:
    truth, named = result["truth"], set(_names(result))
    return all(named & {e["name"], *truth["equivalents"].get(e["name"], [])} for e in truth["effects"])


def _joint_right(result: dict[str, Any]) -> bool:
    return bool(result["verdict"]["effects"][0]["joint"] == result["truth"]["effects"][0]["joint"])


def as_text(table: dict[str, tuple[float | None, int]], noise: float) -> str:
    """Return the table as Markdown, with what is wanted at the nearest of the three noise levels."""
    level = int(np.argmin([abs(noise - x) for x in LEVELS]))
    lines = [f"| {100 * noise:g} % noise | wanted | reached | cases |", "|---|---|---|---|"]
    for name, bounds, more in WANTED:
        value, count = table[name]
        share = "shrinks" not in name and "floor" not in name
        wanted = f"{100 * bounds[level]:.0f} %" if share else f"{bounds[level]:g}"
        reached = "-" if value is None else (f"{100 * value:.0f} %" if share else f"{value:.2f}")
        lines.append(f"| {name} | {'>=' if more else '<='} {wanted} | {reached} | {count} |")
    return "\n".join(lines)


def confusion_figure(results: Sequence[dict[str, Any]]) -> bytes:
    """Return the confusion matrix as PNG: hidden down, named across; pairs count for each of their effects."""
    rows, columns = ["none", *NAMES, "outside"], ["none", *NAMES, "unknown"]
    count = np.zeros((len(rows), len(columns)), dtype=int)
    for r in results:
        truth = r["truth"]
        hidden = ["none"] if truth["null"] else ["outside"] if truth["out_of_library"] else _hidden(truth)
        named = _names(r) or [r["verdict"]["verdict"]]
        for h in hidden:
            own = [n for n in named if n == h] or [n for n in named if n not in hidden] or named[:1]
            count[rows.index(h), columns.index(own[0])] += 1
    figure = Figure(figsize=(9.0, 8.4), layout="constrained")
    axes = figure.subplots()
    axes.imshow(count / np.maximum(count.sum(1, keepdims=True), 1), cmap="Blues", vmin=0.0, vmax=1.0)
    for (i, j), value in np.ndenumerate(count):
        if value:
            axes.text(j, i, str(value), ha="center", va="center", fontsize=8,
                      color="white" if value > 0.6 * count[i].sum() else "black")  # fmt: skip
    axes.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=90, fontsize=8)
    axes.set_yticks(range(len(rows)), [c.replace("_", " ") for c in rows], fontsize=8)
    axes.set_xlabel("named")
    axes.set_ylabel("hidden")
    return png(figure)


def _hidden(truth: dict[str, Any]) -> list[str]:
    return [e["name"] for e in truth["effects"]]
