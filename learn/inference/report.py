"""Report of an identification: its numbers, headline and page."""

from __future__ import annotations

import math
import shlex
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ...sim.base.host import describe
from ...version import __version__
from ..cases.case import BranchCase, JointCase
from ..replay.case_motion import case_motion
from ..replay.recording import recordings
from ..reports.figures import (
    MODEL,
    amplitude_figure,
    convergence_figure,
    coverage_figure,
    loop_figure,
    posterior_figure,
    prediction_figure,
    residual_figure,
)
from ..reports.motion import ReportMotion
from ..reports.page import KeyNumber, ParameterRow, ReportContent, ReportFigure
from ..samplers.registry import SAMPLERS
from .outcome import Outcome
from .predict import main_channels
from .settings import Settings

#: RMSE over noise floor above which the residual is more than noise.
TOLERANCE = 1.3
#: Probabilities of the coverage curve.
NOMINAL = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)


def unit_of(case: BranchCase | JointCase) -> str:
    """Return the unit of the main channels: ``m`` or ``rad`` and their rates."""
    if isinstance(case, BranchCase):
        return "m"
    output = case.channels[0]
    joint = next(j for j in case.joints if j.name == output.joint)
    base = "rad" if joint.type == "revolute" else "m"
    return {
        "position": base,
        "velocity": f"{base}_per_s",
        "acceleration": f"{base}_per_s2",
        "effort": "N_m" if base == "rad" else "N",
    }[output.quantity]


def spoken(unit: str) -> str:
    """Return a unit as a reader writes it: ``N m`` for ``N_m``, ``rad/s`` for ``rad_per_s``."""
    return unit.replace("_per_", "/").replace("_", " ")


def summary(outcome: Outcome) -> dict[str, Any]:
    """Return what ``report.json`` holds: scores on the held-out trajectories and every parameter's interval."""
    unit, p = unit_of(outcome.case), outcome.prediction
    scores = {"interval_95_width": p.width, "rms_misfit": p.rms, "noise_floor": outcome.noise_floor}
    middle, low, high = outcome.posterior.interval()
    out: dict[str, Any] = {
        "case": outcome.case.name,
        "coverage_95": p.coverage,
        **{f"{name}_{unit}": value for name, value in scores.items()},
        "misfit_over_noise": outcome.ratio,
        "unit": unit,
        "parameters": {
            name: {"median": float(m), "low": float(a), "high": float(b), "unit": u}
            for name, m, a, b, u in zip(
                outcome.posterior.names, middle, low, high, outcome.posterior.units, strict=True
            )
        },
        "trajectories": {
            "train": [j + 1 for j in outcome.train],
            "test": [j + 1 for j in outcome.test],
            f"rms_misfit_{unit}": [float(np.sqrt(np.mean(r[:, list(p.main)] ** 2))) for r in p.residual],
        },
        f"rms_misfit_by_channel_{unit}": _by_channel(outcome),
        "misfit_by_amplitude": {
            f"{name}_{unit}": x.tolist() for name, x in zip(("amplitude", "misfit"), p.by_amplitude(), strict=True)
        },
        "starts_that_agree": outcome.posterior.agreement,
        "caveat": caveat(outcome),
        "widened_for_correlated_residuals": outcome.posterior.widened,
        "converged": outcome.posterior.convergence.converged,
        "convergence": outcome.posterior.convergence.reason,
        "diagnostics": outcome.posterior.convergence.numbers,
        "mean_nll": p.mean_nll,
        f"mean_crps_{unit}": p.mean_crps,
        "coverage_curve": {f"{q:.2f}": p.coverage_at(q) for q in NOMINAL},
        "world_steps": outcome.world_steps,
        "seconds": outcome.seconds,
        "settings": _settings(outcome.settings),
        "version": __version__,
        "machine": describe(),
    }
    if unit == "rad":
        out |= {f"{name}_deg": math.degrees(value) for name, value in scores.items()}
    return out


def _settings(s: Settings) -> dict[str, Any]:
    effects = [{"name": a.name, "joint": a.joint, "parameters": dict(a.known)} for a in s.effects]
    return asdict(replace(s, effects=())) | {"effects": effects}


def _by_channel(outcome: Outcome) -> dict[str, float]:
    """Return the held-out RMSE of every main channel, by axis or joint."""
    case, p = outcome.case, outcome.prediction
    names = ["xyz"[c] if isinstance(case, BranchCase) else case.channels[c].joint for c in p.main]
    squares = np.mean(np.concatenate([r[:, list(p.main)] ** 2 for r in p.residual]), axis=0)
    return dict(zip(names, np.sqrt(squares).tolist(), strict=True))


def _shown(outcome: Outcome) -> tuple[float, str]:
    """Scale and unit for readers: centimetres for a branch, degrees for angles."""
    if isinstance(outcome.case, BranchCase):
        return 100.0, "cm"
    unit = unit_of(outcome.case)
    return (math.degrees(1.0), "deg") if unit == "rad" else (1.0, spoken(unit))


def headline(outcome: Outcome) -> tuple[str, str]:
    """Return the verdict in a sentence, and good, warning or bad."""
    done = outcome.posterior.convergence
    if not done.converged:
        return f"The sampler did not converge: {done.reason}. The results below are not the posterior.", "bad"
    p, (scale, unit) = outcome.prediction, _shown(outcome)
    rms, floor = f"{scale * p.rms:.3g} {unit}", f"{scale * outcome.noise_floor:.3g} {unit}"
    if outcome.ratio <= TOLERANCE:
        return f"The model explains the held-out motion to within the noise: RMSE {rms}, noise floor {floor}.", "good"
    agree = outcome.posterior.agreement >= 0.25
    why = (
        f"the fit is not the cause ({outcome.posterior.agreement:.0%} of the starts found the same optimum): "
        f"the model lacks an effect that the data contain, and the intervals do not allow for it. {_advice(outcome)}"
        if agree
        else "few starts agree on an optimum, so the fit itself may have failed, and the intervals with it"
    )
    error = "RMSE in the one recording, which was fitted to," if _alone(outcome) else "held-out RMSE"
    return (
        f"The {error} is {outcome.ratio:.1f} times the noise floor ({rms} against {floor}); {why}.",
        "warning" if agree else "bad",
    )


def plain(outcome: Outcome) -> str:
    """Return the verdict for who has not heard of a posterior; `headline` says the same precisely."""
    if not outcome.posterior.convergence.converged:
        return "Not settled: the search for springs and dampers did not converge. Use nothing below yet."
    p, (scale, unit) = outcome.prediction, _shown(outcome)
    what = "springs and dampers" if isinstance(outcome.case, BranchCase) else "parameters"
    how = "the motion it was fitted to" if _alone(outcome) else "pushes that they were not fitted to"
    if outcome.ratio <= TOLERANCE:
        return f"The {what} below foretell {how} as well as the sensors can tell: {scale * p.rms:.2g} {unit}."
    missed = f"{scale * p.rms:.2g} {unit}, where the sensors alone leave {scale * outcome.noise_floor:.2g}"
    if outcome.posterior.agreement >= 0.25:
        return (
            f"Do not trust the {what} below: with the best of them {how} is missed by {missed}. Something is missing."
        )
    return f"Do not trust the {what} below: the search found no best ones, and misses {how} by {missed}."


def _commands(outcome: Outcome) -> list[tuple[str, str]]:
    """Return what to do next with this case, in the page's folder."""
    case, branch = shlex.quote(str(outcome.case.folder.resolve())), isinstance(outcome.case, BranchCase)
    doubted = outcome.ratio > TOLERANCE or not outcome.posterior.convergence.converged
    diagnose = (f"bough diagnose {case} --out diagnosis", "says what the model lacks, or that it lacks nothing")
    shown = [
        (f"bough view . --case {case}", "shows branches drawn from the posterior beside the measured one"),
        ("bough forest --posterior posterior.npz --out forest", "grows trees of such wood"),
    ]
    return [diagnose] if not branch else [diagnose, shown[0]] if doubted else [*shown, diagnose]


def _motion(outcome: Outcome) -> ReportMotion | None:
    """Return the held-out recording that is missed most as a motion; None where no position was foretold."""
    p = outcome.prediction
    k = int(np.argmax([float(np.mean(r[:, list(p.main)] ** 2)) for r in p.residual]))
    j, median = outcome.test[k], p.median[k]
    recording = recordings(outcome.case)[j]
    if recording.output.shape != median.shape:
        return None
    shown = case_motion(outcome.case, j, recording, {"foretold": (MODEL, median)})
    return shown and replace(shown, title="The motion, measured and foretold")


def _advice(outcome: Outcome) -> str:
    return f"Run bough diagnose {outcome.case.folder} to find it"


def caveat(outcome: Outcome) -> str:
    """Return what to know before the intervals are used: they hold if the model does, and span all modes.

    Empty where the model is right as far as the recordings tell and there is one mode.
    """
    done = outcome.posterior.convergence
    if not done.converged:
        return "The sampler did not converge: these intervals are not those of the posterior."
    modes = int(done.numbers.get("modes", 1))
    several = (
        f"The particles lie in {modes} modes far from each other: the recordings allow {modes} answers, and an interval"
        " spans them all." if modes > 1 else ""
    )  # fmt: skip
    return " ".join(text for text in (several, _misses(outcome)) if text)


def _misses(outcome: Outcome) -> str:
    """Return what a model that misses the motion does to the intervals; empty where it does not."""
    if outcome.ratio <= TOLERANCE:
        return ""
    return (
        f"These intervals hold only if the model is right, and it misses the motion by {outcome.ratio:.1f} times the"
        " noise: what it lacks is put into springs and dampers, and the true values may lie far outside (a damper came"
        f" to 2.14 to 2.54 where it was 0.47). {_advice(outcome)}, then identify again with --model."
    )


def content(outcome: Outcome) -> ReportContent:
    """Return what the report page shows."""
    precisely, status = headline(outcome)
    p, (scale, unit) = outcome.prediction, _shown(outcome)
    middle, low, high = outcome.posterior.interval()
    rows = zip(outcome.posterior.names, middle, low, high, outcome.posterior.units, strict=True)
    numbers = [
        KeyNumber("Held-out RMSE", scale * p.rms, unit, "Root mean square of measured minus predicted."),
        KeyNumber("Noise floor", scale * outcome.noise_floor, unit, "RMSE of a perfect model, from the data alone."),
        KeyNumber("RMSE / noise floor", outcome.ratio, "", f"Above {TOLERANCE} the model lacks an effect."),
        KeyNumber("Coverage of 95 % intervals", 100 * p.coverage, "%", "Share of held-out points inside; 95 is ideal."),
    ]
    exact = [
        KeyNumber(
            "Mean interval width", scale * p.width, unit, "Of the 95 % interval over held-out points, noise included."
        ),
        KeyNumber(
            "CRPS",
            scale * p.mean_crps,
            unit,
            "Continuous ranked probability score of held-out points; lower is better.",
        ),
        KeyNumber("Negative log density", p.mean_nll, "", "Mean over held-out points, in nats; lower is better."),
    ]
    return ReportContent(
        title=f"Identification of {outcome.case.name}",
        headline=plain(outcome),
        precisely=precisely,
        status=status,  # type: ignore[arg-type]
        numbers=[*numbers, *_acting(outcome.settings)],
        exact=exact,
        commands=_commands(outcome),
        motion=_motion(outcome),
        parameters=[ParameterRow(n, float(m), float(a), float(b), u) for n, m, a, b, u in rows],
        caveat=caveat(outcome),
        figures=_figures(outcome, scale, unit),
        details={
            "training trajectories": ", ".join(outcome.case.trajectories[j].file for j in outcome.train),
            "held-out trajectories": ", ".join(outcome.case.trajectories[j].file for j in outcome.test),
            **_method(outcome),
            "bough": __version__,
            **describe(),
            **{f"note {i + 1}": w for i, w in enumerate(_notes(outcome))},
        },
        further=[
            ("posterior.npz", "the particles, for your own code"),
            ("report.json", "every number on this page"),
        ],
    )


def _acting(s: Settings) -> list[KeyNumber]:
    """Return a line on the effects that act, none if there are none."""
    if not s.effects:
        return []
    told = [f"{a.label} ({', '.join(f'{k} {v:.4g}' for k, v in a.known.items()) or 'inferred'})" for a in s.effects]
    return [KeyNumber("Effects that act", str(len(told)), "", f"Beside springs and dampers: {', '.join(told)}.")]


def _notes(outcome: Outcome) -> list[str]:
    """Return the case's warnings, and what is not held out."""
    said = ["one recording: nothing is held out, scores are of the training data"] if _alone(outcome) else []
    return [*outcome.case.warnings, *said]


def _alone(outcome: Outcome) -> bool:
    """Return whether there is one recording only, which is training data and test."""
    return len(outcome.case.trajectories) == 1


def _method(outcome: Outcome) -> dict[str, str | int | float]:
    """Return how it was computed, line by line."""
    s, q = outcome.settings, outcome.posterior
    likelihood = (
        "Gaussian, noise inferred, noise of the force propagated through the model"
        if s.loss == "gaussian"
        else f"published loss (thesis eq. 3.5, 3.9), kT {s.temperature:g}"
    )
    return {
        "method": f"Levenberg-Marquardt from 16 starts, then {SAMPLERS.of(s.sampler).title} in whitened coordinates",
        "likelihood": likelihood,
        "prior": " and ".join(["smooth box", *s.priors]),
        "cross-validation": f"{s.cv} folds" if s.cv else "none",
        "particles or chains": s.particles,
        "iterations": s.iterations,
        "seed": s.seed,
        "starts at the best mode": f"{q.agreement:.0%}",
        "convergence": q.convergence.reason,
        "simulated world-steps": f"{outcome.world_steps:,}",
        "wall time [s]": ", ".join(f"{k} {v:.1f}" for k, v in outcome.seconds.items()),
    }


def _figures(outcome: Outcome, scale: float, unit: str) -> list[ReportFigure]:
    loops = [_loops(outcome, outcome.case)] if isinstance(outcome.case, BranchCase) else []
    return [*_held_out(outcome, scale, unit), *loops, *_sampled(outcome)]


def _held_out(outcome: Outcome, scale: float, unit: str) -> list[ReportFigure]:
    """Return the figures of the held-out trajectories: prediction, residual, and error against amplitude."""
    case, p, main = outcome.case, outcome.prediction, list(main_channels(outcome.case))
    shown = ["xyz"[c] if isinstance(case, BranchCase) else case.channels[c].joint for c in main]
    labels, titles = [f"{name} [{unit}]" for name in shown], _titles(outcome)
    scaled = {k: [scale * a[:, main] for a in getattr(p, k)] for k in ("measured", "median", "low", "high", "residual")}
    bands = [scaled[k] for k in ("measured", "median", "low", "high")]
    amplitude, misfit = p.by_amplitude()
    return [
        ReportFigure(
            "prediction.png", prediction_figure(p.t, *bands, titles=titles, labels=labels),
            "Held-out trajectories: measured points, predicted median and 95 % interval.",
        ),
        ReportFigure(
            "residual.png",
            residual_figure(p.t, scaled["residual"], scale * outcome.sigma[main], label=f"residual [{unit}]"),
            "Residual of held-out trajectories: noise alone stays in the green band and has no autocorrelation.",
        ),
        ReportFigure(
            "amplitude.png",
            amplitude_figure(scale * amplitude, scale * misfit, scale * outcome.noise_floor, label=unit),
            "RMSE against amplitude in time windows: an RMSE that grows with the amplitude is model error, not noise.",
        ),
    ]  # fmt: skip


def _titles(outcome: Outcome) -> list[str]:
    return [outcome.case.trajectories[j].file for j in outcome.test]


def _loops(outcome: Outcome, case: BranchCase) -> ReportFigure:
    p, force = outcome.prediction, [case.trajectories[j].force for j in outcome.test]
    measured, median = ([x[:, :3] for x in part] for part in (p.measured, p.median))
    return ReportFigure(
        "loops.png", loop_figure(force, measured, median, titles=_titles(outcome)),
        "Force against displacement: the slope is the stiffness, the enclosed area the energy lost.",
    )  # fmt: skip


def _sampled(outcome: Outcome) -> list[ReportFigure]:
    """Return the figures of the posterior: marginals and pairs, calibration, convergence."""
    q = outcome.posterior
    names = [f"{n} [{u}]" for n, u in zip(q.names, q.units, strict=True)]
    covered = np.array([outcome.prediction.coverage_at(x) for x in NOMINAL])
    return [
        ReportFigure(
            "posterior.png", posterior_figure(q.particles, names),
            "Posterior particles: marginals with median and 95 % interval, and correlations of pairs.",
        ),
        ReportFigure(
            "coverage.png", coverage_figure(np.array(NOMINAL), covered),
            "Calibration: coverage of held-out points against nominal probability; the diagonal is ideal.",
        ),
        ReportFigure(
            "convergence.png", convergence_figure(q.trace_log_posterior, q.trace_mean),
            "Convergence: log posterior of the particles and their mean; both should be flat at the end.",
        ),
    ]  # fmt: skip
