"""An effort that points against its motion is refused only where it takes work out of it, too."""

import numpy as np
import pytest
from bough.learn.recordings.plausible import check_sign
from bough.sim.base.errors import InputError

T = np.linspace(0.0, 4.0, 801)


def driven(frequency, inertia=0.2, damping=0.3, stiffness=2.0):
    """Return torque and angle of a joint that a motor swings: J a'' + D a' + K a of a = sin(w t), [T, 1] each."""
    w = 2 * np.pi * frequency
    a, v = np.sin(w * T), w * np.cos(w * T)
    return [(-inertia * w * w * a + damping * v + stiffness * a)[:, None]], [a[:, None]]


@pytest.mark.parametrize("kind", ["force", "torque"])
def test_a_pull_the_other_way_is_refused(kind):
    """Refuse what opposes a slow pull and takes 0.5 K x^2 and what a damper takes out; not the same pull turned."""
    effort, motion = driven(0.05)
    check_sign(effort, motion, None, kind=kind)
    turned = [-f for f in effort]
    for flip in ("force", "motion", "none"):
        check_sign(turned, motion, flip, kind=kind)
    whose = {"force": "branch's pull on the hand", "torque": "load does to the drive"}[kind]
    with pytest.raises(InputError, match=f"a {kind} that points against.*{whose}"):
        check_sign(turned, motion, None, kind=kind)


def test_a_drive_that_outruns_its_load_is_no_mistake():
    """Keep the torque of a motor above resonance: it opposes the angle (-J w^2), and does the damper's work.

    At 3 Hz J w^2 is 71 N m beside K = 2 and D w = 5.7: force and motion have a correlation of -0.997.
    """
    effort, motion = driven(3.0)
    assert np.corrcoef(effort[0][:, 0], motion[0][:, 0])[0, 1] < -0.99
    check_sign(effort, motion, None, kind="torque")
