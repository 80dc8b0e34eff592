"""What kernels with laws are built of: one for every choice of effects, another for every other law."""

import pytest
import warp as wp
from bough.kernels.effects.rollout import effect_rollout_kernels
from bough.kernels.effects.step import term_kernels
from bough.kernels.effects.structs import PARAMETERS
from bough.kernels.effects.terms import Term
from bough.learn.systems.acting import Acting, ActingSet
from bough.sim.effects import Setting, effects, terms_of


def law_with(factor):
    """Return a law whose helper multiplies by a factor; sources of the laws themselves are equal."""
    if factor == 1:

        @wp.func
        def helper(x: float):
            return x * 1.0

    else:

        @wp.func
        def helper(x: float):
            return x * 2.0

    @wp.func
    def law(j: wp.array(dtype=float), p: float, r: float):
        return helper(r)

    return law


@pytest.mark.parametrize("kind", ["joint", "link", "force"])
def test_a_law_that_differs_in_its_helper_is_another_kernel(kind):
    """Compile anew where what a law calls is another: modules have other names, as Warp's cache on disk knows them."""
    kernels = []
    for factor in (1, 2, 1):
        terms = (Term("x", kind, law_with(factor), 0, True), Term("y", kind, law_with(1), 1, True))
        kernels.append((effect_rollout_kernels(16, 32, terms).joint, effect_rollout_kernels(16, 32, terms).point))
        if kind != "force":  # a free step has no sensor
            kernels[-1] += (term_kernels(16, 32, terms).step,)
    names = [[k.module.name for k in own] for own in kernels]
    assert names[0] == names[2] and not set(names[0]) & set(names[1])


def test_a_law_that_holds_otherwise_is_another_kernel():
    """Compile anew where what a law says that it holds is another."""
    law = law_with(1)
    names = []
    for factor in (1, 2, 1):
        own = Term("x", "joint", law, 0, True, memory=1, holds=law_with(factor))
        other = Term("y", "joint", law, 1, True, memory=1, holds=law_with(1))
        names.append(effect_rollout_kernels(16, 32, (own, other)).point.module.name)
    assert names[0] == names[2] != names[1]


def test_one_kernel_serves_any_choice_of_effects():
    """Build a replay with all effects that can act, whatever acts; its neutral values are all of them."""
    setting = Setting(torque=1.0, angle=1.0, rate=1.0, force=1.0)
    one = ActingSet([Acting("dry_friction", 0)], "branch", [setting])
    two = ActingSet([Acting("quadratic_drag"), Acting("cubic_stiffness", 0)], "branch", [setting])
    assert one.names == two.names == tuple(e.name for e in effects() if e.branch is not None)
    assert effect_rollout_kernels(16, 32, terms_of(one.names, "branch")) is effect_rollout_kernels(
        16, 32, terms_of(two.names, "branch")
    )
    assert list(one.laws) == ["dry_friction"] and len(one.neutral()) == PARAMETERS * len(one.names)
    assert one.persists and not two.persists and not one.settles
    assert ActingSet([], "branch", [setting]).names == ()
