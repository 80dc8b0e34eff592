"""Play of a joint that turns every way, against roots of the moments."""

import numpy as np
import pytest
from oracles.effect_case import FORCE, KS, held, resting, settled, stick, stick_case


@pytest.mark.parametrize("twist", [0.0, 0.6])
def test_of_twist_a_share_plays(tmp_path, twist):
    """Rest where a round gap does that sees a share of the twist, which a coupling brings, and gives as much of it."""
    case, gap, kappa, chi = stick_case(tmp_path / "c", [held()]), 0.06, 0.5, 1.1
    on = {
        "backlash": {"gap_rad": gap, "twist": twist},
        "bending_torsion_coupling": {"coupling": kappa, "axis_rad": chi},
    }
    c, z, share = np.array([np.cos(chi), np.sin(chi), 0.0]), np.array([0.0, 0.0, 1.0]), np.array([1.0, 1.0, twist])
    matrix = KS * (np.eye(3) + kappa * (np.outer(c, z) + np.outer(z, c)))

    def spring(phi, share=share):
        seen = share * phi
        return KS * share * seen * min(1.0, gap / max(np.linalg.norm(seen), 1e-9)) - matrix @ phi

    expected, whole = (resting(case, lambda phi, s=s: spring(phi, s), lambda R: FORCE) for s in (share, np.ones(3)))
    assert np.linalg.norm(expected - whole) > 2e-3
    np.testing.assert_allclose(settled(stick(case, **on)[0]), expected, atol=3e-4)


@pytest.mark.parametrize(("single", "uneven"), [(0.0, 0.0), (0.0, 0.3), (1.0, -0.3), (0.6, 0.0)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_play_about_an_axis(tmp_path, single, uneven, side):
    """Rest where a gap from -g (1 - u) to g (1 + u) about an axis does, and about the others a share of the play."""
    case, gap, psi, left = stick_case(tmp_path / "c", [held(300, side * FORCE)]), 0.02, 0.7, 0.2
    on = {"separate": 1.0, "left": left, "twist": 1.0, "axis_rad": psi, "single": single, "uneven": uneven}
    c, s = np.cos(psi), np.sin(psi)
    axes, share = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([1.0, 1.0 - single, 1.0 - single])
    low, high = -gap * np.array([1.0 - uneven, 1.0, 1.0]), gap * np.array([1.0 + uneven, 1.0, 1.0])

    def spring(phi, axes=axes, share=share, low=low, high=high):
        return KS * ((1.0 - left) * (axes.T @ (share * np.clip(share * (axes @ phi), low, high))) - phi)

    def along(phi):
        return KS * ((1.0 - left) * np.clip(phi, -gap, gap) - phi)

    expected, plain = (resting(case, spring, lambda R: side * FORCE) for spring in (spring, along))
    assert np.linalg.norm(expected - plain) > 1e-3
    out = stick(case, backlash={"gap_rad": gap, **on})[0]
    np.testing.assert_allclose(settled(out), expected, atol=3e-4)
