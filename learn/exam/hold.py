"""Holding an exam: cases with effects hidden by another simulator, diagnosed, graded, and drawn."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pydantic import TypeAdapter

from ...sim.base.console import bar
from ...sim.base.errors import InputError
from ...sim.base.files import read_text
from ...sim.base.json_file import object_of
from ..cases.case import load_case
from ..gap.diagnose import find_missing
from ..gap.diagnosis import Settings
from ..gap.run import Run
from ..hidden import NAMES, Spec, exam_plan, hide
from ..hidden.joints.hide import FAINT, hide_joints
from ..hidden.joints.plan import JointCaseSpec, joint_plan
from ..reports.figures import png
from ..runs.folder import replace_text
from ..runs.schema import Kept, NotNegative, validated
from ..runs.side_by_side import side_by_side
from ..runs.threads import one_thread
from .grades import WANTED, WANTED_JOINTS, as_text, grades, names_of

#: Noise of a branch's sensors where the command does not say.
NOISE = 0.03
#: Most cases of an exam: at half a minute each they take days.
MOST_CASES = 10_000


class Result(Kept):
    """What a line of ``results.jsonl`` says of a case, as far as an exam is gone on with and graded by it."""

    case: NotNegative
    kind: str
    noise: float
    spec: dict[str, Any]
    truth: dict[str, Any]
    verdict: dict[str, Any]


def hold(
    out: Path, *, cases: int, noise: float | None, seed: int, jobs: int, joints: bool = False, hard: bool = False,
    held_back: bool = False,
) -> str:  # fmt: skip
    """Hold an exam and return its table; see `cli.diagnose.Exam`.

    Raises:
        InputError: A number cannot be, or ``out`` holds cases of another exam.
        ChildProcessError: The process of a case was killed.
    """
    if not 1 <= cases <= MOST_CASES:
        raise InputError("exam", "--cases", str(cases), f"1 to {MOST_CASES}")
    if jobs < 1:
        raise InputError("exam", "--jobs", str(jobs), "1 or more")
    if joints and (hard or held_back):
        raise InputError("exam", "--hard", "with --joints", "branches: every case of joints is as hard as it gets")
    if noise is not None and joints:
        raise InputError(
            "exam", "--noise", f"{noise:g} with --joints", "no --noise: every joint has sensors of its own"
        )
    if noise is not None and not 0.0 < noise < 1.0:
        raise InputError("exam", "--noise", f"{noise:g}", "a share of the rms, 0 to 1")
    noise = None if joints else NOISE if noise is None else noise
    out.mkdir(parents=True, exist_ok=True)
    plan: list[Spec | JointCaseSpec] = []
    plan += (
        joint_plan(cases, seed)
        if noise is None
        else exam_plan(cases, seed, noise=noise, hard=hard, held_back=held_back)
    )
    place = out / "results.jsonl"
    done = done_before(place, plan)
    todo = [(k, s) for k, s in enumerate(plan) if k not in {d["case"] for d in done}]
    with bar("exam", len(todo)) as advance:
        for result in side_by_side(sit, todo, jobs, advance):
            with place.open("a") as file:
                file.write(json.dumps(result) + "\n")
            done.append(result)
    wanted = WANTED_JOINTS if joints else WANTED
    table = grades(done, wanted)
    (out / "exam.json").write_text(json.dumps({"noise": noise, "seed": seed, "grades": table}, indent=1) + "\n")
    (out / "confusion.png").write_bytes(confusion_figure(done))
    text = as_text(table, noise, wanted)
    (out / "exam.md").write_text(text + "\n")
    return text


def done_before(place: Path, plan: Sequence[Spec | JointCaseSpec]) -> list[dict[str, Any]]:
    """Return the results of a stopped exam that belong to a plan; a line that was cut off is taken away.

    Raises:
        InputError: A line is no result of a case, or one of another exam.
    """
    if not place.exists():
        return []
    *lines, rest = read_text(place).split("\n")
    results = [_result(line, place, number) for number, line in enumerate(lines, start=1)]
    if rest:  # killed while it was written
        replace_text(place, "".join(f"{line}\n" for line in lines))
    done = [d for d in results if d["case"] < len(plan)]
    for d in done:
        if d.get("spec") != _told(plan[d["case"]]):
            found = f"case {d['case']} of another exam"
            raise InputError(place, "", found, "the options that it was begun with, or another --out")
    return done


def _result(line: str, place: Path, number: int) -> dict[str, Any]:
    allowed = "a case's result as bough exam writes it (without the line its case is held again)"
    found = object_of(line, place, allowed, number)
    validated(TypeAdapter(Result), found, place, f"line {number}", allowed)
    return found


def _told(spec: Spec | JointCaseSpec) -> dict[str, Any]:
    """Return what makes a case, as JSON reads it back."""
    return dict(json.loads(json.dumps(asdict(spec))))


def sit(item: tuple[int, Spec | JointCaseSpec], advance: Callable[[int], None]) -> dict[str, Any]:
    """Hide one case, diagnose it, and return answer and verdict."""
    number, spec = item
    with tempfile.TemporaryDirectory() as folder, one_thread():
        place = Path(folder) / "case"
        if isinstance(spec, JointCaseSpec):
            answer = hide_joints(place, **spec.options)
            noise = max(answer["noise"], FAINT)
        else:
            answer, noise = hide(place, **spec.options), spec.noise
        found = find_missing(load_case(place), Run(Settings(particles=0)))
    verdict = found.verdict_file()
    verdict["case"] = number
    advance(1)
    keys = ("null", "out_of_library", "effects", "equivalents", "weak", "visible_gap", "rig", "outside", "rate",
            "measurement_gap")  # fmt: skip
    truth = {k: answer[k] for k in keys if k in answer}
    return {"case": number, "kind": spec.kind, "noise": noise, "spec": _told(spec), "truth": truth,
            "verdict": verdict, "seconds": found.seconds["total"],
            "reduced_chi2": found.ranking[0].reduced_chi2, "base_reduced_chi2": found.base_reduced_chi2,
            "motion": found.motion,
            "ranking": [(r.effects, r.reduced_chi2, r.delta, r.explained) for r in found.ranking]}  # fmt: skip


def confusion_figure(results: Sequence[dict[str, Any]]) -> bytes:
    """Return the confusion matrix as PNG: hidden down, named across; pairs count for each of their effects."""
    rows, columns = ["none", *NAMES, "outside"], ["none", *NAMES, "unknown"]
    count = np.zeros((len(rows), len(columns)), dtype=int)
    for r in results:
        truth = r["truth"]
        hidden = ["none"] if truth["null"] else ["outside"] if truth["out_of_library"] else _hidden(truth)
        named = names_of(r) or [r["verdict"]["verdict"]]
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
