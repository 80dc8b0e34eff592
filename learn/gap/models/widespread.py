"""One law at many joints: the friction of every gear of an arm, or the grain of a branch along its whole length.

Effects are named two together if not asked otherwise, since freedom explains anything. A law at every joint is one
name. Where torques are fitted each joint shows its own in its own torque; of a branch's laws those are tried that wood
has everywhere (`Law.throughout`).
"""

from __future__ import annotations

from collections.abc import Sequence

from ....sim.effects import effect_of
from ...cases.case import BranchCase, JointCase
from ...replay.equation_error import fits_torque
from .contest import Batch, activated
from .fitted import FURTHER, FittedModels, Model, overdispersion, penalty
from .levels import reduced
from .refit import fit

#: Laws that are tried: those of the leading models.
LAWS = 3
#: Steps of a fit of all joints, and of one from there with a joint less.
STEPS, LESS = 30, 8
#: Least share of a joint's own excess that the law must explain there.
OWN = 0.4


def widespread(fitted: FittedModels, most: int) -> list[Model]:
    """Return models of one law at more than ``most`` joints, none for replays of joints.

    From all joints those are left out one by one at which the law does not pay for its parameters or, where torques are
    fitted, explains less than `OWN` of what is missing from that joint's torque.
    """
    case = fitted.contest.case
    if isinstance(case, JointCase) and not fits_torque(case):
        return []
    return [m for name in _laws(fitted)[:LAWS] for m in _pruned(fitted, name, most)]


def _laws(fitted: FittedModels) -> list[str]:
    """Return the names of the leading models' laws, best first; of models with more effects for a branch alone."""
    if isinstance(fitted.contest.case, JointCase):
        return list(dict.fromkeys(fitted.names(m)[0] for m in fitted.of_size(1)))
    leading = sorted(fitted.models, key=fitted.criterion)
    names = dict.fromkeys(name for m in leading for name in fitted.names(m))
    return [n for n in names if (law := effect_of(n).branch) is not None and law.throughout]


def _pruned(fitted: FittedModels, name: str, most: int) -> list[Model]:
    """Return the model of a law at all joints where it pays, if these are more than ``most``."""
    candidates = fitted.contest.candidates
    members = tuple(k for k, c in enumerate(candidates) if c.name == name and c.acting.joint is not None)
    if len(members) <= most:
        return []
    model = Model(members, fit(fitted.contest, _begun(fitted, members), STEPS), True)
    while len(model.members) > most:
        parts = reduced(fitted.contest, [model], LESS)
        idle = [m for m in parts if not _pays(fitted, model, m)]
        if not idle:
            return [model, *parts]
        model = min(idle, key=lambda m: m.cost)
    return []


def _begun(fitted: FittedModels, members: Sequence[int]) -> Batch:
    """Return the base with a law at several joints, at each as it was fitted there alone."""
    out = activated(fitted.contest, fitted.base.fit.batch, [members])
    for c in members:
        own = list(fitted.contest.candidates[c].columns)
        alone = min((m for m in fitted.of_size(1) if m.members == (c,)), key=lambda m: m.cost, default=None)
        out.free[:, own] = fitted.contest.centre[own] if alone is None else alone.fit.batch.free[:, own]
    return out


def _pays(fitted: FittedModels, model: Model, part: Model) -> bool:
    """Return whether a joint's law is worth its parameters and, of torques, explains much of what is missing there."""
    contest, (gone,) = fitted.contest, set(model.members) - set(part.members)
    gained = (part.cost - model.cost) / overdispersion(contest, model.chi2) - penalty(contest, (gone,))
    if isinstance(contest.case, BranchCase):
        return gained >= FURTHER
    with_law, without = (_own_excess(fitted, m, gone) for m in (model, part))
    return gained >= FURTHER and without - with_law >= OWN * without


def _own_excess(fitted: FittedModels, model: Model, candidate: int) -> float:
    """Return a model's chi-squared beyond noise in the torque of a candidate's joint."""
    contest = fitted.contest
    case, joint = contest.case, contest.candidates[candidate].acting.joint
    assert isinstance(case, JointCase) and joint is not None
    name = case.joints[joint].name
    channel = next(c for c, item in enumerate(case.inputs) if item.joint == name)
    left = contest.residual(model.fit.batch)[0][..., channel]
    return float((left**2).sum()) - contest.num_samples / len(case.inputs)
