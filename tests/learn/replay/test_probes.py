"""Pushes point where they say; what no arm can be told is refused."""

import numpy as np
import pytest
from bough.learn.replay.probes import ArmProbe, Push
from bough.sim.base.errors import InputError
from scipy.spatial.transform import Rotation


def pushed(axis) -> ArmProbe:
    """Return a probe of one push along this."""
    return ArmProbe("push", (Push(axis, 1.0, 1.0, np.ones_like),))


def test_a_push_points_along_its_axis_or_between():
    """Take an axis as it is, and parts of several at any length as one unit vector: 3, 0 and 4 of 5, by hand."""
    axes = Rotation.from_rotvec([0.3, 1.2, -0.5]).as_matrix()
    for k in range(3):
        assert np.array_equal(pushed(k).check().pushes[0].direction(axes), axes[k])
    between = pushed((-30.0, 0.0, 40.0)).check().pushes[0].direction(axes)
    assert between == pytest.approx(-0.6 * axes[0] + 0.8 * axes[2], abs=1e-12)


@pytest.mark.parametrize("axis", [3, -1, "x", (0.0, 0.0, 0.0), (1.0, 2.0), (1.0, float("nan"), 0.0), (1, 2, "x")])
def test_a_push_to_nowhere_is_refused(axis):
    """Name the axis, and say what it may be."""
    with pytest.raises(InputError, match=r"axis.*0, 1, 2, or a tuple of three numbers"):
        pushed(axis).check()
