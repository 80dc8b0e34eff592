"""Diagnostics against closed forms, second implementations and runs known to be good or cut short."""

import math

import pytest
import torch
from bough.learn.samplers.base import AutogradDensity
from bough.learn.samplers.choose import sample
from bough.learn.samplers.diagnostics import (
    converged,
    effective_size,
    ksd_ratio,
    modes_of,
    r_hat,
    squared_ksd,
    stein_residuals,
)


def draws(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def normal(dims, rho):
    covariance = torch.full((dims, dims), rho, dtype=torch.float64).fill_diagonal_(1.0)
    precision = torch.linalg.inv(covariance)
    return AutogradDensity(lambda x: -0.5 * (x @ precision * x).sum(1))


def judge(run):
    return converged(run.trace, chain=run.chain, gradient=run.gradient)


def test_ksd_of_two_points_by_hand():
    """Compute the Stein kernel of two points in one dimension by hand."""
    x, g = torch.tensor([[0.0], [1.0]], dtype=torch.float64), torch.tensor([[0.5], [-2.0]], dtype=torch.float64)
    own = [0.25 + 1.0, 4.0 + 1.0]  # g^2 k(0) + d2k(0), with k(0) = 1 and d/dx d/dy k = 1
    # k = 2^-1/2; with r = x - y = -1: dk/dx = -r 2^-3/2, dk/dy = r 2^-3/2, d2k/dxdy = 2^-3/2 - 3 2^-5/2
    k, s = 2**-0.5, 2**-1.5
    pair = 0.5 * -2.0 * k + 0.5 * -s + -2.0 * s + s - 3.0 * 2**-2.5
    assert squared_ksd(x, g, statistic="u") == pytest.approx(pair, abs=1e-12)
    assert squared_ksd(x, g) == pytest.approx((sum(own) + 2 * pair) / 4, abs=1e-12)


def test_ksd_against_automatic_differentiation():
    """Build the Stein kernel by differentiating the kernel twice, for draws in three dimensions."""
    x, g = draws(6, 3), draws(6, 3, seed=1)

    def kernel(a, b):
        return (1.0 + ((a - b) ** 2).sum()) ** -0.5

    total = 0.0
    for i in range(6):
        for j in range(6):
            by_a, by_b = torch.func.grad(kernel, 0)(x[i], x[j]), torch.func.grad(kernel, 1)(x[i], x[j])
            mixed = torch.func.jacrev(torch.func.grad(kernel, 0), 1)(x[i], x[j]).trace()
            total += g[i] @ g[j] * kernel(x[i], x[j]) + g[i] @ by_b + g[j] @ by_a + mixed
    assert squared_ksd(x, g) == pytest.approx(float(total) / 36, rel=1e-10)


def test_u_statistic_is_unbiased():
    """Average to zero over sets of exact draws, within four standard errors, and not over draws moved by a half."""
    values = torch.tensor([squared_ksd(x, -x, statistic="u") for x in draws(200, 30, 3)])
    assert abs(values.mean()) < 4.0 * values.std() / math.sqrt(200)
    moved = torch.tensor([squared_ksd(x + 0.5, -(x + 0.5), statistic="u") for x in draws(200, 30, 3)])
    assert moved.mean() > 20.0 * values.std() / math.sqrt(200)


@pytest.mark.parametrize("dims", [1, 4, 8])
def test_exact_draws_have_ratio_one(dims):
    """Rate exact draws of a correlated normal at one within 30 %, and draws that miss the mean higher."""
    density = normal(dims, 0.7 if dims > 1 else 0.0)
    covariance = torch.full((dims, dims), 0.7, dtype=torch.float64).fill_diagonal_(1.0)
    x = draws(100, dims, seed=5) @ torch.linalg.cholesky(covariance).T
    exact = ksd_ratio(x, density.evaluate(x)[1])
    far = ksd_ratio(x + 1.0, density.evaluate(x + 1.0)[1])
    assert 0.7 < exact < 1.3
    assert far > 1.3 * exact


def test_stein_residuals_of_a_normal():
    """Measure a mean that is off by 0.3 deviations and a variance that is off by half, in closed form."""
    x = draws(50, 2)
    x = x - x.mean(0)
    x = torch.linalg.solve_triangular(torch.linalg.cholesky(x.T @ x / 50), x.T, upper=False).T
    assert max(stein_residuals(x, -x)) < 1e-6
    moved = x + torch.tensor([0.3, 0.3], dtype=torch.float64)
    assert stein_residuals(moved, -moved)[0] == pytest.approx(0.3, rel=1e-3)
    # E[g x^T] + I = I - 1.5 I
    assert stein_residuals(x * 1.5**0.5, -x * 1.5**0.5)[1] == pytest.approx(0.5, rel=1e-6)


def test_r_hat_and_size_of_autoregressive_chains():
    """Find the effective size n (1 - a) / (1 + a) of autoregressive chains, and R-hat near one."""
    a, noise = 0.6, draws(4000, 4, 1)
    chain = [noise[0]]
    for n in noise[1:]:
        chain.append(a * chain[-1] + math.sqrt(1 - a * a) * n)
    trace = torch.stack(chain)
    # 16000 draws; arviz estimates sizes to about 10 %
    assert float(effective_size(trace)[0]) == pytest.approx(16000 * (1 - a) / (1 + a), rel=0.15)
    assert 0.99 < float(r_hat(trace)[0]) < 1.02
    apart = trace + torch.arange(4)[:, None] * 1.0
    assert float(r_hat(apart)[0]) > 1.2


@pytest.mark.parametrize("method", ["mh", "sgld", "sghmc", "emcee"])
def test_long_chains_converge_and_short_ones_do_not(method):
    """Pass a long run on a correlated normal; fail one cut short from a wide start, and say why."""
    density = normal(3, 0.6)
    good = judge(sample(density, draws(40, 3), method=method, iterations=3000))
    bad = judge(sample(density, 50.0 * draws(40, 3), method=method, iterations=12))
    assert good.converged
    assert "effective sample size" in good.reason
    assert not bad.converged
    assert bad.numbers["r_hat"] > 1.05
    assert "R-hat" in bad.reason


@pytest.mark.parametrize("dims", [2, 8])
@pytest.mark.parametrize("count", [32, 100])
def test_particles_converge_unless_cut_short(dims, count):
    """Pass SVGD that came to rest on the target; fail it cut short from a wide start, and say why."""
    good = judge(sample(normal(dims, 0.5), 2.0 * draws(count, dims), iterations=60))
    bad = judge(sample(normal(dims, 0.5), 30.0 * draws(count, dims), iterations=10))
    assert good.converged, good.reason
    assert not bad.converged
    assert "Stein identity, spread" in bad.reason


def two_modes(apart, width=3.0):
    """Log density of two normals with deviations one and ``width``, ``apart`` from each other in both coordinates."""

    def log_density(x):
        second = -0.5 * ((x - apart) ** 2).sum(1) / width**2 - 2.0 * math.log(width)
        return torch.logaddexp(-0.5 * (x**2).sum(1), second)

    return AutogradDensity(log_density)


@pytest.mark.parametrize(("apart", "width", "count"), [(7.0, 1.0, 2), (7.0, 3.0, 1), (60.0, 3.0, 2), (1000.0, 3.0, 2)])
def test_modes_at_rest_are_converged(apart, width, count):
    """Pass particles at rest in two modes of one width or two, however far they are apart; one where they touch."""
    x = draws(100, 2)
    x[::2] = width * x[::2] + apart
    verdict = judge(sample(two_modes(apart, width), x, iterations=100))
    assert verdict.converged, verdict.reason
    assert verdict.numbers["modes"] == count


@pytest.mark.parametrize("wrong", [0.5, 1.6])
def test_one_mode_too_narrow_or_too_wide_is_not_converged(wrong):
    """Fail two modes of which one is drawn with other deviations, or two of its deviations off."""
    x = draws(200, 2)
    x[::2] = 3.0 * wrong * x[::2] + 1000.0
    moved = draws(200, 2)
    moved[::2] = 3.0 * (moved[::2] + 2.0) + 1000.0
    for start, text in ((x, "spread"), (moved, "mean")):
        verdict = converged(start.expand(20, 200, 2), chain=False, gradient=two_modes(1000.0).evaluate(start)[1])
        assert not verdict.converged
        assert f"Stein identity, {text}" in verdict.reason


@pytest.mark.parametrize("dims", [1, 3, 12])
def test_particles_are_counted_to_their_modes(dims):
    """Tell three modes of other sizes apart, count a lone particle to the largest, and leave one normal whole."""
    x = draws(64, dims)
    x[:20] += 300.0
    x[20:26] = 5.0 * x[20:26] - 1000.0
    x[26] += 5000.0
    mode = modes_of(x)
    assert sorted(mode.sum(0).tolist()) == [6.0, 20.0, 38.0]
    assert float(mode[26] @ mode.sum(0)) == 38.0
    assert all(modes_of(draws(64, dims, seed=k)).shape[1] == 1 for k in range(1, 20))


def test_particles_that_do_not_move_are_not_converged():
    """Fail particles at rest that are not draws: at rest is not enough."""
    x = draws(50, 2) * 0.3
    verdict = converged(x.expand(20, 50, 2), chain=False, gradient=-x)
    assert not verdict.converged
    assert verdict.numbers["drift"] == 0.0


def test_degenerate_runs_are_not_converged():
    """Fail, with a reason, chains that never moved, too few draws, collapsed particles and NaN."""
    x = draws(20, 2)
    nan = x.clone()
    nan[3, 0] = torch.nan
    flat = x.clone()
    flat[:, 1] = 1.0
    for trace, chain, text in (
        (x.expand(40, 20, 2), True, "R-hat"),
        (x.expand(4, 20, 2), True, "too few"),
        (flat.expand(40, 20, 2), False, "collapsed"),
        (nan.expand(40, 20, 2), False, "not finite"),
    ):
        verdict = converged(trace, chain=chain, gradient=-x)
        assert not verdict.converged
        assert text in verdict.reason
