"""Mixtures of normals against scipy."""

import numpy as np
import pytest
import torch
from bough.learn.samplers.mixture import SHIFTS, Mixture, scott_bandwidth
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import logsumexp
from scipy.stats import gaussian_kde, norm

POINTS = 4


@pytest.fixture(scope="module")
def components():
    """Means and deviations [7, 4] of clumped, overlapping components."""
    rng = np.random.default_rng(0)
    return rng.normal(0.0, [0.1, 1.0, 3.0, 1e-3], (7, POINTS)), rng.uniform(0.05, 0.6, (7, POINTS))


@pytest.fixture(scope="module")
def mixture(components):
    return Mixture(*map(torch.as_tensor, components))


def share_below(components, k, x):
    """Distribution function of the mixture at point k."""
    return norm.cdf(x, components[0][:, k], components[1][:, k]).mean()


@pytest.mark.parametrize("share", [0.025, 0.5, 0.8])
def test_quantile(components, mixture, share):
    """Find what a root finder finds, to the 2^-40 of the bracket (here about 25 wide)."""
    found = mixture.quantile(share).numpy()
    for k in range(POINTS):
        root = brentq(lambda x, k=k: share_below(components, k, x) - share, -20, 20, xtol=1e-13)
        assert abs(found[k] - root) < 1e-10


def test_distribution_function(components, mixture):
    """Average the components' distribution functions."""
    y = np.array([-0.3, 0.0, 2.0, 0.1])
    np.testing.assert_allclose(
        mixture.cdf(torch.as_tensor(y)), [share_below(components, k, y[k]) for k in range(POINTS)], rtol=1e-12
    )


def test_log_density(components, mixture):
    """Equal the log of the mean density, also thirty deviations out, where the density itself underflows."""
    for y in (np.array([-0.3, 0.0, 2.0, 0.1]), np.full(POINTS, 60.0)):
        expected = logsumexp(norm.logpdf(y, *components), axis=0) - np.log(7)
        np.testing.assert_allclose(mixture.log_density(torch.as_tensor(y)), expected, rtol=1e-12)


@pytest.mark.parametrize("y", [-0.4, 0.02, 5.0])
def test_ranked_probability_score(components, mixture, y):
    """Equal the integral of (F(x) - [x >= y])^2 (Gneiting and Raftery 2007), by quadrature."""
    found = mixture.crps(torch.full((POINTS,), y, dtype=torch.float64)).numpy()
    for k in range(POINTS):
        below = quad(lambda x, k=k: share_below(components, k, x) ** 2, -20, y, limit=400, points=[0.0, -3.0])[0]
        above = quad(lambda x, k=k: (1 - share_below(components, k, x)) ** 2, y, 20, limit=400, points=[5.5, 8.0])[0]
        assert abs(found[k] - below - above) < 1e-7


def test_score_of_one_normal():
    """Equal the closed form of one normal, s (z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi))."""
    z = (1.3 - 0.5) / 0.7
    expected = 0.7 * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
    one = Mixture(torch.tensor([[0.5]]).double(), torch.tensor([[0.7]], dtype=torch.float64))
    np.testing.assert_allclose(one.crps(torch.tensor([1.3], dtype=torch.float64)), expected, rtol=1e-12)


def test_score_of_many_components():
    """Stay within 3 % of the full double sum where every component has but 64 of its 255 partners.

    A pair's distance spreads by 0.85; over 256 x 64 pairs its mean errs by 0.7 %, and the score by twice that.
    """
    rng = np.random.default_rng(1)
    mean, deviation = rng.normal(size=(4 * SHIFTS, 1)), np.full((4 * SHIFTS, 1), 0.2)
    found = float(Mixture(torch.as_tensor(mean), torch.as_tensor(deviation)).crps(torch.tensor([0.3]).double()))

    def spread(m, s):
        return 2 * s * norm.pdf(m / s) + m * (2 * norm.cdf(m / s) - 1)

    full = spread(0.3 - mean, 0.2).mean() - 0.5 * spread(mean - mean.T, 0.2 * np.sqrt(2)).mean()
    assert abs(found / full - 1) < 0.03


def test_scott_bandwidth():
    """Take the bandwidth of scipy's kernel density estimate; a single sample has none."""
    x = np.random.default_rng(2).normal(size=(40, 3))
    expected = [np.sqrt(gaussian_kde(x[:, k]).covariance[0, 0]) for k in range(3)]
    np.testing.assert_allclose(scott_bandwidth(torch.as_tensor(x)), expected, rtol=1e-12)
    assert (scott_bandwidth(torch.ones(1, 3)) == 0.0).all()
