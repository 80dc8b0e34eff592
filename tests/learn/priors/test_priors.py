"""Which densities the names of priors stand for."""

import numpy as np
import pytest
import torch
from bough.learn.cases.case import load_case
from bough.learn.priors.choose import LOGNORMAL_SIGMA, make_prior
from bough.learn.systems.branch import BranchSystem, Unknowns
from bough.sim.base.errors import InputError
from oracles.branch_case import make_branch_case


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("priors") / "case"
    make_branch_case(folder, 3, segments=3, noise=0.03, samples=20)
    return load_case(folder)


def middle(system):
    return torch.tensor([p.start for p in system.parameters], dtype=torch.float64)


def test_box_alone_is_flat_inside(case):
    """Be constant inside, and fall as a normal tail of width 0.1 outside."""
    system = BranchSystem(case)
    prior, x = make_prior((), system), middle(system)
    outside = x.clone()
    outside[0] = np.log(system.parameters[0].high) + 0.2
    assert prior(x) == prior(x + 0.1)
    assert torch.isclose(prior(outside) - prior(x), torch.tensor(-2.0, dtype=torch.float64))


def test_lognormal_is_centred_at_the_typical_values(case):
    """Two deviations are a factor of ten."""
    system = BranchSystem(case)
    prior, x = make_prior(("lognormal",), system), middle(system)
    away = x.clone()
    away[1] += np.log(10.0)
    assert torch.isclose(prior(x) - prior(away), torch.tensor(0.5 * (np.log(10.0) / LOGNORMAL_SIGMA) ** 2))


@pytest.mark.parametrize("name", ["inequality", "geometry"])
def test_a_child_stiffer_than_its_parent_is_unlikely(case, name):
    """Lose far more where the order is reversed than where it holds; dampers count as springs do."""
    system = BranchSystem(case)
    prior, x = make_prior((name,), system), middle(system)
    for first in (0, 3):
        reversed_ = x.clone()
        reversed_[first + 1] = x[first] + 1.5
        assert prior(x) - prior(reversed_) > 3.0


def test_names_multiply(case):
    """The log density of two is the sum."""
    system = BranchSystem(case)
    x = middle(system) + 0.3
    both, one, other, box = (
        make_prior(n, system)(x) for n in (("lognormal", "inequality"), ("lognormal",), ("inequality",), ())
    )
    assert torch.isclose(both, one + other - box)


def test_shared_springs_have_no_order(case):
    """Refuse the inequality where there is no parent and child."""
    system = BranchSystem(case, Unknowns(shared=("stiffness", "damping")))
    with pytest.raises(InputError, match="no parent and child"):
        make_prior(("inequality",), system)
