"""Learning the springs of a recorded case, predicting what was held out, and saying so in a report."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .. import __version__
from ..sim.errors import InputError
from ..sim.files import output_folder
from ..sim.host import describe
from ..sim.tree import Array
from .case import BranchCase, JointCase, load_case
from .figures import convergence_figure, loop_figure, posterior_figure, prediction_figure, residual_figure
from .noise import NoiseEstimate, estimate_noise
from .posterior import Posterior, infer
from .predict import Prediction, main_channels, predict
from .report import KeyNumber, ParameterRow, ReportContent, ReportFigure, write_report
from .rollout import Recording, recordings
from .target import Target

Progress = Callable[[str, int], None]

#: A misfit above this many times the noise is more than noise.
TOLERANCE = 1.3


@dataclass(frozen=True)
class Settings:
    """How to identify.

    Attributes:
        particles: Particles of SVGD.
        iterations: Updates of SVGD.
        seed: Of every random number used.
    """

    particles: int = 64
    iterations: int = 60
    seed: int = 0

    def check(self) -> None:
        """Raise `InputError` for numbers that cannot be."""
        for name, low in (("particles", 8), ("iterations", 10)):
            if getattr(self, name) < low:
                raise InputError("identify", f"--{name}", str(getattr(self, name)), f"{low} or more")


@dataclass
class Outcome:
    """Everything a report is made of.

    Attributes:
        train, test: Indices of the trajectories learnt from and held out.
        seconds: Wall time of each stage.
    """

    case: BranchCase | JointCase
    settings: Settings
    noise: NoiseEstimate
    sigma: Array
    train: list[int]
    test: list[int]
    posterior: Posterior
    prediction: Prediction
    world_steps: int
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def noise_floor(self) -> float:
        """Misfit that a perfect model would leave, in the main channels' unit."""
        return float(np.sqrt(np.mean(self.sigma[list(self.prediction.main)] ** 2)))

    @property
    def ratio(self) -> float:
        """Held-out misfit over the noise."""
        return self.prediction.rms / self.noise_floor


def split(case: BranchCase | JointCase) -> tuple[list[int], list[int]]:
    """Return indices of the trajectories to learn from and to hold out.

    As the case says, where it does. Else about a quarter is held out: the last trajectories that no other repeats and
    that repeat no other, so that what is held out was seen in no form.

    Raises:
        InputError: There are fewer than two trajectories.
    """
    count = len(case.trajectories)
    if isinstance(case, JointCase) and case.train is not None and case.test is not None:
        return list(case.train), list(case.test)
    if count < 2:
        raise InputError(case.folder / "meta.yaml", "trajectories", f"{count}", "two or more: one is held out")
    original = {t.replicate_of for t in case.trajectories}
    single = [i for i, t in enumerate(case.trajectories) if t.replicate_of is None and i not in original]
    held = (single or list(range(count)))[-max(1, count // 4) :]
    return [i for i in range(count) if i not in held], held


def pooled_sigma(case: BranchCase | JointCase, noise: NoiseEstimate) -> Array:
    """Return the noise of the channels that are predicted.

    The axes of a branch share one value a kind; across the plane of a planar case it is zero.
    """
    if isinstance(case, BranchCase):
        axes = np.array([1.0, 0.0 if case.planar else 1.0, 1.0])
        pooled = [np.sqrt(np.sum(axes * v**2) / axes.sum()) for v in (noise.displacement, noise.velocity)]
        return np.concatenate([axes * s for s in pooled])
    return noise.sigma


def run(case: BranchCase | JointCase, settings: Settings, progress: Progress = lambda stage, done: None) -> Outcome:
    """Identify a loaded case and predict its held-out trajectories."""
    settings.check()
    clock = time.perf_counter()
    noise = estimate_noise(case)
    sigma = pooled_sigma(case, noise)
    train, test = split(case)
    every: list[Recording] = recordings(case)
    for j in train:
        _check_moves(case, j, every[j])
    target = Target(case, [every[j] for j in train], torch.as_tensor(sigma))
    posterior = infer(
        target, particles=settings.particles, iterations=settings.iterations, seed=settings.seed, progress=progress
    )
    learnt = time.perf_counter()
    prediction = predict(case, posterior, [every[j] for j in test], torch.as_tensor(sigma), seed=settings.seed)
    progress("prediction", 1)
    seconds = {"inference": learnt - clock, "prediction": time.perf_counter() - learnt}
    return Outcome(case, settings, noise, sigma, train, test, posterior, prediction, target.world_steps, seconds)


def _check_moves(case: BranchCase | JointCase, j: int, recording: Recording) -> None:
    still = np.ptp(recording.output, axis=0).max() == 0.0
    if still:
        raise InputError(case.folder / case.trajectories[j].file, "", "no motion in any row", "a trajectory that moves")


def identify(
    folder: str | Path, out: str | Path, settings: Settings, progress: Progress = lambda s, d: None
) -> Outcome:
    """Identify the case in ``folder`` and write posterior, report and figures into ``out``.

    Raises:
        InputError: The case or the settings cannot be used; nothing is written then.
    """
    with output_folder(out) as work:
        outcome = run(load_case(folder), settings, progress)
        outcome.posterior.save(work / "posterior.npz")
        (work / "report.json").write_text(json.dumps(summary(outcome), indent=2) + "\n")
        write_report(work, content(outcome))
    return outcome


# ---- what is said --------------------------------------------------------------------------------------------------


def unit_of(case: BranchCase | JointCase) -> str:
    """Return the unit of the main channels: ``m`` or ``rad`` and their rates."""
    if isinstance(case, BranchCase):
        return "m"
    output = case.outputs[0]
    joint = next(j for j in case.joints if j.name == output.joint)
    base = "rad" if joint.type == "revolute" else "m"
    return {"position": base, "velocity": f"{base}_per_s", "acceleration": f"{base}_per_s2"}[output.quantity]


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
        "starts_that_agree": outcome.posterior.agreement,
        "particle_drift": outcome.posterior.drift,
        "world_steps": outcome.world_steps,
        "seconds": outcome.seconds,
        "settings": asdict(outcome.settings),
        "version": __version__,
        "machine": describe(),
    }
    if unit == "rad":
        out |= {f"{name}_deg": math.degrees(value) for name, value in scores.items()}
    return out


def _shown(outcome: Outcome) -> tuple[float, str]:
    """Scale and unit that people read: centimetres for a branch, degrees for angles."""
    if isinstance(outcome.case, BranchCase):
        return 100.0, "cm"
    unit = unit_of(outcome.case)
    return (math.degrees(1.0), "deg") if unit == "rad" else (1.0, unit.replace("_per_", "/"))


def headline(outcome: Outcome) -> tuple[str, str]:
    """Return the verdict in a sentence, and good, warning or bad."""
    p, (scale, unit) = outcome.prediction, _shown(outcome)
    rms, floor = f"{scale * p.rms:.3g} {unit}", f"{scale * outcome.noise_floor:.3g} {unit}"
    if outcome.ratio <= TOLERANCE:
        return f"The model explains the held-out motion to within the noise: misfit {rms}, noise {floor}.", "good"
    agree = outcome.posterior.agreement >= 0.25
    why = (
        f"this is no failure of the fit ({outcome.posterior.agreement:.0%} of the independent starts ended at the same "
        "optimum): the model lacks something that the measurement contains"
        if agree
        else "and few starts agree on an optimum, so the fit itself may be at fault"
    )
    return (
        f"The held-out misfit is {outcome.ratio:.1f} times the noise ({rms} against {floor}); {why}.",
        "warning" if agree else "bad",
    )


def content(outcome: Outcome) -> ReportContent:
    """Return what the report page shows."""
    text, status = headline(outcome)
    p, (scale, unit) = outcome.prediction, _shown(outcome)
    middle, low, high = outcome.posterior.interval()
    rows = zip(outcome.posterior.names, middle, low, high, outcome.posterior.units, strict=True)
    numbers = [
        KeyNumber("Held-out misfit", scale * p.rms, unit, "Root mean square of measured minus predicted."),
        KeyNumber("Noise", scale * outcome.noise_floor, unit, "What a perfect model would leave, from the data alone."),
        KeyNumber("Misfit / noise", outcome.ratio, "", f"Above {TOLERANCE} the model lacks something."),
        KeyNumber("95 % interval covers", 100 * p.coverage, "%", "Share of held-out points inside; 95 is ideal."),
        KeyNumber("Width of the interval", scale * p.width, unit, "Mean over held-out points, noise included."),
    ]
    s = outcome.settings
    return ReportContent(
        title=f"Identification of {outcome.case.name}",
        headline=text,
        status=status,  # type: ignore[arg-type]
        numbers=numbers,
        parameters=[ParameterRow(n, float(m), float(a), float(b), u) for n, m, a, b, u in rows],
        figures=_figures(outcome, scale, unit),
        details={
            "trajectories learnt from": ", ".join(outcome.case.trajectories[j].file for j in outcome.train),
            "trajectories held out": ", ".join(outcome.case.trajectories[j].file for j in outcome.test),
            "method": "Levenberg-Marquardt from 16 starts, then SVGD in whitened coordinates; Gaussian likelihood with "
            "inferred noise; smooth box prior on logarithms",
            "particles": s.particles,
            "iterations": s.iterations,
            "seed": s.seed,
            "starts that agree": f"{outcome.posterior.agreement:.0%}",
            "drift of the particles": f"{outcome.posterior.drift:.3f} posterior deviations over the last tenth",
            "world-steps": f"{outcome.world_steps:,}",
            "seconds": ", ".join(f"{k} {v:.1f}" for k, v in outcome.seconds.items()),
            "bough": __version__,
            **describe(),
            **{f"note {i + 1}": w for i, w in enumerate(outcome.case.warnings)},
        },
        further=[
            ("posterior.npz", "the particles, for your own code"),
            ("report.json", "every number on this page"),
        ],
    )


def _figures(outcome: Outcome, scale: float, unit: str) -> list[ReportFigure]:
    case, p = outcome.case, outcome.prediction
    main = list(main_channels(case))
    shown = ["xyz"[c] if isinstance(case, BranchCase) else case.outputs[c].joint for c in main]
    labels = [f"{name} [{unit}]" for name in shown]
    titles = [f"{case.trajectories[j].file}" for j in outcome.test]
    scaled = {k: [scale * a[:, main] for a in getattr(p, k)] for k in ("measured", "median", "low", "high", "residual")}
    names = [f"{n} [{u}]" for n, u in zip(outcome.posterior.names, outcome.posterior.units, strict=True)]
    out = [
        ReportFigure(
            "prediction.png",
            prediction_figure(p.t, scaled["measured"], scaled["median"], scaled["low"], scaled["high"],
                              titles=titles, labels=labels),
            "Held-out trajectories: measured points, the model's prediction and its 95 % band.",
        ),
        ReportFigure(
            "residual.png",
            residual_figure(p.t, scaled["residual"], scale * outcome.sigma[main], label=f"residual [{unit}]"),
            "What the model leaves over, against the noise: mere noise fills the green band and has no memory.",
        ),
    ]  # fmt: skip
    if isinstance(case, BranchCase):
        force = [case.trajectories[j].force for j in outcome.test]
        out.append(
            ReportFigure(
                "loops.png",
                loop_figure(force, [m[:, :3] for m in p.measured], [m[:, :3] for m in p.median], titles=titles),
                "Force against displacement: the slope is stiffness, the area inside a loop is energy lost.",
            )
        )
    out.append(
        ReportFigure(
            "posterior.png", posterior_figure(outcome.posterior.particles, names),
            "Particles of the posterior: what the data say about every parameter, and which they confuse.",
        )
    )  # fmt: skip
    out.append(
        ReportFigure(
            "convergence.png",
            convergence_figure(outcome.posterior.trace_log_posterior, scale * outcome.posterior.trace_misfit,
                               scale * outcome.noise_floor, misfit_label=f"rms misfit [{unit}]"),
            "How the particles settled.",
        )
    )  # fmt: skip
    return out
