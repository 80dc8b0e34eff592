"""The record of a diagnosis, assembled from the results of its stages, and its verdict in one sentence."""

from __future__ import annotations

from ...sim.base.types import Array
from ..inference.posterior import Posterior
from .decide import Decision
from .diagnosis import Diagnosis, Gap, Rival, Where
from .posterior import Intervals
from .prepare import Base
from .run import Run
from .search import Searched


def record(
    base: Base, searched: Searched, decision: Decision, run: Run, *, gap: Gap, ranking: tuple[Rival, ...],
    posterior: Posterior | None, parameters: Intervals, noise: Array, outputs: tuple[Array, Array], where: Where,
    next_experiment: str,
) -> Diagnosis:  # fmt: skip
    """Return the record of a diagnosis; ``outputs`` are those of the base model and of the repaired one."""
    fitted, contest = searched.fitted, base.contest
    explained = fitted.explained(decision.model)
    return Diagnosis(
        case=contest.case, settings=run.settings, recordings=contest.recordings, sigma=noise, verdict=decision.verdict,
        sentence=sentence(decision, gap, explained, base.unusable), effects=decision.named, parameters=parameters,
        alternatives=decision.alternatives, nearest=decision.nearest, where=where, gap=gap, ranking=ranking,
        explained=explained,
        base_reduced_chi2=fitted.reduced_chi2(fitted.base), motion=base.motion, p_null=searched.p_value,
        base_output=outputs[0], best_output=outputs[1], base_values=fitted.values(fitted.base),
        best_values=fitted.values(decision.final), next_experiment=next_experiment, posterior=posterior,
        world_steps=run.keep.earlier + contest.world_steps, seconds=run.seconds,
    )  # fmt: skip


def sentence(decision: Decision, gap: Gap, explained: float, unusable: str | None) -> str:
    """Return the verdict in one sentence."""
    if unusable is not None:
        return f"The data cannot support a verdict: {unusable}."
    if decision.verdict == "none":
        rmse = f"held-out RMSE {gap.base:.3g} {gap.unit}, noise floor {gap.noise_floor:.3g}"
        return f"No missing effect is detectable in these data: {rmse}."
    if decision.verdict == "unknown":
        return (f"An effect is missing that is none of the known ones; the nearest, {decision.nearest}, explains"
                f" {100 * explained:.0f} % of the excess misfit.")  # fmt: skip
    what = " and ".join(a.name if a.joint is None else f"{a.name} at joint {a.joint}" for a in decision.named)
    return (f"The model lacks {what}: adding it reduces the held-out RMSE from {gap.base:.3g} to {gap.repaired:.3g}"
            f" {gap.unit} (noise floor {gap.noise_floor:.3g}).")  # fmt: skip
