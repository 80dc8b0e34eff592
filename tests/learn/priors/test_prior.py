"""Priors against their formulas."""

import torch
from bough.learn.priors.prior import Blocks, Normal, SmoothBox
from scipy import stats

LOW, HIGH = torch.tensor([0.0, 1.0], dtype=torch.float64), torch.tensor([2.0, 3.0], dtype=torch.float64)


def test_smooth_box_is_flat_inside_and_falls_outside():
    """Give 0 inside the box and -d^2 / (2 sigma^2) at a distance d from it."""
    box = SmoothBox(LOW, HIGH, sigma=0.5)
    points = torch.tensor([[1.0, 2.0], [0.0, 3.0], [-0.3, 2.0], [2.4, 0.7]], dtype=torch.float64)
    expected = torch.tensor([0.0, 0.0, -0.09 / 0.5, -(0.16 + 0.09) / 0.5], dtype=torch.float64)
    assert torch.allclose(box(points), expected)


def test_smooth_box_gradient_is_continuous_at_the_edge():
    """Vanish with the distance: the gradient just outside is proportional to it."""
    for d in (1e-3, 1e-6):
        x = torch.tensor([[-d, 2.0]], dtype=torch.float64, requires_grad=True)
        (gradient,) = torch.autograd.grad(SmoothBox(LOW, HIGH, sigma=0.1)(x).sum(), x)
        assert torch.allclose(gradient, torch.tensor([[d / 0.01, 0.0]], dtype=torch.float64))


def test_normal_matches_scipy():
    """Equal SciPy's normal log density up to its constant."""
    mean, sigma = torch.tensor([0.5, -1.0], dtype=torch.float64), torch.tensor([0.2, 3.0], dtype=torch.float64)
    x = torch.tensor([[0.1, 2.0], [0.9, -4.0]], dtype=torch.float64)
    ours = Normal(mean, sigma)(x)
    theirs = torch.as_tensor(stats.norm(mean, sigma).logpdf(x)).sum(1)
    assert torch.allclose(ours - ours[0], theirs - theirs[0])


def test_blocks_add_up():
    """Split a vector over its parts and add their densities."""
    parts = Blocks([(2, SmoothBox(LOW, HIGH)), (0, SmoothBox(LOW[:0], HIGH[:0])), (1, Normal(LOW[:1], HIGH[:1]))])
    x = torch.tensor([[1.0, 4.0, 3.0]], dtype=torch.float64)
    assert torch.allclose(parts(x), torch.tensor([-1.0 / 0.02 - 9.0 / 8.0], dtype=torch.float64))
