"""Covariance of fits whose residuals are correlated: against closed forms, and by how often the truth is covered."""

import numpy as np
import pytest
import torch
from bough.learn.inference.correlated import correlation, sandwich, score_covariance, widening
from scipy.linalg import toeplitz
from scipy.signal import lfilter

RUNS, SAMPLES = 3, 400


def wander(rng, rho, *shape):
    """Return x_t = rho x_{t-1} + e_t of deviation one along the last axis."""
    e = rng.standard_normal((*shape[:-1], shape[-1] + 300)) * np.sqrt(1.0 - rho**2)
    return lfilter([1.0], [1.0, -rho], e, axis=-1)[..., 300:]


def swings():
    """Return three derivatives [3, R, T]: two decaying swings and an offset."""
    t = np.arange(SAMPLES)
    rows = [[np.exp(-t / 300) * f(2 * np.pi * t / 80 + r) for f in (np.sin, np.cos)] for r in range(RUNS)]
    return np.stack([*np.moveaxis(np.array(rows), 1, 0), np.ones((RUNS, SAMPLES))])


def fitted(rng, rho):
    """Fit noise by swings, least squares; return the coefficients, whose truth is zero, and whitened z and J."""
    rows, noise = swings(), wander(rng, rho, RUNS, SAMPLES)
    found = np.linalg.lstsq(rows.reshape(3, -1).T, noise.ravel(), rcond=None)[0]
    left = noise - np.tensordot(found, rows, 1)
    z, j = (torch.as_tensor(x / left.std())[..., None] for x in (left, rows))
    return found, z, j


def deviations(z, j):
    """Return standard deviations by the sandwich and by the curvature alone, [3] each."""
    seen = correlation(z, [SAMPLES] * RUNS, 3)
    normal = j.flatten(1) @ j.flatten(1).T
    wide = sandwich(normal, normal, score_covariance(seen, j))
    return [x.diagonal().sqrt().numpy() for x in (wide, torch.linalg.inv(normal))]


def test_scores_of_an_autoregressive_residual():
    """Agree with J^T S J, S the exact covariance of x_t = 0.8 x_{t-1} + e_t, to the 15 % that 60,000 samples tell."""
    rng = np.random.default_rng(1)
    z = torch.as_tensor(wander(rng, 0.8, 30, 2000))[..., None]
    t = np.arange(2000)
    rows = np.stack([np.sin(t / 40), np.ones_like(t), np.sin(t / 3)])
    exact = rows @ toeplitz(0.8**t) @ rows.T
    j = torch.as_tensor(np.repeat(rows[:, None], 30, axis=1))[..., None]
    seen = correlation(z, [2000] * 30)
    assert not seen.white and 10 < seen.longest < 60
    found = score_covariance(seen, j).numpy() / 30
    size = np.sqrt(np.outer(exact.diagonal(), exact.diagonal()))
    assert np.abs(found - exact).max() < 0.15 * size.max() and np.all(np.abs(found - exact) < 0.15 * size)


def test_channels_that_err_together_count_once():
    """Give two channels with the same white residual twice the variance of a sum; independent ones the plain one."""
    rng = np.random.default_rng(2)
    one, other = (torch.as_tensor(rng.standard_normal((4, 1000))) for _ in range(2))
    j = torch.ones(1, 4, 1000, 2, dtype=torch.float64)
    for channels, wanted in (((one, one), 2.0), ((one, other), 1.0)):
        seen = correlation(torch.stack(channels, -1), [1000] * 4)
        assert float(score_covariance(seen, j)) / j.sum() == pytest.approx(wanted, rel=0.08)  # 2 / sqrt(4000) is 0.03
        assert seen.white == (wanted == 1.0)


def test_white_residuals_change_nothing():
    """Widen nothing, to the last bit, where residuals are white: 100 draws, none with a correlation."""
    rng = np.random.default_rng(3)
    for _ in range(100):
        z = torch.as_tensor(rng.standard_normal((6, 110, 6)))
        assert correlation(z, [110] * 6).white
    _, z, j = fitted(rng, 0.0)
    wide, plain = deviations(z, j)
    np.testing.assert_allclose(wide, plain, rtol=3e-3)  # 1197 degrees of freedom for 1200 samples


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.9])
def test_intervals_cover_whatever_the_correlation(rho):
    """Cover the truth in 95 % of 300 fits, four deviations of a binomial and 3 % of bias; curvature alone does not."""
    rng = np.random.default_rng(4)
    inside = np.zeros((2, 3))
    for _ in range(300):
        found, z, j = fitted(rng, rho)
        inside += np.abs(found) < 1.96 * np.stack(deviations(z, j))
    wide, plain = inside / 300
    assert np.all(np.abs(wide - 0.95) < 0.03 + 4 * np.sqrt(0.95 * 0.05 / 300)), wide
    if rho:
        assert plain.max() < 0.85 if rho == 0.6 else plain.max() < 0.6


def test_a_law_of_another_form_is_covered():
    """Cover spring and damper of 200 oscillators with a cubic part that the model lacks and a wandering sensor.

    What the law lacks is of the size of the noise and follows the swings. Least squares about the true motion, 95 % to
    5 %; curvature alone covers less than 80 %.
    """
    rng, t = np.random.default_rng(5), np.arange(SAMPLES) * 0.05
    inside = np.zeros(2)
    for _ in range(200):
        phase = rng.uniform(0, 2 * np.pi, RUNS)[:, None]
        rows = np.stack([t * np.exp(-0.1 * t) * np.cos(2 * t + phase), t * np.exp(-0.1 * t) * np.sin(2 * t + phase)])
        lacking = 0.3 * np.exp(-0.3 * t) * np.cos(6 * t + 3 * phase)  # a cubic spring's third harmonic
        noise = lacking + 0.3 * wander(rng, 0.9, RUNS, SAMPLES) + 0.05 * rng.standard_normal((RUNS, SAMPLES))
        found = np.linalg.lstsq(rows.reshape(2, -1).T, noise.ravel(), rcond=None)[0]
        left = noise - np.tensordot(found, rows, 1)
        wide, plain = deviations(*(torch.as_tensor(x / left.std())[..., None] for x in (left, rows)))
        inside += [np.mean(np.abs(found) < 1.96 * wide), np.mean(np.abs(found) < 1.96 * plain)]
    assert abs(inside[0] / 200 - 0.95) < 0.05 and inside[1] / 200 < 0.8, inside


def test_nothing_gets_narrower():
    """Widen where scores vary more than the curvature says and leave the rest, in coordinates of the precision."""
    factor = torch.tensor([[2.0, 0.0], [0.0, 3.0]], dtype=torch.float64)
    curvature = torch.diag(torch.tensor([4.0, 9.0], dtype=torch.float64))
    scores = torch.diag(torch.tensor([36.0, 1.0], dtype=torch.float64))
    torch.testing.assert_close(widening(factor, curvature, scores), torch.diag(torch.tensor([3.0, 1.0])).double())
