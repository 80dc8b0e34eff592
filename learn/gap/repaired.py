"""The repaired model: one set of numbers for verdict, tables, figures, ``model.yaml`` and ``posterior.npz``.

Base and repaired model are fitted to the training recordings, with rigid segments. Where there is a posterior, the
repaired model is that of its medians. What is claimed of a model is what `replay_model` simulates of it, which is what
``bough simulate --model`` does with the written file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...sim.base.types import Array
from ...sim.effects import effect_of
from ...sim.effects.registry import Form
from ..cases.case import BranchCase, JointCase
from ..inference.posterior import Posterior
from ..inference.replayed import Replayed, held_out, replay_model
from ..inference.report import unit_of
from ..systems.acting import Acting
from ..systems.joint_file import JointModel
from ..systems.model_file import BranchModel
from ..systems.model_file import Model as ModelFile
from .decide import Decision
from .diagnosis import Gap
from .models.contest import Batch, Contest
from .models.fitted import Model, penalty
from .models.left_out import profiles
from .models.refit import Fits, fit
from .posterior import Intervals, infer, intervals
from .prepare import Base
from .run import Run

#: Steps of a refit to the training recordings.
TRAIN = 10


@dataclass(frozen=True)
class Repaired:
    """What a diagnosis writes and claims.

    Attributes:
        model: The repaired model as it is written.
        gap: Held-out RMSE before and after.
        base_values, values: Parameters of base and repaired model in SI units, by name.
        base_output, output: Channels that they simulate, shape [R, T, C].
        posterior: Of the repaired model, or None.
        parameters: Intervals of the named effects' parameters.
        implausible: Parameters of named effects with a value that nature does not have, by label and name.
    """

    model: ModelFile
    gap: Gap
    base_values: dict[str, float]
    values: dict[str, float]
    base_output: Array
    output: Array
    posterior: Posterior | None
    parameters: Intervals
    implausible: tuple[str, ...]

    @property
    def base_stiffness(self) -> Array | None:
        """Springs of a branch's joints in the base model [N m/rad], base first; None for joints."""
        found = [v for name, v in self.base_values.items() if name.startswith("stiffness ")]
        return np.array(found) if isinstance(self.model, BranchModel) else None


def repair(base: Base, decision: Decision, run: Run) -> Repaired:
    """Fit base and repaired model to the training recordings, infer what is uncertain, and measure what they leave."""
    contest = base.contest
    train, fits = shown(contest, decision)
    own = fits.batch[slice(1, 2)]
    posterior = infer(contest, decision, own, train, run)
    parameters = intervals(contest, decision, own, train, posterior)
    rows = contest.values(fits.batch).tolist()
    before, after = _values(contest, decision.base, rows[0]), _values(contest, decision.final, rows[1])
    if posterior is not None:
        after |= dict(zip(posterior.names, posterior.interval()[0].tolist(), strict=True))
    claimed = decision.verdict != "unknown" or not decision.final.members
    held = _held(contest.case, train)
    models = [model_from(contest, decision.base, before, held=held),
              model_from(contest, decision.final, after, held=held, claimed=claimed)]  # fmt: skip
    seen = [replay_model(contest.case, m, off_in(contest, m)) for m in models]
    sigma = base.noise.sigma
    weighted = [s.rms_over(np.where(sigma > 0.0, sigma, 1.0)) for s in seen]
    gap = Gap(seen[0].rms, seen[1].rms, noise_floor(base, seen[0]), unit_of(contest.case), seen[0].test,
              weighted[1] / max(weighted[0], 1e-300))  # fmt: skip
    return Repaired(models[1], gap, before, after, seen[0].output, seen[1].output, posterior, parameters,
                    implausible(contest, decision, parameters))  # fmt: skip


def shown(contest: Contest, decision: Decision) -> tuple[list[int], Fits]:
    """Return the recordings to fit to, in which named effects of a branch show, and both models fitted to them.

    Where effects show only in the recordings that the case holds out, nothing can be learnt of them from the others.
    Then another experiment is held out, the last one without which they show: springs that were fitted beside what is
    missing predict it badly.
    """
    train, test = held_out(contest.case)
    fits = refitted(contest, decision, train)
    if decision.verdict != "effects" or not isinstance(contest.case, BranchCase) or _show(contest, decision, fits):
        return train, fits
    for group in reversed([g for g in profiles(contest) if not set(g) & set(test)]):
        rest = [j for j in range(len(contest.recordings)) if j not in group]
        other = refitted(contest, decision, rest)
        if _show(contest, decision, other):
            return rest, other
    return train, fits


def _show(contest: Contest, decision: Decision, fits: Fits) -> bool:
    """Return whether a base and a repaired model [2] differ by more than chance where they were fitted."""
    gained = float(fits.cost[0] - fits.cost[1])
    return gained > contest.overdispersion * penalty(contest, decision.final.members)


def _held(case: BranchCase | JointCase, train: Sequence[int]) -> tuple[str, ...] | None:
    """Return the files of the recordings that are held out; None where they are those that the case holds out."""
    if list(train) == list(held_out(case)[0]):
        return None
    return tuple(t.file for j, t in enumerate(case.trajectories) if j not in train)


def noise_floor(base: Base, seen: Replayed) -> float:
    """Return the rms that a perfect model would leave in the recordings held out, in the unit of the main channels.

    That is noise of the sensor, and of a branch also what noise of the recorded force does to the simulated motion.
    """
    contest, main = base.contest, list(seen.main)
    count, longest, channels = contest.measured.shape
    variance = np.ones((count, longest, channels))
    if contest.colour is not None:
        variance += contest.colour.variance((longest, channels)).cpu().numpy()
    variance *= base.noise.sigma**2
    parts = [variance[j, : len(seen.recordings[j].t), main].ravel() for j in seen.test]
    return float(np.sqrt(np.concatenate(parts).mean()))


def refitted(contest: Contest, decision: Decision, train: Sequence[int]) -> Fits:
    """Refit base and repaired model to the training recordings, a batch of two.

    Segments are rigid here, as in the model file and in every simulation of it. Springs and dampers fitted beside
    bending wood would have a larger RMSE in such a simulation, the base model more than the repaired one.
    """
    batch = Batch.joined([decision.base.fit.batch, decision.final.fit.batch])
    batch.weight[:] = 0.0
    batch.weight[:, list(train)] = 1.0
    return fit(contest.rigid(), batch, TRAIN)


def _values(contest: Contest, model: Model, row: list[float]) -> dict[str, float]:
    """Return the values of a model's own parameters by name, of a row of all."""
    columns = [*range(contest.num_base), *(k for c in model.members for k in contest.candidates[c].columns)]
    return {contest.parameters[k].name: row[k] for k in columns}


def model_from(
    contest: Contest, model: Model, values: Mapping[str, float], *, held: tuple[str, ...] | None = None,
    claimed: bool = True,
) -> ModelFile:  # fmt: skip
    """Return a model of the search as it is written, with the given parameters and recordings that are held out."""
    case, own = contest.case, contest.parameters[: contest.num_base]
    acting = []
    for c in model.members:
        candidate = contest.candidates[c]
        known = {s.name: values[f"{candidate.acting.label} {s.name}"] for s in candidate.specs}
        acting.append(replace(candidate.acting, known={**candidate.acting.known, **known}))
    if isinstance(case, BranchCase):
        names = case.segment_name
        spring, damper = (np.array([values[f"{k} {n}"] for n in names]) for k in ("stiffness", "damping"))
        size = np.column_stack([case.length, case.radius])
        courses = {t.file: r.course for t, r in zip(case.trajectories, contest.recordings, strict=True)
                   if r.course is not None and model.members}  # fmt: skip
        return BranchModel(case.name, names, spring, damper, tuple(acting), size, claimed, held, courses)
    return JointModel(
        case.name, case.fit, tuple((j.name, j.type) for j in case.joints), tuple(p.name for p in own),
        tuple(p.unit for p in own), np.array([values[p.name] for p in own]), tuple(acting), claimed,
        case.filter_hz if case.fit == "torque" else None,
    )  # fmt: skip


def off_in(contest: Contest, model: ModelFile) -> list[Acting]:
    """Return the candidates that a model does not have, switched off; none for a model without effects."""
    have = [a.label for a in model.effects]
    return [replace(c.acting, known={s.name: s.neutral for s in c.law.parameters})
            for c in contest.candidates if have and c.acting.label not in have]  # fmt: skip


def implausible(contest: Contest, decision: Decision, parameters: Intervals) -> tuple[str, ...]:
    """Return the parameters of named effects whose whole interval is outside what nature or a sensor has."""
    out = []
    form: Form = "branch" if isinstance(contest.case, BranchCase) else "joint"
    for acting in decision.named:
        for spec in effect_of(acting.name).law(form).parameters:
            own = parameters[acting.label].get(spec.name)
            if own and spec.plausible and not (own.low <= spec.plausible[1] and own.high >= spec.plausible[0]):
                low, high = spec.plausible
                out.append(f"{acting.label} {spec.name} {own.median:.3g} {own.unit} (nature has {low:g} to {high:g})")
    return tuple(out)
