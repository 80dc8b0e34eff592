"""Identification from a case folder to its report."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import yaml
from bough.learn.cases.case import BranchCase, load_case
from bough.learn.inference.identify import Settings, identify, run, split
from bough.learn.inference.report import caveat
from bough.learn.inference.target import Target
from bough.learn.replay.recording import recordings
from bough.sim.base.errors import InputError
from oracles.branch_case import make_branch_case
from oracles.case_files import make_planar
from oracles.oscillator import write_case

QUICK = Settings(particles=16, iterations=20)
PENDULUM = Path(__file__).resolve().parents[4] / "shared" / "data" / "pendulum"


@pytest.fixture(scope="module")
def branch(tmp_path_factory):
    folder = tmp_path_factory.mktemp("branch") / "case"
    truth = make_branch_case(folder, 5, segments=2, noise=0.03)
    return folder, truth


def test_branch_from_another_simulator(branch, tmp_path):
    """Predict held-out motion of a finer MuJoCo branch to within its noise and find its springs to 12 %."""
    folder, truth = branch
    outcome = identify(folder, tmp_path / "out", QUICK)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    # 220 points of three channels: three deviations of a 95 % count are 2.5 %; the band is wider
    assert 0.90 <= report["coverage_95"] <= 0.99
    assert report["rms_misfit_m"] <= 1.2 * report["noise_floor_m"]
    assert 0 < report["interval_95_width_m"] < 8 * report["noise_floor_m"]
    found = [report["parameters"][n]["median"] for n in outcome.posterior.names[:2]]
    assert np.abs(np.array(found) / truth["K"] - 1).max() < 0.12
    assert report["starts_that_agree"] >= 0.25 and report["caveat"] == ""
    assert "bough diagnose " not in (tmp_path / "out" / "report.html").read_text().split("</h1>")[0]
    for name in ("posterior.npz", "report.html", "prediction.png", "residual.png", "posterior.png"):
        assert (tmp_path / "out" / name).stat().st_size > 1000
    with np.load(tmp_path / "out" / "posterior.npz") as posterior:
        assert posterior["particles"].shape == (16, 4)
        assert (posterior["particles"] > 0).all()


def test_same_seed_same_bits(branch):
    """Give the same particles from the same seed, and others from another."""
    case = load_case(branch[0])
    quick = [Settings(particles=16, iterations=12, seed=s) for s in (3, 3, 4)]
    a, b, c = (run(case, s).posterior.particles for s in quick)
    assert (a == b).all()
    assert (a != c).any()


def test_joint_case_with_known_answer(tmp_path):
    """Cover the true spring and damper of a closed-form decay."""
    runs = [(0.5, 0.0), (-0.2, 1.0), (0.3, -1.0)]
    folder = write_case(tmp_path / "case", runs, noise=5e-3)
    outcome = run(load_case(folder), Settings(particles=32, iterations=40))
    _, low, high = outcome.posterior.interval()
    slack = 1 + 1e-3  # the step's own error, see test_target
    assert (low / slack <= [80.0, 1.5]).all() and (high * slack >= [80.0, 1.5]).all()
    assert outcome.ratio < 1.1
    assert caveat(outcome) == ""
    done = outcome.posterior.convergence
    several = replace(done, numbers={**done.numbers, "modes": 2.0})
    assert "in 2 modes far from each other" in caveat(
        replace(outcome, posterior=replace(outcome.posterior, convergence=several))
    )


@pytest.mark.skipif(not PENDULUM.exists(), reason="the shared measurements are not here")
def test_real_pendulum_lacks_something(tmp_path):
    """Predict the third release to 5.5 degrees; say that this is far above the noise and not caused by the fit."""
    identify(PENDULUM, tmp_path / "out", Settings(particles=24, iterations=20))
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["rms_misfit_deg"] <= 5.5
    assert report["misfit_over_noise"] > 20
    page = (tmp_path / "out" / "report.html").read_text()
    assert "the fit is not the cause" in page and f"Run bough diagnose {PENDULUM}" in page
    assert "hold only if the model is right" in page and "hold only if the model is right" in report["caveat"]


def test_split_holds_out_what_nothing_repeats(branch):
    """Hold out a quarter, and neither replicates nor what they repeat."""
    case = load_case(branch[0])
    train, test = split(case)
    assert sorted(train + test) == list(range(len(case.trajectories)))
    assert len(test) == 2
    repeated = {t.replicate_of for t in case.trajectories}
    assert all(case.trajectories[j].replicate_of is None and j not in repeated for j in test)


@pytest.mark.parametrize(
    ("sizes", "forces", "replicate_of", "held"),
    [
        ([1.0, 0.9, 0.8, 2.5], [1.0, 1.0, 1.0, 1.0], [None] * 4, [2]),  # what moves twice as wide is learnt from
        ([1.0, 0.9, 0.8, 1.7], [1.0, 1.0, 1.0, 1.9], [None] * 4, [3]),
        ([1.0, 0.9, 0.8, 0.7], [1.0, 0.9, 0.8, 2.2], [None] * 4, [2]),  # so is what is pulled twice as hard
        ([3.0, 1.0, 1.0], [1.0, 1.0, 1.0], [None, None, 1], [1, 2]),  # an experiment is held out with its replicates
        ([1.2, 1.0, 1.0], [1.0, 1.0, 1.0], [None, None, 1], [0]),
        ([3.0, 1.0], [1.0, 1.0], [None, None], [1]),
    ],
)
def test_split_learns_from_the_widest(sizes, forces, replicate_of, held):
    """Hold out no recording of a branch that moves twice as wide as all others, or is pulled twice as hard."""
    rows = np.linspace(-0.5, 0.5, 9)[:, None] * [0.02, 0.0, 0.01]
    made = [SimpleNamespace(displacement=s * rows, force=f * rows, replicate_of=of)
            for s, f, of in zip(sizes, forces, replicate_of, strict=True)]  # fmt: skip
    case = object.__new__(BranchCase)
    object.__setattr__(case, "trajectories", made)
    train, test = split(case)
    assert test == held and sorted(train + test) == list(range(len(sizes)))


def test_too_little_to_hold_out(tmp_path):
    """Refuse a single trajectory in one line, and leave nothing behind."""
    folder = write_case(tmp_path / "case", [(0.5, 0.0)])
    with pytest.raises(InputError, match="two or more"):
        identify(folder, tmp_path / "out", QUICK)
    assert not (tmp_path / "out").exists()


def test_trajectory_without_motion(tmp_path):
    """Name the file in which nothing moves."""
    folder = write_case(tmp_path / "case", [(0.0, 0.0), (0.5, 0.0)])
    with pytest.raises(InputError, match=r"run_1\.csv.*no motion"):
        identify(folder, tmp_path / "out", QUICK)


@pytest.mark.parametrize("settings", [Settings(particles=2), Settings(iterations=0)])
def test_settings_that_cannot_be(branch, settings):
    """Name the option, what was found and what is allowed."""
    with pytest.raises(InputError, match="or more"):
        run(load_case(branch[0]), settings)


def test_planar_case_is_judged_in_its_plane(branch, tmp_path):
    """Leave the axis without motion out of noise, scores and band when a case is planar."""
    folder = tmp_path / "planar"
    make_planar(branch[0], folder)
    meta = yaml.safe_load((folder / "meta.yaml").read_text())
    assert meta["planar"]
    outcome = run(load_case(folder), Settings(particles=24, iterations=20))
    assert outcome.prediction.main == (0, 2)
    floor = np.sqrt(np.mean(outcome.noise.displacement[[0, 2]] ** 2))
    assert np.isclose(outcome.noise_floor, floor)
    every = recordings(load_case(folder))
    target = Target(load_case(folder), every, torch.as_tensor(outcome.sigma))
    assert target.per_group[0] == 2 * sum(len(r.t) for r in every)
    other = target.measured[None].clone()
    other[..., [1, 4]] += 1.0
    assert target.residual(other).abs().max() == 0.0
