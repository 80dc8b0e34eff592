"""Whether a verdict on measured joints hangs on how their recordings are treated: filter, rate, split.

The leading models are fitted again to the same recordings under another cut-off of the filter (torques) or at half the
rate (replays), and to a part of the recordings. A name that does not survive is not claimed, unless what takes its
place is the same in principle, such as a set and a loop of one slider: that is an alternative. Where nothing is
missing a name that another treatment gives makes that unknown. Half of the rate or a part of the recordings shows
nothing that they do not show whole: its effect must be larger than the tolerance there too, or else is only told.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...sim.base.errors import InputError
from ..cases.case import BranchCase, JointCase, JointTrajectory
from ..inference.identify import pooled_sigma
from ..replay.choice import roughness
from ..replay.equation_error import fits_torque, noise_of, recordings_of, thinned
from ..replay.motion_noise import motion_noise
from .decide import EXPLAINED, Decision, alike, alternatives, decide, leading, size
from .evidence import bootstrap_test
from .models.at_rest import Noise
from .models.contest import Batch, Contest
from .models.fitted import FittedModels, Model, penalty
from .models.levels import begun_again
from .models.refit import fit
from .prepare import Base
from .run import Run
from .search import Searched

#: Models that are fitted again, and the most steps of it; of those that hold a name of the decision, which is not taken
#: back because a law of many parameters comes near its best fit slowly.
LEADING, STEPS, ENOUGH = 10, 12, 200
#: Places about a model from which it is fitted as well, and how far from it they are, as a share of the reach.
SCATTERED, APART = 5, 0.3
#: Other cut-offs of the filter, relative to the case's own.
CUTOFFS = (0.5, 1.6)
#: Largest deviation of a skipped sample from the middle of its neighbours, relative to the channel's rms, at which half
#: of the samples still show the motion.
SMOOTH = 0.05
#: Share of the excess by which another name must be ahead under another treatment to take a name back.
CLEARLY = 0.1
#: What the best model of a treatment may leave, relative to what the decision's leaves of the case, in reduced
#: chi-squared: right names left 1 to 3.2 times as much at half of the rate, and 13, 28 and more where efforts are fast.
CARRIED = 4.0
#: Factor of the p-value of another treatment where the case's own names nothing.
UNDO = 100.0


@dataclass(frozen=True)
class Variant:
    """The same recordings, treated otherwise.

    Attributes:
        what: How, such as ``a filter of 12 Hz``.
        case: The case.
        recordings: Indices of the trajectories that are used.
        filtered: Whether another filter lets through what the case's own does not.
    """

    what: str
    case: JointCase
    recordings: tuple[int, ...]
    filtered: bool = False


def steadied(base: Base, searched: Searched, decision: Decision, run: Run) -> Decision:
    """Return a decision on joints without the names that another filter, rate or split does not give.

    Unknown if none is left, or if nothing was named and another treatment names something.
    """
    case = base.contest.case
    if isinstance(case, BranchCase) or decision.verdict == "unknown":
        return decision
    kept = decision.model.members if decision.verdict == "effects" else ()
    changes: list[str] = []
    small: list[str] = []
    akin: dict[str, set[str]] = {}
    for variant in variants(case):
        again, fitted = _again(base, searched, decision, variant, run)
        if not _carries(searched, decision, fitted):
            continue
        gone = _gone(searched, decision, variant, again, fitted, kept)
        lost = []
        for c in gone:
            own = searched.fitted.contest.candidates[c].acting
            same = {a.name for a in fitted.acting(again.model) if alike(own, a)}
            akin.setdefault(own.label, set()).update(same)
            lost += [] if same else [c]
        if lost or (again.verdict == "effects" and not decision.named):
            told = f"{variant.what} gives {' and '.join(fitted.names(again.model))}"
            matters = lost or variant.filtered or _large(base, searched, again.model, run.settings.tolerance)
            (changes if matters else small).append(told)
        kept = tuple(c for c in kept if c not in lost)
    if changes:
        decision = _reduced(searched, decision, kept, (*changes, *small))
    elif small:
        decision = replace(decision, unstable=tuple(small))
    return replace(decision, alternatives=with_akin(decision.alternatives, akin))


def _large(base: Base, searched: Searched, found: Model, tolerance: float) -> bool:
    """Return whether a treatment's effects change the case as it is by the tolerance, or were not fitted to it."""
    models = searched.fitted
    same = [m for m in models.models if set(m.members) == set(found.members)]
    return not same or any(size(models, m, base.motion) >= tolerance for m in same)


def _carries(searched: Searched, decision: Decision, fitted: FittedModels) -> bool:
    """Return whether a model leaves about as little of a treatment's recordings as the decision's does of the case's.

    Half of the rate draws efforts with half of the samples. Where noise is a thousandth of the motion that moves a
    joint elsewhere by many times the noise, and what fits that best says nothing of the joint.
    """
    own = searched.fitted.reduced_chi2(decision.model if decision.verdict == "effects" else decision.base)
    least = min(fitted.reduced_chi2(m) for m in (fitted.base, *fitted.models))
    return least <= CARRIED * max(own, 1.0)


def _gone(
    searched: Searched, decision: Decision, variant: Variant, again: Decision, fitted: FittedModels, kept: Sequence[int]
) -> list[int]:
    """Return those of the effects still kept whose names a treatment has not, where it could have shown them."""
    part = len(variant.recordings) < len(variant.case.trajectories)
    if again.verdict == "none" or (part and shows_less(fitted, again.model, decision.model)):
        return []
    if part and set(again.model.members) < set(decision.model.members) and _agrees(fitted, again, decision, variant):
        return []
    return [c for c in kept if not _held(fitted, again.model, _name(searched, c))]


def _agrees(fitted: FittedModels, again: Decision, decision: Decision, variant: Variant) -> bool:
    """Return whether a part that names fewer effects is fitted as well by all of them, with the values of the whole.

    A set that one recording is too weak to show is not contradicted by it.
    """
    batch = _within(fitted.contest, decision.model.fit.batch, variant.recordings)
    left = float((fitted.contest.residual(batch)[0] ** 2).sum())
    more = penalty(fitted.contest, sorted(set(decision.model.members) - set(again.model.members)))
    return left - again.model.chi2 <= fitted.overdispersion * more


def with_akin(alternatives: dict[str, tuple[str, ...]], akin: dict[str, set[str]]) -> dict[str, tuple[str, ...]]:
    """Return the alternatives of effects by label, and after them the names that another treatment has instead."""
    return {k: (*v, *sorted(akin.get(k, set()) - set(v))) for k, v in alternatives.items()}


def _held(fitted: FittedModels, model: Model, name: str) -> bool:
    """Return whether a treatment has a name in its leading model, or one in its place that explains nearly as much.

    Whether the leading model explains enough to be claimed is no matter: a part of the data may show less.
    """
    others = [m for m in fitted.of_size(len(model.members)) if name in fitted.names(m)]
    return any(fitted.explained(m) > fitted.explained(model) - CLEARLY for m in others)


def shows_less(fitted: FittedModels, found: Model, own: Model) -> bool:
    """Return whether a part of the recordings names fewer effects than all do, others none, and fits better with all.

    A second effect that a part shows little of is not worth a name there; that takes nothing from it.
    """
    whole = next((m for m in fitted.models if set(m.members) == set(own.members)), None)
    if whole is None or not set(found.members) < set(own.members):
        return False
    return fitted.criterion(whole) < fitted.criterion(found)


def _name(searched: Searched, candidate: int) -> str:
    return searched.fitted.contest.candidates[candidate].name


def _reduced(searched: Searched, decision: Decision, kept: tuple[int, ...], changes: tuple[str, ...]) -> Decision:
    """Return the decision for the effects that are kept, with the model that has them alone.

    What is left of an unstable verdict must explain as much as the effects of a branch to be claimed.
    """
    fitted = searched.fitted
    alone = [m for m in fitted.of_size(len(kept)) if set(m.members) == set(kept)] if kept else []
    if not alone or fitted.explained(alone[0]) < EXPLAINED:
        nearest = fitted.contest.candidates[leading(fitted, decision.model)].name if decision.model.members else None
        return replace(decision, verdict="unknown", named=(), alternatives={}, nearest=nearest,
                       final=decision.model, unstable=changes)  # fmt: skip
    model = alone[0]
    return replace(decision, model=model, final=model, named=fitted.acting(model),
                   alternatives=alternatives(fitted, model), unstable=changes)  # fmt: skip


def variants(case: JointCase) -> Iterator[Variant]:
    """Yield other treatments of a case's recordings: another filter or rate, and a part of the recordings."""
    every = tuple(range(len(case.trajectories)))
    if fits_torque(case):
        for cutoff in (share * case.filter_hz for share in CUTOFFS):
            other = replace(case, filter_hz=cutoff)
            if cutoff < 0.4 / case.dt and _usable(other):
                yield Variant(f"a filter of {cutoff:.3g} Hz", other, every, filtered=True)
    elif _smooth(case):
        yield Variant(f"a rate of {0.5 / case.dt:.4g} Hz", at_half_rate(case), every)
    if len(every) > 1:
        for part in (every[::2], every[1::2]):
            numbers = ", ".join(str(k + 1) for k in part)
            yield Variant(f"recording{'s' if len(part) > 1 else ''} {numbers} alone", case, part)
    elif fits_torque(case):  # half of a replay may hold one way of a loop alone
        half = replace(case, trajectories=(_beginning(case.trajectories[0]),))
        if _usable(half):
            yield Variant("the first half of the recording", half, every)


def _usable(case: JointCase) -> bool:
    try:
        return roughness(case) is None
    except InputError:
        return False


def _beginning(t: JointTrajectory) -> JointTrajectory:
    half = len(t.t) // 2
    return replace(t, t=t.t[:half], effort=t.effort[:half], output=t.output[:half])


def at_half_rate(case: JointCase) -> JointCase:
    """Return a case of every second sample; efforts are averaged over the samples left out, so that impulses stay."""
    held = np.array([item.hold == "zero_order" for item in case.inputs], dtype=bool)
    out = []
    for t in case.trajectories:
        count = len(t.t) // 2
        after = np.concatenate([t.effort[1:], t.effort[-1:]])
        before = np.concatenate([t.effort[:1], t.effort[:-1]])
        effort = np.where(held, 0.5 * (t.effort + after), 0.25 * (before + 2.0 * t.effort + after))
        kept = slice(0, 2 * count, 2)
        out.append(replace(t, t=t.t[kept], effort=effort[kept], output=t.output[kept]))
    return replace(case, dt=2.0 * case.dt, trajectories=tuple(out))


def _smooth(case: JointCase) -> bool:
    """Return whether half of the samples still show the motion."""
    for c in range(len(case.outputs)):
        columns = [t.output[:, c] for t in case.trajectories]
        skipped = np.concatenate([x[1:-1] - 0.5 * (x[:-2] + x[2:]) for x in columns])
        if skipped.std() > SMOOTH * np.concatenate(columns).std():
            return False
    return True


def _again(
    base: Base, searched: Searched, decision: Decision, variant: Variant, run: Run
) -> tuple[Decision, FittedModels]:
    """Return the decision by the leading models, fitted to a variant, and these models."""
    contest = _contest(base.contest, variant, searched.fitted.base.fit.batch)
    chosen = _leading(searched.fitted, decision)
    batch = _within(contest, Batch.joined([m.fit.batch for m in chosen]), variant.recordings)
    fits = fit(contest, batch, STEPS)
    models = [Model(m.members, fits.one(s), True, m.rests, m.idle) for s, m in enumerate(chosen)]
    models = _settled(contest, models, set(decision.model.members))
    fitted = FittedModels(contest, models[0], models[1:])
    contest.overdispersion = fitted.overdispersion
    other = Base(contest, fits.one(0), Noise(contest.sigma.cpu().numpy()), None)
    p_value = searched.p_value
    if decision.verdict == "none":  # a name must be beyond doubt to undo that: there are several treatments
        p_value = min(1.0, bootstrap_test(other, Run(run.settings)).p_value * UNDO)
    return decide(other, Searched(fitted, p_value), run.settings), fitted


def _settled(contest: Contest, models: list[Model], own: set[int]) -> list[Model]:
    """Return models of which those that hold one of ``own`` were fitted until no step betters them, and begun again.

    Each from where it is and from `SCATTERED` places about it, of which the best counts: of a loop whose slider yields
    at once, valleys lie side by side, and which one a fit ran into was decided by the last digits of the data.
    """
    held = [k for k, m in enumerate(models) if own & set(m.members)]
    if not held:
        return models
    done = {k: _best_of(contest, models[k]) for k in held}
    begun_again(contest, [*done.values()])
    return [done.get(k, m) for k, m in enumerate(models)]


def _best_of(contest: Contest, model: Model) -> Model:
    """Return a model fitted from its place and from others about it, the best of them."""
    batch = Batch.joined([model.fit.batch] * (1 + SCATTERED))
    apart = np.random.default_rng(0).standard_normal((SCATTERED, batch.free.shape[1]))
    shift = torch.as_tensor(apart).to(batch.free) * APART * contest.reach
    batch.free[1:] = (batch.free[1:] + torch.where(batch.active[1:], shift, 0.0)).clamp(contest.low, contest.high)
    fits = fit(contest, batch, ENOUGH)
    return replace(model, fit=fits.one(int(fits.cost.argmin())))


def _contest(first: Contest, variant: Variant, base: Batch) -> Contest:
    """Return the contest of a variant, with its noise where the filter makes it another one."""
    case = variant.case
    every = [thinned(case, r) for r in recordings_of(case)]
    sigma = pooled_sigma(case, noise_of(case)) if fits_torque(case) else first.sigma.cpu().numpy()
    contest = Contest(case, [every[j] for j in variant.recordings], sigma, first.names, device=first.device)
    if fits_torque(case):
        base = _within(contest, base, variant.recordings)
        contest.set_noise(np.hypot(sigma, motion_noise(case, contest.unknowns, contest.values(base)[0])))
    return contest.finely() if case.dt > first.case.dt else contest  # with longer steps a law may mend the integration


def _within(contest: Contest, batch: Batch, recordings: tuple[int, ...]) -> Batch:
    """Return a batch for some of its recordings, inside the boxes of another contest."""
    chosen = list(recordings)
    free = batch.free.clamp(contest.low, contest.high)
    return Batch(free, batch.active, batch.start[:, chosen], torch.ones_like(batch.weight[:, chosen]))


def _leading(fitted: FittedModels, decision: Decision) -> list[Model]:
    """Return the base, the preferred model, its parts, and the best others."""
    own = set(decision.model.members)
    ranked = sorted(fitted.models, key=fitted.criterion)
    parts = [m for m in ranked if set(m.members) <= own]
    ahead = {m.members: m for m in reversed([*parts, *ranked[:LEADING]])}
    return [fitted.base, *ahead.values()]
