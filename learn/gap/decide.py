"""From fitted models to a verdict: none, effects by name, or unknown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...sim.effects import EffectParameter, effect_of
from ..cases.case import BranchCase, JointCase
from ..replay.equation_error import fits_torque
from ..systems.acting import Acting
from ..systems.system import Parameter
from .diagnosis import Settings, VerdictName
from .evidence import ALARM, lacks_fit
from .geometry import by_hand
from .models.candidates import Candidate, passes_neutral
from .models.certain import doubtful
from .models.contest import Contest
from .models.fitted import FURTHER, QUIET, FittedModels, Model, penalty
from .models.left_out import fitted_chi2, left_out_chi2, profiles, without_event
from .models.memoryless import MEMORYLESS, QUIET_TORQUE, beyond_angle, memoryless_share, of_the_angle
from .prepare import Base
from .search import Searched

#: Least share of the base model's excess chi-squared that named effects must explain if their residual exceeds noise.
EXPLAINED = 0.87
#: The same where a one-sided spring of a branch is named: cords and neighbours that touch pull one way too, and explain
#: up to 0.939 by it, a right one 0.956 and more.
ONE_SIDED = 0.948
#: The same where a law of a sensor is named: what a sensor does is a definition, from which nature's form does not
#: differ. Right ones of eight blind seeds explain 0.959 and more, gains in the place of a force off its line 0.924.
SENSED = 0.95
#: The same at replayed joints, where noise is a thousandth of the motion, for such a law alone: right ones of exams
#: explain 0.998 and more, the scale of a force in the place of a belt that swings 0.970.
SENSED_JOINT = 0.985
#: The same where two effects of a branch are named: right pairs of seven blind seeds explain 0.968 and more, pairs of
#: which one is wrong 0.88 to 0.964 (five), or nearly all (four).
TOGETHER = 0.966
#: Kinds of laws of sensors.
SENSORS = ("force", "time_delay")
#: Most of a residual over that of the best model of any two effects at which nothing but noise is left of what strikes
#: a stop. A law that does nothing takes 0.001 of a thousand numbers off; a struck stem left 1.084 times as much.
STRUCK = 1.03
#: The same as `EXPLAINED` if their residual passes for noise.
QUIET_EXPLAINED = 0.7
#: The same for joints that are measured directly: where more is left than `LITTLE_LEFT` says, right names of the exam
#: explain 0.97 and more, laws in the place of a spring that leaks through a diode up to 0.93.
EXPLAINED_JOINT = 0.95
#: The same where little is left, by the reduced chi-squared up to which it holds. Noise is a thousandth of the motion
#: there, so small errors of a law's form count for much, and its slow part is not in the estimate: right names explain
#: 0.73 of one real tree's pull and leave 14 deviations, 0.64 of another's and leave 3.
LITTLE_LEFT = ((10.0, 0.6), (300.0, 0.7))
#: The same for torques predicted from a measured motion. Right names of the exam explain 0.83 and more, hysteresis in
#: the place of a diode 0.70 and a plastic set 0.78.
EXPLAINED_TORQUE = 0.87
#: The same where dry friction alone is named, which every gear has, of replays and of torques. Of replays a servo's
#: explains 0.78 to 0.85, friction in the place of twenty laws on no list 0.44 at most, and one that may grow towards
#: rest 0.754 in the place of a motor's cogging; of torques that of a real arm's two gears explains 0.52.
EXPLAINED_FRICTION, EXPLAINED_FRICTION_TORQUE = 0.77, 0.4
#: The least that two effects must explain together at replayed joints, if their residual exceeds noise: right pairs
#: explain 0.99 and more, two laws that make up one on no list 0.9.
TOGETHER_JOINT = 0.95
#: Least share of the remaining excess that a further effect must explain (for motion, for torques).
FURTHER_SHARE, FURTHER_SHARE_TORQUE = 0.3, 0.1
#: Least share of the base model's excess that a further effect must explain, for branches and for joints measured
#: directly. A law differs from the true effect in form, by up to a quarter of its response; a further effect that only
#: corrects that form must not be named. Half of the share suffices for an effect that explains `MOST` of the remaining
#: excess, and any share for one that explains `NEARLY_ALL`: form errors are not corrected so well.
WORTH, WORTH_JOINT, MOST, NEARLY_ALL = 0.1, 0.08, 0.88, 0.93
#: Least share of a branch's excess that one law at two joints or more must explain to be named.
TWICE = 0.97
#: Least share of a further effect's gain that must remain on recordings that were left out of the fits, and what it may
#: lose in one experiment left out, as a share of what it gains in the mean. Of 39 random pairs of the registry's laws
#: the right second effect kept 0.63 or more and never lost; of wrong ones in its place 16 kept less or lost more.
KEPT, LOST = 0.6, 0.1
#: Share of itself by which a law must change at a moment to be a step beside a break.
STEP = 0.25
#: Difference of the information criterion below which two models cannot be told apart.
TIED = 12.0
#: Share of the excess by which a law may explain less than one that ends where it becomes this law.
TURNED = 0.03
#: Share of what a branch's force sensor reads of an open gripper by which its offset may differ from that, both of the
#: root mean square over recordings. Three right offsets of an independent generator differ by 0.003, 0.07 and 0.17, one
#: in the place of a tool's weight by 0.52.
MISREAD = 0.35
#: Reduced chi-squared of a branch's base up to which nothing is missing, however rare the gain of an effect would be
#: by chance: two simulators of one branch differ by as much. Bases that right names repaired left 1.43 or more.
NOISE_ALONE = 1.05
#: Share of its box from an end, on its own scale, within which a parameter is said to be at its bound.
NEAR = 0.01


@dataclass(frozen=True)
class Decision:
    """The verdict on the fitted models.

    Attributes:
        verdict: ``none``, ``effects`` or ``unknown``.
        base: The base model.
        model: The preferred model.
        final: The repaired model: ``model``, at joints without what does nothing in it (`models.idle`); or the base
            model, if nothing is missing.
        named: Effects that are claimed.
        alternatives: For each of them the names that these data cannot tell from it.
        nearest: For ``unknown`` the closest name, not claimed; None if the data cannot support a verdict.
        unstable: What would change the verdict of measured joints, see `steady`.
        may_be_off: For ``unknown`` the labels of the preferred model's effects that may as well be off.
        stretched: For ``unknown`` the labels of those that go as far as their boxes allow, see `at_an_end`.
        ended: Labels of the model that was preferred before, a law of which ends where it becomes another.
        further: The model with one effect more that leaves less, see `models.unclaimed`; None where there is none.
    """

    verdict: VerdictName
    base: Model
    model: Model
    final: Model
    named: tuple[Acting, ...] = ()
    alternatives: dict[str, tuple[str, ...]] = field(default_factory=dict)
    nearest: str | None = None
    unstable: tuple[str, ...] = ()
    may_be_off: tuple[str, ...] = ()
    stretched: tuple[str, ...] = ()
    ended: tuple[str, ...] = ()
    further: Model | None = None


def decide(base: Base, searched: Searched, settings: Settings) -> Decision:
    """Return the verdict, the preferred model and the named effects."""
    models = searched.fitted
    first = chosen(models, settings.max_effects)
    turned = _turned_into(models, first)
    model = _borne_out(models, turned)
    verdict, off = _verdict(base, searched, model, settings.tolerance)
    candidates = models.contest.candidates
    if verdict == "effects":
        named = models.acting(model)
        ended = () if turned is first else models.labels(first)
        return Decision(verdict, models.base, model, model, named, alternatives(models, model), ended=ended)
    if verdict == "none":
        return Decision(verdict, models.base, model, models.base)
    nearest = None if base.unusable or not model.members else candidates[leading(models, model)].name
    may_be_off, most = (tuple(candidates[c].acting.label for c in own) for own in (off, at_an_end(models, model)))
    return Decision(verdict, models.base, model, model, nearest=nearest, may_be_off=may_be_off, stretched=most)


def _verdict(base: Base, searched: Searched, model: Model, tolerance: float) -> tuple[VerdictName, tuple[int, ...]]:
    """Return the verdict, and the effects of the model that may as well be off where that was looked at."""
    if base.unusable is not None:
        return "unknown", ()
    models = searched.fitted
    small = searched.p_value > ALARM or size(models, model, base.motion) < tolerance
    small = small or within_noise(models.contest.case, models.reduced_chi2(models.base))
    if small and not lacks_fit(models, tolerance * base.motion):
        gained = of_the_angle(models, models.base) / models.contest.num_samples
        return "unknown" if np.sqrt(gained) > tolerance * base.motion else "none", ()
    off = doubtful(models, model)
    claimed = not off and not at_an_end(models, model) and known(models, model)
    return "effects" if claimed else "unknown", off


def within_noise(case: BranchCase | JointCase, base_reduced_chi2: float) -> bool:
    """Return whether a base model of a branch leaves so little that nothing can be said to be missing."""
    return isinstance(case, BranchCase) and base_reduced_chi2 <= NOISE_ALONE


def _turned_into(fitted: FittedModels, model: Model) -> Model:
    """Return the model, or where a law of it ends at what makes it another law, one with that law at its joint.

    The other law must not end where it becomes the first.
    """
    others = (other for c in model.members for other, back in _turned(fitted, model, c) if not back)
    return next(others, model)


def _turned(fitted: FittedModels, model: Model, candidate: int) -> Iterator[tuple[Model, bool]]:
    """Yield models with a law that one of a model turns into, at its joint, and whether that turns back into the first.

    The other law must explain as much, to the share by which a law may differ from nature's in its form (`TURNED`).
    """
    candidates = fitted.contest.candidates
    own = candidates[candidate]
    wanted = [(name, own.acting.joint) for name in _becomes(fitted, model, candidate)]
    for other in (k for k, x in enumerate(candidates) if (x.name, x.acting.joint) in wanted):
        members = {*model.members, other} - {candidate}
        found = [m for m in fitted.models if set(m.members) == members and not m.rests]
        best = min(found, key=fitted.criterion, default=None)
        if best is not None and fitted.explained(best) >= fitted.explained(model) - TURNED:
            yield best, own.name in _becomes(fitted, best, other)


def _becomes(fitted: FittedModels, model: Model, candidate: int) -> list[str]:
    """Return the names of the laws that a law turns into where its parameters are in their boxes."""
    own, out = fitted.contest.candidates[candidate], []
    for k, s in zip(own.columns, own.specs, strict=True):
        if s.becomes and _way_up(fitted, model, k) >= s.becomes_from - NEAR:
            out.append(s.becomes)
        if s.below and _way_up(fitted, model, k) <= NEAR:
            out.append(s.below)
    return [*out, "gravity_comp_error"] if _misread(fitted.contest, model, own) else out


def _misread(contest: Contest, model: Model, candidate: Candidate) -> bool:
    """Return whether an effect is an offset of a branch's force that is not what the sensor reads of an open gripper.

    A weight that turns with the gripper reads otherwise once it holds the branch; an offset does not.
    """
    if candidate.name != "force_bias" or not isinstance(contest.case, BranchCase):
        return False
    seen = [r for r in contest.recordings if not r.contact.all()]  # an open gripper's force is read in these alone
    if not seen:
        return False
    own, read = _values(contest, model, candidate), np.stack([r.opened for r in seen])
    before = np.array([[r.t_start + 0.5 * float(r.t[-1]) < own["moment_s"]] for r in seen])
    beside = np.array([own.get(f"force_{c}_N", 0.0) for c in "xyz"]) * (1.0 - own["changes"] * before)
    beside = beside + (own["opened"] - 1.0) * read
    return 0.0 < MISREAD * float(np.linalg.norm(read)) < float(np.linalg.norm(beside))


def _way_up(fitted: FittedModels, model: Model, column: int) -> float:
    """Return how far up its box a parameter of a model is, on its own scale: 0 at the lower end, 1 at the upper."""
    low, high = float(fitted.contest.low[column]), float(fitted.contest.high[column])
    return (float(model.fit.batch.free[0, column]) - low) / (high - low)


def _borne_out(fitted: FittedModels, model: Model) -> Model:
    """Return a model without further effects that may as well be off or are as weak as can be, or that do not pay.

    They pay on recordings left out. The first effect stays: it is the nearest name even where it is not claimed.
    """
    while len(model.members) > 1:
        off = (*doubtful(fitted, model), *weakest(fitted, model))
        smaller = [m for m in fitted.contained(model) if len(m.members) == len(model.members) - 1
                   and not (off and set(off) <= set(m.members))]  # fmt: skip
        inner = min(smaller, key=fitted.criterion, default=None)
        if inner is None or (not off and pays(fitted, model, inner)):
            break
        model = inner
    return _for_certain(fitted, model)


def _for_certain(fitted: FittedModels, model: Model) -> Model:
    """Return the model, or where its one effect may as well be off, one that fits as well with an effect that is on."""
    if len(model.members) != 1 or not doubtful(fitted, model):
        return model
    tied = [m for m in fitted.of_size(1) if fitted.criterion(m) - fitted.criterion(model) < TIED]
    return next((m for m in tied if not doubtful(fitted, m)), model)


def pays(fitted: FittedModels, model: Model, inner: Model) -> bool:
    """Return whether a model predicts recordings that it was not fitted to better than one with an effect less.

    Of what it gains where it is fitted it must keep the share `KEPT` there, and in no experiment may it do harm: a law
    that stands in for another pays for one kind of push with another. The experiment in which something breaks or sets
    in is not left out. True where nothing can be left out: branches with replicates of one experiment alone, and
    joints, whose recordings left out have no start state of their own; `steady` asks every other recording there.
    """
    contest, groups = fitted.contest, profiles(fitted.contest)
    if not isinstance(contest.case, BranchCase) or len(groups) < 2:
        return True
    rest = without_event(contest, (model, inner), groups)
    if not rest:
        return True
    outer, less = left_out_chi2(contest, [model, inner], rest)
    own, other = fitted_chi2(contest, [model, inner], rest)
    return bears_out((less - outer).tolist(), float((other - own).sum()))


def predicts(fitted: FittedModels, model: Model) -> bool:
    """Return whether a model of a branch predicts experiments that it was not fitted to better than the base does.

    Better by what its effects cost: noise alone predicts a little better every second time. Both have the nuisances
    here, which the model as it is written has not.
    """
    groups = profiles(fitted.contest)
    if not isinstance(fitted.contest.case, BranchCase) or len(groups) < 2:
        return False
    own, less = left_out_chi2(fitted.contest, [model, fitted.base], groups)
    return float((less - own).sum()) > fitted.overdispersion * penalty(fitted.contest, model.members)


def bears_out(gains: Sequence[float], fitted: float) -> bool:
    """Return whether gains on experiments left out [G] bear out the gain where a further effect was fitted."""
    total = sum(gains)
    return total > KEPT * fitted and min(gains) > -LOST * total / len(gains)


def chosen(fitted: FittedModels, most: int) -> Model:
    """Return the preferred model with at most ``most`` effects, the base model if nothing else was fitted.

    Selection is forward: a further effect is added only if it explains much of the remaining excess, and is not the
    same in principle as another one at its joint. One law at many joints (`models.widespread`) is one name.
    """
    best = _single(fitted)
    for count in range(2, most + 1):
        further = [m for m in fitted.of_size(count) if not _doubled(fitted, m)]
        if not further or not _worth_more(fitted, best, further[0]):
            break
        best = further[0]
    wide = [m for m in fitted.models if len(m.members) > most and len(set(fitted.names(m))) == 1]
    if isinstance(fitted.contest.case, BranchCase):
        wide = [m for m in wide if known(fitted, m)]
    widest = min(wide, key=fitted.criterion, default=None)
    if widest is None or fitted.criterion(best) - fitted.criterion(widest) <= FURTHER:
        return best
    return widest


def alike(a: Acting, b: Acting) -> bool:
    """Return whether two effects are the same in principle (`Effect.alike`), at one joint."""
    return a.joint == b.joint and b.name in effect_of(a.name).alike


def _doubled(fitted: FittedModels, model: Model) -> bool:
    """Return whether two effects of a model are alike.

    A set or friction beside a loop is a slider more, an anisotropic spring beside a one-sided one its other way or its
    corner: they correct a law's form, and are not missing beside it.
    """
    acting = fitted.acting(model)
    return any(alike(a, b) for a in acting for b in acting)


def _worth_more(fitted: FittedModels, best: Model, trial: Model) -> bool:
    """Return whether a further effect is justified: by criterion, remaining excess and whole excess."""
    case = fitted.contest.case
    share = FURTHER_SHARE_TORQUE if fits_torque(case) else FURTHER_SHARE
    worth = WORTH if isinstance(case, BranchCase) else WORTH_JOINT
    left = best.chi2 - fitted.contest.num_samples
    removed = best.chi2 - trial.chi2
    replayed = not isinstance(case, BranchCase) and not fits_torque(case)
    if replayed and fitted.reduced_chi2(trial) > QUIET and fitted.explained(trial) < TOGETHER_JOINT:
        return False
    if fitted.criterion(best) - fitted.criterion(trial) < FURTHER or removed < share * max(left, 0.0):
        return False
    if fitted.needs_more(best) and removed > NEARLY_ALL * left:
        return True
    least = 0.5 * worth if removed > MOST * left else worth
    return fitted.explained(trial) - fitted.explained(best) >= least


def _single(fitted: FittedModels) -> Model:
    """Return the best model with one effect; among ties, one contained in a clearly better pair."""
    singles, pairs = fitted.of_size(1), fitted.of_size(2)
    best = next(iter(singles), fitted.base)
    if not pairs or fitted.criterion(best) - fitted.criterion(pairs[0]) < FURTHER:
        return best
    tied = [m for m in singles if fitted.criterion(m) - fitted.criterion(best) < TIED]
    return next((m for m in tied if set(m.members) <= set(pairs[0].members)), best)


def size(fitted: FittedModels, model: Model, motion: float) -> float:
    """Return the change of the motion that a model makes against the base, as a share of the motion's rms.

    ``motion`` is that rms in units of the noise. In these units the rms change is the square root of the decrease in
    reduced chi-squared.
    """
    gained = max(fitted.base.chi2 - model.chi2, 0.0) / fitted.contest.num_samples
    return float(np.sqrt(gained)) / motion


def known(fitted: FittedModels, model: Model) -> bool:
    """Return whether a model explains enough for its effects to be named.

    Two effects of a branch, and even more one law at two joints, imitate many unknown ones, so they must explain nearly
    all. What breaks does so under a load. What strikes a stop must leave nothing but noise, with the file's geometry.
    """
    case = fitted.contest.case
    if isinstance(case, BranchCase) and (_drifts_or_strikes(fitted, model) or _staircase(fitted, model)):
        return False
    if isinstance(case, BranchCase) and len(set(fitted.names(model))) < len(model.members):
        return fitted.explained(model) >= TWICE
    if fits_torque(case):
        return _known_torques(fitted, model)
    if isinstance(case, BranchCase):
        least = max(_least(name) for name in fitted.names(model))
        least = max(least, TOGETHER) if len(model.members) > 1 else least
    else:
        least = EXPLAINED_FRICTION if _rubs(fitted, model) else EXPLAINED_JOINT
        least = min([least, *(share for most, share in LITTLE_LEFT if fitted.reduced_chi2(model) <= most)])
        least = SENSED_JOINT if _senses(fitted, model) else least
    if fitted.reduced_chi2(model) <= QUIET:
        least = min(least, QUIET_EXPLAINED)
    return fitted.explained(model) >= least


def _least(name: str) -> float:
    """Return the share of the excess that a law of a branch must explain to be named beside more than noise."""
    if name == "bilinear_stiffness":
        return ONE_SIDED
    return SENSED if effect_of(name).law("branch").kind in SENSORS else EXPLAINED


def _known_torques(fitted: FittedModels, model: Model) -> bool:
    """Return whether a model of torques explains enough, or is friction beside which no other function is seen.

    Such friction must explain as much beside any function of the angle.
    """
    quiet, share = fitted.reduced_chi2(model) <= QUIET_TORQUE, fitted.explained(model)
    if share >= (QUIET_EXPLAINED if quiet else EXPLAINED_TORQUE):
        return True
    if not _rubs(fitted, model) or min(share, beyond_angle(fitted, model)) < EXPLAINED_FRICTION_TORQUE:
        return False
    return memoryless_share(fitted, model) < MEMORYLESS


def _senses(fitted: FittedModels, model: Model) -> bool:
    """Return whether a model has laws of sensors alone."""
    return all(fitted.contest.candidates[c].law.kind in SENSORS for c in model.members)


def _rubs(fitted: FittedModels, model: Model) -> bool:
    """Return whether a model has dry friction alone, at one joint or at several."""
    return set(fitted.names(model)) == {"dry_friction"}


def _staircase(fitted: FittedModels, model: Model) -> bool:
    """Return whether a branch breaks twice in a model, or breaks and something sets in beside it.

    Two steps at two moments follow whatever drifts.
    """
    breaks = [n for n in fitted.names(model) if _lasting(n)]
    return len(breaks) > len(set(breaks)) or (bool(breaks) and _sets_in(fitted, model))


def _sets_in(fitted: FittedModels, model: Model) -> bool:
    """Return whether a law of a model, such as a wind, changes at a moment by the share `STEP` of itself or more."""
    candidates = [fitted.contest.candidates[c] for c in model.members]
    steps = [_values(fitted.contest, model, c)["changes"] for c in candidates if "changes" in {s.name for s in c.specs}]
    return any(abs(x) >= STEP for x in steps)


def _drifts_or_strikes(fitted: FittedModels, model: Model) -> bool:
    """Return whether a branch breaks unloaded or strikes a stop in a model, and more than that is wrong with it."""
    left = fitted.reduced_chi2(model)
    if left > QUIET and breaks_untouched(fitted, model):
        return True
    more = left > min(QUIET, STRUCK * fitted.overdispersion)
    return strikes(fitted, model) and (more or bool(by_hand(fitted.contest.nuisance)))


def _lasting(name: str) -> bool:
    """Return whether an effect happens to a branch's joint at one moment and for good."""
    law = effect_of(name).law("branch")
    return bool(law.moment) and law.lasting


def breaks_untouched(fitted: FittedModels, model: Model) -> bool:
    """Return whether a branch breaks in a model where no gripper has closed: between recordings, or before a pull.

    Springs that drift from recording to recording are followed by such a step. A moment before the recordings is none:
    bending alone breaks it.
    """
    contest = fitted.contest
    candidates = [contest.candidates[c] for c in model.members]
    breaking = [c for c in candidates if _lasting(c.name)]
    return any(not _pulled(contest.case, *_breaks(contest, model, c)) for c in breaking)


def strikes(fitted: FittedModels, model: Model) -> bool:
    """Return whether a spring of a branch stiffens in a model from an angle on, as a branch does that strikes a stop.

    A stop or a cord outside acts at every joint below it, so that a spring at one joint leaves a part of it; of a stop
    at the first segment only where on it the stop is, which a length or a mounting that is a little off may explain.
    """
    candidates = [fitted.contest.candidates[c] for c in model.members]
    offs = [k for c in candidates if c.name == "bilinear_stiffness"
            for k, s in zip(c.columns, c.specs, strict=True) if s.name == "off_rad"]  # fmt: skip
    return any(_way_up(fitted, model, k) < 0.5 - NEAR for k in offs)


def _breaks(contest: Contest, model: Model, candidate: Candidate) -> tuple[float, float]:
    """Return when a candidate's break begins and ends on the absolute clock [s]."""
    values = _values(contest, model, candidate)
    begin = values[candidate.law.moment]
    return begin, begin + values["takes_s"]


def _values(contest: Contest, model: Model, candidate: Candidate) -> dict[str, float]:
    """Return the values of a candidate's parameters in a model, by name, in the order of its law."""
    at = contest.values(model.fit.batch)[0, list(candidate.columns)].tolist()
    return dict(zip((s.name for s in candidate.specs), at, strict=True))


def _pulled(case: BranchCase | JointCase, begin: float, end: float) -> bool:
    """Return whether a recording has been pulled at, and goes on, at some moment between two [s].

    True of moments before the recordings, which say that what bends it breaks it.
    """
    assert isinstance(case, BranchCase)
    held = [t for t in case.trajectories if not t.no_contact.all()]
    pulled = any(t.t_start + t.t[~t.no_contact][0] <= end and begin <= t.t_start + t.t[-1] for t in held)
    return pulled or begin < min(t.t_start for t in case.trajectories)


def stretched(fitted: FittedModels, model: Model) -> tuple[int, ...]:
    """Return the effects of a model that are as strong as their boxes allow, where it leaves more than noise.

    A law in another's place grows until it is stopped. The strength is an effect's first parameter; an end of its box
    at which it is off is no strength.
    """
    if fitted.reduced_chi2(model) <= QUIET:
        return ()
    return tuple(c for c, p, spec, share in _strengths(fitted, model)
                 if share >= 1.0 - NEAR or (passes_neutral(spec, p) and share <= NEAR))  # fmt: skip


def held_fast(fitted: FittedModels, model: Model) -> tuple[int, ...]:
    """Return the effects of a model that end where they become another law, which ends where it becomes the first.

    However much they explain: friction that never slides, and a slider's spring as stiff as can be, are a joint that is
    held where a recording finds it.
    """
    return tuple(c for c in model.members if any(back for _, back in _turned(fitted, model, c)))


def at_an_end(fitted: FittedModels, model: Model) -> tuple[int, ...]:
    """Return the effects of a model that go as far as their boxes allow: `stretched` or `held_fast`."""
    return tuple(sorted({*stretched(fitted, model), *held_fast(fitted, model)}))


def weakest(fitted: FittedModels, model: Model) -> tuple[int, ...]:
    """Return the effects of a model that are as weak as their boxes allow.

    Such a law beside another one does something else than its name says: it corrects that one's form. Of 280 verdicts
    on cases of exams four had one beside another, and none of the four was there. One that acts either way from off has
    no weak end.
    """
    return tuple(c for c, p, spec, share in _strengths(fitted, model) if spec.neutral <= p.low and share <= NEAR)


def _strengths(fitted: FittedModels, model: Model) -> Iterator[tuple[int, Parameter, EffectParameter, float]]:
    """Yield effects, their first parameters, as unknowns and as registered, and how far up their boxes these are."""
    for c in model.members:
        own = fitted.contest.candidates[c]
        k = own.columns[0]
        yield c, fitted.contest.parameters[k], own.specs[0], _way_up(fitted, model, k)


def leading(fitted: FittedModels, model: Model) -> int:
    """Return the effect of a model that explains most by itself; the first if none was fitted alone."""
    alone = {c: min((m.chi2 for m in fitted.of_size(1) if m.members == (c,)), default=np.inf) for c in model.members}
    return min(model.members, key=lambda c: alone[c])


def alternatives(fitted: FittedModels, model: Model) -> dict[str, tuple[str, ...]]:
    """Return for each effect of a model the other names that fit as well in its place.

    A rival takes the place of one effect. It fits as well if the information criteria differ by less than `TIED`, or,
    if even the best model leaves more than noise, if it explains nearly as much.
    """
    out: dict[str, tuple[str, ...]] = {}
    own = set(model.members)
    for c in model.members:
        name = fitted.contest.candidates[c].name
        found: list[str] = []
        for rival in fitted.of_size(len(model.members)):
            others = own - {c}
            if rival is model or not others <= set(rival.members):
                continue
            other = fitted.contest.candidates[next(iter(set(rival.members) - others))].name
            if other not in (name, *found) and _as_good(fitted, rival, model):
                found.append(other)
        out[fitted.contest.candidates[c].acting.label] = tuple(found)
    return out


def _as_good(fitted: FittedModels, rival: Model, model: Model) -> bool:
    if fitted.criterion(rival) - fitted.criterion(model) < TIED:
        return True
    return fitted.reduced_chi2(model) > QUIET and fitted.explained(rival) > fitted.explained(model) - 0.05


def probe_for(names: Sequence[str], rivals: Sequence[str]) -> str:
    """Return the probes that the registry recommends to tell effects from their alternatives."""
    wanted = list(dict.fromkeys([*rivals, *names]))
    return "; ".join(f"for {n}: {effect_of(n).probe}" for n in wanted[:3])
