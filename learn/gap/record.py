"""The record of a diagnosis, assembled from the results of its stages and held against itself."""

from __future__ import annotations

from ...sim.base.types import Array
from ..inference.posterior import Posterior
from .consistent import consistent
from .decide import Decision, size
from .diagnosis import Diagnosis, Gap, Rival, Where
from .posterior import Intervals
from .prepare import Base
from .run import Run
from .search import Searched
from .usable import different_plants, one_way
from .where import replicate_scatter, swing_of


def record(
    base: Base, searched: Searched, decision: Decision, run: Run, *, gap: Gap, ranking: tuple[Rival, ...],
    posterior: Posterior | None, parameters: Intervals, noise: Array, outputs: tuple[Array, Array], where: Where,
    next_experiment: str,
) -> Diagnosis:  # fmt: skip
    """Return the record of a diagnosis; ``outputs`` are those of the base model and of the repaired one.

    What its results do not bear out is no verdict: it becomes ``unknown`` with what is not understood (`consistent`).
    """
    fitted, contest = searched.fitted, base.contest
    case, recordings, base_values = contest.case, contest.recordings, fitted.values(fitted.base)
    with run.timed("checks"):
        unusable = base.unusable or different_plants(fitted, decision.model)
    return consistent(Diagnosis(
        case=case, settings=run.settings, recordings=recordings, sigma=noise, verdict=decision.verdict,
        sentence="", effects=decision.named, parameters=parameters, alternatives=decision.alternatives,
        nearest=decision.nearest, where=where, gap=gap, ranking=ranking, explained=fitted.explained(decision.model),
        base_reduced_chi2=fitted.reduced_chi2(fitted.base), motion=base.motion, p_null=searched.p_value,
        base_output=outputs[0], best_output=outputs[1], base_values=base_values,
        best_values=fitted.values(decision.final), next_experiment=next_experiment, posterior=posterior,
        world_steps=contest.world_steps, seconds=run.seconds, tried=fitted.labels(decision.final),
        size=size(fitted, decision.model, base.motion), unusable=unusable,
        swing=swing_of(case, recordings, gap.test or range(len(recordings))),
        scatter=replicate_scatter(case, recordings), remarks=one_way(case, recordings, base_values),
    ))  # fmt: skip
