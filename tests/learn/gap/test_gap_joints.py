"""Diagnoses of joints that are measured directly, simulated by SciPy's integrator with laws of its own, or MuJoCo."""

import mujoco
import numpy as np
import pytest
import yaml
from bough.learn.cases.case import load_case
from bough.learn.cases.noise import estimate_noise
from bough.learn.gap.diagnose import find_missing
from bough.learn.gap.diagnosis import Settings
from bough.learn.gap.models.at_rest import Noise
from bough.learn.gap.report import content
from bough.learn.gap.run import Run
from bough.learn.runs.threads import one_thread
from bough.learn.systems.acting import integral, joint_settings
from scipy.integrate import solve_ivp


def write(folder, law, starts, joint, *, quantity="position", drive=None, rate=100.0, duration=10.0, noise=0.01,
          sway=None):  # fmt: skip
    """Write a case: ``law(q, v, u)`` is the acceleration; white noise of a share of the rms; ``sway(t)`` is added."""
    folder.mkdir()
    t = np.arange(round(duration * rate)) / rate
    generator = np.random.default_rng(0)
    for k, start in enumerate(starts):
        u = np.zeros_like(t) if drive is None else drive(t, k)

        def slope(time, y, u=u):
            return [y[1], law(y[0], y[1], np.interp(time, t, u))]

        q, v = solve_ivp(slope, (0.0, t[-1]), start, t_eval=t, max_step=2e-3, rtol=1e-7, atol=1e-10).y
        measured = {"position": q, "velocity": v}[quantity]
        measured = measured + noise * measured.std() * generator.standard_normal(len(t))
        measured += 0.0 if sway is None else sway(t)
        np.savetxt(folder / f"run_{k + 1}.csv", np.column_stack([t, u, measured]), fmt="%.9g", delimiter=",",
                   header="time_s,effort,measured", comments="")  # fmt: skip
    driven = {"joint": "axis", "column": "effort", "scale": 1.0, "hold": "linear"}
    meta = {
        "format": "joint-gap-case/1", "name": folder.name, "mechanism": {"joints": [{"name": "axis"} | joint]},
        "input": None if drive is None else driven,
        "outputs": [{"joint": "axis", "quantity": quantity, "column": "measured", "scale": 1.0}],
        "trajectories": [{"file": f"run_{k + 1}.csv", "t_start_s": 100.0 * k, "replicate_of": None}
                         for k in range(len(starts))],
        "noise_nominal": None,
    }  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return folder


def diagnosed(folder):
    """Return the diagnosis of a case, with one effect at most."""
    with one_thread():
        return find_missing(load_case(folder), Run(Settings(particles=0, max_effects=1)))


@pytest.mark.parametrize("seed", [0, 10])
def test_an_oscillator_whose_rate_alone_is_measured_stiffens(tmp_path, seed):
    """Name the cubic spring of a mass that moves by millimetres, from its rate; it adds a fifth to the torque there.

    With wide finite-difference steps alone the reduced chi-squared of the second drive is 35.
    """
    joint = {"type": "prismatic", "inertia": None, "stiffness": None, "damping": None}

    def many_sines(t, k):
        tone = np.arange(2.0, 25.0, 0.25)[:, None]
        phase = np.random.default_rng(seed + k).uniform(0, 2 * np.pi, tone.shape)
        return 0.4 * (1 + 0.3 * k) * np.cos(2 * np.pi * tone * t + phase).sum(0)

    found = diagnosed(write(tmp_path / "duffing", lambda q, v, u: (u - 8000 * q - 4e7 * q**3 - 6 * v) / 1.5,
                            [(0.0, 0.0)] * 2, joint, quantity="velocity", drive=many_sines, rate=400.0))  # fmt: skip
    assert [a.name for a in found.effects] == ["cubic_stiffness"], found.sentence
    assert found.gap.repaired < 0.1 * found.gap.base
    assert found.ranking[0].reduced_chi2 < 1.1


def test_a_cart_that_slides_by_millimetres_rubs(tmp_path):
    """Name dry friction of a cart that stops in ten swings of 20 to 45 mm, and predict a wide run to a thirtieth."""
    joint = {"type": "prismatic", "inertia": 2.0, "stiffness": None, "damping": None}
    found = diagnosed(write(tmp_path / "cart", lambda q, v, u: -(900 * q + 0.8 * v + 0.9 * np.tanh(v / 1e-4)) / 2.0,
                            [(0.03, 0.0), (0.02, 0.0), (0.045, 0.0), (0.044, 0.0)], joint, rate=200.0, duration=6.0,
                            noise=0.002))  # fmt: skip
    assert [a.name for a in found.effects] == ["dry_friction"], found.sentence
    assert found.gap.repaired < found.gap.base / 30
    assert {n: i.unit for n, i in found.parameters["dry_friction@0"].items()} == {
        "torque_Nm": "N", "bend_rad": "m", "gradual": "1", "stribeck": "1", "stribeck_radps": "m/s",
    }  # fmt: skip
    assert {k.unit for k in content(found, drawn=False).numbers} == {"cm", "N", "m", "m/s", ""}


def test_friction_that_grows_with_the_effort_of_a_drive(tmp_path):
    """Name friction T + mu |u| of a sprung axis that an effort u drives, and find T and mu within their intervals."""
    size, grows = 0.15, 0.12

    def law(q, v, u):
        return (u - 30.0 * q - 0.4 * v - (size + grows * abs(u)) * np.tanh(v / 1e-3)) / 0.6

    def drive(t, k):
        return (3.0 + k) * np.sin((1.7 + 0.9 * k) * t) + (2.0 - k) * np.sin(0.6 * t)

    joint = {"type": "revolute", "inertia": 0.6, "stiffness": None, "damping": None}
    found = diagnosed(write(tmp_path / "drive", law, [(0.0, 0.0)] * 4, joint, drive=drive, noise=0.005))
    assert [a.name for a in found.effects] == ["dry_friction"], found.sentence
    inside = found.parameters["dry_friction@0"]
    assert inside["torque_Nm"].low < size < inside["torque_Nm"].high
    assert inside["load"].low < grows < inside["load"].high
    assert inside["load"].low > 0.5 * grows


RUBBING = """<mujoco><option timestep="5e-4"/><worldbody><body><joint name="axis" axis="0 -1 0" damping="0.004"
armature="0.002" frictionloss="{friction}"/><inertial pos="0 0 -0.1" mass="0.5" diaginertia="1e-6 1e-6 1e-6"/></body>
</worldbody></mujoco>"""


def let_go(folder, friction, starts, *, count=2 * np.pi / 4096, rate=285.0, duration=4.0):
    """Write a case of MuJoCo's swings of a servo's arm let go, rounded to counts; the clock is put on a grid by lines.

    The file says nothing of friction, and the arm's mass is off the axis: its inertia about that is 0.007 kg m^2, 7000
    times that about its own centre.
    """
    folder.mkdir()
    model = mujoco.MjModel.from_xml_string(RUBBING.format(friction=friction))
    (folder / "arm.xml").write_text(RUBBING.format(friction=0.0))
    grid = np.arange(round(duration * rate)) / rate
    for k, start in enumerate(starts):
        data, moments, angles = mujoco.MjData(model), [0.0], [start]
        data.qpos[0] = start
        while moments[-1] < grid[-1]:
            mujoco.mj_step(model, data, np.random.default_rng(len(moments)).integers(6, 9))
            moments.append(data.time)
            angles.append(data.qpos[0])
        read = np.interp(grid, moments, np.round(np.array(angles) / count) * count)
        np.savetxt(folder / f"run_{k + 1}.csv", np.stack([grid, read], -1), fmt="%.12g", delimiter=",",
                   header="time_s,angle_rad", comments="")  # fmt: skip
    meta = {
        "format": "joint-gap-case/1", "mechanism": {"mjcf": "arm.xml", "unknown": ["damping"]}, "input": None,
        "outputs": [{"joint": "axis", "quantity": "position", "column": "angle_rad", "scale": 1.0}],
        "trajectories": [{"file": f"run_{k + 1}.csv", "t_start_s": 10.0 * k} for k in range(len(starts))],
    }  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return folder


def test_an_arm_that_is_let_go_rubs(tmp_path):
    """Name dry friction of an arm given as an MJCF file, of which only angles were measured, in counts on a new grid.

    The friction's box went up to a torque of the arm's inertia about its own centre, a thousandth of what there is, and
    the noise was a thirtieth of what counts leave, for most of the time the arm stands still. Real: an XL330 servo.
    """
    folder = let_go(tmp_path / "arm", 0.012, (-0.34, -0.6, -0.66, -0.95))
    case = load_case(folder)
    assert estimate_noise(case).sigma[0] == pytest.approx(2 * np.pi / 4096 / np.sqrt(12), rel=1e-6)
    found = diagnosed(folder)
    assert [a.name for a in found.effects] == ["dry_friction"], found.sentence
    assert found.parameters["dry_friction@0"]["torque_Nm"].median == pytest.approx(0.012, rel=0.1)
    assert found.gap.repaired < 0.2 * found.gap.base


def test_a_magnet_under_a_pendulum_is_not_nothing(tmp_path):
    """Call unknown what no candidate explains any of, and not nothing, where the misfit is 1.4 % of the motion."""
    joint = {"type": "revolute", "inertia": 1.0, "stiffness": 0.0, "damping": None,
             "gravity_torque": {"amplitude": None, "zero_angle": 0.0}}  # fmt: skip
    found = diagnosed(write(tmp_path / "magnet",
                            lambda q, v, u: -14 * np.sin(q) - 0.05 * v + 2 * q * np.exp(-((q / 0.15) ** 2)),
                            [(0.7, 0.0), (1.05, 0.0), (0.44, 0.0)], joint, duration=15.0, noise=1e-3))  # fmt: skip
    assert found.verdict == "unknown" and found.effects == (), found.sentence


def test_friction_and_drag_of_a_long_precise_swing(tmp_path):
    """Name drag, and at most friction beside it, of a pendulum that swings forty times, measured to 1e-4.

    Chi-squared has a minimum at every swing gained or lost. The pair left 1.4e7 squares a number where drag alone left
    1e5 and the base 4e6. It must leave less than drag alone, and no model more than its parts.
    """
    joint = {"type": "revolute", "inertia": 1.0, "stiffness": 0.0, "damping": None,
             "gravity_torque": {"amplitude": None, "zero_angle": 0.0}}  # fmt: skip
    folder = write(tmp_path / "swing",
                   lambda q, v, u: -30 * np.sin(q) - 0.002 * v - 0.05 * np.tanh(v / 1e-3) - 0.02 * v * abs(v),
                   [(2.6, 0.0), (1.2, 0.0)], joint, duration=50.0, noise=1e-4)  # fmt: skip
    with one_thread():
        found = find_missing(load_case(folder), Run(Settings(particles=0)))
    assert found.effects[-1].name == "quadratic_drag", found.sentence
    assert {a.name for a in found.effects} <= {"dry_friction", "quadratic_drag"}, found.sentence
    by_effects = {r.effects: r.reduced_chi2 for r in found.ranking}
    for effects, left in by_effects.items():
        assert all(left <= other for part, other in by_effects.items() if set(part) <= set(effects)), effects
    assert by_effects["dry_friction@0", "quadratic_drag@0"] < 0.9 * by_effects["quadratic_drag@0",]
    assert all(r.explained >= 0.0 for r in found.ranking) and found.gap.repaired < 0.2 * found.gap.base


@pytest.mark.parametrize("zero", [0.0, np.pi, 100.0])
def test_the_zero_of_an_encoder_changes_no_verdict(tmp_path, zero):
    """Call unknown what leaves 1 % of the swing, also where an encoder counts from pi or from 100 rad.

    Relative to the rms about zero it is 0.005 % at 100 rad, which was called none.
    """
    joint = {"type": "revolute", "inertia": 1.0, "stiffness": 0.0, "damping": None,
             "gravity_torque": {"amplitude": None, "zero_angle": float(zero)}}  # fmt: skip
    folder = write(tmp_path / "magnet", lambda q, v, u: -14 * np.sin(q) - 0.05 * v + 6 * q * np.exp(-((q / 0.15) ** 2)),
                   [(0.7, 0.0), (1.05, 0.0), (0.44, 0.0)], joint, duration=5.0, noise=1e-3,
                   sway=lambda t: zero)  # fmt: skip
    with one_thread():
        case, run = load_case(folder), Run(Settings(particles=0, effects=("dry_friction", "quadratic_drag")))
        found = find_missing(case, run)
    assert found.verdict == "unknown" and found.effects == (), found.sentence
    assert 700 < found.motion < 1500  # noise is a thousandth of each swing; 260,000 about the zero at 100 rad
    angle = joint_settings(case, [1.0])[0].angle
    assert angle == pytest.approx(1.05, rel=0.01)


@pytest.mark.parametrize("cubic, verdict", [(7e8, "effects"), (0.0, "none")])
def test_wind_that_sways_a_tree_before_the_pull_is_noise(tmp_path, cubic, verdict):
    """Name the spring that stiffens by a third, and nothing where none does, though a tree sways by 2 % of its bend.

    Neighbouring samples differ by a fifth of the sway, and tell little of it.
    """
    joint = {"type": "revolute", "inertia": None, "stiffness": None, "damping": None}
    generator = np.random.default_rng(3)
    tone, phase = generator.uniform(0.03, 0.3, 12), generator.uniform(0, 2 * np.pi, 12)

    def pull(t, k):
        return 2000.0 * np.interp(t, [0, 60, 110, 140, 180, 200], [0, 0, 1, 0.8, 0, 0])

    found = diagnosed(write(tmp_path / "tree", lambda q, v, u: (u - 2e5 * q - cubic * q**3 - 4e3 * v) / 400,
                            [(0.0, 0.0)], joint, drive=pull, rate=4.0, duration=200.0, noise=0.002,
                            sway=lambda t: 1e-4 * np.cos(2 * np.pi * np.outer(t, tone) + phase).sum(1)))  # fmt: skip
    assert found.verdict == verdict, found.sentence
    assert [a.name for a in found.effects] == ["cubic_stiffness"] * (verdict == "effects"), found.sentence


def test_noise_is_drawn_with_its_spectrum():
    """Draw the noise x_k = 0.9 x_{k-1} + e from its spectrum: deviation, and correlation 0.9 and 0.9^5 at lags 1 and 5.

    1.4 million numbers, each worth a nineteenth of an independent one: 0.4 % is one deviation.
    """
    frequency = np.linspace(0.0, 0.5, 2001)
    power = 1.0 / (1.0 + 0.81 - 1.8 * np.cos(2 * np.pi * frequency))
    noise = Noise(np.array([2.0, 0.5]), {1: (frequency, power)})
    x = noise.draw(np.random.default_rng(0), (7, 4, 50_000, 2))
    assert np.allclose(x.std(axis=(0, 1, 2)), [2.0, 0.5], rtol=0.02)
    for lag in (1, 5):
        apart = (x[:, :, lag:] * x[:, :, :-lag]).mean(axis=(0, 1, 2)) / noise.sigma**2
        assert np.allclose(apart, [0.0, 0.9**lag], atol=0.02)


@pytest.mark.parametrize("drift", [0.0, 0.3])
def test_what_is_not_measured_is_integrated_without_drift(drift):
    """Find an amplitude from rate and from acceleration over 7.3 periods, as near as the box of a prior needs.

    Ends that do not meet wrap round: that is a part in pi of the first integral's size and more of the second's.
    """
    t, w, a = np.arange(1000) * 0.01, 2 * np.pi * 0.73, 0.02
    once, twice = a * w * (np.cos(w * t) + drift * t / t[-1]), -a * w * w * (np.sin(w * t) + drift * t / t[-1])
    assert a / 2.0 < np.abs(integral(once, 0.01)).max() < 2.0 * a
    assert a / 2.5 < np.abs(integral(integral(twice, 0.01), 0.01)).max() < 2.5 * a
