"""Samplers of one interface: moments of known densities, the same bits after a resume, bad input."""

import pytest
import torch
from bough.learn.samplers.base import AutogradDensity, Population
from bough.learn.samplers.choose import METHODS, make_sampler, sample
from bough.learn.samplers.diagnostics import effective_size
from bough.sim.base.errors import InputError

CHAINS = [name for name in METHODS if name != "svgd"]


def start(count, dims, scale, seed=1):
    return torch.randn(count, dims, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) * scale


def normal(dims, rho):
    covariance = torch.full((dims, dims), rho, dtype=torch.float64).fill_diagonal_(1.0)
    precision = torch.linalg.inv(covariance)
    return AutogradDensity(lambda x: -0.5 * (x @ precision * x).sum(1))


@pytest.mark.parametrize("dims", [2, 5])
@pytest.mark.parametrize("rho", [0.0, 0.8])
@pytest.mark.parametrize("method", CHAINS)
def test_moments_of_a_normal(method, dims, rho):
    """Match mean and variance of a correlated normal within four Monte-Carlo errors, from a start too wide."""
    run = sample(normal(dims, rho), start(40, dims, 10.0), method=method, iterations=1200, seed=3)
    draws = run.draws
    size = effective_size(run.trace[run.warm_up :])
    assert size.min() > 200
    # Var(mean) = 1 / ess; Var(variance) = 2 / ess for a normal, with draws of squares no less dependent
    assert (draws.mean(0).abs() < 4.0 / size.sqrt()).all()
    # without an acceptance test the variance is too large by at most h/4 and h/(2(2-a)), see the samplers
    bias = {"sgld": 0.2 / 4, "sghmc": 0.1 / 3}.get(method, 0.0)
    assert (draws.var(0) < 1.0 + bias / (1.0 - bias) + 4.0 * (2.0 / size).sqrt()).all()
    assert (draws.var(0) > 1.0 - 4.0 * (2.0 / size).sqrt()).all()


@pytest.mark.parametrize("method", ["sgld", "sghmc"])
def test_bias_is_what_the_recursion_says(method):
    """Find the closed-form stationary variance of each unadjusted recursion on a normal density, at a large step.

    The preconditioner is frozen at the population's own variance, which differs from one, so the step in units of the
    target is h times that variance; SGHMC's friction is a half.
    """
    sampler = make_sampler(method, start(400, 1, 1.0), iterations=1000, seed=5, step_size=0.5)
    density = normal(1, 0.0)
    draws = torch.stack([sampler.step(density).clone() for _ in range(1000)])[sampler.warm_up :]
    scale = float(sampler.factor) ** 2
    expected = 1 / (1 - 0.5 * scale / (4 if method == "sgld" else 3))
    # 200,000 draws with a correlation time of a few: the variance's standard error is below 0.01
    assert abs(float(draws.var()) - expected) < 0.04
    assert expected > 1.1


def test_metropolis_hastings_tunes_its_acceptance():
    """Accept about 0.234 of the proposals after the warm-up, whatever the scale of the start."""
    for scale in (0.01, 1.0, 100.0):
        sampler = make_sampler("mh", start(50, 4, scale), iterations=1000, seed=0)
        for _ in range(1000):
            sampler.step(normal(4, 0.5))
        assert 0.18 < float(sampler.accepted.mean()) < 0.3


def test_metropolis_hastings_step_by_hand():
    """Follow one iteration by the textbook with the same random numbers."""
    density, x = normal(2, 0.3), start(6, 2, 1.0)
    sampler = make_sampler("mh", x, iterations=10, seed=9)
    factor, scale = sampler.factor, float(sampler.log_scale.exp())
    generator = torch.Generator().manual_seed(9)
    noise = torch.randn(6, 2, generator=generator, dtype=torch.float64)
    uniform = torch.rand(6, generator=generator, dtype=torch.float64)
    after = sampler.step(density)
    for i in range(6):
        proposal = x[i] + scale * factor @ noise[i]
        ratio = torch.exp(density.log_density(proposal[None]) - density.log_density(x[i : i + 1]))
        assert torch.allclose(after[i], proposal if uniform[i] < ratio else x[i])


@pytest.mark.parametrize("stop", [1, 7, 15, 29])
@pytest.mark.parametrize("method", METHODS)
def test_resume_gives_the_same_bits(method, stop):
    """Go on from a state to the bits of the uninterrupted run, in positions, densities and state."""

    def modes(x):
        return torch.logaddexp(-0.5 * (x**2).sum(1), -0.5 * ((x - 5.0) ** 2).sum(1) - 1.0)

    density = AutogradDensity(modes)

    def make(seed):
        return make_sampler(method, start(20, 3, 4.0), iterations=30, seed=seed)

    whole, first, second = make(4), make(4), make(99)
    for _ in range(30):
        whole.step(density)
    for _ in range(stop):
        first.step(density)
    state = first.state()
    assert all(isinstance(value, torch.Tensor) for value in state.values())
    first.step(density)  # the state is a copy: going on does not change it
    second.load(state)
    for _ in range(30 - stop):
        second.step(density)
    for name, value in whole.state().items():
        assert torch.equal(value, second.state()[name]), name


@pytest.mark.parametrize("method", METHODS)
def test_same_seed_same_bits(method):
    """Repeat a run exactly with the same seed; give different chains with another."""
    runs = [sample(normal(2, 0.5), start(20, 2, 2.0), method=method, iterations=20, seed=s) for s in (1, 1, 2)]
    assert torch.equal(runs[0].trace, runs[1].trace)
    assert torch.equal(runs[0].trace, runs[2].trace) == (method == "svgd")


@pytest.mark.parametrize("method", METHODS)
def test_log_densities_belong_to_positions(method):
    """Report at every iteration the log density of the positions reported."""
    density = normal(3, 0.5)
    run = sample(density, start(16, 3, 2.0), method=method, iterations=12)
    assert run.trace.shape == (12, 16, 3)
    assert torch.allclose(density.log_density(run.trace.flatten(0, 1)), run.log_density_trace.flatten(), atol=1e-12)
    assert torch.equal(run.particles, run.trace[-1])


@pytest.mark.parametrize("method", METHODS)
def test_densities_that_are_not_finite_are_survived(method):
    """Keep to where the density exists: the half-normal on x > 0; NaN or -inf elsewhere, where some start."""

    def log_density(x):
        inside = -0.5 * (x**2).sum(1)
        outside = torch.where(x[:, 1] > 0.0, torch.nan, -torch.inf)
        return torch.where(x[:, 0] > 0.0, inside, outside)

    x = start(40, 2, 1.0)
    x[10:, 0] = x[10:, 0].abs()
    run = sample(AutogradDensity(log_density), x, method=method, iterations=400, seed=1)
    assert run.trace.isfinite().all()
    if run.chain:
        mean = float(run.draws[:, 0].mean())
        # sqrt(2 / pi) = 0.80; a refused step keeps a chain near the edge longer than reflection would, so not exact
        assert abs(mean - 0.798) < 0.15
        assert (run.draws[:, 0] > 0.0).double().mean() > 0.95


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"name": "nuts"}, "found nuts; allowed: svgd, mh, sgld, sghmc, emcee"),
        ({"particles": torch.zeros(1, 2)}, "shape [1, 2]"),
        ({"particles": torch.tensor([[0.0, 1.0], [torch.nan, 1.0]])}, "particle 1"),
        ({"iterations": 1}, "iterations: found 1"),
        ({"step_size": 1.5}, "step_size: found 1.5"),
        ({"name": "mh", "step_size": 0.1}, "this sampler finds its own"),
        ({"name": "emcee", "particles": torch.zeros(5, 3)}, "6 or more"),
    ],
)
def test_bad_input(change, text):
    """Name what was found and what is allowed."""
    arguments = {"name": "svgd", "particles": torch.ones(8, 2), "iterations": 10, "seed": 0} | change
    with pytest.raises(InputError) as e:
        make_sampler(**arguments)
    assert text in str(e.value)
    assert "\n" not in str(e.value)


def test_every_sampler_has_the_interface():
    """Offer the same attributes and the same state for every name."""
    for method in METHODS:
        sampler = make_sampler(method, start(12, 2, 1.0), iterations=4, seed=0)
        assert isinstance(sampler, Population)
        assert sampler.name == method
        assert sampler.step(normal(2, 0.0)).shape == (12, 2)
        assert {"particles", "log_density", "gradient", "generator", "iteration"} <= set(sampler.state())
        assert sampler.iteration == 1
