"""Predictions of held-out recordings: calibrated where the model is true, and scored by the density they state."""

import numpy as np
import pytest
from bough.learn.inference.identify import Identification, Settings
from bough.learn.inference.predict import Prediction, pooled
from bough.learn.inference.report import spoken
from bough.learn.replay.simulated_case import Experiment, random_branch, write_simulated_case

TRAIN, TEST = [0, 1, 2], [3, 4, 5, 6]


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    """Return an identification of a branch of the model's own structure, its posterior and what that predicts."""
    rng = np.random.default_rng(11)
    truth = {"stiffness": np.array([90.0, 35.0]), "damping": np.array([1.5, 0.6])}
    experiment = Experiment(samples=80, noise=0.02, force_noise=0.05)
    folder = tmp_path_factory.mktemp("predict") / "case"
    case = write_simulated_case(folder, random_branch(rng, 2), truth, experiment, trajectories=7, seed=1)
    work = Identification(case, Settings(particles=24, iterations=12))
    posterior = work.learn(TRAIN, "posterior")
    return work, posterior, work.predict(posterior, TEST)


def test_coverage_at_every_level(learnt):
    """Cover held-out displacement as often as stated, to 4 % at 80 and 95 % and 8 % at half.

    Of the 960 points the force's noise correlates about ten: a hundred independent ones know half to 5 %.
    """
    _, _, prediction = learnt
    assert prediction.main == (0, 1, 2)
    for nominal in (0.5, 0.8, 0.95):
        assert abs(prediction.coverage_at(nominal) - nominal) < (0.08 if nominal == 0.5 else 0.04)
    assert prediction.coverage == prediction.coverage_at(0.95)


def test_interval_is_where_the_level_says(learnt):
    """Find a point inside its 95 % interval exactly where its level lies between 2.5 and 97.5 %."""
    _, _, p = learnt
    for low, high, median, measured, level in zip(p.low, p.high, p.median, p.measured, p.level, strict=True):
        clear = np.abs(np.abs(level - 0.5) - 0.475) > 1e-6
        inside = (low <= measured) & (measured <= high)
        assert (inside == (np.abs(level - 0.5) <= 0.475))[clear].all()
        assert ((low < median) & (median < high)).all()


def test_noise_of_the_force_widens_the_interval(learnt):
    """Cover too little where the force is taken for exact, with a narrower interval and worse scores."""
    work, posterior, prediction = learnt
    known = work.force_sigma
    work.force_sigma = None
    try:
        blind = work.predict(posterior, TEST)
    finally:
        work.force_sigma = known
    assert blind.width < 0.95 * prediction.width
    assert blind.coverage < prediction.coverage
    assert blind.mean_nll > prediction.mean_nll and blind.mean_crps > prediction.mean_crps


def test_residual_of_a_true_model_is_noise(learnt):
    """Leave over what noise of sensor and force explains: rms near what the interval's width says of a normal."""
    _, _, p = learnt
    width = np.concatenate([(high - low)[:, :3].ravel() for high, low in zip(p.high, p.low, strict=True)])
    width = np.sqrt(np.mean(width**2))
    assert abs(p.rms / (width / (2 * 1.96)) - 1.0) < 0.15


def constant(value: float, count: int) -> Prediction:
    """Return a prediction of one recording [count, 2] in which every number is the same."""
    a = [np.full((count, 2), value)]
    return Prediction(a, a, [x + 1.0 for x in a], a, [x * 0 + 0.5 for x in a], a, a, [np.arange(count) * 0.1], (0,))


def test_pooled_scores_weigh_points_alike():
    """Put folds end to end: means are over points, so that a fold of thirty counts three times one of ten."""
    both = pooled([constant(1.0, 10), constant(3.0, 30)])
    assert len(both.t) == 2 and both.mean_nll == both.mean_crps == 2.5
    assert both.width == 1.0 and both.coverage == 1.0 and both.rms == 0.0
    assert [len(r) for r in both.residual] == [10, 30] and both.main == (0,)


@pytest.mark.parametrize(
    ("unit", "words"), [("N_m", "N m"), ("rad_per_s", "rad/s"), ("m_per_s2", "m/s2"), ("rad", "rad")]
)
def test_units_are_printed_as_they_are_read(unit, words):
    """Write the units of files, which are parts of keys, as a reader does: ``simulate --model`` printed ``N_m``."""
    assert spoken(unit) == words
