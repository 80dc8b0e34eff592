"""When a part of the recordings takes a name back."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from bough.learn.cases.case import BranchCase
from bough.learn.gap import steady
from bough.learn.gap.decide import Decision, alike, chosen
from bough.learn.gap.diagnosis import Settings
from bough.learn.gap.models.candidates import Candidate
from bough.learn.gap.models.fitted import FittedModels, Model
from bough.learn.gap.search import Searched
from bough.learn.gap.steady import Variant, shows_less, steadied, with_akin
from bough.learn.systems.acting import Acting
from bough.sim.effects import EffectParameter, effect_of

SAMPLES, FIRST, SECOND, OTHER = 1000, 0, 1, 2


def model(chi2, *members):
    """Return a fitted model that leaves a chi-squared."""
    return Model(members, SimpleNamespace(chi2=[chi2], cost=[chi2]))


def part(pair):
    """Return models fitted to a part of the recordings in which two effects together leave ``pair``."""
    specs = (EffectParameter("share", "1", 0.0, 1.0),) * 2
    candidates = [SimpleNamespace(columns=(0, 1), specs=specs) for _ in range(3)]  # 2 log(1000) = 14 for each effect
    contest = SimpleNamespace(num_samples=SAMPLES, candidates=candidates)
    models = [model(1000.0, FIRST), model(5000.0, SECOND), model(1300.0, OTHER), model(pair, FIRST, SECOND)]
    return FittedModels(contest, model(9000.0), models)


@pytest.mark.parametrize(
    "pair, named, less",
    [
        (950.0, (FIRST,), True),  # the second effect still pays here: 50 for 14
        (990.0, (FIRST,), False),  # it does not: what the part lacks was never there
        (950.0, (OTHER,), False),  # another name stands in its place
        (950.0, (FIRST, OTHER), False),
        (950.0, (FIRST, SECOND), False),  # the same names: nothing is less
    ],
)
def test_a_part_that_shows_less_takes_nothing_back(pair, named, less):
    """Fewer names count as less of the same only where both effects still lower the criterion."""
    fitted = part(pair)
    found = next((m for m in fitted.models if set(m.members) == set(named)), model(900.0, *named))
    assert shows_less(fitted, found, model(1.0, FIRST, SECOND)) is less


def test_a_part_without_the_pair_takes_it_back():
    """A pair that was not fitted to a part has shown nothing there."""
    fitted = part(950.0)
    fitted.models.pop()
    assert not shows_less(fitted, fitted.models[0], model(1.0, FIRST, SECOND))


def test_what_is_the_same_in_principle_is_an_alternative():
    """List a set beside a loop where another treatment has it in its place; a name that is there already stays one."""
    found = with_akin({"loop": ("drag",), "play": ()}, {"loop": {"set", "drag"}, "gone": {"set"}})
    assert found == {"loop": ("drag", "set"), "play": ()}


@pytest.mark.parametrize(("first", "second"), [
    ("hysteresis_boucwen", "plastic_set"),
    ("dry_friction", "hysteresis_boucwen"),
    ("bilinear_stiffness", "anisotropic_stiffness"),
])  # fmt: skip
def test_a_law_takes_another_s_place_at_its_own_joint_alone(first, second):
    """Call sets, loops and friction, two springs along an axis, the same in principle at one joint, not at two."""
    own, other = Acting(first, 0), Acting(second, 0)
    assert alike(own, other) and alike(other, own)
    assert not any(alike(own, a) for a in (Acting(second, 1), Acting("cubic_stiffness", 0), own))


def test_a_law_that_corrects_another_s_form_is_no_second_effect():
    """Leave a set beside a loop at one joint of a branch out, however much it explains; not one at another joint."""
    places = [Acting("hysteresis_boucwen", 0), Acting("plastic_set", 0), Acting("plastic_set", 1)]
    laws = [Candidate(a, (), effect_of(a.name).law("branch")) for a in places]
    contest = SimpleNamespace(num_samples=1000, candidates=laws, case=object.__new__(BranchCase))
    models = [model(chi2, *own) for chi2, own in ((1200.0, (0,)), (1010.0, (0, 1)), (1020.0, (0, 2)))]
    fitted = FittedModels(contest, model(3000.0), models)
    assert chosen(fitted, 2).members == (0, 2)
    del fitted.models[-1]
    assert chosen(fitted, 2).members == (0,)


# ---- a name that another treatment takes back ------------------------------------------------------------------------

LAWS = (Acting("dry_friction", 0), Acting("quadratic_drag", 0))


def of_joints(*left):
    """Return models of one law each at joints that leave ``left`` of a base's 9000."""
    candidates = [SimpleNamespace(name=a.name, acting=a, columns=(), specs=()) for a in LAWS]
    contest = SimpleNamespace(num_samples=SAMPLES, candidates=candidates, case=SimpleNamespace(trajectories=(0, 1)))
    return FittedModels(contest, model(9000.0), [model(chi2, k) for k, chi2 in enumerate(left)])


def judged(fitted, verdict, *members):
    """Return a decision for the model with these members; none of them where nothing is missing."""
    own = next((m for m in fitted.models if m.members == members), fitted.base)
    named = tuple(LAWS[k] for k in members) if verdict == "effects" else ()
    return Decision(verdict, fitted.base, own, own, named, {a.label: () for a in named})


def treated(monkeypatch, verdict, members, variant, again, motion=10.0):
    """Return the decision of models that friction explains, once a treatment that ends in ``again`` has been tried.

    ``motion`` is in units of the noise: friction changes it by the root of 8000 over the samples in these.
    """
    fitted = of_joints(1000.0, 8000.0)
    what, recordings = variant
    other = Variant(what, fitted.contest.case, recordings, filtered=what.startswith("a filter"))
    monkeypatch.setattr(steady, "variants", lambda case: [other])
    monkeypatch.setattr(steady, "_again", lambda *_: again)
    base = SimpleNamespace(contest=fitted.contest, motion=motion)
    run = SimpleNamespace(settings=Settings())
    return steadied(base, Searched(fitted, 1e-9), judged(fitted, verdict, *members), run)


@pytest.mark.parametrize("variant", [("a rate of 50 Hz", (0, 1)), ("recording 2 alone", (1,))])
def test_a_name_that_another_rate_or_a_part_takes_back_is_not_claimed(monkeypatch, variant):
    """Keep friction where the treatment has it too; take it back where drag stands there, and say what gives that."""
    same, other = of_joints(1000.0, 8000.0), of_joints(8000.0, 1000.0)
    kept = treated(monkeypatch, "effects", (0,), variant, (judged(same, "effects", 0), same))
    assert (kept.verdict, kept.named, kept.unstable) == ("effects", LAWS[:1], ())
    gone = treated(monkeypatch, "effects", (0,), variant, (judged(other, "effects", 1), other))
    assert (gone.verdict, gone.named, gone.unstable) == ("unknown", (), (f"{variant[0]} gives quadratic_drag",))


def test_nothing_missing_is_unknown_where_another_treatment_names_something(monkeypatch):
    """Keep `none` where half of the rate shows nothing either; abstain where it names a law beyond doubt."""
    fitted, variant = of_joints(1000.0, 8000.0), ("a rate of 50 Hz", (0, 1))
    kept = treated(monkeypatch, "none", (), variant, (judged(fitted, "none"), fitted))
    assert (kept.verdict, kept.unstable) == ("none", ())
    gone = treated(monkeypatch, "none", (), variant, (judged(fitted, "effects", 0), fitted))
    assert (gone.verdict, gone.named, gone.unstable) == ("unknown", (), ("a rate of 50 Hz gives dry_friction",))


@pytest.mark.parametrize("what", ["a rate of 50 Hz", "recording 2 alone", "a filter of 9 Hz"])
def test_what_all_recordings_make_small_undoes_nothing(monkeypatch, what):
    """Keep `none`, and tell of it, where a treatment names what changes the case as it is by 0.2 % of the motion.

    Another filter lets through what the case's own does not, so that what it shows counts.
    """
    fitted, motion = of_joints(1000.0, 8000.0), float(np.sqrt(8000.0 / SAMPLES)) / 0.002
    found = treated(monkeypatch, "none", (), (what, (0, 1)), (judged(fitted, "effects", 0), fitted), motion)
    expected = "unknown" if "filter" in what else "none"
    assert (found.verdict, found.named, found.unstable) == (expected, (), (f"{what} gives dry_friction",))


def test_half_of_the_rate_that_moves_the_joint_elsewhere_says_nothing(monkeypatch):
    """Ask nothing of a treatment of which all models leave 8 times what friction leaves of the case; of 2 times, do."""
    for left, lost in ((8000.0, False), (2000.0, True)):
        other = of_joints(8500.0, left)
        again = judged(other, "effects", 1), other
        found = treated(monkeypatch, "effects", (0,), ("a rate of 50 Hz", (0, 1)), again)
        assert (found.verdict == "unknown") is lost and bool(found.unstable) is lost


@pytest.mark.parametrize(("left", "kept"), [(1005.0, True), (1010.0, False)])
def test_a_part_too_weak_for_one_of_two_effects_takes_nothing_back(monkeypatch, left, kept):
    """Keep a pair where a part names one of them and is fitted as well by both, with the values of the whole.

    As well: within what the other one costs, log(1000) = 7 for the parameter that it adds.
    """
    pair = of_joints(5000.0, 8000.0)
    pair.models.append(model(990.0, 0, 1))
    pair.models[-1].fit.batch = None
    small = of_joints(1000.0, 8000.0)
    small.models.append(model(999.0, 0, 1))
    small.contest.residual = lambda batch: torch.full((1, 1, 1, 1), left**0.5, dtype=torch.float64)
    what = Variant("recording 2 alone", small.contest.case, (1,))
    monkeypatch.setattr(steady, "_within", lambda contest, batch, recordings: batch)
    whole = Decision("effects", pair.base, pair.models[-1], pair.models[-1], LAWS, {a.label: () for a in LAWS})
    found = judged(small, "effects", 0)
    for c in small.contest.candidates:
        c.columns, c.specs = (0,), (EffectParameter("share", "1", 0.0, 1.0),)
    lost = steady._gone(Searched(pair, 1e-9), whole, what, found, small, (0, 1))
    assert lost == ([] if kept else [1])
