"""Pulls that may be proposed, and those that come first."""

import numpy as np
import pytest
from bough.learn.probing.menu import first, menu
from bough.sim.base.errors import InputError

SHARE = np.linspace(0.0, 1.0, 1001)


def test_an_arm_that_cannot_let_go_swings_nothing():
    """Leave out pulls that let go; what is left holds to the end, and the first ones are among it."""
    held = menu(releases=False)
    assert all(push.free_from >= 1.0 for pull in held.values() for push in pull.pushes)
    assert {first(held, k, releases=False) for k in range(2)} == {"triangle_in", "triangle_across"}


def test_first_pulls_bend_the_branch_to_either_side_and_let_it_swing_in_both_planes():
    """Pull in two planes; let go in both, and in one of them pull both ways before: by hand, +1 and -1 of the force."""
    pulls = menu(releases=True)
    both = [pulls[first(pulls, k, releases=True)].pushes for k in range(2)]
    assert [len(p) for p in both] == [1, 1] and {p[0].axis for p in both} == {0, 1}
    held = [p[0].course(SHARE[p[0].free_from > SHARE]) for p in both]
    assert all(p[0].free_from == 0.5 for p in both)
    assert sorted((force.min(), force.max()) for force in held) == [(-1.0, 1.0), (0.0, 1.0)]
    assert all(abs(force[-1]) == 1.0 for force in held)  # it is let go where it is bent most


def test_pulls_are_as_long_as_a_recording_and_chosen_by_name():
    """Give every pull the length of one recording; refuse a name that no pull has, and one that this arm cannot do."""
    assert all(push.length == 1.0 for pull in menu(True).values() for push in pull.pushes)
    assert list(menu(True, ("thrice", "still"))) == ["thrice", "still"]
    for releases, name in ((True, "tickle"), (False, "full_swing_in")):
        with pytest.raises(InputError, match=name):
            menu(releases, (name,))
