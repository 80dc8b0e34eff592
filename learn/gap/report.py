"""What a diagnosis leaves in its folder; its report page: verdict, key numbers, tables, figures and the next probe."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from ...sim.base.host import describe
from ...sim.base.types import Array
from ...sim.effects import effect_of, effects
from ...version import __version__
from ..cases.case import BranchCase, JointCase
from ..inference.predict import main_channels
from ..replay.case_motion import case_motion
from ..reports.figures import ALARM as VERMILION
from ..reports.figures import MODEL
from ..reports.motion import ReportMotion
from ..reports.page import KeyNumber, ParameterRow, ReportContent, ReportFigure, ReportTable, number, write_report
from ..systems.model_file import BranchModel, write_model
from .consistent import error_name, far, grows, missed, percent, plain, readable, share, significant, what
from .decide import TIED
from .diagnosis import Diagnosis, Rival, Share, together
from .evidence import ALARM
from .figures import (
    BASE,
    BEST,
    before_after_figure,
    course_figure,
    gap_figure,
    heat_figure,
    loops_figure,
    motion_figure,
    ranking_figure,
    shares_figure,
)
from .where import joint_motion, locate, motion_of

VERDICT = "verdict.json"
BEFORE = "base.yaml"
"""Of a branch: the model before repair, springs and dampers without effects."""
#: Most recordings drawn over time and as loops, channels per recording, joints of a mechanism, models of the ranking.
SHOWN, LOOPS, CHANNELS, JOINTS, RIVALS = 2, 4, 3, 3, 12
_STATUS: dict[str, Literal["good", "warning", "bad"]] = {"none": "good", "effects": "warning", "unknown": "bad"}
#: Held-out RMSE over noise floor from which the floor says little of what can be reached.
GOOD_SENSOR = 30.0
_P_VALUE = "Probability that the best of all candidates fits this well if the base model is true."


def write_diagnosis(folder: Path, found: Diagnosis) -> Path:
    """Write ``verdict.json``, the figures and ``report.html`` into an existing folder; return the page's path."""
    (folder / VERDICT).write_text(json.dumps(found.verdict_file(), indent=2, allow_nan=False) + "\n")
    return write_report(folder, content(found))


def write_models(folder: Path, found: Diagnosis) -> None:
    """Write ``model.yaml``, of a branch ``base.yaml``, and ``posterior.npz`` where there is one, into a folder."""
    if found.model is not None:
        write_model(folder / "model.yaml", found.model)
    if isinstance(found.model, BranchModel):
        write_model(folder / BEFORE, base_model(found.model, found.base_values))
    if found.posterior is not None:
        found.posterior.save(folder / "posterior.npz")


def base_model(model: BranchModel, values: Mapping[str, float]) -> BranchModel:
    """Return the branch before repair: the base model's springs and dampers, no effects."""
    spring, damper = (np.array([values[f"{k} {n}"] for n in model.segment_name]) for k in ("stiffness", "damping"))
    return replace(model, stiffness=spring, damping=damper, effects=(), claimed=True, courses={})


def content(diagnosis: Diagnosis, *, drawn: bool = True) -> ReportContent:
    """Return what the report page shows; without ``drawn`` no figures."""
    known = (
        "simulate, identify, forest and train" if isinstance(diagnosis.case, BranchCase) else "simulate and identify"
    )
    return ReportContent(
        title=f"Diagnosis of {diagnosis.case.name}",
        headline=plain(diagnosis),
        precisely=diagnosis.sentence,
        status=_STATUS[diagnosis.verdict],
        numbers=[*_gap(diagnosis), *_effects(diagnosis), *_advice(diagnosis)],
        exact=_evidence(diagnosis),
        folded=True,
        commands=_commands(diagnosis),
        motion=_motion(diagnosis) if drawn else None,
        parameters=_parameters(diagnosis),
        tables=_tables(diagnosis),
        figures=_figures(diagnosis) if drawn else [],
        details=_details(diagnosis),
        further=[
            (VERDICT, "the verdict for programs"),
            ("model.yaml", f"the repaired model, for --model of {known}"),
            ("docs/diagnose.md", "how to read this page and how it is computed"),
            ("docs/effects.md", "the law of each effect"),
        ],
    )


def _commands(d: Diagnosis) -> list[tuple[str, str]]:
    """Return what to do next with this case, in the page's folder, by verdict and kind."""
    case, branch = shlex.quote(str(d.case.folder.resolve())), isinstance(d.case, BranchCase)
    repaired = f"bough simulate {case} --model model.yaml --out replayed"
    out = [(repaired, "replays the recordings with the repaired model and prints the same gap")] if d.model else []
    if d.model and branch:
        out.append((f"bough view . --case {case}", "shows the branch before and after in the browser"))
    if d.verdict == "none":
        out.append((f"bough identify {case} --out identified", "learns springs and dampers with their intervals"))
    if d.verdict == "effects" and branch:
        out.append(("bough train powerline --model model.yaml --out trained", "trains among such branches"))
    if d.verdict == "unknown":
        out.append(
            (f"bough diagnose {case} --out again", "judges again, once the next probe is recorded into the case")
        )
    if d.verdict != "none" and d.fit and d.fit["other"]:
        what = f"judges by the other way to fit, {d.fit['other']}"
        out.append((f"bough diagnose {case} --fit {d.fit['other']} --out again", what))
    return out


def _motion(d: Diagnosis) -> ReportMotion | None:
    """Return the recording that the base model misses most as a motion."""
    j = _worst(d, 1)[0]
    models = {BASE: (VERMILION, d.base_output[j]), BEST: (MODEL, d.best_output[j])}
    return case_motion(d.case, j, d.recordings[j], models)


# ---- the first screen -----------------------------------------------------------------------------------------------


def _gap(d: Diagnosis) -> list[KeyNumber]:
    scale, unit = readable(d.gap.unit)
    held = ", ".join(str(j + 1) for j in d.gap.test)
    if d.held_out:
        which = f"Recording{'s' if len(d.gap.test) > 1 else ''} {held}"
        name, of = "Held-out RMSE", f" {which}, not used in the fit." if held else ""
    else:
        name, of = "RMSE", " In the only recording, to which the model was fitted: nothing is held out."
    shown = [
        KeyNumber(f"{name}, base model", scale * d.gap.base, unit,
                  f"Springs and dampers alone.{of} {percent(missed(d))} of {what(d)} beyond the noise."),
        KeyNumber(f"{name}, {BEST}", scale * d.gap.repaired, unit, _repaired(d)),
        KeyNumber("Noise floor", scale * d.gap.noise_floor, unit, _floor(d)),
    ]  # fmt: skip
    if d.scatter is not None:
        why = "Of the same experiment from its mean, noise included: no model of the input does better on the average."
        shown.append(KeyNumber("Scatter of repeats", scale * d.scatter, unit, why))
    return shown


def _repaired(d: Diagnosis) -> str:
    if not d.tried:
        return "No effect is added: the base model."
    if d.verdict == "effects":
        return "Root mean square error with the named effects added."
    worse = " It predicts worse with it than without." if grows(d) else ""
    return f"With {' + '.join(d.tried)} added, which is not claimed.{worse}"


def _floor(d: Diagnosis) -> str:
    force = ", that of the force included" if isinstance(d.case, BranchCase) else ""
    text = f"What a perfect model would leave: the noise of the sensors alone{force}."
    if d.scatter is not None or d.gap.base < GOOD_SENSOR * d.gap.noise_floor:
        return text
    return f"{text} It says little here; record one experiment twice to see what a model can reach."


def _effects(d: Diagnosis) -> list[KeyNumber]:
    """Return a line per parameter of each named effect; what the effect does is said once."""
    out = []
    for acting in d.effects:
        law = f"; {effect_of(acting.name).summary}"
        for name, i in d.parameters.get(acting.label, {}).items():
            row = ParameterRow(name, i.median, i.low, i.high, i.unit)
            low, high = (number(x, row.digits) for x in (i.low, i.high))
            end = f", at the {i.at_bound} end of its box" if i.at_bound else ""
            why = f"95 % interval {low} to {high}{end}{law}."
            unit = "" if i.unit == "1" else i.unit
            out.append(KeyNumber(f"{acting.label} {bare(name)}", number(i.median, row.digits), unit, why))
            law = ""
    return out


def bare(name: str) -> str:
    """Return an effect's parameter without the unit in its name: the unit stands beside it, and a slide has another.

    A rate whose name without the unit is another parameter's is called so.
    """
    label, _, own = name.rpartition(" ")
    laws = [law for e in effects() for law in (e.branch, e.joint) if law is not None]
    every = {p.name for law in laws for p in law.parameters}
    if own in {p.name for law in laws for p in law.parameters if p.unit != "1"}:
        own, _, unit = own.rpartition("_")
        own += " rate" if own in every and unit.endswith("ps") else ""
    return f"{label} {own}".strip()


def _advice(d: Diagnosis) -> list[KeyNumber]:
    """Return where the base model is wrong, what is left open, alternative names, and the next probe."""
    files = [f"{j + 1} ({d.case.trajectories[j].file})" for j in d.where.trajectories]
    place = f", most in recording {', '.join(files)}" if files else ""
    out = [KeyNumber("Largest residuals", "", "", f"{d.where.regime}{place}.")]
    out += [KeyNumber("Not understood", "", "", f"{text}.") for text in d.not_understood]
    out += [KeyNumber("Left open", "", "", text) for text in d.remarks]
    rivals = [f"{label}: {', '.join(names)}" for label, names in d.alternatives.items() if names]
    if rivals:
        out.append(KeyNumber("Alternatives", "", "", f"These data cannot tell apart {'; '.join(rivals)}."))
    if d.verdict == "unknown":
        name = f"{d.nearest}, which is not claimed." if d.nearest else "None."
        out.append(KeyNumber("Nearest candidate", "", "", name))
    out += [KeyNumber("Unstable", "", "", f"{line}.") for line in d.unstable]
    if d.fit:
        other = f" The other way: --fit {d.fit['other']}." if d.fit["other"] else ""
        out.append(KeyNumber("Fitted", d.fit["method"], "", f"{d.fit['reason']}.{other}"))
    return [*out, KeyNumber("Next probe", "", "", d.next_experiment)]


def _evidence(d: Diagnosis) -> list[KeyNumber]:
    if d.unusable is not None:
        return []  # nothing was tested
    chi2 = "Of the base model; 1 if only noise is left."
    return [
        KeyNumber("p-value, family-wise", d.p_null, "", f"{_P_VALUE} {_against_alarm(d)}"),
        *_explained(d),
        KeyNumber("Reduced chi-squared", d.base_reduced_chi2, "", chi2),
    ]


def _against_alarm(d: Diagnosis) -> str:
    """Return what the p-value means for the verdict of the page."""
    if d.p_null > ALARM:
        none = f"Above {ALARM}: no candidate is significant"
        return f"{none}, but the misfit is far beyond the noise." if significant(d) else f"{none}."
    if d.verdict == "none":
        return (
            f"Below {ALARM}, but the effect is smaller than the tolerance: it changes the motion by {percent(d.size)}."
        )
    return f"Below {ALARM}: something is missing."


def _explained(d: Diagnosis) -> list[KeyNumber]:
    """Return the share of the excess that the preferred model explains, none where there is no excess to explain."""
    if not significant(d):
        return []
    which = "named effects" if d.verdict == "effects" else "best model, which is not claimed"
    seen = " In the recordings that it was fitted to; held-out ones are missed by more."
    fitted = seen if grows(d) and d.held_out else ""
    why = f"Of the base model's excess chi-squared, by the {which}.{fitted}"
    return [KeyNumber("Explained", share(d.explained), "", why)]


# ---- tables ---------------------------------------------------------------------------------------------------------


def _parameters(d: Diagnosis) -> list[ParameterRow]:
    if d.posterior is None:
        return []
    middle, low, high = d.posterior.interval()
    rows = zip(map(bare, d.posterior.names), middle, low, high, d.posterior.units, strict=True)
    return [ParameterRow(n, float(m), float(a), float(b), u) for n, m, a, b, u in rows]


def _tables(d: Diagnosis) -> list[ReportTable]:
    header = ("model", "reduced chi-squared", "ΔIC", "explained", "cross-validated")
    rows: list[tuple[object, ...]] = [
        (together(r.effects) or BASE, r.reduced_chi2, r.delta, share(r.explained),
         "not computed" if r.cross_validated is None else r.cross_validated)
        for r in _ranked(d)
    ]  # fmt: skip
    note = (
        "Reduced chi-squared: 1 for a perfect model. ΔIC: information criterion minus the preferred model's; models "
        f"within {TIED:g} cannot be told apart. Explained: share of the base model's excess chi-squared. "
        "Cross-validated: reduced chi-squared in recordings left out of the fit."
    )
    if any(r.delta < -TIED for r in d.ranking):
        note += (
            " A model above the preferred one is not named where its further effect explains too little of the base"
            " model's excess or does not pay on recordings left out: a law that is not quite right has such partners."
        )
    values: list[tuple[object, ...]] = [
        (bare(name), d.base_values.get(name, "-"), d.best_values.get(name, "-"))
        for name in dict.fromkeys([*d.base_values, *d.best_values])
    ]
    return [
        ReportTable("Ranking", header, rows, note),
        ReportTable("Fitted values, SI units", ("parameter", BASE, BEST), values),
    ]


def _ranked(d: Diagnosis) -> list[Rival]:
    """Return the best models, and the base model wherever it ranks."""
    best = list(d.ranking[:RIVALS])
    return best + [r for r in d.ranking[RIVALS:] if not r.effects]


def _details(d: Diagnosis) -> dict[str, object]:
    return {
        "candidate effects": ", ".join(d.settings.effects) or "all that the case can show",
        "tolerance": f"{d.settings.tolerance:g} of the rms of {what(d)}",
        "most effects together": d.settings.max_effects,
        "seed": d.settings.seed,
        **(
            {}
            if d.posterior is None
            else {"intervals widened for model error": f"{d.posterior.widened:.2g} times at most"}
        ),
        "wall time [s]": ", ".join(f"{k} {v:.1f}" for k, v in d.seconds.items()),
        "simulated world-steps": f"{d.world_steps:,}",
        "bough": __version__,
        **describe(),
        **{f"note {i + 1}": line for i, line in enumerate(d.case.warnings)},
    }


# ---- figures --------------------------------------------------------------------------------------------------------


def _figures(d: Diagnosis) -> list[ReportFigure]:
    base, best = d.where, locate(d.case, d.recordings, d.sigma, d.best_output)
    scale, unit = readable(d.gap.unit)
    ranked = _ranked(d)
    delta, explained = (np.array([getattr(r, k) for r in ranked]) for k in ("delta", "explained"))
    floor, scatter = scale * d.gap.noise_floor, None if d.scatter is None else scale * d.scatter
    noise = _noise_share(d)
    repeats = None if d.scatter is None else d.scatter / max(d.swing, 1e-300)
    reach = "the noise floor" if d.scatter is None else "the scatter of repeats, or the noise floor"
    name = error_name(d).split(",")[0].replace(" in the one recording", " of the one recording")
    return [
        ReportFigure("gap.png", gap_figure(scale * d.gap.base, scale * d.gap.repaired, floor, unit=unit,
                                           scatter=scatter, name=name),
                     f"{name[0].upper()}{name[1:]} of both models: a good model comes close to {reach}.", _removed(d)),
        ReportFigure("heat.png", heat_figure(base.of_motion, best.of_motion, base.edges, titles=_titles(d), noise=noise,
                                             scatter=repeats),
                     "Residual as a share of the motion by recording and time: dark windows are where a model is wrong;"
                     " grey: no data.", _darkest(d, base.of_motion, best.of_motion, base.edges)),
        *_courses(d),
        _before_after(d),
        _loops(d) if isinstance(d.case, BranchCase) else _against_motion(d, d.case),
        ReportFigure("ranking.png", ranking_figure([together(r.effects) for r in ranked], delta, explained),
                     "Model comparison: information criterion minus the preferred model's; shorter is better.",
                     _runner_up(d, ranked)),
        ReportFigure("parts.png", shares_figure(base.shares, best.shares),
                     "Residual / noise by part of the motion: parts far above 1 point to the missing law.",
                     _loudest(base.shares, best.shares)),
    ]  # fmt: skip


def _courses(d: Diagnosis) -> list[ReportFigure]:
    """Return the courses of gusts in the recordings that the base model misses most; nothing where there are none."""
    if not isinstance(d.model, BranchModel) or not d.model.courses or not isinstance(d.case, BranchCase):
        return []
    worst, files, lead = sorted(_worst(d, SHOWN)), [t.file for t in d.case.trajectories], d.case.lead
    rms = next(a.known["rms_Pa"] for a in d.model.effects if a.name == "wind_gust")
    seen = [d.recordings[j] for j in worst]
    figure = course_figure([r.t for r in seen], [rms * d.model.courses[files[j]][lead:] for j in worst],
                           [r.contact for r in seen], [_titles(d)[j] for j in worst])  # fmt: skip
    return [ReportFigure("courses.png", figure, "Pressure of the gusts that was read off recordings: of another course"
                         " in each, and there before a gripper closes.", "")]  # fmt: skip


def _removed(d: Diagnosis) -> str:
    """Return what the repaired model takes away of the error beyond the noise; nothing where there is none beyond."""
    excess = [max(x**2 - d.gap.noise_floor**2, 0.0) for x in (d.gap.base, d.gap.repaired)]
    if not far(d) and d.verdict == "none":
        return "The base model comes close to the noise: there is little to explain."
    if not d.tried:
        return ""
    if grows(d):
        return "What was tried does not bring the model closer to what was measured."
    if excess[0] == 0.0:
        return "The base model leaves no more than the noise floor."
    gone = 1.0 - math.sqrt(excess[1] / excess[0])
    return f"The {BEST} takes away {percent(gone)} of the error beyond the noise."


def _darkest(d: Diagnosis, base: Array, best: Array, edges: Array) -> str:
    """Return where the base model misses most, and how much both models miss there."""
    j, w = np.unravel_index(np.nanargmax(base), base.shape)
    return (f"The {BASE} misses most in recording {j + 1}, from {edges[w]:.3g} to {edges[w + 1]:.3g} s: by"
            f" {percent(base[j, w])} of the motion, the {BEST} by {percent(best[j, w])}.")  # fmt: skip


def _runner_up(d: Diagnosis, ranked: Sequence[Rival]) -> str:
    """Return how far the best other model of as many effects is behind the preferred one."""
    if d.verdict != "effects":
        return "No model here is good enough to be claimed." if d.verdict == "unknown" else ""
    own = {a.label for a in d.effects}
    others = [r for r in ranked if len(r.effects) == len(own) and set(r.effects) != own]
    if not others:
        return ""
    first = min(others, key=lambda r: r.delta)
    near = "cannot be told apart from it" if abs(first.delta) <= TIED else f"is {number(first.delta)} behind"
    return f"The best other explanation, {together(first.effects)}, {near}."


def _loudest(base: Sequence[Share], best: Sequence[Share]) -> str:
    """Return the part of the motion that the base model misses most, relative to the noise, before and after."""
    if not base:
        return ""
    worst = max(base, key=lambda s: s.ratio)
    after = next((s.ratio for s in best if (s.by, s.part) == (worst.by, worst.part)), None)
    then = "" if after is None else f", {after:.3g} times with the {BEST}"
    return f"Most is missed in the part called {worst.part}: {worst.ratio:.3g} times the noise{then}."


def _noise_share(d: Diagnosis) -> float:
    """Return the noise as a share of the motion, rms over all samples and channels that have noise."""
    sigma = np.broadcast_to(d.sigma, d.base_output.shape) / motion_of(d.case, d.recordings)
    used = [x[: len(r.t)][:, x.max(axis=0) > 0.0] for x, r in zip(sigma, d.recordings, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate([x.ravel() for x in used]) ** 2)))


def _titles(d: Diagnosis) -> list[str]:
    return [
        f"{j + 1} {Path(t.file).stem} {getattr(t, 'profile', '')}".strip() for j, t in enumerate(d.case.trajectories)
    ]


def _worst(d: Diagnosis, count: int) -> list[int]:
    """Return the recordings with the largest residuals of the base model, worst first, one per set of replicates."""
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
    before, after = (np.sqrt(np.mean((x[0] - measured[0]) ** 2)) for x in (base, best))
    return ReportFigure(
        "before_after.png", drawn, "The recordings with the largest residuals, measured and simulated by both models.",
        f"In recording {chosen[0] + 1} the {BASE} is off by {number(before, 2)} {unit} rms, the {BEST} by"
        f" {number(after, 2)}.",
    )  # fmt: skip


def _loops(d: Diagnosis) -> ReportFigure:
    chosen, place = _worst(d, LOOPS), [0, 1, 2]
    force = [d.recordings[j].input for j in chosen]
    measured = [d.recordings[j].output[:, place] for j in chosen]
    base, best = (_cut(d, out, chosen, place) for out in (d.base_output, d.best_output))
    drawn = loops_figure(force, measured, base, best, titles=[_titles(d)[j] for j in chosen])
    caption = "Force against displacement: the slope is the stiffness, the enclosed area the energy lost."
    work = [sum(_work(f, x) for f, x in zip(force, moved, strict=True)) for moved in (measured, base, best)]
    told = ", ".join(f"{name} {number(w)} J" for name, w in zip(("measured", BASE, BEST), work, strict=True))
    return ReportFigure("loops.png", drawn, caption, f"Work of the gripper in these recordings: {told}.")


def _work(force: Array, moved: Array) -> float:
    """Return the work of a force [T, 3] along a displacement [T, 3] [J]."""
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(moved, axis=0)))


def _against_motion(d: Diagnosis, case: JointCase) -> ReportFigure:
    """Draw the residual of the main channels against coordinate and rate of their joint."""
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
    return ReportFigure(
        "motion.png",
        drawn,
        "Residual against coordinate and rate: a curve shows a missing law, a flat cloud shows noise.",
    )


def _residual(d: Diagnosis, output: Array, channel: int) -> Array:
    return np.concatenate(
        [r.output[:, channel] - out[: len(r.t), channel] for r, out in zip(d.recordings, output, strict=True)]
    )
