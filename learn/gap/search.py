"""The search: every candidate fitted jointly with the base, then further effects; and its checkpoint."""

from __future__ import annotations

from dataclasses import dataclass

from ..replay.input_noise import Colour
from .evidence import ALARM, Evidence, lacks_fit
from .models.contest import Batch
from .models.fitted import FittedModels, Model
from .models.levels import LEADERS, first_level, moved, next_level, reduced, refitted
from .models.refit import Fits
from .prepare import Base, add_wood, colour
from .run import Run

#: Steps of a refit after the noise model has changed.
AGAIN = 5


@dataclass
class Searched:
    """Result of a search.

    Attributes:
        fitted: All models that were fitted.
        p_value: Family-wise p-value of the best candidate under the base model.
    """

    fitted: FittedModels
    p_value: float


def nothing_searched(base: Base) -> Searched:
    """Return the base model alone, for a case whose data cannot support a verdict."""
    return Searched(FittedModels(base.contest, Model((), base.fit), []), 1.0)


def search(base: Base, evidence: Evidence, run: Run) -> Searched:
    """Fit the candidates and, if an effect is missing, further ones beside the best; save a checkpoint."""
    with run.timed("fits"):
        contest = base.contest
        models = first_level(contest, evidence.basis, evidence.scan, run.progress)
        models += moved(contest, models[:2])
        fitted = _recoloured(base, FittedModels(contest, Model((), base.fit), models))
        least = run.settings.tolerance * base.motion
        if evidence.p_value <= ALARM or lacks_fit(fitted, least):
            _add_effects(fitted, run)
    searched = Searched(fitted, evidence.p_value)
    _save(searched, run)
    return searched


def _recoloured(base: Base, fitted: FittedModels) -> FittedModels:
    """Linearise noise of the force and bending of wood about the best model instead of the base, and refit."""
    best = fitted.of_size(1)[0]
    fitted.contest.overdispersion = fitted.overdispersion
    if base.force_sigma is not None:
        colour(fitted.contest, best.fit.batch, base.force_sigma)
        add_wood(fitted.contest, best.fit.batch)
    settled = [m for m in fitted.models if m.settled]
    base_again = refitted(fitted.contest, [fitted.base], AGAIN)[0]
    return FittedModels(fitted.contest, base_again, refitted(fitted.contest, settled, AGAIN))


def _add_effects(fitted: FittedModels, run: Run) -> None:
    """Add a second effect to the leading models, and further ones, while these leave more than noise."""
    for count in range(2, run.settings.max_effects + 1):
        leaders = fitted.of_size(count - 1)[:LEADERS]
        if not leaders or not fitted.needs_more(leaders[0]):
            break
        fitted.contest.overdispersion = fitted.overdispersion
        further = next_level(fitted.contest, leaders, run.progress)
        fitted.models += further + reduced(fitted.contest, further[:2])


# ---- checkpoint -----------------------------------------------------------------------------------------------------


def _save(searched: Searched, run: Run) -> None:
    fitted, contest = searched.fitted, searched.fitted.contest
    models = [vars(m) | {"fit": {**vars(m.fit), "batch": vars(m.fit.batch)}} for m in (fitted.base, *fitted.models)]
    noise = {"nuisance": contest.nuisance, "overdispersion": contest.overdispersion}
    noise["colour"] = None if contest.colour is None else vars(contest.colour)
    run.keep.save("search", {"models": models, "p_value": searched.p_value, **noise})


def restored(base: Base, run: Run) -> Searched | None:
    """Return the search of an interrupted run, or None."""
    state = run.keep.load("search")
    if state is None:
        return None
    contest = base.contest
    contest.nuisance, contest.overdispersion = state["nuisance"], state["overdispersion"]
    contest.colour = None if state["colour"] is None else Colour(**state["colour"])
    models = [Model(m["members"], Fits(**{**m["fit"], "batch": Batch(**m["fit"]["batch"])}), m["settled"])
              for m in state["models"]]  # fmt: skip
    return Searched(FittedModels(contest, models[0], models[1:]), state["p_value"])
