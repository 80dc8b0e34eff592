"""Each effect's law against a closed form or an integration that is written differently."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from oracles.effect_case import DS, FORCE, KS, held, resting, settled, simulate, stick, stick_case, swing_case
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipk

J, K, D = 2.0, 80.0, 1e-3
W = np.sqrt(K / J)
H = 1e-3  # the hinge's step: first order, so that amplitudes are right to W H / 2 = 0.3 %
BEND = 5e-4  # what dry friction bends by before it slips [rad]


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


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_dry_friction_takes_four_torques_a_cycle(tmp_path, scale):
    """Lose 2 T / K of amplitude every half swing: energy T (A + A') each, which is 4 T A a cycle.

    A bend of a thousandth of the swing does so for half a radian and for half a milliradian.
    """
    case, torque = swing_case(tmp_path / "c", [(0.5 * scale, 0.0)]), 2.0 * scale
    own = {"torque_Nm": torque} if scale == 1.0 else {"torque_Nm": torque, "bend_rad": BEND * scale}
    out = simulate(case, K, D, start=[0.5 * scale, 0.0], dry_friction=own)[0]
    _, tops = peaks(case.trajectories[0].t, out[:, 0])
    drop = -np.diff(np.abs([0.5 * scale, *tops[np.abs(tops) > 0.15 * scale]]))
    assert len(drop) >= 5
    # a reversal turns through 2 BEND at no friction in the mean: 2 BEND of A + A' > 0.3, and the step's W H / 2
    np.testing.assert_allclose(drop, 2 * torque / K, rtol=2 * BEND / 0.3 + W * H / 2)


def test_dry_friction_stops_off_centre(tmp_path):
    """Stay at the first turn where K |q| < T, 2 T / K - A after half a swing from A; start from no such pose."""
    # held, the joint unbends by 2 BEND at most, and the spring's work on that way, 2 BEND K |q|, goes into a slide
    # against T - K |q|
    torque, starts = 14.0, [(0.4, 0.0), (-0.38, 0.0), (0.06, 0.0)]
    case = swing_case(tmp_path / "c", starts)
    out = simulate(case, K, D, start=starts, dry_friction={"torque_Nm": torque})
    t = case.trajectories[0].t
    for run, end in zip(out, (2 * torque / K - 0.4, 0.38 - 2 * torque / K, 0.06), strict=True):
        late = t > (1.05 * np.pi / W if abs(run[0, 0]) > torque / K else 0.0)
        within = 2 * BEND * torque / (torque - K * abs(end))
        np.testing.assert_allclose(run[late, 0], end, atol=within + abs(run[0, 0] - end) * W * H / 2)
        assert within < 0.06 * abs(end) and np.abs(run[t > 2.5, 1]).max() < 1e-6


def test_dry_friction_is_a_play(tmp_path):
    """Follow a slow torque M as a play: hold below T, slip as M - T, hold back to M - 2 T, stay at T / K."""
    torque, knots, levels = 2.0, np.arange(9.0), [0.0, 1.5, 1.5, 6.0, 6.0, 2.5, 2.5, 0.0, 0.0]
    case = swing_case(tmp_path / "c", [(0.0, 0.0)], torque=lambda t: np.interp(t, knots, levels), duration=8.0,
                      inertia=0.05)  # fmt: skip
    out = simulate(case, K, 4.0, start=[0, 0], dry_friction={"torque_Nm": torque})[0]
    t, slip = case.trajectories[0].t, (6.0 - torque) / K
    # bent to z = BEND torque / T where it does not slip; after a second at rest exp(-K / D) = 2e-9 of a lag is left
    back = slip - BEND * 3.5 / torque
    for moment, angle in ((1.99, BEND * 1.5 / torque), (3.95, slip), (5.95, back), (8.0, torque / K)):
        assert abs(out[np.argmin(abs(t - moment)), 0] - angle) < 0.05 * BEND, moment


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


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_bilinear_stiffness_has_unequal_half_periods(tmp_path, scale):
    """Stay pi / W on the soft side and pi / (W sqrt(1 + rel)) on the stiff one, of swings large and small."""
    case, rel = swing_case(tmp_path / "c", [(-0.6 * scale, 0.0)]), 1.5
    own = {"relative": rel} if scale == 1.0 else {"relative": rel, "corner_rad": 0.005 * scale}
    out = simulate(case, K, D, start=[-0.6 * scale, 0.0], bilinear_stiffness=own)[0]
    t, q = case.trajectories[0].t, out[:, 0]
    at = np.flatnonzero(np.diff(np.sign(q)))
    cross = t[at] - q[at] * (t[1] - t[0]) / (q[at + 1] - q[at])
    half = np.diff(cross)  # starts below zero: the first whole half swing is above
    # the corner is rounded over 0.005 of 0.4
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


@pytest.mark.parametrize("rounding", [0.05, 0.2])
def test_backlash_with_worn_edges(tmp_path, rounding):
    """Settle where K (phi - phi s) = M with 1 / s = min(1, g / phi) rounded: x^2 e's parabola, the larger root."""
    gap, moments = 0.3, np.array([0.8, 4.0, 16.0])
    case = swing_case(tmp_path / "c", [(0.0, 0.0)], duration=24.0,
                      torque=lambda t: moments[np.minimum(t / 8.0, 2.0).astype(int)])  # fmt: skip
    out = simulate(case, K, 8.0, start=[0, 0], backlash={"gap_rad": gap, "rounding": rounding})[0]
    t = case.trajectories[0].t
    for k, moment in enumerate(moments):
        phi = out[np.argmax(t > 8.0 * k + 7.9), 0]
        # the share s solves (1 - e) s^2 - (1 + g / phi) s + g / phi = 0: with e = 0 its roots are 1 and g / phi
        share = np.roots([1 - rounding, -(1 + gap / phi), gap / phi]).min()
        assert K * phi * (1 - share) == pytest.approx(moment, rel=0.01)


def test_backlash_with_a_soft_gap(tmp_path):
    """Settle where s K phi = M inside the gap and K (phi - (1 - s) g) = M beyond it."""
    gap, left, moments = 0.3, 0.2, np.array([2.0, 4.0, 16.0])
    case = swing_case(tmp_path / "c", [(0.0, 0.0)], duration=24.0,
                      torque=lambda t: moments[np.minimum(t / 8.0, 2.0).astype(int)])  # fmt: skip
    out = simulate(case, K, 8.0, start=[0, 0], backlash={"gap_rad": gap, "left": left})[0]
    t = case.trajectories[0].t
    found = [out[np.argmax(t > 8.0 * k + 7.9), 0] for k in range(3)]
    inside, beyond = moments / (left * K), moments / K + (1 - left) * gap
    assert inside[0] < gap < beyond[2]
    np.testing.assert_allclose(found, np.where(inside < gap, inside, beyond), rtol=0.01)


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


@pytest.mark.parametrize("samples", [0.5, 1.0, 2.3, -0.7])
def test_a_late_sensor_does_not_blur_a_release(tmp_path, samples):
    """Hold a branch and let go, the force recorded late: it moves as if recorded in time.

    A shift that is linear between samples would spread the fall of the force over two of them.
    """
    dt, t = 0.04, 0.04 * np.arange(60)
    force = FORCE * np.interp(t, [0.2, 0.6, 1.2, 1.24], [0, 1, 1, 0])[:, None]
    lag = samples * dt
    late = np.stack([np.interp(t - lag, t, force[:, k]) for k in range(3)], 1)
    opened = [(0.0, 0.16), (1.24, 2.36)]
    runs = [stick_case(tmp_path / name, [f], dt=dt, opened=opened) for name, f in (("a", force), ("b", late))]
    wanted = stick(runs[0])[0]
    out = stick(runs[1], time_delay={"lag_s": lag})[0]
    np.testing.assert_allclose(out, wanted, atol=0.02 * np.abs(wanted).max())  # corners of the rise
    after, most = t > 1.2, np.abs(wanted).max()
    np.testing.assert_allclose(out[after], wanted[after], atol=2e-3 * most)
    assert np.abs(stick(runs[1])[0] - wanted).max() > 0.02 * most


def test_force_bias_and_scale_undo_the_sensor(tmp_path):
    """Read 1.3 times the torque and 0.7 more: take both off again."""
    true = swing_case(tmp_path / "a", [(0.0, 0.0)], torque=pulse)
    read = swing_case(tmp_path / "b", [(0.0, 0.0)], torque=lambda t: 1.3 * pulse(t) + 0.7)
    on = {"force_bias": {"effort_N": 0.7}, "force_scale": {"scale": 1.3}}
    undone = simulate(read, K, 2.0, start=[0, 0], **on)
    np.testing.assert_allclose(undone, simulate(true, K, 2.0, start=[0, 0]), atol=3e-6)


def test_gains_of_axes_undo_the_sensor(tmp_path):
    """Read 1.2 times the force, of y and z 0.8 and 1.5 times that, of x what makes 1.2 their geometric mean."""
    force = held(120) * np.array([1.0, -0.8, 0.6])
    gains = 1.2 * np.array([1 / (0.8 * 1.5), 0.8, 1.5])
    true, read = (stick_case(tmp_path / name, [f]) for name, f in (("a", force), ("b", gains * force)))
    undone = stick(read, force_scale={"scale": 1.2, "relative_y": 0.8, "relative_z": 1.5})
    wanted = stick(true)
    np.testing.assert_allclose(undone, wanted, atol=3e-6)
    assert np.abs(stick(read) - wanted).max() > 0.1 * np.abs(wanted).max()


# ---- a stick in space -----------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("across", [0.0, 1.0])
def test_steady_wind_holds_the_stick_aside(tmp_path, across):
    """Rest where wind, weight and spring balance, from the first sample on, at no force.

    The wind's force is pressure times area; across the stick, the squared speed of the air that flows across it.
    """
    case = stick_case(tmp_path / "c", [np.zeros((60, 3))])
    q = np.array([60.0, -90.0, 40.0])
    on = {f"pressure_{c}_Pa": v for c, v in zip("xyz", q, strict=True)} | {"across": across}
    out = stick(case, steady_wind=on)[0]
    a, b = case.radius[0]
    centre = case.length[0] * (a + 2 * b) / (3 * (a + b))
    strength, blows = np.linalg.norm(q), q / np.linalg.norm(q)

    def push(rotation):
        rod = rotation.apply(case.axis[0])
        u = blows - across * (blows @ rod) * rod
        return case.length[0] * (a + b) * strength * np.linalg.norm(u) * u

    expected = resting(case, lambda phi: -KS * phi, push, point=centre)
    assert np.linalg.norm(expected) > 0.005
    for k in (0, -1):
        np.testing.assert_allclose(out[k, :3], expected, atol=2e-4 * np.linalg.norm(expected))


@pytest.mark.parametrize("before", [False, True])
def test_wind_gust_drives_at_its_frequency(tmp_path, before):
    """Sway without weight as K / (K - J w^2 + i D w) of the static turn, in phase with the absolute clock.

    The first swing has died out after two seconds: of the recording, or of the time before it where the branch sways
    when it begins. Without that it begins at rest.
    """
    f, begin = 0.8, 3.3
    case = stick_case(tmp_path / "c", [np.zeros((400, 3))], gravity=0.0, elevation=90.0, azimuth=0.0, starts=[begin])
    gust = {"sine_x_Pa": 20.0, "cosine_x_Pa": -10.0, "cosine_y_Pa": 15.0, "frequency_Hz": f}
    chosen = [replace(r, sways=before) for r in recordings(case)]
    out = stick(case, chosen=chosen, wind_gust=gust)[0]
    np.testing.assert_array_equal(out[0] == 0.0, not before)
    t = begin + case.trajectories[0].t
    a, b = case.radius[0]
    lever, area = case.length[0] * (a + 2 * b) / (3 * (a + b)), case.length[0] * (a + b)
    w = 2 * np.pi * f
    inertia = case.mass[0] * case.length[0] ** 2 / 3  # a slender rod: the taper moves it by a few percent of J w^2 / K
    gain = 1 / (KS - inertia * w**2 + 1j * w * DS)
    x = area * lever * 0.4 * np.real(gain * (-10.0 - 20.0j) * np.exp(1j * w * t))
    y = area * lever * 0.4 * np.real(gain * 15.0 * np.exp(1j * w * t))
    late = t > begin + (0.0 if before else 2.0) - 1e-9
    np.testing.assert_allclose(out[late, 0], x[late], atol=0.03 * np.abs(x).max())
    np.testing.assert_allclose(out[late, 1], y[late], atol=0.03 * np.abs(y).max())


def test_drag_on_links_makes_one_over_amplitude_linear(tmp_path):
    """Lose amplitude after a release as the closed form for the torque |w| w c int d s^3 ds of the whole stick says."""
    force = np.where(np.arange(400)[:, None] < 50, held(400, np.array([3.0, 0, 0])), 0.0)
    case = stick_case(tmp_path / "c", [force], gravity=0.0, elevation=90.0, azimuth=0.0)
    stiffness, c = 8.0, 40.0
    out = simulate(case, stiffness, 0.013, form="branch", without=("base_compliance",),
                   quadratic_drag={"coefficient_kgpm3": c})[0]  # fmt: skip
    quiet = simulate(case, stiffness, 0.013, form="branch", without=("base_compliance",))[0]
    t = case.trajectories[0].t
    a, b = case.radius[0]
    sweep = case.length[0] ** 4 * (a / 10 + 2 * b / 5)  # of the diameter 2 a + 2 (b - a) s / L
    free = t > 1.1
    time, tops = peaks(t[free], np.arcsin(out[free, 0] / 0.4))
    again, bare = peaks(t[free], np.arcsin(quiet[free, 0] / 0.4))
    w = np.pi / np.diff(again).mean()
    decay = -np.polyfit(again, np.log(np.abs(bare)), 1)[0]  # the linear damper's own, measured
    J_ = stiffness / w**2
    k = 4 * c * sweep * w / (3 * np.pi * J_)
    # A' = -decay A - k A^2:  1 / A = (1 / A0 + k / decay) exp(decay t) - k / decay
    since = time - time[0]
    expected = 1 / ((1 / abs(tops[0]) + k / decay) * np.exp(decay * since) - k / decay)
    np.testing.assert_allclose(np.abs(tops), expected, rtol=0.03)
    assert abs(tops[-1]) < 0.8 * abs(tops[0]) * abs(bare[-1] / bare[0])


def test_anisotropy_and_coupling_equal_a_matrix_spring(tmp_path):
    """Rest where a symmetric matrix spring does."""
    case = stick_case(tmp_path / "c", [held()])
    rel, kappa, psi, chi, twist = 0.7, 0.4, 0.6, 1.1, -0.3
    on = {"anisotropic_stiffness": {"relative": rel, "axis_rad": psi, "twist": twist},
          "bending_torsion_coupling": {"coupling": kappa, "axis_rad": chi}}  # fmt: skip
    n, c = np.array([np.cos(psi), np.sin(psi), 0.0]), np.array([np.cos(chi), np.sin(chi), 0.0])
    z = np.array([0.0, 0.0, 1.0])
    matrix = KS * (
        np.eye(3) + rel * np.outer(n, n) + kappa * (np.outer(c, z) + np.outer(z, c)) + twist * np.outer(z, z)
    )
    expected = resting(case, lambda phi: -matrix @ phi, lambda R: FORCE)
    plain = resting(case, lambda phi: -KS * phi, lambda R: FORCE)
    assert np.linalg.norm(expected - plain) > 0.1 * np.linalg.norm(plain)
    np.testing.assert_allclose(settled(stick(case, **on)[0]), expected, atol=3e-4)


def test_a_coupling_with_the_square_of_the_bend(tmp_path):
    """Rest where the energy K t (kappa u + s u^2 / sqrt(1 + (s u)^4)) beside a spring's does, by its gradient."""
    case = stick_case(tmp_path / "c", [held(400, 3.0 * FORCE)])
    kappa, chi, s = 0.2, 1.1, -8.0
    n, z = np.array([np.cos(chi), np.sin(chi), 0.0]), np.array([0.0, 0.0, 1.0])

    def shared(u, s=s):
        return kappa * u + s * u**2 / np.sqrt(1.0 + (s * u) ** 4)

    def spring(phi, s=s):
        u, h = phi @ n, 1e-6
        slope = (shared(u + h, s) - shared(u - h, s)) / (2.0 * h)
        return -KS * (phi + slope * phi[2] * n + shared(u, s) * z)

    expected, linear = (resting(case, lambda phi, s=s: spring(phi, s), lambda R: 3.0 * FORCE) for s in (s, 0.0))
    assert np.linalg.norm(expected - linear) > 2e-3
    on = {"coupling": kappa, "axis_rad": chi, "squared_prad": s}
    np.testing.assert_allclose(settled(stick(case, bending_torsion_coupling=on)[0]), expected, atol=3e-4)


@pytest.mark.parametrize(
    ("tared", "left", "taken"), [(0.0, 1.0, 0.0), (1.0, 1.0, 1.0), (1.4, 0.6, 1.0), (2.0, 0.0, 1.0)]
)
def test_gravity_comp_error_by_hand(tmp_path, tared, left, taken):
    """Rest under the reading less dm (l g - k R g), R from the rest pose; of 2 what was tared alone turns with R."""
    case, dm = stick_case(tmp_path / "c", [held(force=2 * FORCE)]), 0.3
    g = np.array([0.0, 0.0, -9.81])
    out = settled(stick(case, gravity_comp_error={"mass_kg": dm, "tared": tared})[0])
    expected = resting(case, lambda phi: -KS * phi, lambda R: 2 * FORCE - dm * (left * g - taken * R.apply(g)))
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


def test_what_an_open_gripper_reads_is_the_offset_of_its_recording(tmp_path, same_steps):
    """Read 1.2 times the force and an offset that zeroing changed between recordings: take both off again."""
    offsets = np.array([[0.5, -0.4, 0.3], [-0.2, 0.3, 0.1]])
    forces = [held(), held(force=-FORCE)]
    closed = np.repeat([0.0, 1.0, 0.0], [4, 147, len(forces[0]) - 151])[:, None]
    opened = [(0.0, 0.07), (3.01, 3.98)]
    true = stick_case(tmp_path / "a", [closed * f for f in forces], opened=opened)
    read = stick_case(tmp_path / "b", [1.2 * closed * f + b for f, b in zip(forces, offsets, strict=True)],
                      opened=opened)  # fmt: skip
    undone = stick(read, force_bias={"opened": 1.0}, force_scale={"scale": 1.2})
    np.testing.assert_allclose(undone, stick(true), atol=3e-6)
    assert np.abs(stick(read, force_bias={"opened": 0.9}, force_scale={"scale": 1.2}) - undone).max() > 1e-4


@pytest.mark.parametrize(
    ("kappa", "separate", "curved"),
    [(-6.0, 0.0, 0.0), (-12.0, 0.0, 0.2), (-12.0, 1.0, 0.8), (20.0, 0.4, 1.0), (20.0, 0.0, 0.5)],
)
def test_a_spring_that_softens_or_stiffens_holds_a_stick(tmp_path, kappa, separate, curved):
    """Rest where a cubic beside a quintic, or a softening that ends, round or an axis, balances force and weight."""
    case = stick_case(tmp_path / "c", [held(300, 1.5 * FORCE)])

    def cubic(u):
        if kappa < 0.0:
            return kappa * u / (1.0 + 4.0 * curved * abs(kappa) * u)
        return (1.0 - curved**2) * kappa * u + 2.0 * curved * (kappa * u) ** 2

    def spring(phi):
        return -KS * phi * (1.0 + (1.0 - separate) * cubic(phi @ phi) + separate * cubic(phi**2))

    out = stick(case, cubic_stiffness={"cubic_radm2": kappa, "separate": separate, "curved": curved})[0]
    expected = resting(case, spring, lambda R: 1.5 * FORCE)
    np.testing.assert_allclose(settled(out), expected, atol=2e-4)
    assert np.linalg.norm(expected - resting(case, lambda phi: -KS * phi, lambda R: 1.5 * FORCE)) > 2e-3


def test_rupture_may_take_its_time(tmp_path):
    """Lean as a spring that has lost its share times (t - t0) / d, under a force that stays."""
    share, moment, takes = 0.5, 1.5, 2.0
    case = stick_case(tmp_path / "c", [held(200)])
    out = stick(case, partial_rupture={"share": share, "moment_s": moment, "takes_s": takes})[0]
    for time in (1.4, 2.0, 2.5, 3.0, 3.6):
        lost = share * np.clip((time - moment) / takes, 0.0, 1.0)
        expected = resting(case, lambda phi, lost=lost: -KS * (1.0 - lost) * phi, lambda R: FORCE)
        lag = np.linalg.norm(out[round(time / 0.02), 3:]) * DS / KS / (1.0 - share)  # the damper's, behind its rest
        np.testing.assert_allclose(out[round(time / 0.02), :3], expected, atol=2.0 * lag + 2e-4)
    assert np.linalg.norm(out[180, :3] - out[70, :3]) > 0.02


@pytest.mark.parametrize("preload", [0.0, 1.0])
def test_rupture_softens_later_recordings(tmp_path, preload):
    """Rest as with K before the moment and as with (1 - s) K after it, in the same and in the next recording.

    With the preload goes what carries the weight: the branch hangs lower from then on, before the next push, too.
    """
    case, s = stick_case(tmp_path / "c", [held(), held(), held()]), 0.4
    out = stick(case, partial_rupture={"share": s, "moment_s": 22.0, "preload": preload})
    whole = resting(case, lambda phi: -KS * phi, lambda R: FORCE)
    sag, broken = (resting(case, lambda phi: -KS * (1 - s) * phi, lambda R, f=f: f, lost=s * preload)
                   for f in (np.zeros(3), FORCE))  # fmt: skip
    at = np.argmin(abs(case.trajectories[0].t - 1.95))
    for run, k, expected in ((0, -1, whole), (1, at, whole), (1, -1, broken), (2, 0, sag), (2, -1, broken)):
        np.testing.assert_allclose(out[run, k, :3], expected, atol=5e-4)
    assert (np.linalg.norm(sag) > 2e-3) == bool(preload)


def test_rupture_grows_with_the_largest_bend(tmp_path):
    """Rest as with K (1 - s x / (x + w)), x what the largest bend so far exceeds the limit by, in later recordings too.

    A first push stays below the limit, a second breaks, a third is weaker, a fourth stronger than that.
    """
    share, limit, width, loads = 0.7, 0.04, 0.06, (0.3, 1.0, 0.6, 1.3)
    case = stick_case(tmp_path / "c", [held(force=f * FORCE) for f in loads])
    own = {"share": share, "moment_s": -1.0, "limit_rad": limit, "grows_rad": width}
    out = stick(case, partial_rupture=own)
    most = 0.0
    for f, run in zip(loads, out, strict=True):

        def spring(phi, most=most):
            x = max(np.linalg.norm(phi), most) - limit
            return -KS * (1.0 - share * max(x, 0.0) / (max(x, 0.0) + width)) * phi

        expected = resting(case, spring, lambda R, f=f: f * FORCE)
        np.testing.assert_allclose(settled(run), expected, atol=5e-4)
        most = max(most, 2.0 * np.arcsin(np.linalg.norm(expected) / 0.8))
        assert (most > limit) == (f > 0.5)
    assert np.linalg.norm(settled(out[2]) - resting(case, lambda phi: -KS * phi, lambda R: 0.6 * FORCE)) > 5e-3


def test_dry_friction_holds_a_stick_aside(tmp_path):
    """Lean until K phi + T = F r cos phi, stay at T / K when let go, and not lean below F r = T."""
    torque, lever = 0.5, 0.4
    ramp = np.interp(np.arange(500), [10, 250, 300, 480], [0.0, 1.0, 1.0, 0.0])[:, None]
    forces = [ramp * [4.0, 0, 0], ramp * [0, 1.2, 0]]
    case = stick_case(tmp_path / "c", forces, gravity=0.0, elevation=90.0, azimuth=0.0)
    out = stick(case, dry_friction={"torque_Nm": torque})
    lean = brentq(lambda phi: KS * phi + torque - 4.0 * lever * np.cos(phi), 0.0, 1.0)
    within = 2 * BEND * lever  # of the way back that the bent joint takes
    assert abs(out[0, 299, 0] - lever * np.sin(lean)) < within
    assert abs(out[0, -1, 0] - lever * np.sin(torque / KS)) < within
    assert 0.0 < np.abs(out[1, :, 1]).max() < 1.01 * BEND * lever * 1.2 * lever / torque


def test_friction_that_creeps_lets_a_stick_come_back(tmp_path):
    """Push a stick aside and let go: far below the rate v it creeps home as exp(-K t / (D + T / v))."""
    torque, v, lever = 8.0, 20.0, 0.4
    pulse = np.where(np.arange(400) < 50, 1.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    case = stick_case(tmp_path / "c", [pulse], gravity=0.0, elevation=90.0, azimuth=0.0)
    on = {"torque_Nm": torque, "stribeck": -1.0, "stribeck_radps": v}
    out, plain = stick(case, dry_friction=on)[0], stick(case, damping=DS + torque / v)[0]
    # 1 - exp(-x) is x up to x / 2, x = |w| / v
    slow = np.abs(np.diff(out[:, 0])).max() / 0.02 / lever / v
    np.testing.assert_allclose(out[:, 0], plain[:, 0], atol=slow * np.abs(plain[:, 0]).max())
    assert slow < 0.1 and np.abs(out[-1, 0]) < 1e-3 * np.abs(out[:, 0]).max()


def test_two_maxwell_elements_creep_one_after_the_other(tmp_path):
    """Lean under a constant force as the linear system of angle, dashpots a and dashpot b does, without inertia."""
    (a, first), (b, second), lever, force = (0.6, 0.1), (0.9, 1.2), 0.4, 0.3
    case = stick_case(tmp_path / "c", [np.tile([force, 0.0, 0.0], (200, 1))], gravity=0.0, elevation=90.0, azimuth=0.0)
    two = {"share": a, "relaxation_s": first, "second_share": b, "second_relaxation_s": second}
    out = stick(case, viscoelastic_sls=two)[0]

    def slope(time, y):
        phi, dashpots = y[0], y[1:]
        springs = KS * (phi + a * (phi - dashpots[0]) + b * (phi - dashpots[1]))
        return [(force * lever * np.cos(phi) - springs) / DS, *((phi - dashpots) / [first, second])]

    t = case.trajectories[0].t
    phi = solve_ivp(slope, (0.0, t[-1]), [0.0, 0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-12).y[0]
    late = t > 0.4
    # inertia of 0.015 kg m^2 swings on all springs and decays as exp(-D t / 2 J) = exp(-13 t): 0.5 % are left by 0.4 s
    np.testing.assert_allclose(out[late, 0], lever * np.sin(phi[late]), rtol=0.006)


def test_plastic_set_passes_to_the_next_recording(tmp_path):
    """Start where the last recording ended, respond to a small push as a whole branch does, remember those left out."""
    small, large = held(200, 0.1 * FORCE), np.where(np.arange(200)[:, None] < 150, held(200, 4 * FORCE), 0.0)
    case = stick_case(tmp_path / "c", [small, large, small], gravity=0.0)
    on = {"plastic_set": {"share": 0.5, "yield_rad": 0.08}}
    out = stick(case, **on)
    assert np.abs(out[:2, 0]).max() < 1e-5
    assert np.abs(out[1, -1, :3]).max() > 0.02  # the large push left a set
    np.testing.assert_allclose(out[2, 0, :3], out[1, -1, :3], atol=1e-3)  # the last swings of it
    moved = out[2, -1, :3] - out[2, 0, :3]
    back = np.linalg.norm(moved)
    assert back == pytest.approx(np.linalg.norm(out[0, -1, :3]), rel=0.05)  # as stiff as before, on another lever
    assert np.linalg.norm(moved - out[0, -1, :3]) > 0.02 * back  # and yet turned by the set
    alone = simulate(case, KS, DS, form="branch", without=("base_compliance",), chosen=recordings(case)[2:], **on)
    assert (alone[0] == out[2]).all()


def test_worlds_in_lanes_equal_worlds_alone(tmp_path, monkeypatch):
    """Give the same bits in lanes as one world a thread, with laws of every kind on."""
    case = stick_case(tmp_path / "c", [held(60), held(60, -FORCE)])
    at_joint, elsewhere = ("hysteresis_boucwen", "plastic_set"), ("wind_gust", "steady_wind", "time_delay", "tip_mass")
    elsewhere += ("gravity_comp_error", "force_scale")
    acting = (*(Acting(n, 0) for n in at_joint), *(Acting(n) for n in elsewhere))
    at_values = [0.3, 0.05, 1.4, 0.7, 0.3, 0.6, 0.4, 0.2, 0.1, 0.4, 0.05, 0.5, 0.3, 0.1]
    other_values = [20.0, 30.0, -20.0, 5.0, 0.9, 0.3, 0.4, 0.3, 0.2, 7.0, 10.0, 5.0, -5.0, 0.6, 0.2, 0.5]
    other_values += [0.7, 0.4, 0.3]
    other_values += [0.01, 0.015, 0.02, 0.03, -0.01, 0.4]
    other_values += [0.05, 0.5, 0.1, -0.1, 0.2, 1.2, 1.1, 0.9, 0.3, 10.0, 0.04]
    values = torch.tensor([[KS, DS, *at_values, *other_values]])
    outs = []
    for width in (1, 8):
        monkeypatch.setattr("bough.learn.replay.worlds.simd_width", lambda w=width: w)
        rollout = Rollout(case, recordings(case), 2, unknowns=Unknowns(effects=acting))
        order = [p.name for p in rollout.system.parameters]
        assert order[2] == "hysteresis_boucwen@0 share" and len(order) == 52
        outs.append(rollout(values.repeat(2, 1)).clone())
    assert (outs[0] == outs[1]).all() and torch.isfinite(outs[0]).all()
