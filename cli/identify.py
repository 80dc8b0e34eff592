"""``bough identify``: learn the springs of a measured branch, or the unknowns of measured joints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..learn.samplers.registry import SAMPLERS
from ..sim.base.console import bars, shown, start_warp, tell, warn
from .base.exit_codes import ExitCode


@dataclass(frozen=True)
class Identify:
    """Learn a case's springs and dampers with intervals; write posterior.npz, report.json, figures and report.html.

    Exit code 0: done; 2: bad input, nothing written; 3: written, but the sampler did not converge.

    Attributes:
        case: Case folder: meta.yaml and one CSV file per trajectory.
        out: Folder to write to.
        method: Sampler: Stein variational gradient descent, Metropolis-Hastings, stochastic gradient Langevin or
            Hamiltonian dynamics, the emcee package's ensemble as a reference, or one of an installed package; nnsvgd is
            svgd with the inequality prior.
        prior: What is known beforehand: inequality (child below parent), geometry (as in grown trees), lognormal, or
            the posterior.npz of an earlier case. Several multiply; the box always holds.
        particles: Particles of SVGD, chains of the other samplers.
        iterations: Updates of the sampler.
        joints: Joints of a branch.
        infer: What is inferred of a branch; the rest keeps its typical value.
        shared: Kinds of unknowns that have one number for all joints.
        model: model.yaml of this branch, such as bough diagnose writes: its effects act with the parameters given there
            while springs and dampers are inferred.
        box: Bounds, NAME=LOW:HIGH in SI units, NAME a parameter or a kind: stiffness=5:200.
        cv: Cross-validate over the trajectories with this many folds; 0 holds a quarter out once.
        loss: Gaussian likelihood with inferred noise, or the thesis's norms of errors over a temperature.
        temperature: kT of the published loss.
        seed: Seed of everything random.
        resume: Go on with a killed run of the same case, settings and --out.
        json: Print report.json as JSON instead of a sentence.
    """

    case: tyro.conf.Positional[Path]
    out: Path
    method: Annotated[str, tyro.conf.arg(help_behavior_hint=SAMPLERS.hint)] = "svgd"
    prior: tuple[str, ...] = ()
    particles: int = 64
    iterations: int | None = None
    joints: Literal["spherical", "revolute"] = "spherical"
    infer: tuple[Literal["stiffness", "damping", "density", "rest_angle"], ...] = ("stiffness", "damping")
    shared: tuple[Literal["stiffness", "damping", "density", "rest_angle"], ...] = ()
    model: Path | None = None
    box: tuple[str, ...] = ()
    cv: int = 0
    loss: Literal["gaussian", "published"] = "gaussian"
    temperature: float = 0.01
    seed: int = 0
    resume: bool = False
    json: bool = False

    def run(self) -> int:
        """Identify the case, say what came out and where the report is; return the exit code."""
        from ..learn.cases.case import load_case
        from ..learn.inference.settings import Settings, default_iterations

        count = default_iterations(self.method) if self.iterations is None else self.iterations
        settings = Settings(
            particles=self.particles, iterations=count, seed=self.seed, method=self.method, prior=self.prior,
            joints=self.joints, infer=self.infer, shared=self.shared, box=self.box, cv=self.cv, loss=self.loss,
            temperature=self.temperature,
        )  # fmt: skip
        settings.check()
        case = load_case(self.case)
        start_warp()
        from ..learn.inference.identify import identify  # torch and Warp, after what is quick to refuse

        stages = {"finding modes": None, "sampling": count * settings.trainings, "predicting": max(1, self.cv)}
        says = dict(zip(("modes", "particles", "prediction"), stages, strict=True))
        with bars(stages) as advance:
            outcome = identify(
                case, self.out, settings, model=self.model, resume=self.resume,
                progress=lambda stage, done: advance(says[stage], done),
            )  # fmt: skip
        from ..learn.inference.report import headline

        for line in case.warnings:
            warn(line)
        tell(f"{headline(outcome)[0]} Open {shown(self.out)}/report.html", self.out / "report.json", self.json)
        return ExitCode.DONE if outcome.posterior.convergence.converged else ExitCode.NOT_TRUSTED
