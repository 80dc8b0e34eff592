"""What noise of the force does to simulated motion, against simulating it many times."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bough.learn.replay.input_noise import Colour, input_colour
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.replay.simulated_case import Experiment, random_branch, write_simulated_case
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from bough.sim.effects import effect_of

DRAWS = 600
STIFFNESS, DAMPING = np.array([60.0, 25.0]), np.array([0.9, 0.3])


def two_segments(folder, experiment):
    """Return two recordings of a branch of two segments, and its parameters [4]."""
    truth = {"stiffness": STIFFNESS, "damping": DAMPING}
    meta = random_branch(np.random.default_rng(4), 2)
    case = write_simulated_case(folder, meta, truth, experiment, trajectories=2, seed=1)
    return case, torch.tensor(np.concatenate([STIFFNESS, DAMPING]))


def whitened(case, values, noise, force_noise):
    """Return residuals of a case's truth [R, T, C] in units of its channels' noise, and the same whitened.

    Noises are shares of the motion's and of the force's rms, which it was written with.
    """
    chosen = recordings(case)
    clean = Rollout(case, chosen, 1)(values[None])[0].double().clone()
    sigma = np.repeat([noise * float(clean[..., c : c + 3].square().mean().sqrt()) for c in (0, 3)], 3)
    force = force_noise * np.sqrt(np.mean(np.concatenate([r.input[r.contact] for r in chosen]) ** 2))
    colour = input_colour(case, chosen, values, np.full(3, force), torch.as_tensor(sigma))
    raw = (torch.stack([torch.as_tensor(r.output) for r in chosen]) - clean) / torch.as_tensor(sigma)
    return raw, colour.whiten(raw[None], torch.ones(1))


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    """Return a recording of two segments, its colour, and what the force's noise adds to its motion.

    That is 600 draws [600, T, 6]. The force's noise is 4 % of its rms; motion is in units of the channels' noise,
    0.5 % of theirs.
    """
    rng = np.random.default_rng(4)
    truth = {"stiffness": STIFFNESS, "damping": DAMPING}
    experiment = Experiment(samples=70, noise=0.005, force_noise=0.04, deflection=0.05)
    folder = tmp_path_factory.mktemp("noisy") / "case"
    case = write_simulated_case(folder, random_branch(rng, 2), truth, experiment, trajectories=2, seed=1)
    chosen = recordings(case)[0]
    force = 0.04 * np.sqrt(np.mean(chosen.input[chosen.contact] ** 2))
    sigma = np.repeat([0.005 * np.sqrt(np.mean(chosen.output[:, c : c + 3] ** 2)) for c in (0, 3)], 3)
    values = torch.tensor(np.concatenate([STIFFNESS, DAMPING]))
    colour = input_colour(case, [chosen], values, np.full(3, force), torch.as_tensor(sigma), nearby=values[None])
    noise = force * rng.normal(size=(DRAWS, *chosen.input.shape)) * chosen.contact[:, None]
    every = [chosen, *(replace(chosen, input=chosen.input + n) for n in noise)]
    out = Rollout(case, every, 1)(values[None])[0].double()
    return chosen, colour, (out[1:] - out[0]) / torch.as_tensor(sigma)


def test_variance_of_the_response(noisy):
    """Predict the variance of every output to 20 % of the largest of its kind, displacement or velocity.

    600 draws know a variance to 6 %, three of its deviations are 18 %. The sum over samples and axes is known better.
    """
    chosen, colour, response = noisy
    found, expected = response.var(0), colour.variance((len(chosen.t), 6))[0]
    for kind in (slice(0, 3), slice(3, 6)):
        assert found[:, kind].max() > 10.0  # there is something to predict, far above the channels' own noise
        assert (found - expected)[:, kind].abs().max() < 0.20 * found[:, kind].max()
        np.testing.assert_allclose(expected[:, kind].sum(), found[:, kind].sum(), rtol=0.06)


def test_whitened_draws_are_white(noisy):
    """Whiten simulated residuals to variance one in every direction that the force's noise stretches, and elsewhere.

    Raw residuals vary by 1 + S^2 along the columns of the basis. 600 draws know a variance to 6 %: of a hundred
    directions one is off by 20 %. The square sum over all directions is known to 0.3 %; what the shifted pulses miss of
    variances of a hundred leaves about one percent.
    """
    _, colour, response = noisy
    rng = torch.Generator().manual_seed(0)
    residual = response + torch.randn(response.shape, generator=rng, dtype=torch.float64)
    white, raw = colour.whiten(residual[:, None], torch.ones(len(residual))).flatten(1), residual.flatten(1)
    basis, strong = colour.basis[0].double(), colour.gain[0] > 1.0
    assert int(strong.sum()) >= 5 and colour.gain.max() > 100.0
    assert ((raw @ basis)[:, strong].var(0) > 1.7).all()
    along = (white @ basis)[:, strong].var(0)
    assert (along > 0.75).all() and (along < 1.3).all()
    assert abs(float((white**2).sum(1).mean()) / white.shape[1] - 1.0) < 0.02
    assert abs(float((raw**2).sum(1).mean()) / white.shape[1] - 1.0) > 1.0
    other = torch.linalg.qr(torch.randn(white.shape[1], 40, generator=rng, dtype=torch.float64))[0]
    assert (((white @ other).var(0) - 1.0).abs() < 0.3).all()


@pytest.mark.parametrize("law", ["plastic_set", "hysteresis_boucwen"])
def test_noise_leaves_nothing_behind(tmp_path, law):
    """Answer a pulse in one recording as if no other had been, though the law remembers; see the law in the answer."""
    case, values = two_segments(tmp_path / "case", Experiment(samples=30))
    given = (values, np.full(3, 0.1), torch.full((6,), 1e-3))
    known = {p.name: p.neutral for p in effect_of(law).branch.parameters}
    acting = Acting(law, 1, known | {"yield_rad": 0.01, "share": 0.4})
    unknowns = Unknowns(effects=(acting,), box=("stiffness=1:200",))
    whole, second = (input_colour(case, chosen, *given, unknowns=unknowns) for chosen in
                     (recordings(case), recordings(case)[1:]))  # fmt: skip
    assert (whole.gain[1] == second.gain[0]).all() and (whole.basis[1] == second.basis[0]).all()
    plain = input_colour(case, recordings(case)[1:], *given)
    assert (whole.gain[1].max() - plain.gain.max()).abs() > 0.02 * plain.gain.max()


def test_a_sensor_that_lags_passes_its_noise_on(tmp_path):
    """Answer what the sensor read, a quarter of a sample late, as strongly as what acts where nothing is late.

    Of a second, a two-hundredth more or less is 1 % of what grows with the square of time.
    """
    case, values = two_segments(tmp_path / "case", Experiment(samples=60))
    given = (values, np.full(3, 3.0), torch.full((6,), 1e-3))
    known = {p.name: p.neutral for p in effect_of("time_delay").branch.parameters}
    late = Acting("time_delay", None, known | {"lag_s": 0.005})
    colour = input_colour(case, recordings(case), *given, unknowns=Unknowns(effects=(late,)))
    plain = input_colour(case, recordings(case), *given)
    assert (plain.gain.amax(1) > 10.0).all()
    torch.testing.assert_close(colour.gain.amax(1), plain.gain.amax(1), rtol=0.05, atol=0.0)


@pytest.mark.parametrize("samples", [110, 200, 400])
def test_fast_answers_are_seen(tmp_path, samples):
    """Whiten a stiff branch, which swings once in five samples, as well as a soft one.

    Raw residuals have 240 times the variance of the sensor's noise here. Means over three samples of the force's noise
    would leave 93, a first pulse that cannot rise from a sample before 1.4, answers taken over from the moment before
    1.16; 1.02 to 1.06 are left.
    """
    rng = np.random.default_rng(7)
    meta = random_branch(rng, 1)
    inertia = meta["segments"][0]["mass_kg"] * meta["segments"][0]["length_m"] ** 2 / 3
    truth = {"stiffness": np.array([60.0**2 * inertia]), "damping": np.array([0.2 * 60.0 * inertia])}
    experiment = Experiment(samples=samples, force_noise=0.02, noise=0.005, deflection=0.03)
    case = write_simulated_case(tmp_path / "case", meta, truth, experiment, trajectories=2, seed=3)
    values = torch.tensor(np.concatenate([truth["stiffness"], truth["damping"]]))
    raw, white = whitened(case, values, experiment.noise, experiment.force_noise)
    assert abs(float(white.square().mean()) - 1.0) < 0.1
    assert float(raw.square().mean()) > 100.0


@pytest.mark.parametrize("seed", [4, 5])
def test_answers_change_along_a_wide_motion(tmp_path, seed):
    """Whiten a branch whose tip moves by 0.6 of its length, sampled at 20 Hz.

    Mean squares of 2640 numbers are known to 3 %. A pulse answered as the one some samples before it left 1.2.
    """
    truth = {"stiffness": np.array([20.0, 8.0]), "damping": np.array([0.3, 0.1])}
    experiment = Experiment(samples=110, rate=20.0, force_noise=0.02, noise=0.01, deflection=0.6)
    meta = random_branch(np.random.default_rng(seed), 2)
    case = write_simulated_case(tmp_path / "case", meta, truth, experiment, trajectories=4, seed=3)
    values = torch.tensor(np.concatenate([truth["stiffness"], truth["damping"]]))
    raw, white = whitened(case, values, experiment.noise, experiment.force_noise)
    assert float(raw.square().mean()) > 5.0
    assert abs(float(white.square().mean()) - 1.0) < 0.06


def test_whitening_inverts_the_covariance():
    """Satisfy W (1 + U S^2 U^T) W^T = 1 for every recording, and take a batch of residuals as one by one."""
    rng = torch.Generator().manual_seed(1)
    basis = torch.linalg.qr(torch.randn(2, 12, 3, generator=rng, dtype=torch.float64))[0]
    gain = torch.tensor([[0.5, 20.0, 1e4], [3.0, 0.0, 1.0]], dtype=torch.float64)
    colour = Colour(basis, gain, torch.zeros(0))
    identity = torch.eye(12, dtype=torch.float64).reshape(12, 1, 4, 3).expand(12, 2, 4, 3)
    one = torch.ones(12, dtype=torch.float64)
    rows = colour.whiten(identity, one).flatten(2)  # row i is W e_i of each recording
    for r in range(2):
        w = rows[:, r].T
        covariance = torch.eye(12) + basis[r] * gain[r] @ basis[r].T
        torch.testing.assert_close(w @ covariance @ w.T, torch.eye(12, dtype=torch.float64), atol=1e-9, rtol=0)
    stacked = identity.unflatten(0, (3, 4))
    torch.testing.assert_close(colour.whiten(stacked, one[:3]), colour.whiten(identity, one).unflatten(0, (3, 4)))


def test_noisier_channels_do_not_make_the_force_noisier():
    """With channels twice as noisy the covariance is 4 + U S^2 U^T: its inverse root and determinant follow."""
    rng = torch.Generator().manual_seed(2)
    basis = torch.linalg.qr(torch.randn(1, 6, 2, generator=rng, dtype=torch.float64))[0]
    gain = torch.tensor([[3.0, 40.0]], dtype=torch.float64)
    colour, share = Colour(basis, gain, torch.zeros(0)), torch.tensor([0.25], dtype=torch.float64)
    covariance = 4.0 * torch.eye(6, dtype=torch.float64) + basis[0] * gain[0] @ basis[0].T
    r = torch.randn(6, generator=rng, dtype=torch.float64)
    white = colour.whiten((r / 2.0).reshape(1, 1, 2, 3), share)
    torch.testing.assert_close((white**2).sum(), r @ torch.linalg.solve(covariance, r))
    volume = 6 * np.log(2.0) + colour.log_volume(share)[0]
    torch.testing.assert_close(volume, 0.5 * torch.logdet(covariance))


def test_power_of_the_response(noisy):
    """Ask for the same parameters: tr((1 + B B^T)^-1 B B^T) / 2, the sum of g / (1 + g) over directions."""
    colour = noisy[1]
    expected = float(0.5 * (colour.gain / (1.0 + colour.gain)).sum())
    # directions with gains below a hundredth are not kept in the basis, but count in the power
    assert expected <= float(colour.power[0]) <= 1.05 * expected


def test_noise_is_felt_in_contact_only(noisy):
    """Add nothing before the gripper acts: the first sample is at rest whatever the force's noise."""
    chosen, colour, response = noisy
    expected = colour.variance((len(chosen.t), 6))[0]
    assert expected[0].max() == 0.0 and response[:, 0].abs().max() == 0.0
