"""SVGD against densities whose moments are known."""

import math

import pytest
import torch
from bough.learn.svgd import coordinate_direction, joint_direction, svgd


def normal_density(mean, covariance):
    precision = torch.linalg.inv(covariance)

    def density(x):
        d = x - mean
        return -0.5 * (d @ precision * d).sum(1), -d @ precision

    return density


def run(density, particles, kernel, iterations=200):
    return list(svgd(density, particles, iterations=iterations, kernel=kernel))[-1].particles


@pytest.mark.parametrize("direction", [joint_direction, coordinate_direction])
def test_direction_by_hand(direction):
    """Compute the direction of two particles in one dimension by hand."""
    x = torch.tensor([[0.0], [2.0]], dtype=torch.float64)
    gradient = torch.tensor([[3.0], [-1.0]], dtype=torch.float64)
    bandwidth = 4.0 / math.log(2.0)  # the only pair is 2 apart
    k = math.exp(-4.0 / bandwidth)
    # phi_0 = (k(0,0) g_0 + k(1,0) g_1 + d/dx_1 k(x_1, x_0)) / 2, and the mirror image
    pull = 2.0 / bandwidth * 2.0 * k
    expected = torch.tensor([[(3.0 - k - pull) / 2.0], [(3.0 * k - 1.0 + pull) / 2.0]], dtype=torch.float64)
    assert torch.allclose(direction(x, gradient), expected, atol=1e-12)


def test_correlated_normal_in_two_dimensions():
    """Match mean to 0.05 deviations and variance to 15 % of a correlated normal with 100 particles."""
    mean = torch.tensor([1.0, -2.0], dtype=torch.float64)
    covariance = torch.tensor([[1.0, 0.6], [0.6, 2.0]], dtype=torch.float64)
    start = torch.randn(100, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * 2.0
    x = run(normal_density(mean, covariance), start, "joint", 400)
    assert ((x.mean(0) - mean) / covariance.diagonal().sqrt()).abs().max() < 0.05
    assert (x.var(0) / covariance.diagonal() - 1.0).abs().max() < 0.15
    assert abs(torch.corrcoef(x.T)[0, 1] - 0.6 / math.sqrt(2.0)) < 0.1


def test_coordinate_kernel_keeps_variance_in_eight_dimensions():
    """Keep the variance of a whitened normal within 15 % with 32 particles, where one kernel loses half of it."""
    start = torch.randn(32, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 1.2
    density = normal_density(torch.zeros(8, dtype=torch.float64), torch.eye(8, dtype=torch.float64))
    assert abs(run(density, start, "coordinate").var(0).mean() - 1.0) < 0.15
    assert run(density, start, "joint").var(0).mean() < 0.6


def test_two_modes_keep_their_mass():
    """Leave the particles of two far modes where they are, to 10 % of the mass."""

    def density(x):
        a, b = -0.5 * (x[:, 0] + 4.0) ** 2, -0.5 * (x[:, 0] - 4.0) ** 2
        log_p = torch.logaddexp(a, b)
        weight = torch.exp(a - log_p)
        return log_p, (-(x[:, 0] + 4.0) * weight - (x[:, 0] - 4.0) * (1.0 - weight))[:, None]

    generator = torch.Generator().manual_seed(2)
    sign = torch.where(torch.arange(100) % 2 == 0, 4.0, -4.0)[:, None].double()
    x = run(density, sign + torch.randn(100, 1, generator=generator, dtype=torch.float64), "joint")
    assert abs((x > 0).double().mean() - 0.5) <= 0.05
    for side in (x[x > 0], x[x < 0]):
        assert abs(side.abs().mean() - 4.0) < 0.1
