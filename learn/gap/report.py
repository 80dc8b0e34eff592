"""What a diagnosis says to a person: its verdict, its numbers, its pictures and what to probe next."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np

from ...sim.base.host import describe
from ...sim.base.types import Array
from ...sim.effects import effect_of
from ...version import __version__
from ..cases.case import BranchCase, JointCase
from ..inference.predict import main_channels
from ..reports.page import KeyNumber, ParameterRow, ReportContent, ReportFigure, ReportTable, number
from .decide import TIED
from .diagnosis import Diagnosis, Rival
from .evidence import ALARM
from .figures import (
    before_after_figure,
    gap_figure,
    heat_figure,
    loops_figure,
    motion_figure,
    ranking_figure,
    shares_figure,
)
from .where import joint_motion, locate

VERDICT = "verdict.json"
#: Recordings drawn in time and as loops, channels of a recording, joints of a mechanism, rivals of the ranking.
SHOWN, LOOPS, CHANNELS, JOINTS, RIVALS = 2, 4, 3, 3, 12
_STATUS: dict[str, Literal["good", "warning", "bad"]] = {"none": "good", "effects": "warning", "unknown": "bad"}
#: How people read SI units: factor and name.
_READ = {"m": (100.0, "cm"), "rad": (math.degrees(1.0), "deg"), "rad_per_s": (math.degrees(1.0), "deg/s")}


def content(diagnosis: Diagnosis) -> ReportContent:
    """Return what the report page shows."""
    with_model = isinstance(diagnosis.case, BranchCase)  # a mechanism of joints has no model file
    return ReportContent(
        title=f"Diagnosis of {diagnosis.case.name}",
        headline=diagnosis.sentence,
        status=_STATUS[diagnosis.verdict],
        numbers=[*_gap(diagnosis), *_effects(diagnosis), *_advice(diagnosis), *_evidence(diagnosis)],
        parameters=_parameters(diagnosis),
        tables=_tables(diagnosis),
        figures=_figures(diagnosis),
        details=_details(diagnosis),
        further=[
            (VERDICT, "the verdict for programs"),
            *([("model.yaml", "what simulate, identify, forest and train take as --model")] if with_model else []),
            ("docs/diagnose.md", "how to read this page, and how it is computed"),
            ("docs/effects.md", "the law behind every name"),
        ],
    )


def readable(unit: str) -> tuple[float, str]:
    """Return factor and name of the unit in which people read an SI unit."""
    return _READ.get(unit, (1.0, unit.replace("_per_", "/").replace("_", " ")))


# ---- the first screen -----------------------------------------------------------------------------------------------


def _gap(d: Diagnosis) -> list[KeyNumber]:
    scale, unit = readable(d.gap.unit)
    held = ", ".join(str(j + 1) for j in d.gap.test)
    of = f" Recordings {held}, not fitted to." if held else ""
    repaired = {
        "none": "Nothing is added, so it is the same model.",
        "effects": "With what was found added.",
        "unknown": f"With {d.nearest or 'the best candidate'} added, which is not claimed.",
    }[d.verdict]
    return [
        KeyNumber("Held-out misfit", scale * d.gap.base, unit, f"Of springs and dampers alone, rms.{of}"),
        KeyNumber("Misfit, repaired", scale * d.gap.repaired, unit, repaired),
        KeyNumber("Noise floor", scale * d.gap.noise_floor, unit, "What a perfect model would leave."),
    ]


def _effects(d: Diagnosis) -> list[KeyNumber]:
    """Return a line a parameter of every named effect; what the effect does is told once."""
    out = []
    for acting in d.effects:
        law = f"; {effect_of(acting.name).summary}"
        for name, i in d.parameters.get(acting.label, {}).items():
            row = ParameterRow(name, i.median, i.low, i.high, i.unit)
            low, high = (number(x, row.digits) for x in (i.low, i.high))
            why = f"95 % interval {low} to {high}{law}."
            unit = "" if i.unit == "1" else i.unit
            out.append(KeyNumber(f"{acting.label} {name}", number(i.median, row.digits), unit, why))
            law = ""
    return out


def _advice(d: Diagnosis) -> list[KeyNumber]:
    """Return where it is wrong, what it could be confused with, and what to do next."""
    files = [f"{j + 1} ({d.case.trajectories[j].file})" for j in d.where.trajectories]
    place = f", most in recording {', '.join(files)}" if files else ""
    out = [KeyNumber("Where", "", "", f"{d.where.regime}{place}.")]
    rivals = [f"{label}: {', '.join(names)}" for label, names in d.alternatives.items() if names]
    if rivals:
        out.append(KeyNumber("Could also be", "", "", f"This data cannot tell apart {'; '.join(rivals)}."))
    if d.verdict == "unknown":
        name = f"{d.nearest}, which leaves too much over to be claimed." if d.nearest else "None."
        out.append(KeyNumber("Nearest name", "", "", name))
    return [*out, KeyNumber("Probe next", "", "", d.next_experiment)]


def _evidence(d: Diagnosis) -> list[KeyNumber]:
    chance = (
        "Probability that the best of all candidates looks this good although nothing is missing. "
        f"Above {ALARM} nothing is said to be missing."
    )
    share = "Share of the excess over the noise that the best candidate explains."
    return [KeyNumber("Chance finding", d.p_null, "", chance), KeyNumber("Explained", 100 * d.explained, "%", share)]


# ---- tables ---------------------------------------------------------------------------------------------------------


def _parameters(d: Diagnosis) -> list[ParameterRow]:
    if d.posterior is None:
        return []
    middle, low, high = d.posterior.interval()
    rows = zip(d.posterior.names, middle, low, high, d.posterior.units, strict=True)
    return [ParameterRow(n, float(m), float(a), float(b), u) for n, m, a, b, u in rows]


def _tables(d: Diagnosis) -> list[ReportTable]:
    header = ("model", "squares per number", "behind", "explained", "left out")
    rows: list[tuple[object, ...]] = [
        (_called(r) or "springs and dampers alone", r.misfit, r.behind, f"{r.explained:.0%}",
         "not tried" if r.left_out is None else r.left_out)
        for r in _ranked(d)
    ]  # fmt: skip
    note = (
        "Squares per number: one for a perfect model. Behind: in the information criterion; "
        f"models within {TIED:g} cannot be told apart. Left out: squares per number in recordings that the model was "
        "not fitted to."
    )
    values: list[tuple[object, ...]] = [
        (name, d.base_values.get(name, "-"), d.best_values.get(name, "-"))
        for name in dict.fromkeys([*d.base_values, *d.best_values])
    ]
    return [
        ReportTable("Ranking", header, rows, note),
        ReportTable("Fitted values, SI units", ("parameter", "springs and dampers", "repaired"), values),
    ]


def _ranked(d: Diagnosis) -> list[Rival]:
    """Return the best rivals, and the base wherever it stands."""
    best = list(d.ranking[:RIVALS])
    return best + [r for r in d.ranking[RIVALS:] if not r.effects]


def _called(rival: Rival) -> str:
    return " + ".join(rival.effects)


def _details(d: Diagnosis) -> dict[str, object]:
    return {
        "effects tried": ", ".join(d.settings.effects) or "all that the case can show",
        "tolerance": f"{d.settings.tolerance:g} of the motion's rms",
        "effects together at most": d.settings.max_effects,
        "seed": d.settings.seed,
        "seconds": ", ".join(f"{k} {v:.1f}" for k, v in d.seconds.items()),
        "world-steps": f"{d.world_steps:,}",
        "bough": __version__,
        **describe(),
        **{f"note {i + 1}": line for i, line in enumerate(d.case.warnings)},
    }


# ---- figures --------------------------------------------------------------------------------------------------------


def _figures(d: Diagnosis) -> list[ReportFigure]:
    base, best = d.where, locate(d.case, d.recordings, d.sigma, d.best_output)
    scale, unit = readable(d.gap.unit)
    ranked = _ranked(d)
    behind, explained = (np.array([getattr(r, k) for r in ranked]) for k in ("behind", "explained"))
    return [
        ReportFigure("gap.png", gap_figure(scale * d.gap.base, scale * d.gap.repaired, scale * d.gap.noise_floor,
                                           unit=unit), "Held-out misfit before and after, and what cannot be helped."),
        ReportFigure("heat.png", heat_figure(base.heat, best.heat, base.edges, titles=_titles(d)),
                     "Misfit over noise by recording and time: white is noise, grey is past a recording's end."),
        _before_after(d),
        _loops(d) if isinstance(d.case, BranchCase) else _against_motion(d, d.case),
        ReportFigure("ranking.png", ranking_figure([_called(r) for r in ranked], behind, explained),
                     "Evidence: how far every model is behind the best, and the share of the excess it explains."),
        ReportFigure("parts.png", shares_figure(base.shares, best.shares),
                     "Misfit over noise by part of the motion: what stands out says which law is wrong."),
    ]  # fmt: skip


def _titles(d: Diagnosis) -> list[str]:
    return [
        f"{j + 1} {Path(t.file).stem} {getattr(t, 'profile', '')}".strip() for j, t in enumerate(d.case.trajectories)
    ]


def _worst(d: Diagnosis, count: int) -> list[int]:
    """Return the recordings with the largest misfit of the base model, worst first, one of each set of replicates."""
    chosen: dict[int, int] = {}
    for j in np.argsort(-np.nanmean(d.where.heat**2, axis=1)).tolist():
        original = d.case.trajectories[j].replicate_of
        chosen.setdefault(j if original is None else original, j)
    return list(chosen.values())[:count]


def _cut(d: Diagnosis, output: Array, chosen: list[int], channels: list[int]) -> list[Array]:
    return [output[j, : len(d.recordings[j].t)][:, channels] for j in chosen]


def _before_after(d: Diagnosis) -> ReportFigure:
    chosen, main = _worst(d, SHOWN), list(main_channels(d.case))[:CHANNELS]
    scale, unit = readable(d.gap.unit)
    labels = [f"{'xyz'[c] if isinstance(d.case, BranchCase) else d.case.channels[c].joint} [{unit}]" for c in main]
    measured = [scale * d.recordings[j].output[:, main] for j in chosen]
    base, best = ([scale * x for x in _cut(d, out, chosen, main)] for out in (d.base_output, d.best_output))
    titles = [_titles(d)[j] for j in chosen]
    times = [d.recordings[j].t for j in chosen]
    drawn = before_after_figure(times, measured, base, best, titles=titles, labels=labels)
    return ReportFigure("before_after.png", drawn, "The recordings with the largest misfit, before and after.")


def _loops(d: Diagnosis) -> ReportFigure:
    chosen, place = _worst(d, LOOPS), [0, 1, 2]
    force = [d.recordings[j].input for j in chosen]
    measured = [d.recordings[j].output[:, place] for j in chosen]
    base, best = (_cut(d, out, chosen, place) for out in (d.base_output, d.best_output))
    drawn = loops_figure(force, measured, base, best, titles=[_titles(d)[j] for j in chosen])
    caption = "Force against displacement: the slope is stiffness, the area inside a loop is energy lost."
    return ReportFigure("loops.png", drawn, caption)


def _against_motion(d: Diagnosis, case: JointCase) -> ReportFigure:
    """Draw the residual of the main channels against their joint's coordinate and rate."""
    scale, unit = readable(d.gap.unit)
    main = list(main_channels(case))[:JOINTS]
    names = [case.channels[c].joint for c in main]
    motion = [joint_motion(case, r) for r in d.recordings]
    angle, rate = (
        [np.concatenate([np.zeros(0) if (x := m[name][k]) is None else x for m in motion]) for name in names]
        for k in (0, 1)
    )
    base, best = ([scale * _residual(d, out, c) for c in main] for out in (d.base_output, d.best_output))
    turning = next(j for j in case.joints if j.name == names[0]).type == "revolute"
    units = ("rad", "rad/s", unit) if turning else ("m", "m/s", unit)
    drawn = motion_figure(angle, rate, base, best, names=names, units=units)
    return ReportFigure("motion.png", drawn, "What is left over against coordinate and rate: a curve is a law.")


def _residual(d: Diagnosis, output: Array, channel: int) -> Array:
    return np.concatenate(
        [r.output[:, channel] - out[: len(r.t), channel] for r, out in zip(d.recordings, output, strict=True)]
    )
