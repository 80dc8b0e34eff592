"""Figures 3.7 to 3.9: noise on force and motion, another grasp location, and stand-ins for the hardware.

These use bough's own likelihood, Gaussian with inferred noise, and spherical joints: what `bough identify` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....sim.base.types import Array
from ...cases.case import BranchCase
from ...inference.identify import Identification, run
from ...inference.predict import Prediction
from ...inference.settings import Settings
from ...replay.simulated_case import Experiment, random_branch, write_simulated_case
from ...samplers.diagnostics import Convergence
from ...systems.branch import Unknowns
from .bench import BOX, SAMPLES, TRAINING, draw_springs
from .prior import Advance

NOISES = (0.0, 0.01, 0.03, 0.05, 0.10)
GRASP_NOISE = 0.03
TRAINED_AT, TESTED_AT = 0.9, (0.9, 0.75, 0.5)
STAND_INS = (("Kinova, R = 1", 1, 100, 5.0), ("Franka, R = 1", 1, 120, 7.0), ("Kinova, R = 2", 2, 100, 23.9))
"""Name, segments, samples a trajectory, and the share of points outside that the thesis measured [%] (table 3.2)."""
STAND_IN_NOISE = 0.05
UPDATES = 24
"""Most updates of SVGD, as `bough identify` takes."""
_BOX = tuple(f"{kind}={BOX[0]:g}:{BOX[1]:g}" for kind in ("stiffness", "damping"))


@dataclass(frozen=True)
class Study:
    """What a posterior predicts of some trajectories, and what is true of them.

    Attributes:
        label: Which noise, place or branch.
        prediction: Of the held-out trajectories, sensor noise included.
        convergence: Of the posterior.
        error: Relative error of the posterior's median of every true stiffness, shape [R].
    """

    label: str
    prediction: Prediction
    convergence: Convergence
    error: Array

    @property
    def outside(self) -> float:
        """Share of measured points outside the 95 % interval."""
        return 1.0 - self.prediction.coverage


def _settings(segments: int, particles: int, iterations: int, seed: int, cv: int = 0) -> Settings:
    """NNSVGD; SVGD for one segment, which has no parent to be below."""
    method = "nnsvgd" if segments > 1 else "svgd"
    return Settings(particles=particles, iterations=min(UPDATES, iterations), seed=seed, method=method, box=_BOX, cv=cv)


def make_case(
    folder: Path, seed: int, segments: int, *, noise: float, samples: int = SAMPLES, grasps: Sequence[float],
    planar: bool = False,
) -> tuple[BranchCase, Array]:  # fmt: skip
    """Simulate a branch pushed along gravity; return its case and true stiffnesses [R].

    On spherical joints, or in a vertical plane on revolute ones.
    """
    rng = np.random.default_rng([seed, segments])
    meta = random_branch(rng, segments, planar=planar)
    springs = draw_springs(rng, segments)
    probe = Experiment(samples=samples, noise=noise, force_noise=noise, vertical=True, deflection=0.4, planar=planar)
    unknowns = Unknowns(joints="revolute" if planar else "spherical", box=_BOX)
    case = write_simulated_case(
        folder, meta, springs, probe, trajectories=len(grasps), seed=seed, grasps=grasps, unknowns=unknowns
    )
    return case, springs["stiffness"]


def _error(posterior_median: Array, stiffness: Array) -> Array:
    return np.asarray(np.abs(posterior_median[: len(stiffness)] / stiffness - 1.0))


def noise_study(
    folder: Path, noises: Sequence[float], unseen: int, *, particles: int, iterations: int, seed: int, advance: Advance
) -> list[Study]:
    """Infer one branch of two segments from records with growing noise on force and motion (figure 3.7)."""
    out = []
    for noise in noises:
        places = [TRAINED_AT] * (TRAINING + unseen)
        case, truth = make_case(folder / f"noise_{noise:g}", seed, 2, noise=noise, grasps=places)
        work = Identification(case, _settings(2, particles, iterations, seed))
        posterior = work.learn(list(range(TRAINING)), "posterior")
        prediction = work.predict(posterior, list(range(TRAINING, TRAINING + unseen)))
        error = _error(posterior.interval()[0], truth)
        out.append(Study(f"{100 * noise:g} %", prediction, posterior.convergence, error))
        advance()
    return out


def grasp_study(
    folder: Path, unseen: int, *, particles: int, iterations: int, seed: int, advance: Advance
) -> list[Study]:
    """Infer from pushes at one place of the last segment, predict pushes at others (figure 3.8)."""
    places = [TRAINED_AT] * TRAINING + [p for p in TESTED_AT for _ in range(unseen)]
    case, truth = make_case(folder / "grasp", seed, 2, noise=GRASP_NOISE, grasps=places)
    work = Identification(case, _settings(2, particles, iterations, seed))
    posterior = work.learn(list(range(TRAINING)), "posterior")
    out, error = [], _error(posterior.interval()[0], truth)
    for k, place in enumerate(TESTED_AT):
        first = TRAINING + k * unseen
        prediction = work.predict(posterior, list(range(first, first + unseen)))
        out.append(Study(f"{place:g} of the length", prediction, posterior.convergence, error))
        advance()
    return out


def stand_ins(folder: Path, *, particles: int, iterations: int, seed: int, advance: Advance) -> list[Study]:
    """Cross-validate simulated branches in place of the thesis's arms: 3 + 3 trajectories, two folds (figure 3.9)."""
    out = []
    for k, (name, segments, samples, _) in enumerate(STAND_INS):
        places = [TRAINED_AT] * 6
        case, truth = make_case(
            folder / f"stand_in_{k}", seed + k, segments, noise=STAND_IN_NOISE, samples=samples, grasps=places
        )
        outcome = run(case, _settings(segments, particles, iterations, seed, cv=2))
        error = _error(outcome.posterior.interval()[0], truth)
        out.append(Study(name, outcome.prediction, outcome.posterior.convergence, error))
        advance()
    return out
