"""Coordinates in which no particle leaves its box: the transform by closed forms, and a density cut off by a box."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from bough.learn.inference.fit import Modes
from bough.learn.inference.inside import Inside, coordinates_of, values_at
from bough.learn.inference.posterior import Posterior, Whitened
from bough.learn.samplers.choose import make_sampler
from bough.learn.systems.system import Parameter
from scipy.integrate import quad
from scipy.stats import truncnorm

SHARE = Parameter("share", "1", 0.2, 1.0, None, "linear")
SPRING = Parameter("stiffness", "N m/rad", 1.0, 100.0)


def test_values_stay_inside_whatever_the_coordinate():
    """Stay in the box at coordinates from -700 to 700, turn back to the coordinate, and leave logarithms alone."""
    w = torch.linspace(-700.0, 700.0, 1001, dtype=torch.float64)[:, None].repeat(1, 2)
    inside = Inside((SHARE, SPRING), 3)
    theta = inside.theta(torch.cat([w, w[:, :1]], 1))
    assert bool(((theta[:, 0] >= 0.2) & (theta[:, 0] <= 1.0)).all())
    torch.testing.assert_close(theta[:, 1:], w, rtol=0.0, atol=0.0)
    near = torch.linspace(-12.0, 12.0, 101, dtype=torch.float64)[:, None].repeat(1, 2)
    torch.testing.assert_close(coordinates_of((SHARE, SPRING), values_at((SHARE, SPRING), near)), near)


def test_slopes_and_volumes_are_those_of_differences():
    """Agree with central differences of the transform, and of the density that it makes of exp(2 x)."""
    inside = Inside((SHARE, SPRING), 2)
    w = torch.tensor([[0.7, 1.3]], dtype=torch.float64)

    def density(x):
        theta = inside.theta(x)
        return float(2.0 * theta.sum() + inside.log_volume(x).sum())

    found = inside.gradient(w, torch.full_like(w, 2.0))
    for k in range(2):
        step = torch.zeros_like(w)
        step[0, k] = 1e-5
        ends = inside.theta(w + step) - inside.theta(w - step)
        assert float(inside.slope(w)[0, k]) == pytest.approx(float(ends[0, k]) / 2e-5, rel=1e-8)
        assert float(found[0, k]) == pytest.approx((density(w + step) - density(w - step)) / 2e-5, rel=1e-6)


def test_a_flat_density_stays_flat():
    """Give the mean and the mean square of a uniform density when the one of w is integrated."""
    inside = Inside((SHARE,), 1)

    def moment(power):
        def inner(x):
            w = torch.tensor([x], dtype=torch.float64)
            return float(inside.log_volume(w).exp() * inside.theta(w)[0] ** power)

        return quad(inner, -40.0, 40.0)[0]

    assert moment(1) / moment(0) == pytest.approx(0.6, rel=1e-6)
    assert moment(2) / moment(0) == pytest.approx((1.0 - 0.2**3) / (3 * 0.8), rel=1e-6)


class Peak:
    """A target of one share, normal about a place that may lie outside its box."""

    num_dims, num_parameters, place = 1, 1, torch.device("cpu")
    system = SimpleNamespace(parameters=(SHARE,))

    def __init__(self, centre, width):
        self.centre, self.width = centre, width

    def linearise(self, theta):
        """Return nothing that is used."""
        return theta, theta

    def log_density(self, theta):
        """Return the log density [P]."""
        return -0.5 * (((theta - self.centre) / self.width) ** 2).sum(-1)

    def evaluate(self, theta, derivative):
        """Return log density and gradient."""
        gradient = -(theta - self.centre) / self.width**2
        return SimpleNamespace(log_posterior=self.log_density(theta), gradient=gradient)


@pytest.mark.parametrize(("centre", "width"), [(0.6, 0.05), (1.1, 0.1), (0.1, 0.3), (0.6, 5.0), (1.0, 1e-4)])
def test_particles_follow_a_density_that_the_box_cuts_off(centre, width):
    """Stay inside, with the truncated normal's median to a tenth of its deviation; the interval holds 90 to 99 % of it.

    Its peak is inside the box, beyond its end, nowhere (a flat share), and at the end, much sharper than a hundredth of
    the box, where particles that began that far inside were flung away.
    """
    target = Peak(centre, width)
    mode = torch.tensor([[min(max(centre, 0.2), 1.0)]], dtype=torch.float64)
    precision = torch.full((1, 1, 1), width**-2 + 12.0 / 0.8**2, dtype=torch.float64)
    found = Inside((SHARE,), 1).modes(Modes(mode, torch.zeros(1, dtype=torch.float64), precision))
    density = Whitened(target, found.theta[0], found.precision[0])
    start = density.z(found.theta + torch.randn(64, 1, dtype=torch.float64, generator=torch.Generator().manual_seed(0)))
    sampler = make_sampler("svgd", start, iterations=60, seed=0)
    for _ in range(60):
        sampler.step(density)
    x = density.theta(sampler.particles)[:, 0].numpy()
    exact = truncnorm((0.2 - centre) / width, (1.0 - centre) / width, centre, width)
    assert x.min() > 0.2 and x.max() < 1.0
    assert abs(np.median(x) - exact.median()) < 0.1 * exact.std()
    posterior = SimpleNamespace(parameters=(SHARE,), particles=x[:, None])
    middle, low, high = (float(v[0]) for v in Posterior.interval(posterior))
    assert 0.2 < low < middle < high < 1.0
    assert 0.9 < exact.cdf(high) - exact.cdf(low) < 0.99


class Told(Peak):
    """A target whose derivatives tell where they were taken, and that counts how often."""

    taken = 0

    def linearise(self, theta):
        """Return the place as the derivative."""
        self.taken += len(theta)
        return theta, theta.clone()

    def evaluate(self, theta, derivative):
        """Keep what was given."""
        self.seen = derivative.clone()
        return SimpleNamespace(log_posterior=theta[:, 0], gradient=theta)


def test_derivatives_are_taken_anew_where_a_particle_has_moved():
    """Take those of a particle that moved by more than `STALE` deviations and of the next farthest, a quarter of all.

    A particle that is lost is taken anew too. Nothing is taken where all rest.
    """
    target = Told(0.6, 0.05)
    density = Whitened(target, torch.zeros(1, dtype=torch.float64), torch.ones(1, 1, dtype=torch.float64))
    z = torch.linspace(-1.0, 1.0, 64, dtype=torch.float64)[:, None]
    density.evaluate(z)
    assert target.taken == 64
    near = z + 0.9 * Whitened.STALE
    density.evaluate(near)
    assert target.taken == 64
    torch.testing.assert_close(target.seen, density.theta(z), rtol=0.0, atol=0.0)
    far = near.clone()
    far[5], far[40] = far[5] + 0.2 * Whitened.STALE, torch.nan
    density.evaluate(far)
    assert target.taken == 64 + 16
    fresh = (target.seen != density.theta(z))[:, 0]
    assert int(fresh.sum()) == 16 and bool(fresh[5]) and bool(fresh[40])
    torch.testing.assert_close(target.seen[fresh], density.theta(far)[fresh], rtol=0.0, atol=0.0, equal_nan=True)
