"""The record of a diagnosis, assembled from the results of its stages, and its verdict in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

from ...sim.base.types import Array
from .decide import Decision
from .diagnosis import Diagnosis, Gap, Rival, Where
from .prepare import Base
from .repaired import Repaired
from .run import Run
from .search import Searched


def record(
    base: Base, searched: Searched, decision: Decision, run: Run, *, repaired: Repaired, ranking: tuple[Rival, ...],
    noise: Array, where: Where, next_experiment: str,
) -> Diagnosis:  # fmt: skip
    """Return the record of a diagnosis."""
    fitted, contest = searched.fitted, base.contest
    explained = fitted.explained(decision.model)
    return Diagnosis(
        case=contest.case, settings=run.settings, recordings=contest.recordings, sigma=noise, verdict=decision.verdict,
        sentence=sentence(decision, repaired.gap, explained, base.unusable) + stand_in(repaired.implausible),
        effects=decision.named, parameters=repaired.parameters,
        alternatives=decision.alternatives, nearest=decision.nearest, where=where, gap=repaired.gap, ranking=ranking,
        explained=explained,
        base_reduced_chi2=fitted.reduced_chi2(fitted.base), motion=base.motion, p_null=searched.p_value,
        base_output=repaired.base_output, best_output=repaired.output, base_values=repaired.base_values,
        best_values=repaired.values, next_experiment=next_experiment, model=repaired.model,
        implausible=repaired.implausible, posterior=repaired.posterior,
        world_steps=contest.world_steps, seconds=run.seconds,
    )  # fmt: skip


def stand_in(implausible: Sequence[str]) -> str:
    """Return what to think of a name whose value nature does not have; empty where there is none."""
    if not implausible:
        return ""
    return f" It has a value that nature does not have: {'; '.join(implausible)}. Treat the name as a stand-in."


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
