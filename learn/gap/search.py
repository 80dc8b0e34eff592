"""The search: every candidate fitted beside the base, then further effects; and how a killed run goes on from it."""

from __future__ import annotations

from dataclasses import dataclass

from ..replay.input_noise import Colour
from .evidence import ALARM, Evidence, lacks_fit
from .models.contest import Rows
from .models.field import Field, Model
from .models.levels import LEADERS, first_level, moved, next_level, reduced, refitted
from .models.refit import Fits
from .prepare import Base, add_wood, colour
from .run import Run

#: Steps of a refit after the noise model has changed.
AGAIN = 5


@dataclass
class Searched:
    """What a search came to.

    Attributes:
        field: All models that were fitted.
        p_value: Family-wise p-value of the best candidate under the base model.
    """

    field: Field
    p_value: float


def nothing_searched(base: Base) -> Searched:
    """Return the base model alone, for a case that can say nothing."""
    return Searched(Field(base.contest, Model((), base.fit), []), 1.0)


def search(base: Base, evidence: Evidence, run: Run) -> Searched:
    """Fit all candidates that are worth it, and keep what was found."""
    with run.timed("fits"):
        contest = base.contest
        models = first_level(contest, evidence.basis, evidence.scan, run.progress)
        models += moved(contest, models[:2])
        field = _recoloured(base, Field(contest, Model((), base.fit), models))
        least = run.settings.tolerance * base.motion
        if evidence.p_value <= ALARM or lacks_fit(field, least):
            _add_effects(field, run)
    searched = Searched(field, evidence.p_value)
    _save(searched, run)
    return searched


def _recoloured(base: Base, field: Field) -> Field:
    """Take noise of the force and bending of wood through the best model instead of a base that is far off."""
    best = field.of_size(1)[0]
    field.contest.overdispersion = field.overdispersion
    if base.force_sigma is not None:
        colour(field.contest, best.fit.rows, base.force_sigma)
        add_wood(field.contest, best.fit.rows)
    settled = [m for m in field.models if m.settled]
    base_again = refitted(field.contest, [field.base], AGAIN)[0]
    return Field(field.contest, base_again, refitted(field.contest, settled, AGAIN))


def _add_effects(field: Field, run: Run) -> None:
    """Fit a second effect beside the leading models, and further ones, while these leave more than noise."""
    for count in range(2, run.settings.max_effects + 1):
        leaders = field.of_size(count - 1)[:LEADERS]
        if not leaders or not field.needs_more(leaders[0]):
            break
        field.contest.overdispersion = field.overdispersion
        further = next_level(field.contest, leaders, run.progress)
        field.models += further + reduced(field.contest, further[:2])


# ---- a killed run ---------------------------------------------------------------------------------------------------


def _save(searched: Searched, run: Run) -> None:
    field, contest = searched.field, searched.field.contest
    models = [vars(m) | {"fit": {**vars(m.fit), "rows": vars(m.fit.rows)}} for m in (field.base, *field.models)]
    noise = {"nuisance": contest.nuisance, "overdispersion": contest.overdispersion}
    noise["colour"] = None if contest.colour is None else vars(contest.colour)
    run.keep.save("search", {"models": models, "p_value": searched.p_value, **noise})


def restored(base: Base, run: Run) -> Searched | None:
    """Return what a killed run had found, or None."""
    state = run.keep.load("search")
    if state is None:
        return None
    contest = base.contest
    contest.nuisance, contest.overdispersion = state["nuisance"], state["overdispersion"]
    contest.colour = None if state["colour"] is None else Colour(**state["colour"])
    models = [Model(m["members"], Fits(**{**m["fit"], "rows": Rows(**m["fit"]["rows"])}), m["settled"])
              for m in state["models"]]  # fmt: skip
    return Searched(Field(contest, models[0], models[1:]), state["p_value"])
