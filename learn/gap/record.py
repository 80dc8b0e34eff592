"""The record of a diagnosis, assembled from the results of its stages and held against itself."""

from __future__ import annotations

from dataclasses import replace

from ...sim.base.types import Array
from ..systems.model_file import BranchModel
from .consistent import consistent, percent
from .decide import Decision, predicts, size
from .diagnosis import Diagnosis, Geometry, Rival, Where
from .geometry import alone, explained_by, instead
from .models.fitted import FittedModels
from .models.memoryless import left_without_memory, without_memory
from .prepare import Base
from .repaired import Repaired
from .run import Run
from .search import Searched
from .usable import different_plants, one_way, rests_elsewhere
from .where import replicate_scatter, swing_of

#: Of gusts whose course was read off the recordings.
READ_OFF = (
    "What blew in each recording was read off its motion: the branch sways before it is touched, and differs from"
    " repeat to repeat. The model tells what blew then and foretells no gust; springs and dampers have their intervals"
    " beside these courses."
)


def record(
    base: Base, searched: Searched, decision: Decision, run: Run, *, repaired: Repaired, ranking: tuple[Rival, ...],
    noise: Array, where: Where, next_experiment: str,
) -> Diagnosis:  # fmt: skip
    """Return the record of a diagnosis.

    What its results do not bear out is no verdict: it becomes ``unknown`` with what is not understood (`consistent`).
    """
    fitted, contest, gap = searched.fitted, base.contest, repaired.gap
    case, recordings = contest.case, contest.recordings
    with run.timed("checks"):
        unusable = base.unusable or different_plants(fitted, decision.model)
        beside = _beside(base, fitted, decision) if base.doubted else Geometry()
        askew = beside.share > run.settings.tolerance
        ahead = decision.verdict == "effects" and askew and predicts(fitted, decision.final)
    remarks = (*one_way(case, recordings, fitted.values(fitted.base)),
               *rests_elsewhere(case, recordings, repaired.base_output))  # fmt: skip
    asked = decision.verdict == "unknown" and not base.unusable
    memoryless = left_without_memory(fitted, decision.model) if asked else 0.0
    remarks += without_memory(memoryless)
    if askew and not base.unusable:
        remarks += ("Geometry and mountings that are not quite as the file says explain"
                    f" {percent(beside.share)} of the motion (furthest: {beside.furthest}).",)  # fmt: skip
    if isinstance(repaired.model, BranchModel) and repaired.model.held_out is not None:
        other = " and ".join(repaired.model.held_out)
        remarks += (f"What is missing shows only in recordings held out by default: {other} is held out instead.",)
    if isinstance(repaired.model, BranchModel) and repaired.model.courses:
        remarks += (READ_OFF,)
    if decision.ended:
        remarks += (f"{' and '.join(decision.ended)} would leave less, but at an end of its box where it is the law"
                    " that is named.",)  # fmt: skip
    return consistent(Diagnosis(
        case=case, settings=run.settings, recordings=recordings, sigma=noise, verdict=decision.verdict,
        sentence="", effects=decision.named, parameters=repaired.parameters, alternatives=decision.alternatives,
        nearest=decision.nearest, where=where, gap=gap, ranking=ranking, explained=fitted.explained(decision.model),
        base_reduced_chi2=fitted.reduced_chi2(fitted.base), motion=base.motion, p_null=searched.p_value,
        base_output=repaired.base_output, best_output=repaired.output, base_values=repaired.base_values,
        best_values=repaired.values, next_experiment=next_experiment, model=repaired.model,
        implausible=repaired.implausible, posterior=repaired.posterior,
        world_steps=run.keep.earlier + contest.world_steps, seconds=run.seconds, tried=fitted.labels(decision.final),
        size=0.0 if base.unusable else size(fitted, decision.model, base.motion), unusable=unusable,
        swing=swing_of(case, recordings, gap.test or range(len(recordings))),
        scatter=replicate_scatter(case, recordings), remarks=remarks, memoryless=memoryless,
        unstable=decision.unstable, may_be_off=decision.may_be_off, stretched=decision.stretched,
        geometry=beside, ahead=ahead, nested=not fitted.broken(),
    ))  # fmt: skip


def _beside(base: Base, fitted: FittedModels, decision: Decision) -> Geometry:
    """Return what geometry and mountings explain beside the named effects, or else all that they could explain."""
    free = alone(base.contest, fitted.base.fit)
    shown = decision.final.fit if decision.verdict == "effects" else free
    other = instead(base.contest, free, decision.model.fit)
    return replace(explained_by(base.contest, shown, base.motion), instead=other)
