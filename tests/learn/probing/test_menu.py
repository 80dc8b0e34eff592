"""Pulls that may be proposed, and those that come first."""

import numpy as np
import pytest
from bough.learn.probing.menu import first, left, menu
from bough.sim.base.errors import InputError
from scipy.spatial.transform import Rotation

SHARE = np.linspace(0.0, 1.0, 1001)


def test_an_arm_that_cannot_let_go_swings_nothing():
    """Leave out pulls that let go; what is left holds to the end, and the first ones are among it."""
    held = menu(releases=False)
    assert all(push.free_from >= 1.0 for pull in held.values() for push in pull.pushes)
    assert {first(held, k, releases=False) for k in range(2)} == {"ramp_down", "triangle_across"}


def test_first_pulls_are_slow_and_let_go():
    """Pull down and back within the recording, then up and let go where it is bent most, at 0.35 of it; by hand."""
    pulls = menu(releases=True)
    (ramp,), (release,) = (pulls[first(pulls, k, releases=True)].pushes for k in range(2))
    force = ramp.course(SHARE)
    assert (force.min(), force.max(), force[0], force[-1]) == (-1.0, 0.0, 0.0, 0.0) and ramp.free_from == 1.0
    assert np.ptp(SHARE[force < -0.5]) == pytest.approx(0.525, abs=0.003)  # from 0.15 to 0.675
    held = release.course(SHARE[release.free_from > SHARE])
    assert release.free_from == 0.35 and held[-1] == held.max() == 1.0


def test_diagonal_pulls_lie_between_the_planes():
    """Push at 45 degrees to both axes across the segment, to either side, and at right angles to the segment."""
    axes = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
    pulls = menu(releases=True)
    ways = [pulls[name].pushes[0].direction(axes) for name in ("ramp_diagonal", "release_diagonal")]
    assert ways[0] @ ways[1] == pytest.approx(0.0, abs=1e-12)
    for way in ways:  # parts of 1 / sqrt(2) along both axes across, none along
        assert np.abs(axes @ way) == pytest.approx([0.5**0.5, 0.5**0.5, 0.0], abs=1e-12)
    assert np.array_equal(pulls["full_swing_across"].pushes[0].direction(axes), axes[1])


def test_pulls_that_were_done_are_done_again_last():
    """Leave what is not done yet; all of them once all are done."""
    pulls = menu(True, ("thrice", "still", "pull"))
    assert set(left(pulls, {"still"})) == {"thrice", "pull"}
    assert left(pulls, set(pulls)) == pulls


def test_pulls_are_as_long_as_a_recording_and_chosen_by_name():
    """Give every pull the length of one recording; refuse a name that no pull has, and one that this arm cannot do."""
    assert all(push.length == 1.0 for pull in menu(True).values() for push in pull.pushes)
    assert list(menu(True, ("thrice", "still"))) == ["thrice", "still"]
    for releases, name in ((True, "tickle"), (False, "full_swing_in")):
        with pytest.raises(InputError, match=name):
            menu(releases, (name,))
