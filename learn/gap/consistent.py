"""Results of a diagnosis held against each other before anything is written: what contradicts is no verdict.

Verdict, p-value, share explained, size of the effect and held-out error come from different computations: a scan, a
bootstrap, joint refits, and refits to the training recordings alone. Each may be right and say something else.
A page that names an effect beside a held-out error that grew, or says that nothing is missing beside an error of a
thousand times the noise, is worse than no verdict. Every rule looks at one such pair and says in words what is not
understood; one that finds something turns the verdict into ``unknown``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from ...sim.effects import effect_of
from ..cases.case import BranchCase, JointCase
from ..inference.report import spoken
from ..replay.equation_error import fits_torque
from ..systems.model_file import BranchModel
from .decide import probe_for, within_noise
from .diagnosis import Diagnosis, joints_of, together
from .evidence import ALARM, LACK, lack_of

#: Held-out error over the noise floor from which it is more than noise. Refits to fewer recordings bring right models
#: above it too; 1.02 to 1.30 in practice cases while the floor was the sensor's noise alone, 1.05 to 1.16 in the median
#: of an exam.
FAR = 2.0
#: The same where the excess is this share of the motion: an excess as large as noise itself, as it is asked of what the
#: fits leave. Of 78 cases of joints without an effect one had more, 1.54 times, but 0.9 % of the motion.
FAR_OF_MUCH, MUCH = math.sqrt(1.0 + LACK), 0.05

#: Units for readers: factor from the SI unit, and name.
READ = {"m": (100.0, "cm"), "rad": (math.degrees(1.0), "deg"), "rad_per_s": (math.degrees(1.0), "deg/s")}

#: Share of the base model's held-out error that a named effect leaves at most, where noise is far below it. Right names
#: of exams left 0.42 of it or less, or came within 1.3 times the noise; a wrong one left 0.97 of an error of 142 % of
#: the motion and explained 99.7 % of the excess chi-squared.
HARDLY = 0.8
#: How much larger the held-out error of a repaired model as written may be than the base's where wrong geometry excuses
#: it. Of three names of blind exams whose error grew by 10 to 21 % two were wrong.
EXCUSED = 1.05
#: Share explained above which a name's being off may be told as what keeps it from being claimed.
HALF = 0.5

Rule = Callable[[Diagnosis], str | None]


def consistent(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis with its sentence, whose numbers do not contradict its verdict; else one that abstains."""
    lost = _finite(found)  # rules compare numbers
    broken = (lost,) if lost else tuple(said for rule in RULES if (said := rule(found)))
    if broken or found.unusable:
        found = _abstaining(found, () if found.unusable else broken)
    return replace(found, sentence=sentence(found))


def _abstaining(found: Diagnosis, broken: tuple[str, ...]) -> Diagnosis:
    """Return the diagnosis as ``unknown``: nothing is claimed, the closest name is kept as such."""
    ranked = (label for rival in found.ranking for label in rival.effects)
    nearest = found.nearest or next((label.split("@")[0] for label in (*found.tried, *ranked)), None)
    probe = found.unusable or (_probe(nearest) if found.verdict == "none" else found.next_experiment)
    model = found.model and replace(found.model, claimed=not found.model.effects)
    return replace(
        found, verdict="unknown", effects=(), parameters={}, alternatives={}, posterior=None, not_understood=broken,
        nearest=None if found.unusable else nearest, next_experiment=probe, model=model, implausible=(),
    )  # fmt: skip


def _probe(nearest: str | None) -> str:
    again = "the same recordings once more, and one of them twice as large"
    return again if nearest is None else f"{again}; {probe_for([nearest], [])}"


# ---- numbers that the rules and the page share ----------------------------------------------------------------------


def far(found: Diagnosis) -> bool:
    """Return whether the base model's held-out error is more than noise: the less above it, the more must be missed.

    Not where a fit to all recordings leaves noise alone: those it was fitted to leave open what the others ask for.
    """
    return _beyond(found) and not _within_noise(found)


def _beyond(found: Diagnosis) -> bool:
    base, floor = found.gap.base, found.gap.noise_floor
    return base > FAR * floor or (base > FAR_OF_MUCH * floor and missed(found) > MUCH)


def missed(found: Diagnosis) -> float:
    """Return the base model's held-out error beyond noise and nuisances, as a share of the motion.

    The model as it is written has the file's geometry and rigid segments.
    """
    excess = max(found.gap.base**2 - found.gap.noise_floor**2, 0.0) / max(found.swing, 1e-300) ** 2
    return math.sqrt(max(excess - found.geometry.share**2, 0.0))


def left_over(found: Diagnosis) -> float:
    """Return what the base model leaves beyond doubt, as a share of the motion: where it was fitted, or held out."""
    excess = found.base_reduced_chi2 - 1.0
    fitted = math.sqrt(excess) / max(found.motion, 1e-300) if excess > lack_of(found.case) else 0.0
    return max(fitted, missed(found) if far(found) else 0.0)


def what(found: Diagnosis) -> str:
    """Return what shares are shares of, in words: the motion, or torques where these are what a model fits."""
    return "the torques" if fits_torque(found.case) else "the motion"


def significant(found: Diagnosis) -> bool:
    """Return whether something is missing beyond doubt: by the p-value, or by a misfit that no noise makes."""
    return found.p_null <= ALARM or found.base_reduced_chi2 > 1.0 + lack_of(found.case)


def shrinks(found: Diagnosis) -> bool:
    """Return whether the repaired model's held-out error is below the base model's, in the digits that are shown."""
    return float(f"{found.gap.repaired:.3g}") < float(f"{found.gap.base:.3g}")


def grows(found: Diagnosis) -> bool:
    """Return whether the repaired model's held-out error is above the base model's, in the digits that are shown."""
    return float(f"{found.gap.repaired:.3g}") > float(f"{found.gap.base:.3g}")


# ---- rules ----------------------------------------------------------------------------------------------------------


def _finite(d: Diagnosis) -> str | None:
    """Every number that a sentence uses is a number."""
    values = {
        "RMSE of the base model": d.gap.base, "RMSE of the repaired model": d.gap.repaired,
        "noise floor": d.gap.noise_floor, "p-value": d.p_null, "share explained": d.explained,
        "reduced chi-squared": d.base_reduced_chi2,
    }  # fmt: skip
    lost = [name for name, x in values.items() if not math.isfinite(x)]
    return f"{' and '.join(lost)} could not be computed, a simulation diverged" if lost else None


def _not_nested(d: Diagnosis) -> str | None:
    """No model leaves more than one that it contains: one that does was not fitted to its end, nor can it be judged."""
    return None if d.nested else "a model leaves more than one that is part of it, so that their fits did not end"


def _none_but_large(d: Diagnosis) -> str | None:
    """Nothing is missing: then the p-value is above the alarm, or the effect is smaller than the tolerance or noise."""
    if d.verdict != "none" or d.p_null > ALARM or d.size < d.settings.tolerance:
        return None
    if _within_noise(d):
        return None
    return (f"an effect is significant (p = {d.p_null:.1g}) and changes the motion by {percent(d.size)}, which is above"
            f" the tolerance of {percent(d.settings.tolerance)}")  # fmt: skip


def _within_noise(d: Diagnosis) -> bool:
    """Return whether the base model leaves no more than noise, and no effect changes much of the motion."""
    return within_noise(d.case, d.base_reduced_chi2) and d.size < MUCH


def _none_but_far(d: Diagnosis) -> str | None:
    """Nothing is missing: then the held-out error is near the noise, or smaller than the tolerance."""
    if d.verdict != "none" or left_over(d) <= d.settings.tolerance:
        return None
    return (f"{_best(d)}, and yet the base model leaves {percent(left_over(d))} of {what(d)} beyond the noise,"
            f" above the tolerance of {percent(d.settings.tolerance)} ({error_name(d)}"
            f" {_times(d.gap.base, d.gap.noise_floor)} the noise floor)")  # fmt: skip


def _none_but_askew(d: Diagnosis) -> str | None:
    """Nothing is missing: then no number of the geometry that matters is further off than the file says it can be."""
    if d.verdict != "none" or not _askew(d):
        return None
    return (f"{_best(d)}, and yet geometry and mountings explain {percent(d.geometry.share)} of the motion"
            f" with {_too_far(d)}")  # fmt: skip


def _askew(d: Diagnosis) -> bool:
    """Return whether geometry that matters is further off than chance allows."""
    return d.geometry.share > d.settings.tolerance and d.geometry.chance <= ALARM


def _too_far(d: Diagnosis) -> str:
    return f"{d.geometry.furthest}, further than they can be (p = {d.geometry.chance:.1g})"


def _best(d: Diagnosis) -> str:
    if d.p_null > ALARM:
        return "no candidate is significant"
    return f"the best candidate (p = {d.p_null:.1g}) changes the motion by only {percent(d.size)}"


def _named_but_insignificant(d: Diagnosis) -> str | None:
    """Effects are named: then something is missing."""
    if d.verdict != "effects" or significant(d):
        return None
    return (f"{_named(d)} would be named, and yet the base model's misfit is no more than noise (p = {d.p_null:.2g},"
            f" reduced chi-squared {d.base_reduced_chi2:.3g})")  # fmt: skip


def _named_but_no_better(d: Diagnosis) -> str | None:
    """Effects are named: then they lower the held-out error, or what is left out beside geometry that is wrong.

    Such geometry excuses an error that does not fall, and not one that grows: nobody wants that model as it is written.
    """
    excused = d.ahead and d.gap.repaired <= EXCUSED * d.gap.base
    if d.verdict != "effects" or shrinks(d) or excused:
        return None
    change = f"grows from {_gap(d, d.gap.base)} to" if grows(d) else "stays at"
    return (f"{_named(d)} would be named for {share(d.explained)} of the excess misfit, and yet the {error_name(d)}"
            f" {change} {_gap(d, d.gap.repaired)} with it")  # fmt: skip


def _named_but_hardly_better(d: Diagnosis) -> str | None:
    """Effects are named: then what they leave held out is near the noise, or clearly less than without them.

    Of joints with unequal torques the largest make the error; one in units of each channel's noise serves as well.
    """
    known = max(d.gap.noise_floor, d.scatter or 0.0)
    if d.verdict != "effects" or d.ahead or not shrinks(d) or not d.held_out:
        return None
    if d.gap.repaired <= max(FAR * known, HARDLY * d.gap.base) or d.gap.in_noise <= HARDLY:
        return None
    return (f"{_named(d)} would be named for {share(d.explained)} of the excess misfit, and yet the {error_name(d)}"
            f" hardly shrinks with it, from {_gap(d, d.gap.base)} to {_gap(d, d.gap.repaired)},"
            f" {_times(d.gap.repaired, known)} the noise floor")  # fmt: skip


def _named_but_askew(d: Diagnosis) -> str | None:
    """Effects are named: then geometry that is further off than it can be explains less, alone and beside them.

    Beside right effects of exams it was as far off where it explained 0.01 and 0.8 of what they did, beside a wrong
    pair 2.3 times as much.
    """
    more = _askew(d) and d.geometry.share > d.size
    if d.verdict != "effects" or not (d.geometry.instead or more):
        return None
    other = (f"alone explain more, with {d.geometry.instead}" if d.geometry.instead else
             f"beside it explain {percent(d.geometry.share)} of the motion, where it changes"
             f" {percent(d.size)}, with {_too_far(d)}")  # fmt: skip
    return (f"{_named(d)} would be named for {share(d.explained)} of the excess misfit, and yet geometry and mountings"
            f" {other}")  # fmt: skip


def _named_but_nothing_explained(d: Diagnosis) -> str | None:
    """Effects are named: then they explain a share of the excess that is positive and at most all of it."""
    if d.verdict != "effects" or 0.0 < d.explained <= 1.005:
        return None
    return f"{_named(d)} would be named, and yet explains {100.0 * d.explained:.0f} % of the excess misfit"


def _named_without_numbers(d: Diagnosis) -> str | None:
    """Effects are named: then every one has parameters, inside their intervals."""
    if d.verdict != "effects":
        return None
    if not d.effects:
        return "an effect would be named, and yet none is in the preferred model"
    for acting in d.effects:
        own = d.parameters.get(acting.label, {})
        outside = [n for n, i in own.items() if not i.low <= i.median <= i.high]
        if not own or outside:
            what = f"{outside[0]} lies outside its own interval" if outside else "it has no parameters"
            return f"{acting.label} would be named, and yet {what}"
    return None


RULES: tuple[Rule, ...] = (
    _not_nested, _none_but_large, _none_but_far, _none_but_askew, _named_but_insignificant, _named_but_no_better,
    _named_but_hardly_better, _named_but_askew, _named_but_nothing_explained, _named_without_numbers,
)  # fmt: skip


# ---- words ----------------------------------------------------------------------------------------------------------


def plain(found: Diagnosis) -> str:
    """Return the verdict in words that need no statistics: what is missing, and what it changes."""
    if found.unusable is not None or found.not_understood:
        return "These data give no verdict."
    if found.verdict == "none":
        large = significant(found) or far(found)
        return "Nothing that matters here is missing." if large else "Nothing is missing that these data can show."
    if found.verdict == "unknown":
        return ("Something is missing, and these data cannot say what." if significant(found)
                else "These data name nothing that is missing.")  # fmt: skip
    lacking = list(dict.fromkeys(effect_of(a.name).plain or a.name.replace("_", " ") for a in found.effects))
    text = f"The model lacks {' and '.join(lacking)}."
    return f"{text} {_misses(found)}" if shrinks(found) else text


def _misses(found: Diagnosis) -> str:
    """Return what the named effects change for the prediction, in the units of a reader."""
    factor, unit = readable(found.gap.unit)
    before, after, floor = (f"{factor * x:.2g}" for x in (found.gap.base, found.gap.repaired, found.gap.noise_floor))
    told = "what was measured" if found.held_out else "the one recording, to which it was fitted,"
    return f"With that it misses {told} by {after} {unit} instead of {before}; the sensors alone leave {floor}."


def readable(unit: str) -> tuple[float, str]:
    """Return factor and name of the unit in which an SI unit is shown."""
    return READ.get(unit, (1.0, spoken(unit)))


def sentence(found: Diagnosis) -> str:
    """Return the verdict in one sentence, and in further ones what is to be known with it."""
    if found.unusable is not None:
        first = f"The data cannot support a verdict: {found.unusable}."
    elif found.not_understood:
        first = f"No verdict, because the results contradict each other: {'; '.join(found.not_understood)}."
    else:
        first = {"none": _none, "unknown": _unknown, "effects": _effects}[found.verdict](found)
    return " ".join([first, *stand_in(found.implausible), *found.remarks])


def stand_in(implausible: Sequence[str]) -> list[str]:
    """Return what to think of a name whose value nature does not have; nothing where there is none."""
    if not implausible:
        return []
    return [f"It has a value that nature does not have: {'; '.join(implausible)}. Treat the name as a stand-in."]


def _none(d: Diagnosis) -> str:
    numbers = f"{error_name(d)} {_gap(d, d.gap.base)}, noise floor {d.gap.noise_floor:.3g}{_beside(d)}"
    if not significant(d) and not far(d):
        return f"No missing effect is detectable in these data: {numbers}."
    nothing = f"Nothing larger than the tolerance of {percent(d.settings.tolerance)} of {what(d)} is missing"
    if d.p_null <= ALARM and d.size >= d.settings.tolerance:
        nothing = f"Nothing larger than the noise is missing (reduced chi-squared {d.base_reduced_chi2:.3g})"
    if d.p_null <= ALARM:
        best = f"the best candidate changes {what(d)} by {percent(d.size)} (p = {d.p_null:.1g}; {numbers})"
        return f"{nothing}: {best}."
    return f"{nothing}: {numbers}, a misfit of {percent(left_over(d))} of {what(d)}."


def _beside(d: Diagnosis) -> str:
    """Return what of an error beyond the noise is no missing effect."""
    if _beyond(d) and not far(d):
        return (f", which a fit to all recordings does not leave (reduced chi-squared {d.base_reduced_chi2:.3g}):"
                f" without those held out, springs or dampers stay open")  # fmt: skip
    if not far(d) or d.geometry.share <= d.settings.tolerance:
        return ""
    return f", of which geometry and mountings, no further off than the file allows, make {percent(d.geometry.share)}"


def _unknown(d: Diagnosis) -> str:
    if d.unstable:
        return f"No effect is named, since the verdict hangs on how the data are treated: {d.unstable[0]}."
    seen = significant(d) or d.memoryless > 0.0
    first = "Something is missing that these data cannot name" if seen else "These data name no effect"
    if not d.tried and d.nearest is None:
        return f"{first}: no candidate could be fitted."
    what = together(d.tried) or d.nearest
    text = f"{first}: the nearest candidate, {what}, explains {share(d.explained)} of the excess misfit"
    if grows(d):
        name = error_name(d)
        return (f"{text} of the recordings it was fitted to, but does not carry over: with it the {name} grows from"
                f" {_gap(d, d.gap.base)} to {_gap(d, d.gap.repaired)}.")  # fmt: skip
    if d.may_be_off and d.explained > HALF:
        off = " and ".join(d.may_be_off)
        return f"{text}, but {off} may as well be off: the interval reaches where it does nothing."
    if d.stretched and d.explained > HALF:
        most = " and ".join(d.stretched)
        return f"{text}, but only with {most} as far as it is allowed to go: another law may be in its place."
    if d.memoryless > 0.0 and d.explained > HALF:
        return f"{text}, but what it leaves is in large part no noise either."
    return f"{text}, which is not enough to claim it."


def _effects(d: Diagnosis) -> str:
    left = ""
    if d.gap.repaired > FAR * max(d.gap.noise_floor, d.scatter or 0.0):
        left = f"; what is left, {percent(d.gap.repaired / max(d.swing, 1e-300))} of {what(d)}, is not explained"
    adding = "adding it" if len(d.effects) == 1 else "adding them"
    if d.ahead and not shrinks(d):
        return (f"The model lacks {_named(d)}: {adding} predicts experiments left out better, beside geometry and"
                f" mountings that may be a little wrong; as written, with the file's geometry, the model has a"
                f" {error_name(d)} of {_gap(d, d.gap.repaired)} ({d.gap.base:.3g} before, noise floor"
                f" {d.gap.noise_floor:.3g}).")  # fmt: skip
    if read_off(d):
        return (f"The model lacks {_named(d)}: of another course in each recording, which was read off those held out"
                f" too, they leave {_gap(d, d.gap.repaired)} of {d.gap.base:.3g} there (noise floor"
                f" {d.gap.noise_floor:.3g}{left}).")  # fmt: skip
    return (f"The model lacks {_named(d)}: {adding} reduces the {error_name(d)} from {d.gap.base:.3g} to"
            f" {_gap(d, d.gap.repaired)} (noise floor {d.gap.noise_floor:.3g}{left}).")  # fmt: skip


def read_off(found: Diagnosis) -> bool:
    """Return whether what is named follows courses that were read off the recordings themselves."""
    return isinstance(found.model, BranchModel) and bool(found.model.courses)


def error_name(found: Diagnosis) -> str:
    """Return what the gap is called: a held-out error, or that of the only recording, to which the model was fitted."""
    return "held-out RMSE" if found.held_out else "RMSE in the one recording, which was fitted to,"


def share(explained: float) -> str:
    """Return a share of the excess misfit in words, within none and all of it."""
    return "none" if explained < 0.005 else f"{100.0 * min(explained, 1.0):.0f} %"


def _named(d: Diagnosis) -> str:
    """Return the named effects in words, each once with all its joints."""
    joints = joints_of([a.label for a in d.effects])
    words = (f"{name}{_at([_joint(d.case, k) for k in own])}" for name, own in joints.items())
    return " and ".join(words) or "an effect"


def _joint(case: BranchCase | JointCase, index: str) -> str:
    """Return a joint's number, and of a mechanism its name in the case as well."""
    if isinstance(case, JointCase) and len(case.joints) > 1:
        return f"{index} ({case.joints[int(index)].name})"
    return index


def _at(joints: list[str]) -> str:
    """Return joints in words: none, one, or several."""
    if len(joints) < 2:
        return f" at joint {joints[0]}" if joints else ""
    return f" at joints {', '.join(joints[:-1])} and {joints[-1]}"


def _gap(d: Diagnosis, value: float) -> str:
    return f"{value:.3g} {spoken(d.gap.unit)}"


def percent(x: float) -> str:
    """Return a share in percent, in two digits or whole."""
    return f"{100.0 * x:.2g} %" if x < 0.1 else f"{100.0 * x:,.0f} %"


def _times(a: float, b: float) -> str:
    times = a / max(b, 1e-300)
    return f"{times:.2g} times" if times < 100.0 else f"{times:,.0f} times"
