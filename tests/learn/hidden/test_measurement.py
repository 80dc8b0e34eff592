"""Shapes, callipers, mounting, noise, probes and what stands around the branch: each against what defines it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from bough.learn.cases.case import load_case
from bough.learn.hidden import hide
from bough.learn.hidden.air_forms import FORMS, Drag, dryden_spectrum, velocities
from bough.learn.hidden.branch import random_branch
from bough.learn.hidden.drive import drive
from bough.learn.hidden.forms import recipe
from bough.learn.hidden.grip_forms import FORMS as GRIP
from bough.learn.hidden.measurement import (
    ANGLE_ERROR,
    DENSITY_ERROR,
    LENGTH_ERROR,
    RADIUS_ERROR,
    Mounting,
    Noise,
    measured,
    mounting,
    noise,
    shaped,
)
from bough.learn.hidden.parts import AIR, Now, Part, Readings
from bough.learn.hidden.probes import HARD_PROFILES, QUIET, Experiment, hard_shape
from bough.learn.hidden.rig import build, rig
from bough.sim.base.errors import InputError
from oracles.held_joint import RATE, STEP, Held, K, held_by, rod, scale
from scipy.spatial.transform import Rotation

SMALL = {"segments": 1, "samples": 50, "dt": 2e-3}


def part(effect: str, form: str, strength: float, seed: int = 4) -> Part:
    """Return an effect in a form, of a given strength."""
    return recipe(effect, form)(np.random.default_rng(seed), scale(), 0).make(strength)


# ---- shapes and callipers --------------------------------------------------------------------------------------------


def test_shaped_segments_are_arcs_over_their_chords() -> None:
    """End where the straight segments end, turn by the angle that is told, and swell about the frustum's radius."""
    branch = shaped(random_branch(np.random.default_rng(2), 3), np.random.default_rng(3))
    for i, axis in enumerate(branch.axes()):
        steps, radii = branch.links(i, 12)
        np.testing.assert_allclose(steps.sum(axis=0), branch.length[i] * axis, atol=1e-12)
        size = np.linalg.norm(steps, axis=1)
        turn = np.arccos(steps[0] @ steps[-1] / size[0] / size[-1])
        assert turn == pytest.approx(
            np.linalg.norm(branch.bend[i]) * 11 / 12
        )  # between the middles of the first and last
        assert size.sum() > branch.length[i]
        straight = np.linspace(branch.radius_base[i], branch.radius_tip[i], 13)
        assert 0.01 < np.abs(radii / straight - 1).max() < 0.0801
    _, data = build(branch)
    np.testing.assert_allclose(data.qacc, 0, atol=2e-2)  # the pose given is the equilibrium
    assert np.linalg.norm(data.sensordata[:3] - branch.grasp()) < 0.05 * branch.length[-1]


def test_callipers_err_by_what_they_should() -> None:
    """Miss each number by its deviation, over many branches, and never know of an arc."""
    found = {"length": [], "radius_base": [], "elevation": [], "density": []}
    for seed in range(300):
        true = shaped(random_branch(np.random.default_rng(seed), 3), np.random.default_rng(seed))
        read = measured(true, np.random.default_rng(1000 + seed))
        assert read.bend == read.swell == [] and read.grasp_distance <= read.length[-1]
        for name in found:
            found[name].append(np.ravel(getattr(read, name)) - np.ravel(getattr(true, name)))
            if name != "elevation":
                found[name][-1] = found[name][-1] / np.ravel(getattr(true, name))
    for name, error in zip(found, (LENGTH_ERROR, RADIUS_ERROR, ANGLE_ERROR, DENSITY_ERROR), strict=True):
        size = np.concatenate(found[name]).std()
        assert 0.8 * error < size < 1.15 * error, name  # 300 draws, cut at two deviations, which takes 12 %


# ---- mounting and noise ----------------------------------------------------------------------------------------------


def test_mounting_shows_what_its_sensors_see() -> None:
    """See a point that goes with the held link, in a turned frame; nothing else where sensors sit right."""
    time = np.arange(400) * 0.005
    turns = 0.3 * np.sin(2 * time)[:, None] * np.array([0.0, 0.6, 0.8])
    quaternion = Rotation.from_rotvec(turns).as_quat()[:, [3, 0, 1, 2]][None]
    zero = np.zeros((1, 400, 3))
    force = np.random.default_rng(0).normal(size=(1, 400, 3))
    still = Readings(time, force, zero, zero, quaternion)
    right = Mounting(np.zeros(3), np.zeros(3), np.zeros(3)).seen(still)
    np.testing.assert_array_equal(right.force, force)
    np.testing.assert_array_equal(right.moved, zero)
    offset, tracker, cell = np.array([0.004, 0.0, 0.001]), np.array([0.0, 0.0, np.pi / 2]), np.array([np.pi / 2, 0, 0])
    seen = Mounting(offset, tracker, cell).seen(still)
    swung = Rotation.from_rotvec(turns).apply(offset) - offset
    # a frame turned by a quarter about z has the world's y as its x, and the world's -x as its y
    np.testing.assert_allclose(seen.moved[0], np.stack([swung[:, 1], -swung[:, 0], swung[:, 2]], axis=1), atol=1e-12)
    np.testing.assert_allclose(seen.force[0], force[0][:, [0, 2, 1]] * [1, 1, -1], atol=1e-12)
    spin = 0.6 * np.cos(2 * time)[:, None] * np.array([0.0, 0.6, 0.8])
    speed = np.cross(spin, swung + offset)
    wanted = np.stack([speed[:, 1], -speed[:, 0], speed[:, 2]], axis=1)
    np.testing.assert_allclose(seen.velocity[0, 1:-1], wanted[1:-1], atol=1e-6)
    drawn = [mounting(np.random.default_rng(k)) for k in range(30)]
    assert all(2e-3 <= np.linalg.norm(m.offset) <= 6e-3 for m in drawn)
    assert all(1.0 <= np.degrees(np.linalg.norm(m.tracker)) <= 3.0 for m in drawn)


def test_noise_remembers_drifts_and_steps() -> None:
    """Have deviation one, the correlation that is told, the slow share that is told, and readings on a grid."""
    law = Noise(0.7, 0.2, 0.5)
    drawn = law.draw(np.random.default_rng(0), (60, 2000, 3))
    assert drawn.std() == pytest.approx(1.0, abs=0.01)  # 360,000 values, a memory of six
    slow = np.abs(np.fft.rfft(drawn, axis=1)[:, 1:5]) ** 2
    assert 2 * slow.sum() / (2000**2 * 180) == pytest.approx(0.2, rel=0.1)
    fast = Noise(0.7, 0.0, 0.0).draw(np.random.default_rng(1), (60, 2000, 3))
    assert np.mean(fast[:, 1:] * fast[:, :-1]) == pytest.approx(0.7, abs=0.01)
    assert fast[:, 0].std() == pytest.approx(1.0, abs=0.16)  # 180 values: three deviations
    steps = law.rounded(drawn, 0.1) / 0.05
    np.testing.assert_allclose(steps, steps.round(), atol=1e-9)
    assert np.abs(law.rounded(drawn, 0.1) - drawn).max() < 0.0251
    values = np.array([0.123])
    np.testing.assert_array_equal(Noise(0.0, 0.0, 0.0).rounded(values, 1.0), values)
    assert noise(np.random.default_rng(0), 500.0).memory > noise(np.random.default_rng(0), 50.0).memory > 0.0


# ---- probes and cases ------------------------------------------------------------------------------------------------


def test_hard_probes_start_and_end_at_rest() -> None:
    """Push with no force until ``QUIET`` and at the end, one at most, in more than one direction only in circles."""
    t = np.arange(800) / 200
    for profile in HARD_PROFILES:
        history = hard_shape(profile, t, t[-1], np.random.default_rng(0))
        assert history.shape == (800, 2) and not history[t <= QUIET].any(), profile
        assert np.abs(history[-1]).max() < 0.03 and 0.1 < np.linalg.norm(history, axis=1).max() <= 1.0 + 1e-9, profile
        assert history[:, 1].any() == (profile == "circle")
    u = (t - QUIET) / (t[-1] - 2 * QUIET)
    size = np.linalg.norm(hard_shape("circle", t, t[-1], np.random.default_rng(0)), axis=1)
    np.testing.assert_allclose(size[(u > 0.2) & (u < 0.8)], 0.6)


def test_hard_chirp_rises_in_frequency() -> None:
    """Cross zero ever faster, from below one hertz to above two."""
    t = np.arange(4000) / 800
    crossed = t[1:][np.diff(np.sign(hard_shape("chirp", t, t[-1], np.random.default_rng(0))[:, 0])) != 0]
    gaps = np.diff(crossed)[1:]  # the first one is where it sets in
    assert gaps[0] > 0.5 and gaps[-2] < 0.25 and (np.diff(gaps[:-1]) < 5e-3).all()


def test_hard_case_is_a_case(tmp_path: Path) -> None:
    """Write a case in which all is harder: it loads, its geometry is the measured one, its rate a fast one."""
    kinds = ("shape", "geometry", "probes", "noise", "sensors", "forms")
    answer = hide(tmp_path / "hard", effects=("cubic_stiffness",), seed=3, hard=kinds, segments=1, rate=50.0, dt=4e-3)
    case = load_case(tmp_path / "hard")
    meta = yaml.safe_load((tmp_path / "hard" / "meta.yaml").read_text())
    assert answer["hard"] == list(kinds) and answer["effects"][0]["form"]
    assert answer["branch"]["length"][0] != pytest.approx(meta["segments"][0]["length_m"], rel=1e-5)
    assert answer["branch"]["length"][0] == pytest.approx(meta["segments"][0]["length_m"], rel=2.01 * LENGTH_ERROR)
    assert 150 <= meta["n_samples"] <= 250 and {r["profile"] for r in meta["trajectories"]} == set(HARD_PROFILES)
    assert 0.002 < answer["measurement_gap"] < 0.1
    assert answer == json.loads((tmp_path / "hard_answer.json").read_text())
    assert len(case.trajectories) == 8


def test_every_kind_is_harder_by_itself(tmp_path: Path) -> None:
    """Change what a kind is about and nothing else of the branch or the experiment."""
    plain = Experiment(5, 2, 50.0, 60, 0.22)
    for kind in ("shape", "geometry", "probes", "noise", "sensors"):
        other = Experiment(5, 2, 50.0, 60, 0.22, (kind,))
        assert (other.branch.bend != []) == (kind == "shape")
        assert (other.measured.length != plain.measured.length) == (kind == "geometry")
        assert (other.mounting is not None) == (kind == "sensors") and (other.noise is not None) == (kind == "noise")
        assert np.array_equal(other.forces, plain.forces) == (kind != "probes")
        assert other.branch.stiffness == plain.branch.stiffness
    assert hide(tmp_path / "a", seed=5, **SMALL)["measurement_gap"] == 0.0


def test_measurement_gap_is_that_of_the_mounting(tmp_path: Path) -> None:
    """Leave little where only numbers are wrong, and no more than the sine where frames are turned."""
    gaps = {kind: hide(tmp_path / kind, seed=6, hard=(kind,), **SMALL)["measurement_gap"] for kind in
            ("geometry", "sensors")}  # fmt: skip
    assert 0.0 < gaps["geometry"] < 0.02 and 0.005 < gaps["sensors"] < np.sin(np.radians(3.0 + 1.5)) + 0.02


@pytest.mark.parametrize(
    ("wrong", "said"),
    [({"hard": ("wood",)}, "shape, geometry"), ({"outside": "cross_talk"}, "tether"), ({"samples": 0}, "20 to 2000")],
)
def test_bad_hard_input_writes_nothing(tmp_path: Path, wrong: dict, said: str) -> None:
    """Say what is allowed in one line: no other kind, no held-back name unless asked."""
    with pytest.raises(InputError) as error:
        hide(tmp_path / "case", seed=1, **{**SMALL, **wrong})
    assert said in str(error.value) and not list(tmp_path.iterdir())


# ---- air -------------------------------------------------------------------------------------------------------------


def test_velocities_are_those_of_the_links() -> None:
    """Agree with differences of the links' places, to the step."""
    import mujoco

    made = rig(random_branch(np.random.default_rng(1), 2), dt=1e-4)
    made.data.qvel[:] = np.random.default_rng(2).normal(size=made.model.nv)
    mujoco.mj_step1(made.model, made.data)
    bodies, place = made.model.geom_bodyid, made.data.geom_xpos.copy()
    said = velocities(Now(made, [made.data], 1e-4), bodies, place[None])[0]
    mujoco.mj_integratePos(made.model, made.data.qpos, made.data.qvel, 1e-6)
    mujoco.mj_kinematics(made.model, made.data)
    np.testing.assert_allclose((made.data.geom_xpos - place) / 1e-6, said, rtol=0, atol=1e-4)


@pytest.mark.parametrize(("power", "linear"), [(2.0, 0.0), (1.6, 0.0), (2.0, 0.5)])
def test_drag_bends_a_rod_by_its_moment(power: float, linear: float) -> None:
    """Turn a rod in a uniform wind U by rho/2 1.1 d (U^p + c U) L^2 / 2 over K."""

    def blow(time: np.ndarray, place: np.ndarray) -> np.ndarray:
        return np.array([0.0, 3.0, 0.0]) + 0 * place

    part = Part({}, law=lambda: Drag(AIR, blow, power=power, linear=linear), settled=True)
    moved = drive(rod(), np.zeros((1, 20, 3)), RATE, parts=[part], sub=1, dt=2e-3).moved[0]
    turn = 0.5 * AIR * 1.1 * 0.02 * (3.0**power + 3.0 * linear) * 0.4**2 / 2 / K
    assert moved[0, 1] == pytest.approx(0.3 * turn, rel=0.01) and np.ptp(moved[:, 1]) < 1e-3 * moved[0, 1]


def test_leaves_add_drag() -> None:
    """Slow a swing down more with leaves than without."""
    force = held_by([0, 3.0, 0], 60) * (np.arange(60) < 30)[None, :, None]
    swings = []
    for made in (None, part("quadratic_drag", "cylinders", 200.0), part("quadratic_drag", "leafy", 200.0)):
        moved = drive(rod(damping=0.02), force, RATE, parts=[made] if made else [], sub=4, wood=0.02, dt=1e-3).moved
        swings.append(np.abs(moved[0, 50:, 1]).max())
    assert swings[2] < 0.9 * swings[1] < 0.8 * swings[0]


def test_profiles_of_wind() -> None:
    """Grow with a power or the logarithm of the height, and turn with it."""
    height = np.array([0.0, 1.0, 3.0])  # above the base, which is a metre above the ground
    place = np.stack([0 * height, 0 * height, height], axis=1)[None]
    made = part("steady_wind", "power_law", 6.0)
    speed = np.linalg.norm(made.law().wind(np.zeros(1), place)[0], axis=1)
    np.testing.assert_allclose(speed, made.params["speed_mps"] * np.array([1, 2, 4]) ** made.params["exponent"])
    made = part("steady_wind", "log_law", 6.0)
    speed = np.linalg.norm(made.law().wind(np.zeros(1), place)[0], axis=1)
    np.testing.assert_allclose(np.diff(speed)[0], np.diff(speed)[1])  # a doubling each
    assert speed[0] == pytest.approx(np.sqrt(2 * 6.0 / AIR))
    made = part("steady_wind", "veering", 6.0)
    wind = made.law().wind(np.zeros(1), place)[0]
    angle = np.unwrap(np.arctan2(wind[:, 1], wind[:, 0]))
    np.testing.assert_allclose(np.diff(angle), made.params["veer_radpm"] * np.array([1, 2]))
    assert made.settled


@pytest.mark.parametrize("name", ["steady_wind", "wind_gust"])
def test_no_wind_is_slower_than_the_branch(name: str) -> None:
    """Draw no weaker wind than one as fast as the grasp point at its fastest: a slower one is little but a drag."""
    for form in FORMS[name]:
        draft = recipe(name, form)(np.random.default_rng(0), scale(), 0)
        assert draft.make(draft.low).params["speed_mps"] == pytest.approx(scale().speed)
        assert draft.low <= draft.start <= draft.high


def blown(made: Part, time: np.ndarray) -> np.ndarray:
    """Return a gust's speed along its direction, over its largest."""
    wind = made.law().wind(time, np.zeros((len(time), 1, 3)))[:, 0]
    return wind @ np.array(made.params["direction"]) / made.params["speed_mps"]


def test_gusts() -> None:
    """Swing about calm within one; or come one by one, their mean that of a raised cosine over the period."""
    time = np.arange(0, 400, 0.01)
    swing = blown(part("wind_gust", "sines", 6.0), time)
    assert np.abs(swing).max() <= 1.0 and abs(swing.mean()) < 0.01 and 0.2 < swing.std() < 0.75
    made = part("wind_gust", "one_minus_cosine", 6.0)
    swing = blown(made, time)
    assert swing.min() == 0.0 and swing.max() == pytest.approx(1.0, abs=1e-3)
    assert swing.mean() == pytest.approx(made.params["length_s"] / 2 / made.params["period_s"], rel=0.01)


def test_turbulence_has_drydens_spectrum() -> None:
    """Correlate as exp(-2 pi f t), Dryden's, over a tenth to a whole time scale; the spectrum's variance is one."""
    wide = np.geomspace(1e-5, 1e4, 100001)
    assert np.trapezoid(dryden_spectrum(wide, 0.3), wide) == pytest.approx(1.0, abs=1e-3)
    made = part("wind_gust", "dryden", 6.0)
    swing = 2.5 * blown(made, np.arange(0, 1000, 0.02))
    corner = made.params["corner_Hz"]
    inside = 2 / np.pi * (np.arctan(8.0 / corner) - np.arctan(0.03 / corner))  # of the variance, between its ends
    assert swing.std() ** 2 == pytest.approx(inside, rel=0.05)
    for lag in (0.1, 1.0):
        shift = round(lag / (2 * np.pi * corner) / 0.02)
        low = 1 - inside  # what is left out is nearly all slow and would be there at both times
        correlation = np.mean(swing[shift:] * swing[:-shift]) + low
        assert correlation == pytest.approx(np.exp(-shift * 0.02 * 2 * np.pi * corner), abs=0.06)


# ---- trunk, tip, grip ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["deep", "bending", "damped"])
def test_trunks_give_way_by_their_springs(form: str) -> None:
    """Turn by F l / K at every joint below: up by that times l, back by it times the joint's depth."""
    made = part("base_compliance", form, 0.1)
    force = held_by([0, 0, 0.2])
    stiff, soft = (drive(rod(), force, RATE, parts=p, sub=1, dt=2e-3).moved[0, -1] for p in ((), (made,)))
    depth, parts, k = (made.params[key] for key in ("depth_m", "parts", "stiffness_Nmprad"))
    turn, depths = 0.2 * 0.3 / k, depth * (1 - np.arange(parts) / parts)
    assert (soft - stiff)[2] == pytest.approx(parts * turn * 0.3, rel=0.02)
    assert (soft - stiff)[0] == pytest.approx(-turn * depths.sum(), rel=0.05)


@pytest.mark.parametrize("form", GRIP["tip_mass"])
def test_masses_at_the_tip_add_their_inertia(form: str) -> None:
    """Add sum m r^2 about the joint, wherever the masses are, and rest where the branch rested."""
    import mujoco

    made, found = part("tip_mass", form, 0.2), []
    for twig in ((), made.twig):
        model, data = build(rod(9.81), sub=1, twig=twig)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(model, data, full)
        found.append(full[2, 2])
        np.testing.assert_allclose(data.qacc, 0, atol=1e-3)
    added = sum(mass * ((0.4 + place[0]) ** 2 + place[1] ** 2) for place, mass in made.twig)
    assert found[1] - found[0] == pytest.approx(added, rel=1e-3)
    assert sum(mass for _, mass in made.twig) == pytest.approx(made.params["mass_kg"])


def test_grips_slide_at_their_rates() -> None:
    """Slide with what exceeds a limit; with the square of the force; sooner the more the force points along."""
    held = Held()
    across, along = np.array([[6.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 6.0]])

    def speed(form: str, force: np.ndarray) -> float:
        made = part("grasp_slip", form, 0.5)
        law = made.law()
        held.force = force
        law.begin(held)
        law.act(held)
        assert np.allclose(held.couple, np.cross(law.slide[:, None] * held.grip_axis, force)) or not law.slide.any()
        held.couple = np.zeros((1, 3))
        return float(law.slide[0]) / STEP / made.params["mobility_mpNs"]

    limit = part("grasp_slip", "threshold", 0.5).params["limit_N"]
    assert speed("threshold", across) == pytest.approx(6.0 - limit) and speed("threshold", 0.1 * across) == 0.0
    assert speed("creeping", across) == pytest.approx(36.0 / 10.0)
    assert speed("creeping", 0.5 * along) == pytest.approx(9.0 / 10.0)
    limit = part("grasp_slip", "dragged", 0.5).params["limit_N"]
    assert speed("dragged", along) == pytest.approx(6.0 - limit) == -speed("dragged", -along)
    assert speed("dragged", across) == 0.0
    jerk = part("grasp_slip", "jerking", 0.02).params
    law, held.force = part("grasp_slip", "jerking", 0.02).law(), 0.99 * jerk["limit_N"] / 6.0 * across
    law.begin(held)
    for size, way in ((0.99, 0.0), (1.01, jerk["way_m"]), (0.5, jerk["way_m"])):
        held.force = size * jerk["limit_N"] / 6.0 * across
        for _ in range(round(0.04 / STEP)):
            law.act(held)
        assert law.slide[0] == pytest.approx(way) and (size > 1.0 or law.speed[0] == 0.0)
    held.couple = np.zeros((1, 3))
    weight = part("grasp_slip", "rubbing", 0.5).params["weight"]
    assert speed("rubbing", along) - speed("rubbing", across) == pytest.approx(6.0 * weight)


# ---- the force sensor ------------------------------------------------------------------------------------------------


def seen(force: np.ndarray, turn=(1.0, 0.0, 0.0, 0.0)) -> Readings:
    """Return readings of two recordings of a force [T, 3]."""
    force = np.tile(np.asarray(force, dtype=float), (2, 1, 1))
    zero = np.zeros_like(force)
    return Readings(np.arange(force.shape[1]) * 0.04, force, zero, zero, np.tile(np.array(turn), (*zero.shape[:2], 1)))


def test_offsets_that_do_not_stay() -> None:
    """Start at B and end at B (1 + d (1 - e^-3)); or be another one a recording, near B."""
    none = seen(np.zeros((5, 3)))
    made = part("force_bias", "warming", 0.1)
    bias, read = np.array(made.params["force_N"]), made.sense(none).force
    assert np.linalg.norm(bias) == pytest.approx(1.0)
    np.testing.assert_allclose(read[0, 0], bias)
    np.testing.assert_allclose(read[1, 0], bias * (1 + made.params["drift"] * (1 - np.exp(-3))))
    made = part("force_bias", "rezeroed", 0.1)
    read = made.sense(none).force
    assert (np.linalg.norm(read[:, 0] - made.params["force_N"], axis=1) < 4 * made.params["scatter"]).all()
    assert np.linalg.norm(read[0, 0] - read[1, 0]) > 1e-3


def test_gains_that_are_not_one_number() -> None:
    """Scale each axis by its own; or less and less towards the largest force."""
    force = np.diag([2.0, 3.0, 10.0])
    made = part("force_scale", "per_axis", 0.2)
    np.testing.assert_allclose(made.sense(seen(force)).force[0], force * made.params["axes"])
    assert np.ptp(np.abs(np.log(made.params["axes"]))) <= 0.4 * 0.2
    made = part("force_scale", "curved", 0.2)
    gain, curve = made.params["scale"], made.params["curve"]
    np.testing.assert_allclose(
        np.diag(made.sense(seen(force)).force[0]), gain * (1 - curve * np.array([0.2, 0.3, 1.0])) * [2, 3, 10]
    )


def test_delays_that_are_not_one_lag() -> None:
    """Lag a ramp by the filter's time constant; or each recording by its own, within a fifth of the mean."""
    ramp = np.outer(np.arange(100.0), np.ones(3))
    made = part("time_delay", "low_pass", 3.0)
    late = ramp[-1, 0] - made.sense(seen(ramp)).force[0, -1, 0]
    assert late == pytest.approx(np.exp(-1 / 3) / -np.expm1(-1 / 3))  # the filter's delay in samples, near 3 - 1/2
    made = part("time_delay", "unsteady", 2.0)
    late = ramp[-1, 0] - made.sense(seen(ramp)).force[:, -1, 0]
    assert (np.abs(late / 2.0 - 1) <= 0.2 + 1e-9).all() and late[0] != late[1]


def test_weights_that_were_tared_wrong() -> None:
    """Leave the weight less what was tared in another pose, or a while ago."""
    none = np.zeros((60, 3))
    made = part("gravity_comp_error", "other_pose", 0.3)
    weight, tared, lean = made.params["mass_kg"] * -9.81, made.params["tared"], made.params["lean_rad"]
    read = made.sense(seen(none)).force[0, 0]
    assert read[2] == pytest.approx(weight * (1 - tared * np.cos(lean)))
    assert np.hypot(read[0], read[1]) == pytest.approx(abs(weight) * tared * np.sin(lean))
    made = part("gravity_comp_error", "late_pose", 0.3)
    weight, tared = made.params["mass_kg"] * -9.81, made.params["tared"]
    steady = made.sense(seen(none, (0.0, 1.0, 0.0, 0.0))).force
    np.testing.assert_allclose(steady, np.tile([0, 0, weight * (1 + tared)], (2, 60, 1)), atol=1e-9)
    turning = seen(none)
    turning.turn[:, 30:] = [0.0, 1.0, 0.0, 0.0]
    read = made.sense(turning).force[0, :, 2] / weight
    lag = made.params["lag_s"] / 0.04
    assert read[29 + int(lag)] == pytest.approx(1 - tared) and read[31 + int(lag)] == pytest.approx(1 + tared)
