"""Each effect's law against a closed form or an integration that is written differently."""

import numpy as np
import pytest
import torch
from bough.learn.acting import Acting
from bough.learn.plant_branch import Unknowns
from bough.learn.rollout import Rollout, recordings
from oracles.effect_case import resting, simulate, stick_case, swing_case
from scipy.integrate import solve_ivp
from scipy.special import ellipk

J, K, D = 2.0, 80.0, 1e-3
W = np.sqrt(K / J)
H = 1e-3  # the hinge's step: first order, so that amplitudes are right to W H / 2 = 0.3 %


def peaks(t, q):
    """Return times and values of the extrema of a sampled angle, by parabolas through three samples."""
    at = np.flatnonzero(np.diff(np.sign(np.diff(q)))) + 1
    a, b, c = q[at - 1], q[at], q[at + 1]
    shift = 0.5 * (a - c) / (a - 2 * b + c)
    return t[at] + shift * (t[1] - t[0]), b - 0.25 * (a - c) * shift


def integrate(t, torque, q0, v0, extra=()):
    """Return angle and rate of J q'' = torque(t, q, v, z) with further states z, dz = torque's second result."""

    def slope(time, y):
        force, dz = torque(time, y[0], y[1], y[2:])
        return [y[1], force / J, *dz]

    y = solve_ivp(slope, (0.0, t[-1]), [q0, v0, *extra], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.01).y
    return y[0], y[1]


def test_dry_friction_takes_four_torques_a_cycle(tmp_path):
    """Lose 2 T / K of amplitude every half swing: energy 2 T (A + A') each, which is 4 T A a cycle."""
    case, torque = swing_case(tmp_path / "c", [(0.5, 0.0)]), 2.0
    out = simulate(case, K, D, start=[0.5, 0.0], dry_friction={"torque_Nm": torque})[0]
    _, tops = peaks(case.trajectories[0].t, out[:, 0])
    drop = -np.diff(np.abs([0.5, *tops[np.abs(tops) > 0.15]]))
    assert len(drop) >= 5
    # the creep range below 0.01 rad/s lasts (0.01 / (W A)) of a swing
    np.testing.assert_allclose(drop, 2 * torque / K, rtol=0.03)


def test_quadratic_drag_makes_one_over_amplitude_linear(tmp_path):
    """Decay as 1 / A = 1 / A0 + 4 c W t / (3 pi J) (Krylov-Bogoliubov, first order in c A / J)."""
    c = 0.3
    case = swing_case(tmp_path / "c", [(0.5, 0.0)], duration=6.0)
    out = simulate(case, K, D, start=[0.5, 0.0], quadratic_drag={"coefficient_Nms2": c})[0]
    time, tops = peaks(case.trajectories[0].t, out[:, 0])
    slope = np.polyfit(time, 1 / np.abs(tops), 1)[0]
    assert slope == pytest.approx(4 * c * W / (3 * np.pi * J), rel=0.02)


def test_cubic_stiffness_has_the_period_of_duffing(tmp_path):
    """Swing with period 4 K(m) / sqrt(W^2 (1 + kappa A^2)), m = kappa A^2 / (2 (1 + kappa A^2)), at two amplitudes."""
    kappa, starts = 3.0, [(0.2, 0.0), (0.8, 0.0)]
    case = swing_case(tmp_path / "c", starts)
    out = simulate(case, K, D, start=starts, cubic_stiffness={"cubic_radm2": kappa})
    for (amplitude, _), run in zip(starts, out, strict=True):
        time, _ = peaks(case.trajectories[0].t, run[:, 0])
        e = kappa * amplitude**2
        expected = 4 * ellipk(e / (2 * (1 + e))) / (W * np.sqrt(1 + e))
        assert 2 * np.diff(time).mean() == pytest.approx(expected, rel=2e-3)


def test_bilinear_stiffness_has_unequal_half_periods(tmp_path):
    """Stay pi / W on the soft side and pi / (W sqrt(1 + rel)) on the stiff one."""
    case, rel = swing_case(tmp_path / "c", [(-0.6, 0.0)]), 1.5
    out = simulate(case, K, D, start=[-0.6, 0.0], bilinear_stiffness={"relative": rel})[0]
    t, q = case.trajectories[0].t, out[:, 0]
    at = np.flatnonzero(np.diff(np.sign(q)))
    cross = t[at] - q[at] * (t[1] - t[0]) / (q[at + 1] - q[at])
    half = np.diff(cross)  # starts below zero: the first whole half swing is above
    # the corner is rounded over 0.005 rad of 0.4
    np.testing.assert_allclose(half[0::2], np.pi / (W * np.sqrt(1 + rel)), rtol=0.01)
    np.testing.assert_allclose(half[1::2], np.pi / W, rtol=0.01)


def test_standard_linear_solid_creeps(tmp_path):
    """Creep under a constant torque M as M / K (1 - a / (1 + a) exp(-t / (T (1 + a)))) once the swing is damped."""
    a, T, M = 0.8, 0.4, 8.0
    case = swing_case(tmp_path / "c", [(0.0, 0.0)], torque=lambda t: np.full_like(t, M), inertia=1e-3)
    out = simulate(case, K, 0.4, start=[0, 0], viscoelastic_sls={"share": a, "relaxation_s": T})[0]
    t = case.trajectories[0].t
    expected = M / K * (1 - a / (1 + a) * np.exp(-t / (T * (1 + a))))
    late = t > 0.1  # the damper D / K = 5 ms has relaxed; it lags the creep by its own 5 ms, 1 % of 0.7 s
    np.testing.assert_allclose(out[late, 0], expected[late], rtol=0.006)


def test_bouc_wen_loop(tmp_path):
    """Follow the law written with its sign function, and turn the same energy into heat over a loop."""
    share, y, M = 1.2, 0.05, 30.0
    case = swing_case(tmp_path / "c", [(0.0, 0.0)], torque=lambda t: M * np.sin(3.0 * t), duration=6.0)
    t = case.trajectories[0].t

    def law(time, q, v, z):
        heat = v * (1 - 0.5 * (1 + np.sign(v * z[0])) * (z[0] / y) ** 2)
        drive = np.interp(time, t, M * np.sin(3.0 * t))
        return drive - K * q - 4.0 * v - share * K * z[0], [heat]

    q, v = integrate(t, law, 0.0, 0.0, [0.0])
    out = simulate(case, K, 4.0, start=[0, 0], hysteresis_boucwen={"share": share, "yield_rad": y})[0]
    np.testing.assert_allclose(out[:, 0], q, atol=0.01 * np.abs(q).max())
    last = t > t[-1] - 2 * np.pi / 3
    area = [np.trapezoid(M * np.sin(3.0 * t[last]) * rate, t[last]) for rate in (out[last, 1], v[last])]
    assert area[0] == pytest.approx(area[1], rel=0.02)
    free = simulate(case, K, 4.0, start=[0, 0])[0]
    assert np.abs(free[:, 0] - q).max() > 0.1 * np.abs(q).max()  # the effect is not small here


def test_backlash_flies_through_the_gap(tmp_path):
    """Cross a gap of 2 g at constant rate, bounce off its end for half a period, and come back."""
    gap, rate = 0.3, 1.0
    case = swing_case(tmp_path / "c", [(0.0, rate)])
    out = simulate(case, K, D, start=[0.0, rate], backlash={"gap_rad": gap})[0]
    t, q = case.trajectories[0].t, out[:, 0]
    hit, half = gap / rate, np.pi / W
    top = gap + rate / W
    inside = t < hit
    np.testing.assert_allclose(q[inside], rate * t[inside], atol=2e-3)
    assert q.max() == pytest.approx(top, rel=0.005)
    back = (t > hit + half) & (t < hit + half + 2 * gap / rate)
    np.testing.assert_allclose(q[back], gap - rate * (t[back] - hit - half), atol=5e-3)


def test_plastic_set_stays(tmp_path):
    """Push quasi-statically beyond the yield angle: phi (1 - s) = M / K - s y, and s (phi - y) stays."""
    s, y, M = 0.4, 0.1, 16.0
    case = swing_case(tmp_path / "d", [(0.0, 0.0)], torque=lambda t: M * np.interp(t, [0, 1, 5, 5.5], [0, 1, 1, 0]),
                      duration=9.0)  # fmt: skip
    out = simulate(case, K, 25.0, start=[0, 0], plastic_set={"share": s, "yield_rad": y})[0]
    t, top = case.trajectories[0].t, (M / K - s * y) / (1 - s)
    assert out[np.argmin(abs(t - 5.0)), 0] == pytest.approx(top, rel=0.01)
    assert out[-1, 0] == pytest.approx(s * (out[:, 0].max() - y), rel=0.01)


def pulse(t):
    """Return a torque that changes slope at samples only."""
    return 10.0 * np.interp(t, [0, 0.5, 0.7, 1.0, 1.3], [0, 0, 1, -1, 0])


def test_time_delay_shifts_by_samples(tmp_path):
    """Equal the run of a record that is three samples earlier, and between samples the mean of both neighbours."""
    dt = 0.01
    case = swing_case(tmp_path / "a", [(0.0, 0.0)], torque=pulse, dt=dt)
    early = swing_case(tmp_path / "b", [(0.0, 0.0)], torque=lambda t: pulse(t + 3 * dt), dt=dt)
    late = swing_case(tmp_path / "d", [(0.0, 0.0)], torque=lambda t: pulse(t - 1.5 * dt), dt=dt)
    moved = simulate(case, K, 2.0, start=[0, 0], time_delay={"lag_s": 3 * dt})
    np.testing.assert_allclose(moved, simulate(early, K, 2.0, start=[0, 0]), atol=3e-6)  # float32 of 0.2 rad and rate 1
    moved = simulate(case, K, 2.0, start=[0, 0], time_delay={"lag_s": -1.5 * dt})
    wanted = simulate(late, K, 2.0, start=[0, 0])
    assert np.abs(moved - wanted).max() < 2e-3 * np.abs(wanted).max()  # corners fall between the samples


def test_force_bias_and_scale_undo_the_sensor(tmp_path):
    """Read 1.3 times the torque and 0.7 more: take both off again."""
    true = swing_case(tmp_path / "a", [(0.0, 0.0)], torque=pulse)
    read = swing_case(tmp_path / "b", [(0.0, 0.0)], torque=lambda t: 1.3 * pulse(t) + 0.7)
    on = {"force_bias": {"effort_N": 0.7}, "force_scale": {"scale": 1.3}}
    undone = simulate(read, K, 2.0, start=[0, 0], **on)
    np.testing.assert_allclose(undone, simulate(true, K, 2.0, start=[0, 0]), atol=3e-6)


# ---- a stick in space -----------------------------------------------------------------------------------------------

KS, DS = 20.0, 0.4
FORCE = np.array([2.0, -3.0, 1.5])


def held(n=200, force=FORCE):
    """Return a force that rises in 0.4 s and stays."""
    return np.interp(np.arange(n), [5, 25], [0.0, 1.0])[:, None] * force


def stick(case, **on):
    """Simulate a stick with everything but the trunk compiled in; `KS` and `DS` hold it."""
    return simulate(case, KS, DS, form="branch", without=("base_compliance",), **on)


def settled(out):
    """Return the displacement at the end, at rest there."""
    assert np.abs(out[-1, 3:]).max() < 2e-3
    return out[-1, :3]


def test_effects_off_change_nothing(tmp_path):
    """Give the plain kernel's bits with every effect compiled in and all of them neutral."""
    case = stick_case(tmp_path / "c", [held(), held(force=-FORCE)])
    plain = Rollout(case, recordings(case), 1)(torch.tensor([[KS, DS]]))[0].double().numpy()
    assert (stick(case) == plain).all()


def test_no_effect_is_the_plain_kernel(tmp_path):
    """Build the plain kernel, bit for bit, where no effect acts."""
    case = stick_case(tmp_path / "c", [held()])
    rollout = Rollout(case, recordings(case), 1, unknowns=Unknowns(effects=()))
    assert rollout.effects is None


def test_steady_wind_holds_the_stick_aside(tmp_path):
    """Rest where pressure times area, weight and spring balance, from the first sample on, at no force."""
    case = stick_case(tmp_path / "c", [np.zeros((60, 3))])
    q = np.array([60.0, -90.0, 40.0])
    out = stick(case, steady_wind={f"pressure_{c}_Pa": v for c, v in zip("xyz", q, strict=True)})[0]
    a, b = case.radius[0]
    centre = case.length[0] * (a + 2 * b) / (3 * (a + b))
    push = q * case.length[0] * (a + b)
    expected = resting(case, lambda phi: -KS * phi, lambda R: push, point=centre)
    assert np.linalg.norm(expected) > 0.005
    for k in (0, -1):
        np.testing.assert_allclose(out[k, :3], expected, atol=2e-4 * np.linalg.norm(expected))


def test_wind_gust_drives_at_its_frequency(tmp_path):
    """Sway without weight as K / (K - J w^2 + i D w) of the static turn, in phase with the absolute clock."""
    f, begin = 0.8, 3.3
    case = stick_case(tmp_path / "c", [np.zeros((400, 3))], gravity=0.0, elevation=90.0, azimuth=0.0, starts=[begin])
    gust = {"sine_x_Pa": 20.0, "cosine_x_Pa": -10.0, "cosine_y_Pa": 15.0, "frequency_Hz": f}
    out = stick(case, wind_gust=gust)[0]
    t = begin + case.trajectories[0].t
    a, b = case.radius[0]
    lever, area = case.length[0] * (a + 2 * b) / (3 * (a + b)), case.length[0] * (a + b)
    w = 2 * np.pi * f
    inertia = case.mass[0] * case.length[0] ** 2 / 3  # a slender rod: the taper moves it by a few percent of J w^2 / K
    gain = 1 / (KS - inertia * w**2 + 1j * w * DS)
    x = area * lever * 0.4 * np.real(gain * (-10.0 - 20.0j) * np.exp(1j * w * t))
    y = area * lever * 0.4 * np.real(gain * 15.0 * np.exp(1j * w * t))
    late = t > begin + 2.0
    np.testing.assert_allclose(out[late, 0], x[late], atol=0.03 * np.abs(x).max())
    np.testing.assert_allclose(out[late, 1], y[late], atol=0.03 * np.abs(y).max())


def test_drag_on_links_makes_one_over_amplitude_linear(tmp_path):
    """Lose amplitude after a release as the closed form for torque c A r^3 |w| w says."""
    force = np.where(np.arange(400)[:, None] < 50, held(400, np.array([3.0, 0, 0])), 0.0)
    case = stick_case(tmp_path / "c", [force], gravity=0.0, elevation=90.0, azimuth=0.0)
    stiffness, c = 8.0, 40.0
    out = simulate(case, stiffness, 0.013, form="branch", without=("base_compliance",),
                   quadratic_drag={"coefficient_kgpm3": c})[0]  # fmt: skip
    quiet = simulate(case, stiffness, 0.013, form="branch", without=("base_compliance",))[0]
    t = case.trajectories[0].t
    a, b = case.radius[0]
    lever, area = case.length[0] * (a + 2 * b) / (3 * (a + b)), case.length[0] * (a + b)
    free = t > 1.1
    time, tops = peaks(t[free], np.arcsin(out[free, 0] / 0.4))
    again, bare = peaks(t[free], np.arcsin(quiet[free, 0] / 0.4))
    w = np.pi / np.diff(again).mean()
    decay = -np.polyfit(again, np.log(np.abs(bare)), 1)[0]  # the linear damper's own, measured
    J_ = stiffness / w**2
    k = 4 * c * area * lever**3 * w / (3 * np.pi * J_)
    # A' = -decay A - k A^2:  1 / A = (1 / A0 + k / decay) exp(decay t) - k / decay
    since = time - time[0]
    expected = 1 / ((1 / abs(tops[0]) + k / decay) * np.exp(decay * since) - k / decay)
    np.testing.assert_allclose(np.abs(tops), expected, rtol=0.03)
    assert abs(tops[-1]) < 0.8 * abs(tops[0]) * abs(bare[-1] / bare[0])


def test_anisotropy_and_coupling_equal_a_matrix_spring(tmp_path):
    """Rest where a symmetric matrix spring does."""
    case = stick_case(tmp_path / "c", [held()])
    rel, kappa, psi, chi = 0.7, 0.4, 0.6, 1.1
    on = {"anisotropic_stiffness": {"relative": rel, "axis_rad": psi},
          "bending_torsion_coupling": {"coupling": kappa, "axis_rad": chi}}  # fmt: skip
    n, c = np.array([np.cos(psi), np.sin(psi), 0.0]), np.array([np.cos(chi), np.sin(chi), 0.0])
    z = np.array([0.0, 0.0, 1.0])
    matrix = KS * (np.eye(3) + rel * np.outer(n, n) + kappa * (np.outer(c, z) + np.outer(z, c)))
    expected = resting(case, lambda phi: -matrix @ phi, lambda R: FORCE)
    plain = resting(case, lambda phi: -KS * phi, lambda R: FORCE)
    assert np.linalg.norm(expected - plain) > 0.1 * np.linalg.norm(plain)
    np.testing.assert_allclose(settled(stick(case, **on)[0]), expected, atol=3e-4)


@pytest.mark.parametrize("tared", [0.0, 1.0])
def test_gravity_comp_error_by_hand(tmp_path, tared):
    """Rest under the reading less dm (g - k R g), R from the rest pose."""
    case, dm = stick_case(tmp_path / "c", [held(force=2 * FORCE)]), 0.3
    g = np.array([0.0, 0.0, -9.81])
    out = settled(stick(case, gravity_comp_error={"mass_kg": dm, "tared": tared})[0])
    expected = resting(case, lambda phi: -KS * phi, lambda R: 2 * FORCE - dm * (g - tared * R.apply(g)))
    plain = resting(case, lambda phi: -KS * phi, lambda R: 2 * FORCE)
    assert np.linalg.norm(expected - plain) > 1e-3
    np.testing.assert_allclose(out, expected, atol=1e-4)


def test_force_bias_needs_contact(tmp_path):
    """Take the offset off where the gripper holds and not where it is open."""
    case = stick_case(tmp_path / "c", [held()], opened=[(0.0, 0.06), (3.0, 3.98)])
    bias = {"force_x_N": 0.5, "force_y_N": -0.4, "force_z_N": 0.3}
    out = stick(case, force_bias=bias)[0]
    expected = resting(case, lambda phi: -KS * phi, lambda R: FORCE - np.array([0.5, -0.4, 0.3]))
    at = np.argmin(abs(case.trajectories[0].t - 2.9))
    np.testing.assert_allclose(out[at, :3], expected, atol=5e-4)
    assert np.abs(out[-1, :3]).max() < 1e-3


def test_rupture_softens_later_recordings(tmp_path):
    """Rest as with K before the moment and as with (1 - s) K after it, in the same and in the next recording."""
    case, s = stick_case(tmp_path / "c", [held(), held(), held()]), 0.4
    out = stick(case, partial_rupture={"share": s, "moment_s": 22.0})
    whole = resting(case, lambda phi: -KS * phi, lambda R: FORCE)
    broken = resting(case, lambda phi: -KS * (1 - s) * phi, lambda R: FORCE)
    at = np.argmin(abs(case.trajectories[0].t - 1.95))
    for run, k, expected in ((0, -1, whole), (1, at, whole), (1, -1, broken), (2, -1, broken)):
        np.testing.assert_allclose(out[run, k, :3], expected, atol=5e-4)


def test_grasp_slip_ends_at_the_tip(tmp_path):
    """Slide to the segment's end under a pull along it, and rest as if held there; hold the marked point again next."""
    case = stick_case(tmp_path / "c", [held(400), held(400, -FORCE)])
    out = stick(case, grasp_slip={"mobility_mpNs": 1.0, "least_N": 0.05})
    pull = case.axis[0] @ FORCE
    assert pull > 0.3
    at_tip = resting(case, lambda phi: -KS * phi, lambda R: FORCE, point=0.5)
    np.testing.assert_allclose(settled(out[0]), at_tip, atol=5e-4)
    early = 9
    np.testing.assert_allclose(out[1, early], stick(case)[1, early], atol=2e-3)


def test_plastic_set_passes_to_the_next_recording(tmp_path):
    """Start every recording calm, respond to a small push as a whole branch does, and remember those left out."""
    small, large = held(200, 0.1 * FORCE), np.where(np.arange(200)[:, None] < 150, held(200, 4 * FORCE), 0.0)
    case = stick_case(tmp_path / "c", [small, large, small], gravity=0.0)
    on = {"plastic_set": {"share": 0.5, "yield_rad": 0.08}}
    out = stick(case, **on)
    assert np.abs(out[:, 0]).max() < 1e-5
    assert np.abs(out[1, -1, :3]).max() > 0.02  # the large push left a set
    back = np.linalg.norm(out[2, -1, :3])
    assert back == pytest.approx(np.linalg.norm(out[0, -1, :3]), rel=0.05)  # as stiff as before, on another lever
    assert np.linalg.norm(out[2, -1, :3] - out[0, -1, :3]) > 0.02 * back  # and yet turned by the set
    alone = simulate(case, KS, DS, form="branch", without=("base_compliance",), chosen=recordings(case)[2:], **on)
    assert (alone[0] == out[2]).all()


def test_worlds_in_lanes_equal_worlds_alone(tmp_path, monkeypatch):
    """Give the same bits in lanes as one world a thread, with laws of every kind on."""
    case = stick_case(tmp_path / "c", [held(60), held(60, -FORCE)])
    at_joint, elsewhere = ("hysteresis_boucwen", "plastic_set"), ("wind_gust", "steady_wind", "time_delay", "tip_mass")
    acting = (*(Acting(n, 0) for n in at_joint), *(Acting(n) for n in elsewhere))
    values = torch.tensor([[KS, DS, 0.3, 0.05, 0.4, 0.05, 20, 30, -20, 5, 0.9, 10, 5, -5, 0.01, 0.02]])
    outs = []
    for width in (1, 8):
        monkeypatch.setattr("bough.learn.rollout.simd_width", lambda w=width: w)
        rollout = Rollout(case, recordings(case), 2, unknowns=Unknowns(effects=acting))
        order = [p.name for p in rollout.plant.parameters]
        assert order[2] == "hysteresis_boucwen@0 share" and len(order) == 16
        outs.append(rollout(values.repeat(2, 1)).clone())
    assert (outs[0] == outs[1]).all() and torch.isfinite(outs[0]).all()
