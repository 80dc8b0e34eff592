"""What one effect more would change in the parameters of a model of joints, where it would leave less.

An effect is not named where it only corrects the form of those that are, or where it is the third. What is named has
other values beside it all the same, by more than noise explains: which of the two models is right, the data do not say.
"""

from __future__ import annotations

from ...cases.case import BranchCase
from .fitted import FittedModels, Model, penalty
from .levels import Progress, next_level


def unclaimed(fitted: FittedModels, model: Model, progress: Progress) -> Model | None:
    """Return the best model with one effect more than a model of joints; None where that is no better.

    Better by the information criterion. None for branches.
    """
    if isinstance(fitted.contest.case, BranchCase):
        return None
    best = min(next_level(fitted.contest, [model], progress), key=fitted.criterion, default=None)
    added = 0.0 if best is None else penalty(fitted.contest, sorted(set(best.members) - set(model.members)))
    if best is None or (model.cost - best.cost) / fitted.overdispersion <= added:
        return None
    return best
