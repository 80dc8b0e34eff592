"""Checks whether a case's data can support a verdict; if not, why, and which probe is missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from ..cases.joints import JointSpec
from ..replay.equation_error import recordings_of, thinned
from ..replay.recording import Recording
from ..systems.choose import system_of
from .models.contest import Batch, Contest
from .models.fitted import QUIET, FittedModels, Model
from .models.refit import Fits, fit
from .where import joint_motion

#: Largest noise relative to the rms of the motion.
MOST_NOISE = 0.7
#: Least number of measured values for every unknown of the base model, its start states and a law: ten to twenty is
#: usual for a fit that is to say something about other data (Harrell, Regression Modeling Strategies, 2015, 4.4).
PER_UNKNOWN = 10
#: Parameters of a typical law.
LAW = 3
#: Factor between what recordings say of one plant from which it is not one; share of the best model's excess that fits
#: to each recording alone may leave for that; steps of such a fit; least motion of a recording beside the largest.
APART, SEPARATE_LEAVE, SEPARATE_STEPS, LIVELY = 1.5, 0.25, 20, 0.1
#: Share of the base model's excess from which the preferred model's effects are why recordings differ: a branch that
#: broke in part is another one afterwards.
ENOUGH_EXPLAINED = 0.87
#: Rate, relative to the largest, from which a joint moves; share of moving samples that make a direction.
MOVING, DIRECTION = 0.05, 0.02
#: Shares of a recording's samples, its end, in which a joint is to rest and its model about it; how far they may move
#: there, of all that the joint moves; how many standard deviations from the model is beside it in all recordings.
END, LONG_END, STILL, NEARLY_STILL, BESIDE = 0.1, 0.25, 0.01, 0.15, 3.0


def nothing_moves(case: BranchCase | JointCase) -> str | None:
    """Return that nothing acts or nothing moves, or None."""
    if isinstance(case, BranchCase) and not any(t.force.any() for t in case.trajectories):
        return "no trajectory has any force; push the branch"
    if not any(np.ptp(r.output, axis=0).any() for r in recordings_of(case)):
        return "nothing moves in any trajectory; push harder"
    return None


def too_few(case: BranchCase | JointCase) -> str | None:
    """Return that a branch has too few trajectories, or a case too few samples for its unknowns, or None."""
    if isinstance(case, BranchCase) and len(case.trajectories) < 2:
        return "one trajectory can be fitted by almost any effect; push in two more directions"
    recorded = [thinned(case, r) for r in recordings_of(case)]
    unknowns = len(system_of(case).parameters) + sum(r.start.size for r in recorded) + LAW
    samples, needed = sum(len(r.t) for r in recorded), PER_UNKNOWN * unknowns
    channels = max(1, int(np.ptp(np.concatenate([r.output for r in recorded]), axis=0).astype(bool).sum()))
    if samples * channels >= needed:
        return None
    return (f"{samples} samples are too few for {unknowns} unknowns (the model's, its start states and a law's); record"
            f" {-(-needed // channels)} or more, {PER_UNKNOWN} measured values for each")  # fmt: skip


def too_noisy(motion: float) -> str | None:
    """Return what to do where noise hides the motion; ``motion`` is its rms in units of the noise."""
    if motion < 1.0 / MOST_NOISE:
        return "noise is as large as the motion; push harder, or average repeated pushes"
    return None


# ---- one and the same plant -----------------------------------------------------------------------------------------


def different_plants(fitted: FittedModels, model: Model) -> str | None:
    """Return that the recordings do not look like one and the same plant, or None.

    The base model is fitted to each recording by itself. If that explains what even the preferred model of all
    recordings leaves, and the springs that it finds differ by more than `APART`, either several plants were recorded
    into one case or it was changed in between. A mechanism from an MJCF file is not checked.
    """
    contest, case = fitted.contest, fitted.contest.case
    count = len(contest.recordings)
    left = model.chi2 - contest.num_samples
    known = fitted.reduced_chi2(model) <= QUIET or fitted.explained(model) >= ENOUGH_EXPLAINED
    if count < 2 or known or (isinstance(case, JointCase) and case.mjcf is not None):
        return None
    alone = _each_alone(contest, fitted.base.fit.batch)
    if float(alone.chi2.sum()) - contest.num_samples > SEPARATE_LEAVE * left:
        return None
    values = contest.values(alone.batch)[:, : contest.num_base].cpu().numpy()
    names, size = [p.name for p in contest.parameters[: contest.num_base]], [_rms(r) for r in contest.recordings]
    seen = [j for j in range(count) if size[j] > LIVELY * max(size)]
    for what, numbers in plant_numbers(case, [dict(zip(names, row, strict=True)) for row in values]).items():
        low, high = min(seen, key=lambda j: numbers[j]), max(seen, key=lambda j: numbers[j])
        if numbers[high] > APART * numbers[low]:
            first, second = (f"recording {j + 1} ({case.trajectories[j].file})" for j in (high, low))
            return (f"these recordings do not look like one and the same plant: fitted by itself, {first} has"
                    f" {numbers[high] / numbers[low]:.3g} times the {what} of {second}; make a case of each plant, or"
                    " record again without a change in between")  # fmt: skip
    return None


def _each_alone(contest: Contest, base: Batch) -> Fits:
    """Fit the base model to each of R recordings by itself, from the fit to all and from what it suggests itself."""
    case, count = contest.case, len(contest.recordings)
    batch = base[torch.zeros(2 * count, dtype=torch.long, device=contest.place)]
    batch.weight = torch.eye(count).repeat(2, 1).to(batch.free)
    if isinstance(case, JointCase):  # swings of another frequency end in false minima from the fit to all
        for j, t in enumerate(case.trajectories):
            own = {p.name: p for p in system_of(replace(case, trajectories=(t,), train=None, test=None)).parameters}
            for k, p in enumerate(contest.parameters[: contest.num_base]):
                batch.free[count + j, k] = own.get(p.name, p).start
        batch.free[count:] = batch.free[count:].clamp(contest.low, contest.high)
    fits = fit(contest, batch, SEPARATE_STEPS)
    chi2 = fits.chi2.view(2, count)
    return fits[torch.arange(count, device=contest.place) + count * chi2.argmin(0)]


def _rms(r: Recording) -> float:
    """Return the rms of a recording's channels about their means."""
    return float(np.sqrt(np.mean((r.output - r.output.mean(axis=0)) ** 2)))


def plant_numbers(case: BranchCase | JointCase, values: Sequence[dict[str, float]]) -> dict[str, list[float]]:
    """Return what one recording suffices to know of a plant, by name, for each set of base parameters.

    Of a branch how far its grasp point gives way to a force, sum lever^2 / K; of a joint on a fixed frame spring and
    gravity torque over inertia, or the inertia where neither is there.
    """
    if isinstance(case, BranchCase):
        link, along = case.grasp_segment, case.grasp_distance
        point = case.lower_end[link] + case.axis[link] * along
        lever = np.linalg.norm(point - case.lower_end[: link + 1], axis=1)
        spring = [np.array([v[f"stiffness {n}"] for n in case.segment_name[: link + 1]]) for v in values]
        return {"compliance at the grasp point": [float(np.sum(lever**2 / k)) for k in spring]}
    return {what: [own(v) for v in values] for j in case.joints if isinstance(j, JointSpec)
            for what, own in [_joint_number(j)]}  # fmt: skip


def _joint_number(joint: JointSpec) -> tuple[str, Callable[[dict[str, float]], float]]:
    """Return the name of a joint's number and the function of base parameters that gives it."""
    gravity = joint.gravity_torque

    def known(v: dict[str, float], kind: str, value: float | None) -> float:
        """Return a base parameter of the joint, or the number that the case gives for it, or 0."""
        return v.get(f"{kind} {joint.name}", value or 0.0)

    def inertia(v: dict[str, float]) -> float:
        """Return the joint's inertia [kg m^2]."""
        return known(v, "inertia", joint.inertia)

    def frequency(v: dict[str, float]) -> float:
        """Return (stiffness + gravity torque) / inertia, the squared frequency of small swings [rad^2/s^2]."""
        hanging = known(v, "gravity torque", gravity.amplitude if gravity else None)
        return (known(v, "stiffness", joint.stiffness) + hanging) / inertia(v)

    if joint.stiffness == 0.0 and (gravity is None or gravity.amplitude == 0.0):
        return f"inertia of {joint.name}", inertia
    return f"squared frequency of {joint.name}", frequency


# ---- friction and offset --------------------------------------------------------------------------------------------


def one_way(case: BranchCase | JointCase, recordings: Sequence[Recording], values: dict[str, float]) -> tuple[str, ...]:
    """Return a remark for every joint that moves in one direction only while a constant effort on it is free.

    Coulomb's friction is such a constant then: the offset holds it, and nothing seems to be missing.
    """
    if isinstance(case, BranchCase):
        return ()
    out = []
    for joint in case.joints:
        name = next((n for n in (f"offset {joint.name}", f"preload {joint.name}") if n in values), None)
        motion = [joint_motion(case, r).get(joint.name, (None, None)) for r in recordings]
        rates = [rate for _, rate in motion if rate is not None]
        if name is None or not rates or turns_back(rates):
            continue
        unit = "N m" if joint.type == "revolute" else "N"
        out.append(
            f"Joint {joint.name} moves in one direction only: dry friction and a constant offset cannot be told apart,"
            f" so the fitted {name} of {values[name]:.3g} {unit} may be friction; record the same motion both ways."
        )
    return tuple(out)


def turns_back(rates: Sequence[Array]) -> bool:
    """Return whether a joint with these rates, arrays [T], moves in both directions."""
    rate = np.concatenate(list(rates))
    moving = rate[np.abs(rate) > MOVING * np.quantile(np.abs(rate), 0.99)]
    forward = float(np.mean(moving > 0.0)) if len(moving) else 0.5
    return min(forward, 1.0 - forward) >= DIRECTION


def rests_elsewhere(case: BranchCase | JointCase, recordings: Sequence[Recording], simulated: Array) -> tuple[str, ...]:
    """Return a remark for every replayed joint that comes to rest elsewhere than the base model, in all recordings.

    ``simulated`` are the base model's channels, shape [R, T, C]. Nothing may act at the end of a recording.
    """
    if isinstance(case, BranchCase) or case.fit == "torque":
        return ()
    out = []
    for c, o in enumerate(case.outputs):
        pairs = zip(recordings, simulated, strict=True)
        found = [_rest(r.output[:, c], own[: len(r.t), c], r.input) for r, own in pairs]
        away = np.array([x for x in found if x is not None])
        if o.quantity != "position" or len(away) < 2 or abs(away.mean()) <= BESIDE * max(away.std(ddof=1), 1e-12):
            continue
        unit = "rad" if next(j for j in case.joints if j.name == o.joint).type == "revolute" else "m"
        out.append(
            f"Joint {o.joint} comes to rest about {away.mean():.1g} {unit} from where the model does, in {len(away)}"
            " recordings alike: its zero may be off (offset in meta.yaml, or --position-zero end of bough new-case), or"
            " its centre of mass (unknown), or friction holds it on the side that it was pulled to."
        )
    return tuple(out)


def _rest(measured: Array, model: Array, acting: Array) -> float | None:
    """Return how far a joint is from its model at the end of a recording; None where either moves or something acts."""
    last, longer = (slice(-max(2, round(share * len(measured))), None) for share in (END, LONG_END))
    swing = float(np.ptp(measured))
    rests = np.ptp(measured[last]) <= STILL * swing and np.ptp(model[longer]) <= NEARLY_STILL * swing
    if not rests or np.abs(acting[last]).max(initial=0.0) > 0.0:
        return None
    return float(measured[last].mean() - 0.5 * (model[longer].max() + model[longer].min()))
