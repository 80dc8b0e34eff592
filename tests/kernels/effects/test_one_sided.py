"""A one-sided spring whose corner is off rest, against a root of the moments."""

import numpy as np
import pytest
from oracles.effect_case import FORCE, KS, held, resting, settled, stick, stick_case


@pytest.mark.parametrize(("relative", "split"), [(-0.6, 0.0), (1.5, 0.0), (-0.6, 0.7), (1.5, 0.4), (1.5, 1.0)])
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("off", [0.03, -0.03])
def test_a_one_sided_spring_changes_at_an_angle_from_rest(tmp_path, relative, split, way, off):
    """Rest where a spring with its corner at the angle |d| does, whose stiff side holds the rest pose, or the soft one.

    Pushed to either side; bent the way that holds the rest pose it only stays as it is. The corner is rounded over
    0.1 mrad, of which half is lacking beyond it. A share of the change may be made the other way round below the
    corner, of which a tenth of the stiffness is left at least.
    """
    case, psi = stick_case(tmp_path / "c", [held(force=way * FORCE)]), 0.7
    n = np.array([np.cos(psi), np.sin(psi), 0.0])

    def spring(phi, off=off):
        corner = -np.sign(relative) * off
        back = min(split * relative, 0.9)
        upper = max(phi @ n, corner) - max(0.0, corner)
        lower = min(phi @ n, corner) - min(0.0, corner)
        return -KS * (phi + (relative * upper - back * lower) * n)

    own = {"relative": relative, "axis_rad": psi, "corner_rad": 1e-4, "off_rad": off, "split": split}
    expected, centred = (resting(case, lambda phi, d=d: spring(phi, d), lambda R: way * FORCE) for d in (off, 0.0))
    moved = float(np.linalg.norm(expected - centred))
    assert moved > 2e-3 if way * relative * off < 0.0 else moved < 1e-6
    np.testing.assert_allclose(settled(stick(case, bilinear_stiffness=own)[0]), expected, atol=3e-4)
