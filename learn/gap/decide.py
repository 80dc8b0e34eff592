"""From fitted models to a verdict: none, effects by name, or unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...sim.effects import effect_of
from ..cases.case import BranchCase, JointCase
from ..replay.equation_error import fits_torque
from ..systems.acting import Acting
from .diagnosis import Settings, VerdictName
from .evidence import ALARM, lacks_fit
from .models.field import QUIET, Field, Model
from .prepare import Base
from .search import Searched

#: Least share of the base's excess that named effects must explain where what they leave is more than noise.
EXPLAINED = 0.87
#: The same where what is left passes for noise.
QUIET_EXPLAINED = 0.7
#: The same of joints that are measured directly: noise is a thousandth of the motion there, so that what a law misses
#: of nature's own counts for much. 0.6 of the squares are a gap that is 1.6 times smaller.
EXPLAINED_JOINT = 0.6
#: The same where torques are predicted from a measured motion, whose own errors no noise estimate holds.
EXPLAINED_TORQUE = 0.25
#: By how much an information criterion must prefer a further effect, and which share of what is left it must explain.
FURTHER, FURTHER_SHARE, FURTHER_SHARE_TORQUE = 20.0, 0.3, 0.1
#: Least share of the base's excess that a further effect must explain, in a branch and at joints measured directly:
#: laws differ in form from what they stand for, by a quarter of what they do, and an effect that only makes up for that
#: is none. Half of that will do for one that explains `MOST` of what is left, and less for one that explains
#: `NEARLY_ALL`, which ends the search: no law makes up for another one's form so well.
WORTH, WORTH_JOINT, MOST, NEARLY_ALL = 0.1, 0.08, 0.88, 0.93
#: Least share of a branch's excess that the same law at two joints must explain to be named.
TWICE = 0.97
#: Models this little behind the best in the information criterion cannot be told from it.
TIED = 12.0


@dataclass(frozen=True)
class Decision:
    """What the fitted models come to.

    Attributes:
        verdict: ``none``, ``effects`` or ``unknown``.
        base: The base model.
        model: The model that is best worth its effects, claimed or not.
        final: The repaired model: ``model``, or the base where nothing is missing.
        named: Effects that are claimed.
        alternatives: For each of them the names that this data cannot tell from it.
        nearest: For ``unknown`` the closest name, not claimed; None where the case can say nothing.
    """

    verdict: VerdictName
    base: Model
    model: Model
    final: Model
    named: tuple[Acting, ...] = ()
    alternatives: dict[str, tuple[str, ...]] = field(default_factory=dict)
    nearest: str | None = None


def decide(base: Base, searched: Searched, settings: Settings) -> Decision:
    """Return the verdict, the model that it rests on, and its names."""
    models = searched.field
    model = chosen(models, settings.max_effects)
    verdict = _verdict(base, searched, model, settings.tolerance)
    candidates = models.contest.candidates
    if verdict == "effects":
        named = tuple(candidates[c].acting for c in model.members)
        return Decision(verdict, models.base, model, model, named, alternatives(models, model))
    if verdict == "none":
        return Decision(verdict, models.base, model, models.base)
    nearest = None if base.unusable else candidates[leading(models, model)].name
    return Decision(verdict, models.base, model, model, nearest=nearest)


def _verdict(base: Base, searched: Searched, model: Model, tolerance: float) -> VerdictName:
    if base.unusable is not None:
        return "unknown"
    models = searched.field
    small = searched.p_value > ALARM or size(models, model, base.motion) < tolerance
    if small and not lacks_fit(models, tolerance * base.motion):
        return "none"
    return "effects" if known(models, model) else "unknown"


def chosen(field: Field, most: int) -> Model:
    """Return the model that is best worth its effects: one more only where it explains much of what is left.

    The base where nothing else was fitted.
    """
    best = _single(field)
    for count in range(2, most + 1):
        further = field.of_size(count)
        if not further or not _worth_more(field, best, further[0]):
            break
        best = further[0]
    return best


def _worth_more(field: Field, best: Model, trial: Model) -> bool:
    """Return whether a model is worth its one effect more: by the criterion, of what is left, and of the whole gap."""
    case = field.contest.case
    share = FURTHER_SHARE_TORQUE if fits_torque(case) else FURTHER_SHARE
    worth = WORTH if isinstance(case, BranchCase) else WORTH_JOINT
    left = best.chi2 - field.contest.num_samples
    removed = best.chi2 - trial.chi2
    if field.criterion(best) - field.criterion(trial) < FURTHER or removed < share * max(left, 0.0):
        return False
    if field.needs_more(best) and removed > NEARLY_ALL * left:
        return True
    least = 0.5 * worth if removed > MOST * left else worth
    return field.explained(trial) - field.explained(best) >= least


def _single(field: Field) -> Model:
    """Return the best model with one effect; of those that tie, one in a pair that is clearly better than any."""
    singles, pairs = field.of_size(1), field.of_size(2)
    best = next(iter(singles), field.base)
    if not pairs or field.criterion(best) - field.criterion(pairs[0]) < FURTHER:
        return best
    tied = [m for m in singles if field.criterion(m) - field.criterion(best) < TIED]
    return next((m for m in tied if set(m.members) <= set(pairs[0].members)), best)


def size(field: Field, model: Model, motion: float) -> float:
    """Return the change of the motion that a model makes against the base, as a share of the motion's rms.

    ``motion`` is that rms in units of the noise. In these units the rms change of all channels is the root of the
    reduced chi-squared that the model explains.
    """
    gained = max(field.base.chi2 - model.chi2, 0.0) / field.contest.num_samples
    return float(np.sqrt(gained)) / motion


def known(field: Field, model: Model) -> bool:
    """Return whether a model explains enough for its effects to be named.

    What is on no list is easily made up of one law at two joints of a branch, so that must explain nearly all.
    """
    least = _least(field.contest.case)
    if isinstance(field.contest.case, BranchCase) and len(set(field.names(model))) < len(model.members):
        return field.explained(model) >= TWICE
    if field.reduced_chi2(model) <= QUIET:
        least = min(least, QUIET_EXPLAINED)
    return field.explained(model) >= least


def leading(field: Field, model: Model) -> int:
    """Return which of a model's effects explains most by itself; the first where none was fitted alone."""
    alone = {c: min((m.chi2 for m in field.of_size(1) if m.members == (c,)), default=np.inf) for c in model.members}
    return min(model.members, key=lambda c: alone[c])


def _least(case: BranchCase | JointCase) -> float:
    if fits_torque(case):
        return EXPLAINED_TORQUE
    return EXPLAINED if isinstance(case, BranchCase) else EXPLAINED_JOINT


def alternatives(field: Field, model: Model) -> dict[str, tuple[str, ...]]:
    """Return for each effect of a model the other names that fit as well in its place.

    A rival takes the place of one effect. It fits as well when the information criterion hardly tells, or, where even
    the best leaves more than noise, when it explains nearly as much: laws differ in form from what they stand for.
    """
    out: dict[str, tuple[str, ...]] = {}
    own = set(model.members)
    for c in model.members:
        name = field.contest.candidates[c].name
        found: list[str] = []
        for rival in field.of_size(len(model.members)):
            others = own - {c}
            if rival is model or not others <= set(rival.members):
                continue
            other = field.contest.candidates[next(iter(set(rival.members) - others))].name
            if other not in (name, *found) and _as_good(field, rival, model):
                found.append(other)
        out[field.contest.candidates[c].acting.label] = tuple(found)
    return out


def _as_good(field: Field, rival: Model, model: Model) -> bool:
    if field.criterion(rival) - field.criterion(model) < TIED:
        return True
    return field.reduced_chi2(model) > QUIET and field.explained(rival) > field.explained(model) - 0.05


def probe_for(names: Sequence[str], rivals: Sequence[str]) -> str:
    """Return the probe that the registry recommends to tell effects from what they are taken for."""
    wanted = list(dict.fromkeys([*rivals, *names]))
    return "; ".join(f"for {n}: {effect_of(n).probe}" for n in wanted[:3])
