"""The search: every candidate fitted jointly with the base, then further effects; and its checkpoint."""

from __future__ import annotations

from dataclasses import dataclass

from ..replay.input_noise import Colour
from .evidence import ALARM, Evidence, bootstrap_test, lacks_fit
from .models.at_rest import Noise
from .models.contest import Batch
from .models.fitted import FittedModels, Model
from .models.levels import LEADERS, better_of, first_level, moved, next_level, reduced, refitted
from .models.nested import close, fitted_again, rebased
from .models.refit import Fits
from .prepare import Base, add_wood, colour, settle
from .run import Run

#: Steps of a refit after the noise model has changed.
AGAIN = 5
#: Most times that the first level is fitted: again where a candidate's springs led the base out of a false minimum,
#: which is where its cost fell by this share.
ROUNDS, FALSE = 2, 0.02
#: Least decrease of the base's cost, per unit of overdispersion, after which the p-value is formed anew.
MOVED = 1.0


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
    """Fit the candidates and, if an effect is missing, further ones beside the best; save a checkpoint.

    No model leaves more than one that it contains, see `models.nested`, and the p-value is that of a base which no
    candidate's springs improve.
    """
    fitted, evidence = _first_level(base, evidence, run)
    with run.timed("fits"):
        fitted_again(fitted, 1)
        fitted.models += moved(fitted.contest, fitted.of_size(1)[:2])
        fitted = _recoloured(base, fitted)
        least = run.settings.tolerance * base.motion
        if evidence.p_value <= ALARM or lacks_fit(fitted, least):
            _add_effects(fitted, run)
    evidence = _closed(base, fitted, evidence, run)
    searched = Searched(fitted, evidence.p_value)
    _save(searched, run)
    return searched


def _first_level(base: Base, evidence: Evidence, run: Run) -> tuple[FittedModels, Evidence]:
    """Fit every candidate beside the base and the base from every candidate, until neither leads the other on."""
    earlier: list[Model] = []
    for _ in range(ROUNDS):
        with run.timed("fits"):
            models = first_level(base.contest, evidence.basis, evidence.scan, run.progress)
            models = better_of(base.contest, models, earlier)
            better = rebased(base.contest, Model((), base.fit), models).fit
        fallen, base.fit, before = float(base.fit.cost[0] - better.cost[0]), better, float(base.fit.cost[0])
        if fallen > FALSE * before:
            with run.timed("base"):
                settle(base)
            earlier = models
        if fallen > MOVED * base.contest.overdispersion:
            evidence = bootstrap_test(base, run)
        if fallen <= FALSE * before:
            break
    return FittedModels(base.contest, Model((), base.fit), models), evidence


def _closed(base: Base, fitted: FittedModels, evidence: Evidence, run: Run) -> Evidence:
    """Fit the base once more from every model, hold all to what they contain, and return the evidence that remains."""
    with run.timed("fits"):
        close(fitted)
        before, fitted.base = fitted.base, rebased(fitted.contest, fitted.base, fitted.models)
        base.fit = fitted.base.fit
        for size in sorted({len(m.members) for m in fitted.models}):
            fitted_again(fitted, size)
        close(fitted)
    moved = before.cost - fitted.base.cost > max(FALSE * before.cost, MOVED * fitted.contest.overdispersion)
    return bootstrap_test(base, run) if moved else evidence


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
        fitted_again(fitted, count, every=True)


# ---- checkpoint -----------------------------------------------------------------------------------------------------


def _save(searched: Searched, run: Run) -> None:
    fitted, contest = searched.fitted, searched.fitted.contest
    models = [vars(m) | {"fit": {**vars(m.fit), "batch": vars(m.fit.batch)}} for m in (fitted.base, *fitted.models)]
    noise = {"sigma": contest.sigma, "nuisance": contest.nuisance, "overdispersion": contest.overdispersion}
    noise["colour"] = None if contest.colour is None else vars(contest.colour)
    run.keep.save("search", {"models": models, "p_value": searched.p_value, **noise})


def restored(base: Base, run: Run) -> Searched | None:
    """Return the search of an interrupted run, or None."""
    state = run.keep.load("search")
    if state is None:
        return None
    contest = base.contest
    contest.set_noise(state["sigma"].cpu().numpy())
    base.noise = Noise(state["sigma"].cpu().numpy(), base.noise.spectrum)
    contest.nuisance, contest.overdispersion = state["nuisance"], state["overdispersion"]
    contest.colour = None if state["colour"] is None else Colour(**state["colour"])
    models = [Model(m["members"], Fits(**{**m["fit"], "batch": Batch(**m["fit"]["batch"])}), m["settled"], m["rests"])
              for m in state["models"]]  # fmt: skip
    base.fit = models[0].fit
    return Searched(FittedModels(contest, models[0], models[1:]), state["p_value"])
