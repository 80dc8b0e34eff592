"""A grip that slides along the segment it holds, against closed forms of the way it goes."""

import numpy as np
import pytest
from bough.learn.replay.recording import recordings
from oracles.effect_case import FORCE, KS, held, resting, settled, stick, stick_case


@pytest.mark.parametrize(("mobility", "end"), [(1.0, 0.5), (-1.0, 0.0)])
def test_grasp_slip_ends_with_the_segment(tmp_path, mobility, end):
    """Slide to the tip or to the base whatever the force's direction, rest as if held there; begin anew in the next."""
    case = stick_case(tmp_path / "c", [held(400), held(400, -FORCE)])
    on = {"grasp_slip": {"mobility_mpNs": mobility, "least_N": 0.05}}
    out = stick(case, **on)
    for run, force in zip(out, (FORCE, -FORCE), strict=True):
        at_end = resting(case, lambda phi: -KS * phi, lambda R, f=force: f, point=end, seen=end)
        np.testing.assert_allclose(settled(run), at_end, atol=1e-4)
    alone = stick(case, chosen=recordings(case)[1:], **on)
    assert (alone[0] == out[1]).all()


@pytest.mark.parametrize("mobility", [0.01, -0.02])
def test_grasp_slip_drifts_while_held_and_stays(tmp_path, mobility):
    """Slide by the integral of mobility (|F| - least), at rest on the way as if held there, and stay when let go."""
    least, size = 2.0, np.linalg.norm(FORCE)
    force = np.where(np.arange(200)[:, None] < 126, held(), 0.0)
    case = stick_case(tmp_path / "c", [force], opened=[(2.52, 3.98)])
    out = stick(case, grasp_slip={"mobility_mpNs": mobility, "least_N": least})[0]
    t = case.trajectories[0].t

    def slide(until):
        """Integrate the excess over a rise of 0.4 s that ends at 0.5 s, a hold, and a fall of one sample from 2.5 s."""
        over = size - least
        ramps = 0.4 + (0.02 if until > 2.5 else 0.0)
        return mobility * over * (ramps * over / (2 * size) + min(until, 2.5) - 0.5)

    for k in (50, 80, 120):
        at = 0.4 + slide(t[k])
        expected = resting(case, lambda phi: -KS * phi, lambda R: FORCE, point=at, seen=at)
        # the stick lags its rest by D / K = 20 ms of the slide
        np.testing.assert_allclose(out[k, :3], expected, atol=0.02 * abs(mobility) * (size - least))
        rate = (out[k + 1, :3] - out[k - 1, :3]) / 0.04
        np.testing.assert_allclose(out[k, 3:], rate, atol=0.01 * np.linalg.norm(rate))
    # a step on the threshold slides by less than its whole excess; 2.5 ms steps of 0.4 s
    np.testing.assert_allclose(settled(out), slide(3.98) * case.axis[0], atol=1e-4 * abs(slide(3.98)) + 1e-6)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_tracker_that_follows_the_wood_sees_less_of_a_slide(tmp_path, share):
    """Slide as ever, and see the point that the share of the way leads to, its velocity with it."""
    mobility, least = -0.02, 2.0
    case = stick_case(tmp_path / "c", [held()])
    on = {"mobility_mpNs": mobility, "least_N": least}
    seen, out = (stick(case, grasp_slip=on | extra)[0] for extra in ({}, {"seen": share}))
    size = np.linalg.norm(FORCE)
    for k in (80, 190):
        way = mobility * (size - least) * (0.4 * (size - least) / (2 * size) + case.trajectories[0].t[k] - 0.5)
        expected = resting(case, lambda phi: -KS * phi, lambda R, p=0.4 + way: FORCE, point=0.4 + way,
                           seen=0.4 + share * way)  # fmt: skip
        np.testing.assert_allclose(out[k, :3], expected, atol=0.02 * abs(mobility) * (size - least))
        rate = (out[k + 1, :3] - out[k - 1, :3]) / 0.04
        np.testing.assert_allclose(out[k, 3:], rate, atol=0.01 * np.linalg.norm(rate) + 1e-5)
        assert np.linalg.norm(seen[k, :3] - out[k, :3]) > 5e-3


def test_grasp_slip_at_a_rate_that_the_force_does_not_raise(tmp_path):
    """Slide at mobility times 1 N while the force is beyond half of each recording's largest, large or small."""
    mobility = -0.02
    case = stick_case(tmp_path / "c", [held(200) * size for size in (1.0, 0.4)])
    on = {"mobility_mpNs": mobility, "least_N": 0.0, "least_share": 0.5, "viscous": 0.0}
    t = case.trajectories[0].t
    for run, size in zip(stick(case, grasp_slip=on), (1.0, 0.4), strict=True):
        for k in (80, 180):
            at = 0.4 + mobility * (t[k] - 0.3)  # half of the force half-way up the rise from 0.1 to 0.5 s
            expected = resting(case, lambda phi: -KS * phi, lambda R, f=size * FORCE: f, point=at, seen=at)
            # a step late at the threshold, and 20 ms behind its rest
            np.testing.assert_allclose(run[k, :3], expected, atol=0.025 * abs(mobility) + 0.02 * abs(mobility))


def test_grasp_slip_follows_the_force_along_the_segment(tmp_path):
    """Slide by the integral of mobility (|F_axis| - least) where the force along the stick points, out and back.

    The stick is so stiff that its axis stays: it leans by F r / K = 1.6 mrad.
    """
    mobility, least, along = 0.01, 0.5, 2.0
    case = stick_case(tmp_path / "c", [held(200) * 0.0], elevation=90.0, azimuth=0.0, gravity=0.0)
    swing = np.sin(2 * np.pi * np.arange(200) / 100)[:, None]
    forces = [along * swing * case.axis[0], 3.0 * held(200) / np.linalg.norm(FORCE) * [1.0, 1.0, 0.0]]
    case = stick_case(tmp_path / "d", forces, elevation=90.0, azimuth=0.0, gravity=0.0)
    on = {"mobility_mpNs": mobility, "least_N": least, "least_share": 0.0, "viscous": 1.0, "axial": 1.0}
    out = stick(case, grasp_slip=on)
    pull = along * np.sin(2 * np.pi * np.linspace(0.0, 3.98, 20000) / 2.0)
    rate = mobility * np.sign(pull) * np.maximum(np.abs(pull) - least, 0.0)
    way = np.interp(case.trajectories[0].t, np.linspace(0.0, 3.98, 20000), np.cumsum(rate) * 3.98 / 20000)
    # forces are held for a sample of 20 ms: a fiftieth of the largest rate for as long
    np.testing.assert_allclose(out[0, :, :3] @ case.axis[0], way, atol=0.02 * mobility * along)
    assert way.max() > 20 * 0.02 * mobility * along
    assert (out[1] == stick(case)[1]).all()  # across the stick it holds


def test_grasp_slip_needs_its_least_force(tmp_path):
    """Give the bits of a grip that holds where the whole force stays below the least."""
    case = stick_case(tmp_path / "c", [held(60), held(60, -FORCE)])
    on = {"mobility_mpNs": -1.0, "least_N": 1.001 * np.linalg.norm(FORCE)}
    assert (stick(case, grasp_slip=on) == stick(case)).all()


@pytest.mark.parametrize("mobility", [20.0, -20.0])
def test_a_grip_may_jerk_and_hold_again(tmp_path, mobility):
    """Slide at once when the force reaches its least, by ``most_m`` and no farther, and be held there from then on."""
    most, least = 0.03, 2.0
    case = stick_case(tmp_path / "c", [held(200)])
    out = stick(case, grasp_slip={"mobility_mpNs": mobility, "least_N": least, "most_m": most})[0]
    at = 0.4 + np.copysign(most, mobility)
    expected = resting(case, lambda phi: -KS * phi, lambda R: FORCE, point=at, seen=at)
    np.testing.assert_allclose(settled(out), expected, atol=1e-4)
    t = case.trajectories[0].t
    early = t < 0.1 + 0.4 * least / np.linalg.norm(FORCE)  # the force rises from 0.1 to 0.5 s
    assert (out[early] == stick(case)[0][early]).all()


@pytest.mark.parametrize(("kept", "zeroed"), [(1.0, 0.0), (0.6, 0.0), (1.0, 1.0), (0.6, 0.5)])
def test_a_grip_that_is_not_taken_anew_stays_where_it_slid(tmp_path, kept, zeroed):
    """Begin the next recording with the share kept of the way, and hold there; see what is not zeroed of it."""
    most = 0.03
    case = stick_case(tmp_path / "c", [held(200), held(200, 0.5 * FORCE)])
    on = {"mobility_mpNs": -20.0, "least_N": 0.8 * np.linalg.norm(FORCE), "most_m": most}
    out = stick(case, grasp_slip={**on, "kept": kept, "zeroed": zeroed})
    assert (out[0] == stick(case, grasp_slip=on)[0]).all()
    at, shift = 0.4 - kept * most, zeroed * kept * most * case.axis[0]
    for k, force in ((0, 0.0 * FORCE), (-1, 0.5 * FORCE)):
        expected = resting(case, lambda phi: -KS * phi, lambda R, f=force: f, point=at, seen=at)
        np.testing.assert_allclose(out[1, k, :3] if k == 0 else settled(out[1]), expected + shift, atol=1e-4)


def test_a_grip_may_slide_from_a_moment_on(tmp_path):
    """Hold until a moment on the clock, in the second recording, and jerk then, however large the force was before."""
    most, moment = 0.03, 21.5
    case = stick_case(tmp_path / "c", [held(200), held(200)])
    on = {"mobility_mpNs": 20.0, "least_N": 1.0, "most_m": most, "moment_s": moment}
    plain, out = stick(case), stick(case, grasp_slip=on)
    before = case.trajectories[1].t + 20.0 <= moment
    np.testing.assert_allclose(out[0], plain[0], atol=1e-6)
    np.testing.assert_allclose(out[1, before], plain[1, before], atol=1e-6)
    at = 0.4 + most
    expected = resting(case, lambda phi: -KS * phi, lambda R: FORCE, point=at, seen=at)
    np.testing.assert_allclose(settled(out[1]), expected, atol=1e-4)
