"""The search: every candidate fitted jointly with the base, then further effects; and its checkpoint."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache

import torch

from ..cases.case import BranchCase
from ..replay.input_noise import Colour
from .evidence import ALARM, Evidence, bootstrap_test, lacks_fit, retested
from .geometry import in_doubt
from .gusts.answers import GUST
from .gusts.read_off import EXPLAINED, gusts_in
from .gusts.sway import sways
from .models.at_rest import Noise, noise_of_neighbours, noise_of_repeats
from .models.contest import Batch, Contest
from .models.fitted import QUIET, FittedModels, Model, overdispersion, penalty
from .models.idle import spare
from .models.levels import (
    LEADERS,
    at_other_moments,
    begun_again,
    better_of,
    first_level,
    in_plain_form,
    led_whole,
    mirrored,
    moved,
    next_level,
    reduced,
    refitted,
    taken_for,
)
from .models.nested import close, fitted_again, rebased
from .models.nuisance import Nuisances
from .models.refit import Fits, evaluated
from .models.widespread import widespread
from .prepare import Base, answer_as, prepare, settle
from .run import Run

#: Steps of a refit after the noise model has changed.
AGAIN = 5
#: Most times that the first level is fitted: again where a candidate's springs led the base out of a false minimum,
#: which is where its cost fell by this share.
ROUNDS, FALSE = 2, 0.02
#: Least decrease of the base's cost, per unit of overdispersion, after which the p-value is formed anew.
MOVED = 1.0


@dataclass(frozen=True)
class Blown:
    """A branch with gusts of any course.

    Attributes:
        base: The case prepared anew: a search takes for noise what differs from repeat to repeat, and gusts do.
        contest: Of recordings along the courses that were read off.
        fits: Base and gusts fitted to it, a batch of two.
    """

    base: Base
    contest: Contest
    fits: Fits


@dataclass
class Searched:
    """Result of a search.

    Attributes:
        fitted: All models that were fitted.
        p_value: Family-wise p-value of the best candidate under the base model.
        gusts: Reads gusts off the recordings; None where there are none. It does so once.
        blown: Whether gusts left so little that no further effects were searched for.
    """

    fitted: FittedModels
    p_value: float
    gusts: Callable[[], Blown | None] = lambda: None
    blown: bool = False


def nothing_searched(base: Base) -> Searched:
    """Return the base model alone, for a case whose data cannot support a verdict."""
    return Searched(FittedModels(base.contest, Model((), base.fit), []), 1.0)


def search(base: Base, evidence: Evidence, run: Run) -> Searched:
    """Fit all models with the file's geometry, and again with uncertain geometry where the data ask for it.

    A right model with the right geometry leaves noise. Geometry that is off leaves what no effect explains; only then
    is it uncertain, since it can imitate small effects, such as a few grams at the tip. Saves a checkpoint.
    """
    gusts = cache(lambda: _gusts(base, run))
    searched = _searched(base, evidence, run, gusts)
    if not searched.blown and _doubted(base, searched.fitted, run):
        searched = _searched(base, bootstrap_test(base, run), run, gusts)
    _save(base, searched, run)
    return searched


def _doubted(base: Base, fitted: FittedModels, run: Run) -> bool:
    """Return whether geometry and mountings are in doubt beside the best model; they are nuisances then."""
    if not len(fitted.contest.nuisance):
        return False
    with run.timed("base"):
        base.doubted = in_doubt(fitted.contest, fitted.best.fit.batch, run.settings.tolerance * base.motion)
        if base.doubted:
            settle(base)
    return base.doubted


def _gusts(base: Base, run: Run) -> Blown | None:
    """Return a branch with the gusts that are read off its recordings; None where it does not sway or has none."""
    case, names = base.contest.case, base.contest.names
    if not isinstance(case, BranchCase) or GUST not in names or not sways(base.contest):
        return None
    fresh = prepare(case, replace(run, settings=replace(run.settings, effects=(GUST,))))
    with run.timed("fits"):
        found = gusts_in(fresh.contest, fresh.fit)
    return None if found is None else Blown(fresh, *found)


def _blown(fitted: FittedModels, gusts: Callable[[], Blown | None]) -> bool:
    """Return whether gusts leave noise alone where no model so far explains as much as gusts must."""
    best = fitted.best
    if not fitted.needs_more(best) or fitted.explained(best) > EXPLAINED or (found := gusts()) is None:
        return False
    return float(found.fits.chi2[1]) <= QUIET * found.contest.num_samples


def _searched(base: Base, evidence: Evidence, run: Run, gusts: Callable[[], Blown | None]) -> Searched:
    """Fit the candidates and, if an effect is missing, further ones beside the best, unless gusts are all that is.

    No model leaves more than one that it contains, see `models.nested`, and the p-value is that of a base which no
    candidate's springs improve.
    """
    fitted, evidence = _first_level(base, evidence, run)
    with run.timed("fits"):
        _begin_elsewhere(fitted)
        known = base.noise
        fitted = _recoloured(base, fitted)
    if base.noise is not known:
        evidence = bootstrap_test(base, run)
    lacks = evidence.p_value <= ALARM or lacks_fit(fitted, run.settings.tolerance * base.motion)
    blown = lacks and _add_effects(fitted, run, gusts)
    evidence = _closed(base, fitted, evidence, run)
    return Searched(fitted, evidence.p_value, gusts, blown)


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


def _begin_elsewhere(fitted: FittedModels) -> None:
    """Begin single laws again wherever another start may leave less than the scan's."""
    contest = fitted.contest
    fitted_again(fitted, 1)
    fitted.models += moved(contest, fitted.of_size(1)[:LEADERS])
    fitted.models += taken_for(fitted, 1)
    fitted.models += mirrored(contest, fitted.of_size(1)[:LEADERS])
    if fitted.needs_more(fitted.best):
        fitted.models += led_whole(contest)
        fitted.models += at_other_moments(contest, fitted.of_size(1)[:LEADERS])
        fitted.models += in_plain_form(contest, fitted.of_size(1)[:LEADERS])
    _begin_leaders_again(fitted, 1)


def _closed(base: Base, fitted: FittedModels, evidence: Evidence, run: Run) -> Evidence:
    """Fit the base once more from every model, hold all to what they contain, and return the evidence that remains."""
    with run.timed("fits"):
        close(fitted)
        before, fitted.base = fitted.base, rebased(fitted.contest, fitted.base, fitted.models)
        base.fit = fitted.base.fit
        for size in sorted({len(m.members) for m in fitted.models}):
            fitted_again(fitted, size)
        close(fitted)
        spare(fitted)
    moved = before.cost - fitted.base.cost > max(FALSE * before.cost, MOVED * fitted.contest.overdispersion)
    evidence = bootstrap_test(base, run) if moved else evidence
    return retested(base, fitted.best, evidence, run)


def _recoloured(base: Base, fitted: FittedModels) -> FittedModels:
    """Take noise, its response and the nuisances about the likeliest model instead of the base, and refit."""
    contest, model = fitted.contest, fitted.of_size(1)[0]
    contest.overdispersion = fitted.overdispersion
    if base.force_sigma is not None:
        leading = fitted.of_size(1)[: LEADERS if fitted.needs_more(model) else 1]
        model = _answer_as_likeliest(base, [fitted.base, *leading])
    known = base.noise
    for seen in (noise_of_neighbours, noise_of_repeats):
        base.noise = seen(contest, model.fit.batch, base.noise)
        contest.set_noise(base.noise.sigma)
    if base.noise is not known:
        answer_as(base, model.fit.batch)
    settled = [m for m in fitted.models if m.settled]
    base_again = refitted(contest, [fitted.base], AGAIN)[0]
    base.fit = base_again.fit
    return FittedModels(contest, base_again, refitted(contest, settled, AGAIN))


def _answer_as_likeliest(base: Base, models: Sequence[Model]) -> Model:
    """Take the answer to noise of the force, and the nuisances, about that model which is likeliest with its own.

    A law that is not there answers otherwise than the branch: stiction that lets no noise through would make alarms of
    branches without it. Return that model.
    """
    contest, found = base.contest, []
    for model in models:
        answer_as(base, model.fit.batch)
        found.append((_surprise(contest, model), contest.colour, contest.nuisance, model))
    _, contest.colour, contest.nuisance, likeliest = min(found, key=lambda own: own[0])
    return likeliest


def _surprise(contest: Contest, model: Model) -> float:
    """Return minus twice the log likelihood of a model under the present noise, which may be larger, and its penalty.

    Up to a constant; the noise's scale is the likeliest that is not below one.
    """
    chi2 = float(evaluated(contest, model.fit.batch).chi2[0])
    scale = overdispersion(contest, chi2)
    volume = 0.0 if contest.colour is None else float(contest.colour.log_volume(torch.ones(1, device=contest.place))[0])
    return chi2 / scale + contest.num_samples * math.log(scale) + 2.0 * volume + penalty(contest, model.members)


def _add_effects(fitted: FittedModels, run: Run, gusts: Callable[[], Blown | None]) -> bool:
    """Add a second effect to the leading models, and further ones, while these leave more than noise.

    What still does may be one law at more joints than effects are named together. Return whether gusts are all instead:
    two laws of which each says what it does cost less than a course that may be anything, so that these come first.
    """
    for count in range(2, run.settings.max_effects + 1):
        leaders = fitted.of_size(count - 1)[:LEADERS]
        if not leaders or not fitted.needs_more(leaders[0]):
            break
        fitted.contest.overdispersion = fitted.overdispersion
        with run.timed("fits"):
            further = next_level(fitted.contest, leaders, run.progress)
            fitted.models += further
        if _blown(fitted, gusts):
            return True
        with run.timed("fits"):
            _settle_level(fitted, further, count)
    with run.timed("fits"):
        if fitted.needs_more(fitted.best):
            fitted.models += widespread(fitted, run.settings.max_effects)
    return False


def _settle_level(fitted: FittedModels, further: Sequence[Model], count: int) -> None:
    """Begin models of so many effects again wherever another start may leave less: those that were fitted first."""
    contest = fitted.contest
    fitted.models += reduced(contest, further[:2]) + mirrored(contest, further[:2])
    fitted_again(fitted, count, every=True)
    _begin_leaders_again(fitted, count)
    fitted.models += taken_for(fitted, count)
    _begin_leaders_again(fitted, count)
    if fitted.needs_more(fitted.best):
        fitted.models += at_other_moments(contest, fitted.of_size(count)[:1])
    leader = fitted.of_size(count)[:1]
    fitted.models += reduced(contest, leader) + mirrored(contest, leader)


def _begin_leaders_again(fitted: FittedModels, size: int) -> None:
    """Fit the leading models of a size again where the best leaves more than noise, and at joints where any does.

    In a narrow curved valley a fit ends where its steps run out: which of two names was ahead was then decided by the
    last digits of the data.
    """
    leaders = fitted.of_size(size)[:LEADERS]
    at_joints = not isinstance(fitted.contest.case, BranchCase)
    if leaders and (at_joints or fitted.needs_more(leaders[0])):
        begun_again(fitted.contest, leaders)


# ---- checkpoint -----------------------------------------------------------------------------------------------------


def _save(base: Base, searched: Searched, run: Run) -> None:
    fitted, contest = searched.fitted, searched.fitted.contest
    models = [vars(m) | {"fit": {**vars(m.fit), "batch": vars(m.fit.batch)}} for m in (fitted.base, *fitted.models)]
    noise = {"sigma": contest.sigma, "overdispersion": contest.overdispersion}
    noise["nuisance"] = {f.name: getattr(contest.nuisance, f.name) for f in fields(Nuisances)}
    noise["colour"] = None if contest.colour is None else vars(contest.colour)
    told = {"p_value": searched.p_value, "blown": searched.blown, "doubted": base.doubted}
    run.keep.save("search", {"models": models, **told, **noise})


def restored(base: Base, run: Run) -> Searched | None:
    """Return the search of an interrupted run, or None."""
    state = run.keep.load("search")
    if state is None:
        return None
    contest = base.contest
    contest.set_noise(state["sigma"].cpu().numpy())
    base.doubted = state["doubted"]
    base.noise = Noise(state["sigma"].cpu().numpy(), base.noise.spectrum)
    contest.nuisance, contest.overdispersion = Nuisances(**state["nuisance"]), state["overdispersion"]
    contest.colour = None if state["colour"] is None else Colour(**state["colour"])
    models = [Model(m["members"], Fits(**{**m["fit"], "batch": Batch(**m["fit"]["batch"])}), m["settled"], m["rests"],
                    m["idle"])
              for m in state["models"]]  # fmt: skip
    base.fit = models[0].fit
    fitted = FittedModels(contest, models[0], models[1:])
    return Searched(fitted, state["p_value"], cache(lambda: _gusts(base, run)), state["blown"])
