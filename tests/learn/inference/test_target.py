"""Rollouts, likelihoods, their gradients and modes against closed forms."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from bough.learn.cases.case import load_case
from bough.learn.inference.fit import find_modes
from bough.learn.inference.posterior import initial_vectors
from bough.learn.inference.target import Target
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from oracles.oscillator import decay, write_case

K, D, J = 80.0, 1.5, 2.0
RUNS = [(0.5, 0.0), (-0.2, 1.0)]


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    return load_case(write_case(tmp_path_factory.mktemp("decay"), RUNS))


def exact(case, log_parameters, starts):
    """Angles [R, T] in closed form."""
    k, d = np.exp(log_parameters)
    return np.stack([decay(t.t, J, k, d, q0, v0)[0] for t, (q0, v0) in zip(case.trajectories, starts, strict=True)])


def test_rollout_equals_closed_form(case):
    """Follow a damped oscillator to what a first-order step of 1 ms allows: amplitude x (w h) / 2 x w t."""
    rollout = Rollout(case, recordings(case), 3)
    values = torch.tensor([[K, D]], dtype=torch.float64).repeat(3, 1)
    starts = torch.tensor(RUNS, dtype=torch.float64)[None, :, None, :].repeat(3, 1, 1, 1)
    out = rollout(values, starts).numpy()
    w, h = np.sqrt(K / J), 1e-3
    assert np.abs(out[..., 0] - exact(case, np.log([K, D]), RUNS)).max() < 0.5 * w * h
    assert (out[0] == out[2]).all()


def test_rollout_refuses_another_number_of_sets(case):
    """Say how many sets it takes."""
    with pytest.raises(ValueError, match="takes 3"):
        Rollout(case, recordings(case), 3)(torch.ones(2, 2))


def test_gaussian_likelihood_by_hand(case):
    """Sum -r^2 / (2 s^2) - log s over samples."""
    target = Target(case, recordings(case), torch.tensor([0.1]))
    prediction = target.measured[None] + 0.2
    count = target.measured.numel()
    expected = -0.5 * count * 4.0 - count * np.log(0.1)
    assert np.isclose(target.log_likelihood(prediction, torch.log(torch.tensor([[0.1]])).double()).item(), expected)


def test_published_loss_by_hand(case):
    """Sum the norms of the error over recordings and divide by kT (thesis eq. 3.5 and 3.9)."""
    target = Target(case, recordings(case), torch.tensor([0.1]), loss="published", temperature=0.5)
    prediction = target.measured[None] + 0.2
    expected = -sum(0.2 * np.sqrt(len(t.t)) for t in case.trajectories) / 0.5
    assert np.isclose(target.log_likelihood(prediction, torch.zeros(1, 0)).item(), expected)


def test_gradient_agrees_with_float64_reference(case):
    """Agree to 1 % with the gradient of the closed-form likelihood, differentiated in float64."""
    noise = 0.05
    target = Target(case, recordings(case), torch.tensor([noise]))
    log_p = np.log([K * 1.1, D * 0.8])
    starts = np.array(RUNS) + 0.03

    def log_likelihood(x):
        r = np.stack([t.output[:, 0] for t in case.trajectories]) - exact(case, x[:2], x[2:].reshape(2, 2))
        return -0.5 * (r**2).sum() / noise**2

    x = np.concatenate([log_p, starts.ravel()])
    reference = np.array([(log_likelihood(x + e) - log_likelihood(x - e)) / 2e-6 for e in 1e-6 * np.eye(6)])
    theta = torch.tensor(np.concatenate([x, [np.log(noise)]]))[None]
    ours = target.evaluate(theta).gradient[0, :6].numpy()
    # the first-order step itself moves the trajectory by w h / 2 = 0.3 % a radian of phase
    assert np.abs(ours - reference).max() < 0.01 * np.abs(reference).max() + 0.02 * np.abs(reference).mean()


def test_derivatives_from_nearby_move_the_gradient_little(case):
    """Combine residuals here with derivatives taken a few percent away: off by about their own relative change."""
    target = Target(case, recordings(case), torch.tensor([0.05]))
    start = torch.tensor(RUNS, dtype=torch.float64).flatten()
    here, near = (
        torch.cat([torch.log(torch.tensor([K * k, D])).double(), start, target.log_noise0])[None] for k in (1.02, 1.03)
    )
    fresh = target.evaluate(here)
    stale = target.evaluate(here, target.evaluate(near).derivative)
    assert stale.log_posterior == fresh.log_posterior
    # the phase at the end, w t = 19 rad, moves by 0.5 % of itself: derivatives turn by about a tenth
    assert (stale.gradient - fresh.gradient).abs().max() < 0.2 * fresh.gradient.abs().max()
    assert (stale.gradient != fresh.gradient).any()


def test_noise_gradient_by_hand(case):
    """D log p / d log s = sum r^2 / s^2 - N, plus the prior's zero at its centre."""
    target = Target(case, recordings(case), torch.tensor([0.05]))
    start = torch.tensor(RUNS, dtype=torch.float64).flatten()
    theta = torch.cat([torch.log(torch.tensor([K * 1.2, D])).double(), start, target.log_noise0])[None]
    r = target.residual(target.predict(theta))
    expected = (r**2).sum() / 0.05**2 - target.measured.numel()
    assert torch.isclose(target.evaluate(theta).gradient[0, -1], expected, rtol=1e-6)


def test_modes_are_found_from_far(tmp_path):
    """End at the true spring and damper from starts that are decades away, the same from several of them."""
    noisy = load_case(write_case(tmp_path / "noisy", RUNS, noise=2e-3))
    target = Target(noisy, recordings(noisy), torch.tensor([2e-3]))
    modes = find_modes(target, initial_vectors(target, 8, torch.Generator().manual_seed(0)))
    best = int(modes.log_posterior.argmax())
    deviation = torch.linalg.inv(modes.precision[best]).diagonal().sqrt()[:2]
    # four deviations of the posterior, and the (w h)^2 / 12 and h D / (2 J) that the step itself is off by
    error = (modes.theta[best, :2] - torch.log(torch.tensor([K, D]))).abs()
    assert (error < 4 * deviation + torch.tensor([1e-4, 4e-4])).all()
    assert (modes.log_posterior > modes.log_posterior.max() - 3).sum() >= 3


def test_nothing_is_simulated_past_the_end_of_a_box(tmp_path):
    """Move a share at either end and in the middle by 1 % of half its box at most, and never beyond it.

    Derivatives at the ends are those of a one-sided difference by the same step: they are finite.
    """
    case = load_case(write_case(tmp_path / "case", [(0.5, 0.0), (-0.3, 1.0)], noise=0.002))
    unknowns = Unknowns(effects=(Acting("dry_friction", 0),))
    target = Target(case, recordings(case), torch.tensor([0.002]), unknowns=unknowns)
    column = [p.name for p in target.system.parameters].index("dry_friction@0 gradual")
    own = torch.tensor([p.start for p in target.system.parameters], dtype=torch.float64).repeat(3, 1)
    own[:, column] = torch.tensor([0.0, 0.5, 1.0])
    rest = torch.cat([target.start0.flatten(), target.log_noise0]).expand(3, -1)
    seen, values = [], target.values
    target.values = lambda u: seen.append(u) or values(u)
    _, derivative = target.linearise(torch.cat([own, rest], 1))
    tried = seen[0].unflatten(0, (3, -1))[..., column]
    assert bool(((tried >= 0.0) & (tried <= 1.0)).all())
    torch.testing.assert_close(tried.amax(1) - tried.amin(1), torch.tensor([0.005, 0.01, 0.005]).double())
    assert bool(derivative.isfinite().all()) and float(derivative[:, column].abs().amax()) > 0.0


@pytest.mark.parametrize(("off", "lean"), [((0.3, -0.1), 5.0), ((-11.0, 0.0), -10.0), ((2.0, 4.0), 5.0)])
def test_the_lean_holds_about_where_it_was_taken(off, lean):
    """Add slope times distance within an e-fold, or half of a box; what lies farther is paid for no more than that.

    At slopes of 10 and -20 a worse mode's damper, 11 e-folds down, would lean by -110 otherwise.
    """
    centre = torch.tensor([0.7, -0.2], dtype=torch.float64)
    target = SimpleNamespace(
        lean=(torch.tensor([10.0, -20.0], dtype=torch.float64), centre), num_noise=1, num_parameters=2,
        reach=torch.tensor([1.0, 0.25], dtype=torch.float64), prior=lambda theta: 3.0,
        _share=lambda noise: torch.ones(()),
    )  # fmt: skip
    theta = torch.cat([centre + torch.tensor(off, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)])
    assert float(Target.beside(target, theta)) == pytest.approx(3.0 + lean)
