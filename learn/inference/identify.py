"""Identification of a recorded case: posterior of its parameters, held-out prediction, report."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from ...sim.base.errors import InputError
from ...sim.base.files import output_folder, read_bytes
from ...sim.base.host import check_memory
from ...sim.base.types import Array
from ...version import __version__
from ..cases.case import BranchCase, JointCase, load_case
from ..cases.noise import NoiseEstimate
from ..priors.choose import make_prior
from ..priors.earlier import EARLIER
from ..replay.equation_error import noise_of, recordings_of, thinned
from ..replay.recording import Recording
from ..runs.checkpoint import Checkpoint, digest
from ..runs.threads import one_thread
from ..systems.choose import system_of
from ..systems.model_file import blown_by, model_of
from .outcome import Outcome
from .posterior import Posterior, infer
from .predict import Prediction, pooled, predict
from .settings import Settings
from .target import Target

Progress = Callable[[str, int], None]
#: Least noise of a branch's sensors relative to their rms; with exact data rounding errors would count as misfit.
FINEST = 1e-4
#: How much wider than all others a recording of joints moves that is never held out, and how much wider one of a branch
#: moves or how much harder it is pulled.
WIDER, WIDER_BRANCH = 1.1, 2.0


def split(case: BranchCase | JointCase) -> tuple[list[int], list[int]]:
    """Return indices of the trajectories to learn from and to hold out.

    The split that the case states, if any. Otherwise about a quarter is held out: the last trajectories without
    replicates, so that no replicate of a held-out one is in the training set; where there is none, those of the last
    experiment that is repeated. A recording that moves wider than all others, one of a branch twice as wide or pulled
    twice as hard, is not held out: a law that shows there alone cannot be learnt from the others. A single recording
    of torques is used for both, because its samples are thousands of experiments.

    Raises:
        InputError: There are fewer than two trajectories.
    """
    count = len(case.trajectories)
    if isinstance(case, JointCase) and case.train is not None and case.test is not None:
        return list(case.train), list(case.test)
    if count == 1 and isinstance(case, JointCase) and case.fit == "torque":
        return [0], [0]
    if count < 2:
        raise InputError(case.folder / "meta.yaml", "trajectories", f"{count}", "two or more: one is held out")
    experiments, widest, many = _experiments(case), _widest(case), max(1, count // 4)
    pool = [g[0] for g in experiments if len(g) == 1] or list(range(count))
    if pool == [widest] and len(experiments) > 1:
        held = [g for g in experiments if widest not in g][-1]
    else:
        held = [i for i in pool if i != widest or len(pool) <= many][-many:]
    return [i for i in range(count) if i not in held], held


def _experiments(case: BranchCase | JointCase) -> list[list[int]]:
    """Return the trajectories of every experiment, its replicates with it, in the order of their first ones."""
    groups: dict[int, list[int]] = {}
    for i, t in enumerate(case.trajectories):
        groups.setdefault(i if t.replicate_of is None else t.replicate_of, []).append(i)
    return list(groups.values())


def _widest(case: BranchCase | JointCase) -> int | None:
    """Return the trajectory that moves wider than every other one by `WIDER`, or is pulled harder; None if none."""
    if isinstance(case, BranchCase):
        spans = ([np.ptp(t.displacement, axis=0).max() for t in case.trajectories],
                 [np.ptp(t.force, axis=0).max() for t in case.trajectories])  # fmt: skip
        return next((i for span in spans if (i := _largest(np.array(span), WIDER_BRANCH)) is not None), None)
    span = np.array([np.ptp(t.output, axis=0) for t in case.trajectories])
    return _largest((span / np.maximum(span.max(axis=0), 1e-300)).mean(axis=1), WIDER)


def _largest(size: Array, factor: float) -> int | None:
    """Return the entry that is larger than every other one by a factor, None if there is none."""
    largest = int(size.argmax())
    return largest if size[largest] > factor * np.delete(size, largest).max() else None


def folds(case: BranchCase | JointCase, count: int) -> list[list[int]]:
    """Return the held-out trajectories of every fold; replicates of one experiment stay together.

    Raises:
        InputError: There are fewer experiments than folds.
    """
    groups = _experiments(case)
    if len(groups) < count:
        found = f"{len(groups)} different ones"
        raise InputError(
            case.folder / "meta.yaml", "trajectories", found, f"at least as many as the {count} folds of --cv"
        )
    return [sorted(i for g in groups[k::count] for i in g) for k in range(count)]


def pooled_sigma(case: BranchCase | JointCase, noise: NoiseEstimate) -> Array:
    """Return the noise of the channels that are predicted, at least `FINEST` of their rms.

    The axes of a branch share one value per kind; across the plane of a planar case it is zero.
    """
    if isinstance(case, BranchCase):
        moved = [np.concatenate([getattr(t, k) for t in case.trajectories]) for k in ("displacement", "velocity")]
        sigma = (noise.displacement, noise.velocity)
        return np.concatenate([_pool(case, s, m) for s, m in zip(sigma, moved, strict=True)])
    return noise.sigma


def force_noise(case: BranchCase | JointCase, noise: NoiseEstimate) -> Array | None:
    """Return the noise of a branch's force [N], shape [3], one value for all axes; None for joints."""
    if not isinstance(case, BranchCase):
        return None
    return _pool(case, noise.force, np.concatenate([t.force for t in case.trajectories]))


def _pool(case: BranchCase, sigma: Array, measured: Array) -> Array:
    axes = np.array([1.0, 0.0 if case.planar else 1.0, 1.0])

    def rms(squares: Array) -> float:
        """Return the root of the mean of squares [3] over the axes that count."""
        return float(np.sqrt(np.sum(axes * squares) / axes.sum()))

    return np.asarray(axes * max(rms(sigma**2), FINEST * rms(np.mean(measured**2, axis=0))))


class Identification:
    """A loaded case with its settings, from which posteriors and predictions are made.

    Args:
        case: The case.
        settings: How to identify.
        checkpoint: Where to keep what has been reached.
        progress: Called with a stage (``modes``, ``particles``, ``prediction``) and the number of steps done.

    Raises:
        InputError: The settings do not fit the case, or a trajectory cannot be used.
    """

    def __init__(
        self, case: BranchCase | JointCase, settings: Settings, checkpoint: Checkpoint | None = None,
        progress: Progress = lambda stage, done: None,
    ) -> None:  # fmt: skip
        settings.check()
        self.case, self.settings, self.keep, self.progress = case, settings, checkpoint or Checkpoint(), progress
        self.noise = noise_of(case)
        self.sigma, self.force_sigma = pooled_sigma(case, self.noise), force_noise(case, self.noise)
        self.prior = make_prior(settings.priors, system_of(case, settings.unknowns))
        self.recordings: list[Recording] = recordings_of(case)
        self.world_steps, self.simulating = 0, 0.0
        self.keep.count = lambda: self.world_steps
        for j in range(len(self.recordings)):
            _check_moves(case, j, self.recordings[j])

    def learn(self, train: list[int], name: str) -> Posterior:
        """Infer the posterior of some trajectories."""
        s = self.settings
        chosen = [thinned(self.case, self.recordings[j]) for j in train]
        target = Target(
            self.case, chosen, torch.as_tensor(self.sigma), unknowns=s.unknowns, prior=self.prior, loss=s.loss,
            temperature=s.temperature,
        )  # fmt: skip
        before = self.world_steps
        self.keep.count = lambda: before + target.world_steps
        posterior = infer(
            target, method=s.sampler, particles=s.particles, iterations=s.iterations, seed=s.seed,
            force_sigma=self.force_sigma, checkpoint=self.keep, name=name, progress=self.progress,
        )  # fmt: skip
        _check_box(self.case, posterior)
        self.world_steps += target.world_steps
        self.simulating += target.simulation_seconds
        return posterior

    def predict(self, posterior: Posterior, test: list[int]) -> Prediction:
        """Predict some trajectories."""
        out = predict(
            self.case, posterior, [self.recordings[j] for j in test], torch.as_tensor(self.sigma),
            unknowns=self.settings.unknowns, force_sigma=self.force_sigma,
        )  # fmt: skip
        self.progress("prediction", 1)
        return out


def run(
    case: BranchCase | JointCase, settings: Settings, checkpoint: Checkpoint | None = None,
    progress: Progress = lambda stage, done: None,
) -> Outcome:  # fmt: skip
    """Identify a loaded case and predict its held-out trajectories.

    With folds, every trajectory is predicted from a posterior that has not seen it, and the posterior that is returned
    has seen all of them.

    Raises:
        InputError: The settings do not fit the case.
    """
    _check_memory(case, settings)
    clock = time.perf_counter()
    work = Identification(case, settings, checkpoint, progress)
    every, parts, predicting = list(range(len(case.trajectories))), [], 0.0
    held = folds(case, settings.cv) if settings.cv else []
    for k, test in enumerate(held):
        posterior = work.learn([j for j in every if j not in test], f"fold_{k}")
        began = time.perf_counter()
        parts.append(work.predict(posterior, test))
        predicting += time.perf_counter() - began
    train, test = (every, [j for fold in held for j in fold]) if held else split(case)
    posterior = work.learn(train, "posterior")
    began = time.perf_counter()
    prediction = pooled(parts) if held else work.predict(posterior, test)
    predicting += time.perf_counter() - began
    total = time.perf_counter() - clock
    seconds = {
        "total": total, "simulating": work.simulating, "predicting": predicting,
        "inference beside simulation": total - work.simulating - predicting,
    }  # fmt: skip
    return Outcome(
        case,
        settings,
        work.noise,
        work.sigma,
        train,
        test,
        posterior,
        prediction,
        work.keep.earlier + work.world_steps,
        seconds,
    )


def _check_memory(case: BranchCase | JointCase, settings: Settings) -> None:
    """Raise `InputError` where the channels of all particles, float32, do not fit into memory."""
    channels = 6 if isinstance(case, BranchCase) else 3 * len(case.joints)
    samples = sum(len(t.t) for t in case.trajectories)
    what = f"{settings.particles} particles on {samples} samples"
    check_memory("--particles", what, 4.0 * channels * samples * settings.particles)


def _check_moves(case: BranchCase | JointCase, j: int, recording: Recording) -> None:
    place = case.folder / case.trajectories[j].file
    if np.ptp(recording.output, axis=0).max() == 0.0:
        raise InputError(place, "", "no motion in any row", "a trajectory that moves")
    if isinstance(case, BranchCase) and not recording.input.any():
        raise InputError(
            place, "", "no force in any row", "a trajectory with force on the branch, which starts at rest"
        )


def _check_box(case: BranchCase | JointCase, posterior: Posterior) -> None:
    """Raise `InputError` if all particles lie beyond one end of the prior's box: data and prior contradict."""
    for p, x in zip(posterior.parameters, posterior.free.T, strict=True):
        beyond = {p.low: bool((x < p.free(p.low)).all()), p.high: bool((x > p.free(p.high)).all())}
        for end, all_beyond in beyond.items():
            if all_beyond:
                found = f"all particles beyond the end of its box, {end:.4g} {p.unit}"
                allowed = f"data that agree with the box, or a wider one (--box {p.name.split(' ')[0]}=LOW:HIGH)"
                raise InputError(case.folder, p.name, found, allowed)


def identify(
    given: BranchCase | JointCase | str | Path, out: str | Path, settings: Settings | None = None, *,
    model: str | Path | None = None, resume: bool = False, progress: Progress = lambda s, d: None,
) -> Outcome:  # fmt: skip
    """Identify a case, as loaded or by its folder, and write posterior, report and figures into ``out``.

    What has been reached is kept in a hidden folder beside ``out`` until the run ends, so that ``resume`` goes on with
    a killed one to the same bits (on one machine's CPU).

    Args:
        given: The case, or its folder.
        out: Folder to write; whole or not at all.
        settings: None takes those of ``bough identify`` without options.
        model: A ``model.yaml`` of the same branch, whose effects act with the parameters that it gives; its springs and
            dampers are not used.
        resume: Go on with a killed run of the same case, settings and ``out``.
        progress: Called with the stage and how many of its steps are done.

    Returns:
        Posterior, its convergence, and predictions of the held-out recordings.

    Raises:
        InputError: The case, the settings or the model cannot be used; nothing is written then.
    """
    target, settings = Path(out), settings or Settings()
    with output_folder(target) as work:
        case = given if isinstance(given, BranchCase | JointCase) else load_case(given)
        settings.check()
        if model is not None:
            known = model_of(model, case)
            case, settings = blown_by(known, case), replace(settings, effects=known.effects)
        keep = Checkpoint(target.absolute().parent / f".{target.name}.unfinished", _key(case, settings, model))
        keep.open(resume)
        try:
            with one_thread():
                outcome = run(case, settings, keep, progress)
        except InputError:
            keep.close()
            raise
        from ..reports.page import write_report  # matplotlib, once there is something to show
        from .report import content, summary

        outcome.posterior.save(work / "posterior.npz")
        (work / "report.json").write_text(json.dumps(summary(outcome), indent=2) + "\n")
        write_report(work, content(outcome))
    keep.close()
    return outcome


def _key(case: BranchCase | JointCase, settings: Settings, model: str | Path | None) -> str:
    earlier = [read_bytes(p, allowed=EARLIER) for p in settings.prior if p.endswith(".npz")]
    given = None if model is None else read_bytes(model)
    return digest(case.folder, settings, earlier, given, __version__)
