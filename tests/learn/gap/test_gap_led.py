"""Laws of the whole branch led through growing shares of recordings that swing many times."""

import json

import numpy as np
import pytest
import torch
from bough.learn.cases.case import load_case
from bough.learn.cases.noise import estimate_noise
from bough.learn.gap.diagnose import find_missing
from bough.learn.gap.diagnosis import Settings
from bough.learn.gap.models.contest import Contest, activated
from bough.learn.gap.models.levels import led_whole
from bough.learn.gap.models.refit import fit
from bough.learn.gap.run import Run
from bough.learn.hidden import hide
from bough.learn.replay.recording import recordings
from oracles.oscillator import write_case

LAWS = ("tip_mass", "force_scale", "cubic_stiffness")


@pytest.fixture(scope="module")
def heavy(tmp_path_factory):
    """Return a contest on a branch of five segments with a hidden mass at its tip, and the mass [kg]."""
    folder = tmp_path_factory.mktemp("heavy") / "case"
    hide(folder, effects=("tip_mass",), seed=11, noise=0.01, segments=5)
    case = load_case(folder)
    noise = estimate_noise(case)
    answer = json.loads((folder.parent / "case_answer.json").read_text())
    sigma = np.concatenate([noise.displacement, noise.velocity])
    return Contest(case, recordings(case), sigma, LAWS), answer


def test_a_mass_is_found_from_typical_springs(heavy):
    """Find the hidden mass to 3 %, and leave no more than a fit of as many steps over whole recordings does."""
    contest, answer = heavy
    models = led_whole(contest)
    names = [contest.candidates[m.members[0]].name for m in models]
    assert sorted(names) == ["force_scale", "tip_mass"]  # a cubic spring is at a joint
    led = models[names.index("tip_mass")]
    column = contest.candidates[led.members[0]].columns[0]
    mass = float(contest.values(led.fit.batch)[0, column])
    assert mass == pytest.approx(answer["effects"][0]["params"]["mass_kg"], rel=0.03)
    begun = activated(contest, contest.base_batch(1), [list(led.members)])
    begun.free = torch.where(begun.active, contest.typical, begun.free)
    assert led.chi2 < 1.01 * float(fit(contest, begun, 64).chi2[0])


def test_nothing_more_can_be_added_to_the_only_candidate(tmp_path):
    """Call it unknown where the only effect that is looked for leaves a misfit, and the search has no other."""
    hide(tmp_path / "case", effects=("quadratic_drag",), seed=12, noise=0.02, segments=1, size=0.3)
    found = find_missing(load_case(tmp_path / "case"), Run(Settings(particles=0, effects=("tip_mass",))))
    assert (found.verdict, found.nearest) == ("unknown", "tip_mass")


def test_joints_have_no_whole_branch(tmp_path):
    """Lead nothing at measured joints."""
    case = load_case(write_case(tmp_path / "case", [(0.5, 0.0), (0.3, 0.0)], noise=1e-3))
    contest = Contest(case, recordings(case), np.full(len(case.outputs), 1e-3), ("dry_friction",))
    assert led_whole(contest) == []
