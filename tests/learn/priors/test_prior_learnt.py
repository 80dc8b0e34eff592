"""Learnt priors against what they were taught: equation 3.17, and beams on trees that they have not seen."""

import subprocess
import sys

import numpy as np
import pytest
import torch
from bough.learn.priors.learnt import (
    DIFFERENCE,
    POSITION,
    GeometryPrior,
    InequalityPrior,
    branch_pairs,
    chain_pairs,
    grown_pairs,
)
from bough.learn.priors.prior import Product, SmoothBox
from bough.sim.trees.fractal import grow_chain
from bough.sim.trees.stiffness import beam
from hypothesis import given, settings
from hypothesis import strategies as st


def penalty(parent, child, eta):
    """Equation 3.17."""
    return -eta * torch.clamp(child - parent, min=0.0)


def pairs_at(difference, middle=0.0):
    """Values [N, 2] of parent and child with given differences child - parent."""
    return torch.stack([middle - 0.5 * difference, middle + 0.5 * difference], -1)


def line(end, count):
    return torch.linspace(-end, end, count, dtype=torch.float64)


def test_chain_pairs_by_hand():
    """Pair successive names of each kind, wherever they stand, and no name that all branches share."""
    three = ["stiffness trunk", "damping trunk", "density", "stiffness bough", "stiffness twig one", "damping bough"]
    assert chain_pairs(three) == [(0, 3), (3, 4), (1, 5)]
    assert chain_pairs(["stiffness", "damping"]) == []
    assert chain_pairs(["stiffness", "damping a", "damping b"]) == [(1, 2)]
    assert chain_pairs([]) == []


@pytest.mark.parametrize("eta", [0.5, 10.0])
def test_inequality_is_equation_3_17(eta):
    """Stay within 0.05 eta of equation 3.17 over the whole domain: the rounded kink errs by 0.03 eta, the rest less."""
    d, m = torch.meshgrid(line(DIFFERENCE, 481), line(POSITION, 21), indexing="ij")
    theta = pairs_at(d, m)
    error = (InequalityPrior([(0, 1)], eta)(theta) - penalty(theta[..., 0], theta[..., 1], eta)).abs()
    assert error.max() < 0.05 * eta
    assert error[d.abs() > 0.5].max() < 0.01 * eta


def test_inequality_pulls_a_violating_pair_together():
    """Push the child down and the parent up with a slope of eta where violated, and neither where not."""
    d, m = torch.meshgrid(line(DIFFERENCE, 481), line(POSITION, 21), indexing="ij")
    theta = pairs_at(d, m).requires_grad_()
    (slope,) = torch.autograd.grad(InequalityPrior([(0, 1)], 10.0)(theta).sum(), theta)
    assert bool((slope[..., 1] <= 0.0).all()) and bool((slope[..., 0] >= 0.0).all())
    # 0.3 is six times the width that the kink is rounded by
    expected = torch.tensor([10.0, -10.0], dtype=torch.float64)
    assert torch.allclose(slope[d > 0.3], expected, rtol=0.02)
    assert float(slope[d < -0.3].abs().max()) < 0.02 * 10.0


@settings(max_examples=50, deadline=None)
@given(parent=st.floats(-200, 200), step=st.floats(0.01, 100), excess=st.floats(-300, 300))
def test_inequality_keeps_penalising_beyond_its_domain(parent, step, excess):
    """Fall strictly with every further step of a child above its parent, and never rise, however far off."""
    prior = InequalityPrior([(0, 1)])
    near, far = (prior(torch.tensor([parent, parent + e], dtype=torch.float64)) for e in (excess, excess + step))
    # the slope is near eta = 10 in the domain; 5 holds out to eight times the domain's largest position
    assert far <= near
    assert excess < 0.5 or near - far > 5.0 * step


def test_inequality_adds_up_over_a_tree():
    """Add the penalties of a trunk with two children, one of which has a child of its own, for any batch shape."""
    pairs = [(0, 1), (0, 2), (2, 3)]
    theta = torch.randn(4, 5, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * 3.0
    expected = sum(penalty(theta[..., p], theta[..., c], 2.0) for p, c in pairs)
    found = InequalityPrior(pairs, 2.0)(theta)
    assert found.shape == (4, 5)
    assert float((found - expected).abs().max()) < 3 * 0.05 * 2.0


def test_no_pairs_is_flat():
    """Give no penalty and no slope where all branches share one stiffness."""
    theta = torch.zeros(3, 2, dtype=torch.float64, requires_grad=True)
    for prior in (InequalityPrior([]), GeometryPrior([], [], [])):
        value = prior(theta)
        assert value.shape == (3,) and not value.any()
        assert not torch.autograd.grad(value.sum(), theta)[0].any()


@pytest.mark.parametrize("kind, ratios", [(InequalityPrior, ()), (GeometryPrior, ([0.7, 0.6], [0.8, 1.1]))])
def test_gradients_against_finite_differences(kind, ratios):
    """Agree with finite differences about the kink and far from it."""
    prior = kind([(0, 1), (1, 2)], *ratios)
    theta = torch.tensor([[3.0, 2.9, 3.05], [5.0, 1.0, -4.0], [1.0, 3.0, 2.0]], dtype=torch.float64)
    assert torch.autograd.gradcheck(prior, theta.requires_grad_())


def test_ratios_that_are_none_are_refused():
    """Refuse logarithms of ratios, which are negative, and fewer ratios than pairs."""
    for radius, length in (([-0.3], [0.8]), ([0.7], [0.0]), ([], [])):
        with pytest.raises(ValueError, match="1 of each, above 0"):
            GeometryPrior([(0, 1)], radius, length)


def test_copies_do_not_share_weights():
    """Leave other priors alone when one is moved to another precision, and teach no weights further."""
    first, second = InequalityPrior([(0, 1)]), InequalityPrior([(0, 1)])
    first.float()
    assert second.regressor.inner.dtype == torch.float64
    assert not any(p.requires_grad for p in second.parameters())


def test_weights_do_not_depend_on_the_number_of_threads():
    """Train to the same bits on one thread and on two, and leave the caller's number as it was."""
    code = (
        "import sys, torch; from bough.learn.priors.learnt import GeometryPrior, InequalityPrior; "
        "n = int(sys.argv[1]); torch.set_num_threads(n); "
        "priors = (InequalityPrior([(0, 1)]), GeometryPrior([(0, 1)], [0.7], [0.8])); "
        "print([p.detach().numpy().tobytes().hex() for q in priors for p in q.parameters()]); "
        "assert torch.get_num_threads() == n"
    )
    one, two = (subprocess.run([sys.executable, "-c", code, n], capture_output=True, check=True).stdout for n in "12")
    assert one == two and len(one) > 1000


def test_product_with_a_box():
    """Multiply the learnt density with a box's: logarithms add."""
    low, high = torch.zeros(2, dtype=torch.float64), torch.ones(2, dtype=torch.float64)
    theta = torch.tensor([[0.5, 1.2], [0.9, 0.1]], dtype=torch.float64)
    box, order = SmoothBox(low, high), InequalityPrior([(0, 1)])
    assert torch.allclose(Product([box, order])(theta), box(theta) + order(theta))
    assert not Product([])(theta).any()


def test_branch_pairs_of_a_chain():
    """Return the ratios that a chain was grown with, and the beam's stiffness: radius to the fourth over length."""
    tree = beam(grow_chain(4, radius_ratio=0.6, length_ratio=0.8))
    stiffness, radius, length = branch_pairs(tree)
    assert np.allclose(radius, np.log(0.6)) and np.allclose(length, np.log(0.8))
    assert np.allclose(stiffness, np.log(0.6**4 / 0.8)) and len(stiffness) == 3


def density_of_difference(radius, length, middle):
    """Differences [N], their probabilities and log density under the prior of one pair with given ratios."""
    difference = line(DIFFERENCE, 2401)
    log = GeometryPrior([(0, 1)], [radius], [length])(pairs_at(difference, middle))
    return difference, torch.softmax(log, 0), log


@pytest.mark.parametrize("middle", [-20.0, 0.0, 20.0])
def test_geometry_finds_the_beam_in_fresh_trees(middle):
    """Peak at the beam's 4 log r - log l with its scatter, and fall on both sides, on trees grown from another seed.

    Two branches scatter by 0.5 each, so the difference by 0.707. The mode is allowed 0.25, about a third of that.
    """
    _, radius, length = grown_pairs(1)
    for i in np.random.default_rng(0).choice(len(radius), 30, replace=False):
        d, p, log = density_of_difference(np.exp(radius[i]), np.exp(length[i]), middle)
        expected = 4.0 * radius[i] - length[i]
        mean = float((p * d).sum())
        assert abs(float(d[log.argmax()]) - expected) < 0.25
        assert abs(mean - expected) < 0.25
        assert float((p * (d - mean) ** 2).sum().sqrt()) == pytest.approx(0.5 * 2**0.5, rel=0.15)
        rising = torch.arange(len(d) - 1) < log.argmax()
        assert bool((log.diff()[rising] > 0).all()) and bool((log.diff()[~rising] < 0).all())


def test_geometry_is_the_log_density_near_the_mode():
    """Equal the normal log density of the difference, up to a constant, within 0.35 up to two deviations from the mode.

    There it has fallen by 2; the mode's own error of 0.1 makes 0.3 of the difference.
    """
    scatter = 0.5 * 2**0.5
    for radius, length in ((0.7, 0.75), (0.6, 1.0), (1.0, 0.9)):
        expected = 4.0 * np.log(radius) - np.log(length)
        d, _, log = density_of_difference(radius, length, 1.0)
        near = (d - expected).abs() < 2.0 * scatter
        normal = -0.5 * ((d - expected) / scatter) ** 2
        gap = (log - normal)[near]
        assert float((gap - gap.mean()).abs().max()) < 0.35


def test_geometry_does_not_see_what_all_branches_share():
    """Keep its density when all log stiffnesses rise together, as from K to D or to another modulus, within 0.3."""
    prior = GeometryPrior([(0, 1), (1, 2)], [0.7, 0.6], [0.8, 1.0])
    theta = torch.tensor([3.0, 1.8, -0.2], dtype=torch.float64)
    shifts = line(POSITION - 5.0, 21)
    values = prior(theta + shifts[:, None])
    assert float(values.max() - values.min()) < 0.3
