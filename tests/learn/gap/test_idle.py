"""Parameters that may as well be neutral cost a model nothing, by the curvature as by a fit without them."""

import math

import numpy as np
import pytest
import torch
from bough.learn.cases.case import load_case
from bough.learn.gap.models.contest import Contest, activated
from bough.learn.gap.models.fitted import FittedModels, Model, penalty
from bough.learn.gap.models.idle import optional, spare
from bough.learn.gap.models.refit import evaluated, fit
from bough.learn.replay.recording import recordings
from oracles.branch_case import make_branch_case

SIGMA = np.array([1e-3] * 3 + [1e-2] * 3)


@pytest.fixture(scope="module")
def contest(tmp_path_factory):
    """Return a contest of two effects on a stick's three recordings."""
    folder = tmp_path_factory.mktemp("idle") / "case"
    make_branch_case(folder, 4, segments=1, samples=50, dt=1e-3)
    case = load_case(folder)
    return Contest(case, recordings(case)[:3], SIGMA, ("cubic_stiffness", "force_bias"))


def fitted_to(contest, member, values):
    """Return models of a recording in which an effect acts, with noise: the base, and that effect fitted."""
    truth = activated(contest, contest.base_batch(1), [(member,)])
    columns = list(contest.candidates[member].columns)
    truth.free[0, columns] = torch.tensor(values, dtype=torch.float64)
    noise = np.random.default_rng(3).normal(size=contest.measured.shape) * SIGMA
    contest.measured = contest.simulate(contest.values(truth), truth.start)[0].double() + torch.as_tensor(noise)
    own = Model((member,), fit(contest, truth, 12), True)
    return FittedModels(contest, Model((), evaluated(contest, contest.base_batch(1))), [own])


def without(contest, model, columns):
    """Return the cost of a model fitted with some parameters held at their neutral values."""
    batch = model.fit.batch.copy()
    batch.active[:, columns] = False
    return float(fit(contest, batch, 12).cost[0])


@pytest.mark.parametrize(("values", "needed"), [((0.1, 0.0, 0.0), []), ((0.1, 0.0, 0.8), [2]), ((0.1, 0.9, 0.0), [1])])
def test_what_is_idle_is_what_a_fit_without_it_saves(contest, values, needed):
    """Save the price of each optional parameter less what its absence costs, where that is less.

    What is left out may be any of three sets; the best by fits is the best by the curvature, within the curvature's
    error of a tenth of the distance.
    """
    member = next(k for k, c in enumerate(contest.candidates) if c.name == "cubic_stiffness")
    strongest = contest.parameters[contest.candidates[member].columns[0]].high
    fitted = fitted_to(contest, member, (values[0] * strongest, *values[1:]))
    (model,) = fitted.models
    before = fitted.criterion(model)
    spare(fitted)
    assert before - fitted.criterion(model) == pytest.approx(model.idle)
    columns, price = list(contest.candidates[member].columns), math.log(contest.num_samples)
    od = fitted.overdispersion
    gains = {tuple(s): price * len(s) - (without(contest, model, [columns[k] for k in s]) - model.cost) / od
             for s in ([1], [2], [1, 2])}  # fmt: skip
    best = max([(), *gains], key=lambda s: gains.get(s, 0.0))
    assert not set(best) & set(needed)
    distance = price * len(best) - gains.get(best, 0.0)
    assert model.idle == pytest.approx(gains.get(best, 0.0), abs=0.1 * distance + 0.3)
    # priors that are no more counted are a deviation or so each
    assert 0.0 <= model.idle < (price + 2.0) * (2 - len(needed))


def test_what_is_read_of_every_recording_is_paid_for_each(contest):
    """Charge an offset that each recording's open gripper shows once a recording, and give it back where it is idle."""
    member = next(k for k, c in enumerate(contest.candidates) if c.name == "force_bias")
    fitted = fitted_to(contest, member, (0.5, 0.5, -0.5, 0.0))
    (model,) = fitted.models
    price = math.log(contest.num_samples)
    assert penalty(contest, (member,)) == pytest.approx(price * (3 + 3))
    (own,) = optional(contest, model)
    assert own.price == pytest.approx(3 * price)
    spare(fitted)  # nothing is read of an open gripper here, so it does nothing
    assert model.idle == pytest.approx(3 * price, abs=0.01 * price)
