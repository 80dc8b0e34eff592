"""What a model of a case lacks: the stages of a diagnosis in their order, and the folder that one leaves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...sim.base.errors import InputError
from ...sim.base.files import output_folder
from ...version import __version__
from ..cases.case import BranchCase, JointCase, load_case
from ..replay.choice import Choice, choose
from ..runs.checkpoint import Checkpoint, digest
from ..runs.threads import one_thread
from .decide import Decision, decide
from .diagnosis import Diagnosis, Settings
from .evidence import bootstrap_test
from .models.candidates import names_for
from .models.fitted import FittedModels, Model
from .models.idle import lean
from .models.unclaimed import unclaimed
from .next_probe import next_experiment
from .prepare import Base, prepare
from .record import record
from .repaired import repair
from .rivals import ahead, rank
from .run import Progress, Run, silent
from .search import Blown, Searched, nothing_searched, restored, search
from .steady import steadied
from .where import locate, noise_seen


def find_missing(case: BranchCase | JointCase, run: Run) -> Diagnosis:
    """Return what the model of a case lacks.

    Of joints that move faster than the filter of torques a replay is judged, and torques where that names nothing.

    Raises:
        InputError: The settings cannot be, or an effect that they name cannot act in such a case.
    """
    choice = choose(case, run.settings.fit)  # replay or torque, before anything depends on it
    found = _judged(choice, run)
    if found.verdict != "unknown" or not choice.torn:
        return found
    other = _judged(choice.turned(), replace(run, keep=replace(run.keep, part="turned-"), seconds={}))
    return other if other.verdict == "effects" else found


def _judged(choice: Choice, run: Run) -> Diagnosis:
    """Return what the model lacks, fitted in one way: every stage takes the records of those before it."""
    case = choice.case
    check(case, run.settings)
    with run.timed("total"):
        base = prepare(case, run)  # noise, fit of the base model, and whether the case can say anything
        run.keep.count = lambda: base.contest.world_steps
        searched = nothing_searched(base) if base.unusable else restored(base, run)
        if searched is None:
            evidence = bootstrap_test(base, run)  # a scan of all candidates, and the p-value of the best
            searched = search(base, evidence, run)  # joint refits of all candidates, then further effects
        models = searched.fitted
        with run.timed("evidence"):
            decision = decide(base, searched, run.settings)  # none, effects by name, or unknown
            decision = steadied(base, searched, decision, run)  # joints: the same under another filter, rate or split
            gusts = searched.gusts() if searched.blown or decision.verdict == "unknown" else None
            if gusts is None:
                decision = _claimed(models, decision, run)
            run.progress("evidence", 1)
            ranking = rank(models, decision)  # all models; the leading ones where they were not fitted
            if gusts is not None:  # a branch that sways untouched: what blows is read off it
                base, searched, decision = _blown(searched, gusts, run)
                ranking = ahead(searched.fitted, decision.model, ranking)
            models, contest = searched.fitted, base.contest
        repaired = repair(base, decision, run)  # one model that is fitted, inferred, written, and misses what it misses
        noise = noise_seen(contest)
        where = locate(case, contest.recordings, noise, repaired.base_output, repaired.base_stiffness)
        probe = base.unusable or next_experiment(models, decision)
    found = record(
        base, searched, decision, run, repaired=repaired, ranking=ranking, noise=noise, where=where,
        next_experiment=probe,
    )  # fmt: skip
    return replace(found, fit=choice.stated)


def _claimed(models: FittedModels, decision: Decision, run: Run) -> Decision:
    """Return a decision whose named model holds what these data show, and what it does not claim beside it."""
    if decision.verdict != "effects":
        return decision
    decision = replace(decision, final=lean(models, decision.model))
    return replace(decision, further=unclaimed(models, decision.final, run.progress))


def _blown(searched: Searched, found: Blown, run: Run) -> tuple[Base, Searched, Decision]:
    """Return a branch with gusts of any course and these named: they are all that is, or nothing else is named."""
    own, fits, contest = found.contest, found.fits, searched.fitted.contest
    plain, model = Model((), fits.one(0), settled=True), Model((0,), fits.one(1), settled=True)
    acting = own.candidates[0].acting
    named = Decision("effects", plain, model, model, (acting,), {acting.label: ()})
    blowing = replace(found.base, contest=own, fit=plain.fit)
    run.keep.earlier += contest.world_steps + found.base.contest.world_steps  # from now on the new one's are counted
    return blowing, Searched(FittedModels(own, plain, [model]), searched.p_value), named


def check(case: BranchCase | JointCase, settings: Settings) -> None:
    """Raise `InputError` for settings that cannot be."""
    settings.check()
    names_for(case, settings.effects)


def diagnose(
    given: BranchCase | JointCase | str | Path, out: str | Path, settings: Settings | None = None, *,
    resume: bool = False, progress: Progress = silent,
) -> Diagnosis:  # fmt: skip
    """Diagnose a case, as loaded or by its folder, and write verdict, repaired model, figures and report into ``out``.

    Args:
        given: The case, or its folder.
        out: Folder to write; whole or not at all.
        settings: None takes those of ``bough diagnose`` without options.
        resume: Go on with a killed run of the same case, settings and ``out``.
        progress: Called with the stage and how much of it is done.

    Returns:
        Verdict, effects with intervals, where the residual is, held-out error before and after.

    Raises:
        InputError: The case or the settings cannot be used; nothing is written then.
    """
    target, settings = Path(out), settings or Settings()
    with output_folder(target) as work:
        case = given if isinstance(given, BranchCase | JointCase) else load_case(given)
        check(choose(case, settings.fit).case, settings)
        keep = Checkpoint(target.absolute().parent / f".{target.name}.unfinished", _key(case, settings))
        keep.open(resume)
        try:
            with one_thread():
                found = find_missing(case, Run(settings, keep, progress))
        except InputError:
            keep.close()
            raise
        from .report import write_diagnosis, write_models  # matplotlib, once there is something to show

        write_diagnosis(work, found)
        write_models(work, found)
        keep.close()
    return found


def _key(case: BranchCase | JointCase, settings: Settings) -> str:
    return digest(case.folder, settings, __version__)
