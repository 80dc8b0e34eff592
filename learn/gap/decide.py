"""From fitted models to a verdict: none, effects by name, or unknown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...sim.effects import effect_of
from ..cases.case import BranchCase, JointCase
from ..replay.equation_error import fits_torque
from .contest import Contest
from .search import Model, overdispersion, penalty

#: Family-wise p-value above which nothing is said to be missing.
ALARM = 0.01
#: Squares of the base's excess per number above which something is missing even where no candidate explains any of it:
#: no estimate of the noise is so wrong.
LACK = 1.0
#: Squares per number up to which what is left passes for noise, whose size is itself an estimate; and the least share
#: of the excess that named effects must explain then.
QUIET, QUIET_EXPLAINED = 1.15, 0.7
#: Least share of the base's excess that named effects must explain where what they leave is more than noise.
EXPLAINED = 0.87
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


@dataclass
class Field:
    """All models that were fitted to a case.

    Attributes:
        contest: Where they were fitted.
        base: The base model.
        models: With one effect and with more, in any order.
    """

    contest: Contest
    base: Model
    models: list[Model]

    @property
    def best(self) -> Model:
        """The model with the least squares."""
        return min([self.base, *self.models], key=lambda m: m.chi2)

    @property
    def overdispersion(self) -> float:
        """Squares left per number by the best model, at least one."""
        return overdispersion(self.contest, self.best.chi2)

    def criterion(self, model: Model) -> float:
        """Return the information criterion of a model: misfit over the overdispersion, and what its parameters cost."""
        return model.cost / self.overdispersion + penalty(self.contest, model.members)

    def explained(self, model: Model) -> float:
        """Return the share of the base's excess over the noise that a model explains.

        The estimate of the noise may be a little large: the best model counts as noise where it leaves less.
        """
        excess = self.base.chi2 - min(float(self.contest.num_samples), self.best.chi2)
        return (self.base.chi2 - model.chi2) / excess if excess > 0.0 else 0.0

    def of_size(self, count: int) -> list[Model]:
        """Return the models with a number of effects, by the information criterion."""
        return sorted((m for m in self.models if len(m.members) == count), key=self.criterion)

    def names(self, model: Model) -> tuple[str, ...]:
        """Return the names of a model's effects."""
        return tuple(self.contest.candidates[c].name for c in model.members)


def needs_more(field: Field, model: Model) -> bool:
    """Return whether a model leaves more than noise."""
    return model.chi2 / field.contest.num_samples > 0.5 * (1.0 + QUIET)


def chosen(field: Field, most: int) -> Model:
    """Return the model that is best worth its effects: one more only where it explains much of what is left.

    The base where nothing else was fitted.
    """
    best = _single(field)
    share = FURTHER_SHARE_TORQUE if fits_torque(field.contest.case) else FURTHER_SHARE
    worth = WORTH if isinstance(field.contest.case, BranchCase) else WORTH_JOINT
    for count in range(2, most + 1):
        further = field.of_size(count)
        if not further:
            break
        trial = further[0]
        left = best.chi2 - field.contest.num_samples
        gained = field.criterion(best) - field.criterion(trial)
        removed = best.chi2 - trial.chi2
        if gained < FURTHER or removed < share * max(left, 0.0):
            break
        ends = needs_more(field, best) and removed > NEARLY_ALL * left
        least = 0.5 * worth if removed > MOST * left else worth
        if not ends and field.explained(trial) - field.explained(best) < least:
            break
        best = trial
    return best


def _single(field: Field) -> Model:
    """Return the best model with one effect; of those that tie, one in a pair that is clearly better than any."""
    singles, pairs = field.of_size(1), field.of_size(2)
    best = next(iter(singles), field.base)
    if not pairs or field.criterion(best) - field.criterion(pairs[0]) < FURTHER:
        return best
    tied = [m for m in singles if field.criterion(m) - field.criterion(best) < TIED]
    return next((m for m in tied if set(m.members) <= set(pairs[0].members)), best)


def size(field: Field, model: Model, rms: float) -> float:
    """Return the change of the motion that a model makes against the base, as a share of the motion's rms.

    In units of the noise the rms change of all channels is the root of the squares per number it explains.
    """
    gained = max(field.base.chi2 - model.chi2, 0.0) / field.contest.num_samples
    return float(np.sqrt(gained)) / rms


def lacks_fit(contest: Contest, base: Model, least: float) -> bool:
    """Return whether a base leaves far more than noise, and more in all than the rms ``least``, in units of noise."""
    excess = base.chi2 / contest.num_samples - 1.0
    return excess > LACK and float(np.sqrt(excess)) > least


def known(field: Field, model: Model) -> bool:
    """Return whether a model explains enough for its effects to be named.

    What is on no list is easily made up of one law at two joints of a branch, so that must explain nearly all.
    """
    least = _least(field.contest.case)
    if isinstance(field.contest.case, BranchCase) and len(set(field.names(model))) < len(model.members):
        return field.explained(model) >= TWICE
    if model.chi2 / field.contest.num_samples <= QUIET:
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
    leftover = model.chi2 / field.contest.num_samples
    return leftover > QUIET and field.explained(rival) > field.explained(model) - 0.05


def probe_for(names: Sequence[str], rivals: Sequence[str]) -> str:
    """Return the probe that the registry recommends to tell effects from what they are taken for."""
    wanted = list(dict.fromkeys([*rivals, *names]))
    return "; ".join(f"for {n}: {effect_of(n).probe}" for n in wanted[:3])
