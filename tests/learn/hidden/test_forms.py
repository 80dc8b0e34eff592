"""Other forms of a joint's law, each against a closed form or a property that it must have; the split of the forms."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from bough.learn.hidden import NAMES, OUTSIDE, exam_plan, hide
from bough.learn.hidden.elastic_forms import FORMS as ELASTIC
from bough.learn.hidden.elastic_forms import Damage, Set
from bough.learn.hidden.forms import FORMS, PLAIN, draw, held_back, outside_names, practice, recipe
from bough.learn.hidden.memory_forms import Powered, Prony, Slider, Stops, prony
from bough.learn.hidden.outside_laws import MORE, HangingMass, PlaceDamper
from bough.learn.hidden.parts import Readings
from oracles.held_joint import STEP, Held, K, follow, scale, triangle
from scipy.optimize import brentq

ROOT = Path(__file__).resolve().parents[3]
#: One segment, few samples: about a second a case.
SMALL = {"segments": 1, "samples": 50, "rate": 25.0, "dt": 2e-3}
#: Largest angle of the joint in `scale`.
A = 0.2


def part(effect: str, form: str, strength: float, seed: int = 4):
    """Return an effect in a form, of a given strength."""
    return recipe(effect, form)(np.random.default_rng(seed), scale(), 0).make(strength)


def torque(effect: str, form: str, strength: float, angles) -> tuple[np.ndarray, dict]:
    """Return what is added at angles [T, 3], each by itself, and the parameters."""
    made = part(effect, form, strength)
    return follow(made.law(), angles), made.params


# ---- the split -------------------------------------------------------------------------------------------------------


def test_half_of_the_forms_is_held_back_by_hash() -> None:
    """Hold back the half of each effect's other forms whose hashes are the smallest, and keep the plain one."""
    assert set(FORMS) == set(NAMES)
    for effect, forms in FORMS.items():
        kept, open_ = set(held_back(effect)), set(practice(effect))
        assert len(forms) >= 2 and not kept & open_ and kept | open_ == {PLAIN, *forms}
        assert 0 <= len(kept) - (len(open_) - 1) <= 1
        digest = {form: sha256(f"{effect}/{form}".encode()).digest() for form in forms}
        assert all(digest[a] < digest[b] for a in kept for b in open_ - {PLAIN}), effect
        drawn = {draw(effect, np.random.default_rng(k), held=False) for k in range(40)}
        assert drawn == open_ and {draw(effect, np.random.default_rng(k), held=True) for k in range(40)} == kept
    assert set(outside_names(False)) >= set(OUTSIDE)
    assert not set(outside_names(False)) & set(outside_names(True))
    assert set(outside_names(True)) | set(outside_names(False)) == {*OUTSIDE, *MORE}


def test_only_the_held_back_exam_opens_them() -> None:
    """Plan no held-back form or name unless asked; name the option nowhere but where it is made and described."""
    assert not any(spec.hard or spec.held_back for spec in exam_plan(80, 1))
    for held in (False, True):
        specs = exam_plan(80, 1, hard=True, held_back=held)
        assert all(spec.held_back == held and "forms" in spec.hard for spec in specs)
        assert {s.outside for s in specs if s.outside} <= set(outside_names(held))
        assert {s.segments for s in specs} == set(range(1, 7))
    allowed = {"cli/diagnose.py", "learn/exam/hold.py", "docs/hide.md", "CHANGELOG.md"}
    own = (p for p in ROOT.iterdir() if not p.name.startswith(".") and p.name != "out")  # .venv holds 60,000 files
    every = (p for top in own for p in (top.rglob("*") if top.is_dir() else [top]))
    files = [p for p in every if p.suffix in {".py", ".md", ".yaml", ".yml", ".toml"} or p.name == "Makefile"]
    named = {str(p.relative_to(ROOT)) for p in files if {*_words(p)} & {"held_back", "--held-back"}}
    allowed.add("tests/cli/test_hide_story.py")  # of one case in which nothing is hidden
    own = {name for name in named if name.startswith(("learn/hidden/", "tests/learn/hidden/", "docs/decisions/"))}
    assert named - own <= allowed, named - own
    assert "learn/hidden/forms.py" in own


def _words(path: Path) -> set[str]:
    if not path.is_file() or any(part.startswith(".") or part == "out" for part in path.relative_to(ROOT).parts):
        return set()
    text = path.read_text(errors="ignore")
    return {word for word in ("held_back", "--held-back") if word in text}


@pytest.mark.parametrize(("effect", "form"), [(e, f) for e in FORMS for f in FORMS[e]])
def test_every_form_is_visible(tmp_path: Path, effect: str, form: str) -> None:
    """Hide each form: near its size, not taken up by springs and dampers, named in the answer."""
    answer = hide(tmp_path / "case", effects=(effect,), forms={effect: form}, seed=11, noise=0.0, size=0.15, **SMALL)
    assert answer["effects"][0]["name"] == effect and answer["effects"][0]["form"] == form
    assert 0.05 < answer["size_raw"][effect] < 0.35
    assert 0.005 < answer["visible_gap"] < 1.6 * answer["size_raw"][effect]


@pytest.mark.parametrize("name", MORE)
def test_more_outside_effects_are_visible(tmp_path: Path, name: str) -> None:
    """Hide each effect on no list that the hard exams add."""
    answer = hide(tmp_path / "case", outside=name, held_back=True, seed=11, noise=0.0, size=0.15, **SMALL)
    assert 0.05 < answer["size_raw"][name] < 0.35 and answer["visible_gap"] > 0.005


# ---- springs ---------------------------------------------------------------------------------------------------------


SPRINGS = [(e, f) for e in ("cubic_stiffness", "bilinear_stiffness", "backlash", "anisotropic_stiffness",
                            "bending_torsion_coupling") for f in ELASTIC[e]]  # fmt: skip


@pytest.mark.parametrize(("effect", "form"), SPRINGS)
def test_springs_do_no_work_around_a_loop(effect: str, form: str) -> None:
    """Lose and gain nothing on a closed path: each form has an energy. The midpoint rule is off by the step squared."""
    u = np.linspace(0, 2 * np.pi, 8001)
    path = A * np.stack([0.9 * np.sin(u), 0.7 * np.cos(2 * u + 0.4), 0.6 * np.sin(u + 1.0)], axis=1)
    added, _ = torque(effect, form, 0.4, path)
    work = ((added[1:] + added[:-1]) / 2 * np.diff(path, axis=0)).sum(axis=1)
    assert abs(work.sum()) < 1e-4 * np.abs(work).sum()
    assert np.abs(work).sum() > 1e-3


@pytest.mark.parametrize(("form", "tangent"), [("exponential", np.cosh), ("softening", lambda x: np.cosh(x) ** -2)])
def test_tangents_of_exponential_springs(form: str, tangent) -> None:
    """Have the tangent stiffness K cosh(b phi), or K / cosh^2(b phi)."""
    phi = np.linspace(-A, A, 2001)
    added, params = torque("cubic_stiffness", form, 0.5, phi)
    slope = np.gradient(K * phi - added[:, 0], phi)[1:-1]
    np.testing.assert_allclose(slope, K * tangent(params["rate_prad"] * phi[1:-1]), rtol=1e-5)


def test_powers_of_springs() -> None:
    """Grow by 2^5 with twice the angle, by 2^3 whatever the direction, by 2^1.5 beyond a gap, by 2^2 to one side."""
    one = np.array([0.06, -0.04, 0.03])
    added, _ = torque("cubic_stiffness", "quintic", 0.5, [one, 2 * one])
    np.testing.assert_allclose(added[1], 32 * added[0])
    turned = 2 * np.linalg.norm(one) * np.array([0.0, 0.6, 0.8])
    added, _ = torque("cubic_stiffness", "radial", 0.5, [one, turned])
    np.testing.assert_allclose(np.linalg.norm(added, axis=1), np.linalg.norm(added[0]) * np.array([1, 8]))
    phi = np.array([0.02, 0.06])
    added, params = torque("backlash", "hertz", 0.1, params_free(phi, 0.02))
    whole = K * params_free(phi, params["gap_rad"]) - added[:, 0]
    np.testing.assert_allclose(whole[1] / whole[0], 3**1.5)
    axis_angle = part("bilinear_stiffness", "quadratic", 0.5).params["axis_rad"]
    axis = np.array([np.cos(axis_angle), np.sin(axis_angle), 0.0])
    added, _ = torque("bilinear_stiffness", "quadratic", 0.5, np.outer([0.05, 0.1, -0.05], axis))
    np.testing.assert_allclose(added[1], 4 * added[0])
    np.testing.assert_allclose(added[2], added[0])  # stiffer to one side, softer to the other


def params_free(beyond: np.ndarray, gap: float) -> np.ndarray:
    """Return angles so far beyond a gap."""
    return gap + beyond


def test_gaps() -> None:
    """Have no spring inside a sharp gap and K (phi - g) outside; in a soft one the share of it that stays."""
    phi = np.array([0.0, 0.01, -0.015, 0.12])
    added, params = torque("backlash", "dead_zone", 0.1, phi)
    np.testing.assert_allclose(K * phi - added[:, 0], [0, 0, 0, K * (0.12 - params["gap_rad"])], atol=1e-12)
    added, params = torque("backlash", "soft_edges", 0.1, phi)
    np.testing.assert_allclose((K * phi - added[:, 0])[1:3], params["stays"] * K * phi[1:3])


def test_corners() -> None:
    """Change the slope from none to s K: over a width that is told, or only from a corner on."""
    for form in ("smooth_corner", "late_corner"):
        made = part("bilinear_stiffness", form, 0.5)
        axis = np.array([np.cos(made.params["axis_rad"]), np.sin(made.params["axis_rad"]), 0.0])
        u = np.linspace(-1.0, 1.0, 2001) * made.params["side"]
        slope = np.gradient(follow(made.law(), np.outer(u, axis)) @ axis, u)
        ends = slope[[1, -2]]  # 1 rad is far beyond a width of 0.02 to 0.07 rad: short of the whole by its square / 4
        np.testing.assert_allclose(ends, [0, -made.params["relative"] * K], atol=2e-3 * K)
        if form == "late_corner":
            before = np.abs(u) < 0.95 * made.params["corner"] * A
            np.testing.assert_allclose(slope[before], 0, atol=1e-9)


def test_directions() -> None:
    """Stiffen one axis by what softens the other (oval); change twist too (orthotropic); turn with the bend."""
    eye = 0.1 * np.eye(3)
    added, params = torque("anisotropic_stiffness", "section", 0.3, eye)
    assert abs(np.trace(added)) < 1e-12
    np.testing.assert_allclose(sorted(np.linalg.eigvalsh(added) / 0.1), [-0.3 * K, 0, 0.3 * K], atol=1e-12)
    added, params = torque("anisotropic_stiffness", "orthotropic", 0.3, eye)
    np.testing.assert_allclose(added[2], [0, 0, -0.3 * params["twist"] * K * 0.1])
    made = part("anisotropic_stiffness", "turning_axes", 0.3)
    for size in (0.02, 0.2):
        now = made.params["axis_rad"] + made.params["turns_rad"] * size / A
        axis = np.array([np.cos(now), np.sin(now), 0.0])
        np.testing.assert_allclose(follow(made.law(), [size * axis])[0], -made.params["relative"] * K * size * axis)


def test_couplings() -> None:
    """Twist alike for a bend either way (quadratic); with less and less for a growing bend (saturating)."""
    for form in ("quadratic", "saturating"):
        made = part("bending_torsion_coupling", form, 0.3)
        axis = np.array([np.cos(made.params["axis_rad"]), np.sin(made.params["axis_rad"]), 0.0])
        twist = follow(made.law(), np.outer([0.1, -0.1, 0.2, 1e-4], axis))[:, 2] / (-K * made.params["coupling"])
        if form == "quadratic":
            np.testing.assert_allclose(twist[:3], np.array([0.1, 0.1, 0.2]) ** 2 * np.array([1, 1, 1]) / A)
        else:
            np.testing.assert_allclose(twist, A * np.tanh(np.array([0.1, -0.1, 0.2, 1e-4]) / A))


# ---- damage ----------------------------------------------------------------------------------------------------------


def test_voce_hardens_to_a_limit() -> None:
    """Leave in a first load the slip p of phi - p = y + Q (1 - exp(-b p)), and no more in a second like it."""
    made = part("plastic_set", "voce", 0.3)
    y, q, b = (made.params[key] for key in ("yield_rad", "saturation_rad", "rate_prad"))
    up = np.linspace(0, 2 * A, 4000)
    added = follow(made.law(), np.concatenate([up, up[::-1], up]))[:, 0] / K
    slip = brentq(lambda p: 2 * A - p - y + q * np.expm1(-b * p), 0.0, 2 * A)
    np.testing.assert_allclose(added[[3999, 7999, 11999]], slip, rtol=1e-3)


def test_back_angle_saturates() -> None:
    """Bear y + C / gamma in a long load, and yield on the way back after 2 y (Bauschinger)."""
    y, c, gamma = 0.05, 2.0, 40.0
    law = Set(0, K, lambda w: y + 0 * w, 0.0, (c, gamma))
    up = np.linspace(0, 0.6, 12001)
    added = follow(law, np.concatenate([up, up[::-1]]))[:, 0] / K
    assert abs(0.6 - added[12000] - (y + c / gamma)) < 1e-3
    back = np.concatenate([up, up[::-1]])[12001:]
    yields = back[np.flatnonzero(added[12001:] < added[12000] - 1e-6)[0]]
    assert abs(0.6 - yields - 2 * y) < 1e-3
    grown = part("plastic_set", "chaboche", 0.25).params
    assert abs(grown["isotropic"] + grown["kinematic"] - 3.0) < 1e-12


def test_norton_takes_time() -> None:
    """Slip (phi - y) / (1 + h) (1 - exp(-t / T)) after a step of the angle."""
    made = part("plastic_set", "norton", 0.5)
    time = np.arange(1, 400) * STEP
    added = follow(made.law(), [A] * 399)[:, 0] / K
    whole = (A - made.params["yield_rad"]) * 0.5
    np.testing.assert_allclose(added, whole * -np.expm1(-time / made.params["time_s"]), rtol=1e-9)


def test_ruptures_last_and_grow() -> None:
    """Lose equal steps 15 % of the limit apart; 1 - exp(-(x - 1) / w); or with every cycle; and never get it back."""
    angle = np.concatenate([[x, 0.01] for x in np.linspace(0.05, 0.6, 500)])
    for form in ("stepwise", "gradual"):
        made = part("partial_rupture", form, 0.4)
        share = follow(made.law(), angle)[1::2, 0] / (K * 0.01)
        limit = made.params["limit_rad"]
        assert (np.diff(share) >= -1e-12).all() and not share[np.linspace(0.05, 0.6, 500) < limit].any()
        assert abs(share[-1] - 0.4) < 0.01
        if form == "stepwise":
            levels = np.unique(share.round(9))
            np.testing.assert_allclose(np.diff(levels), levels[1], atol=1e-9)
            broke = np.linspace(0.05, 0.6, 500)[np.searchsorted(share, levels[1:] - 1e-6)]
            np.testing.assert_allclose(broke, limit * (1 + 0.15 * np.arange(len(broke))), atol=1.2e-3)
    law = Damage(0, K, 0.1, lambda x: -np.expm1(-x / 0.2), worn=True)
    cycles = np.tile(np.concatenate([np.linspace(0, 0.15, 50), np.linspace(0.15, 0, 50)]), 3)
    share = (follow(law, np.append(cycles, 0.01))[-1, 0]) / (K * 0.01)
    assert abs(share - -np.expm1(-3 * 0.05 / 0.2)) < 1e-9


# ---- friction, hysteresis, creep -------------------------------------------------------------------------------------


def test_coulomb_loses_four_torques_a_cycle() -> None:
    """Lose exactly 4 T (A - bend) a cycle: the contact's own bend is given back."""
    made = part("dry_friction", "coulomb", 0.3)
    angle = triangle(A)
    added = follow(made.law(), angle)[:, 0]
    lost = -np.trapezoid(added[4000:8001], angle[4000:8001])
    bend = made.params["bend_rad"]
    assert abs(lost / (4 * made.params["torque_Nm"] * (A - bend)) - 1) < 1e-3


def sliding(made, speed: float, axis) -> float:
    """Return the torque of a joint that turns on and on at a speed about an axis, at angles that stay small."""
    held, law = Held(), made.law()
    held.w = speed * np.array([axis])
    law.begin(held)
    for _ in range(4000):
        held.phi, held.torque = held.phi + np.array([axis]) * np.sign(speed) * 1e-4, np.zeros((1, 3))
        law.act(held)
    return float(np.linalg.norm(held.torque))


def test_levels_of_friction() -> None:
    """Follow Stribeck's curve at each speed; differ by the way it turns; grow with the angle."""
    made = part("dry_friction", "stribeck", 0.3)
    v, more, t = (made.params[key] for key in ("speed_radps", "more", "torque_Nm"))
    for speed in (0.01 * v, 0.8 * v, 10 * v):
        assert sliding(made, speed, [1, 0, 0]) == pytest.approx(t * (1 + more * np.exp(-((speed / v) ** 2))), rel=1e-6)
    made = part("dry_friction", "asymmetric", 0.3)
    axis, more, t = np.array(made.params["axis"]), made.params["more"], made.params["torque_Nm"]
    assert sliding(made, 1.0, axis) == pytest.approx(t * (1 + more))
    assert sliding(made, -1.0, axis) == pytest.approx(t * (1 - more))
    made = part("dry_friction", "loaded", 0.3)
    assert sliding(made, 1.0, [0, 1, 0]) == pytest.approx(
        made.params["torque_Nm"] * (1 + made.params["more"] * 0.4 / A)
    )


def test_friction_that_creeps_is_a_hyperbolic_tangent_of_the_rate() -> None:
    """Give T tanh(w / v) at each steady rate, either way, and less and less of it once the joint stands."""
    made = part("dry_friction", "creeping", 0.3)
    v, t = made.params["speed_radps"], made.params["torque_Nm"]
    for rate in (0.1 * v, -0.7 * v, 3.0 * v):
        angle = rate * STEP * np.arange(4001)
        assert follow(made.law(), angle)[-1, 0] == pytest.approx(-t * np.tanh(rate / v), rel=1e-6)
    stopped = follow(made.law(), np.minimum(3.0 * v * STEP * np.arange(8001), 12000 * v * STEP))[:, 0]
    assert 0.0 < -stopped[-1] < 0.1 * t < -stopped[4000]


def test_bristles_creep_before_they_slip() -> None:
    """Bend as T (1 - exp(-phi / bend)), as LuGre does at a steady level."""
    law = Slider(0, 0.5, 0.01, lambda phi, w, turn: np.ones((1, 1)), soft=True)
    phi = np.linspace(0, 0.05, 200)
    np.testing.assert_allclose(follow(law, phi)[:, 0], 0.5 * np.expm1(-phi / 0.01), atol=1e-12)


def test_stops_lose_what_each_of_them_loses() -> None:
    """Lose sum 4 k_i r_i (A - r_i) a cycle (Prandtl, Ishlinskii), whatever the speed."""
    made = part("hysteresis_boucwen", "prandtl_ishlinskii", 0.5)
    yields = made.params["yield_rad"] * np.arange(1, 9) / 8
    for count in (4000, 800):
        angle = triangle(A, count)
        lost = -np.trapezoid(follow(made.law(), angle)[count : 2 * count + 1, 0], angle[count : 2 * count + 1])
        assert lost == pytest.approx((4 * 0.5 * K / 8 * yields * (A - yields)).sum(), rel=5e-3)


def test_iwan_loses_with_a_power_of_the_size() -> None:
    """Lose as size^(3 + chi) (Segalman); ten sliders follow it to a tenth of the exponent between their ends."""
    made = part("hysteresis_boucwen", "iwan", 0.5)
    sizes, lost = made.params["yield_rad"] * np.array([0.15, 0.6]), []
    for size in sizes:
        angle = triangle(size)
        lost.append(-np.trapezoid(follow(made.law(), angle)[4000:8001, 0], angle[4000:8001]))
    power = np.diff(np.log(lost))[0] / np.diff(np.log(sizes))[0]
    assert abs(power - (3 + made.params["chi"])) < 0.3


def test_powered_bouc_wen() -> None:
    """Follow y tanh(phi / y) in a first load with exponent two and blend one half, and saturate at y with any."""
    phi = np.linspace(0, 0.5, 10001)
    np.testing.assert_allclose(
        follow(Powered(0, K, 0.1, 2.0, 0.5), phi)[:, 0], -K * 0.1 * np.tanh(phi / 0.1), atol=4e-4
    )
    for n, most in ((0.6, 2.0), (3.0, 0.5)):  # slower the smaller the exponent
        assert follow(Powered(0, K, 0.1, n, 0.8), np.linspace(0, most, 5001))[-1, 0] == pytest.approx(
            -K * 0.1, rel=1e-3
        )
    made = part("hysteresis_boucwen", "bouc_wen_power", 0.5)
    angle = triangle(A)
    assert -np.trapezoid(follow(made.law(), angle)[4000:8001, 0], angle[4000:8001]) > 0.01


def test_creep_relaxes_as_it_should() -> None:
    """Answer a step with the sum of exponentials, with t^-alpha, with exp(-(t / T)^b)."""
    time = np.arange(1, 4000) * STEP
    step = [0.0] + [0.1] * 3999
    left = {}
    for form in ("two_times", "fractional", "stretched"):
        made = part("viscoelastic_sls", form, 0.5)
        left[form] = (-follow(made.law(), step)[1:, 0] / (0.5 * K * 0.1), made.params)
    value, p = left["two_times"]
    fast, slow = np.exp(-time / p["relaxation_s"]), np.exp(-time / p["relaxation_s"] / p["ratio"])
    np.testing.assert_allclose(value, p["part"] * fast + (1 - p["part"]) * slow, rtol=1e-9)
    value, p = left["fractional"]
    inside = (time > 0.08) & (time < 3.5)
    slope = np.polyfit(np.log(time[inside]), np.log(value[inside]), 1)[0]
    assert abs(slope + p["order"]) < 0.05
    value, p = left["stretched"]
    inside = (time > p["relaxation_s"] / 20) & (time < 2 * p["relaxation_s"])
    wanted = np.exp(-((time / p["relaxation_s"]) ** p["exponent"]))
    share = value[inside] / wanted[inside]
    assert share.std() < 0.03 * share.mean()


def test_prony_fits_an_exponential_by_itself() -> None:
    """Fit exp(-t / T) of a time on the grid by that one alone, and weights that are not negative."""
    time = np.geomspace(0.005, 4.0, 8)[3]
    weights, times = prony(lambda t: np.exp(-t / time), 0.01, 1.0)
    assert (weights >= 0).all() and abs(times[weights.argmax()] / time - 1) < 1e-9 and abs(weights.max() - 1) < 1e-6
    held = follow(Prony(0, K * weights, times), [0.0, 0.1])
    assert held[1, 0] == pytest.approx(-K * 0.1 * np.exp(-STEP / time), rel=1e-5)
    assert not follow(Stops(0, np.array([K]), np.array([0.1])), [0.0, 0.0]).any()


# ---- on no list ------------------------------------------------------------------------------------------------------


def test_hanging_mass_swings_at_its_frequency() -> None:
    """Answer a step of the grasp point with a swing of its frequency that decays by its damping, m w^2 at once."""
    held, law = Held(), HangingMass(0.3, 2.0, 0.05)
    law.begin(held)
    held.moved = np.array([[0.1, 0.0, 0.0]])
    pushes = []
    for _ in range(3000):
        held.push = np.zeros((1, 3))
        law.act(held)
        pushes.append(held.push[0, 0])
    w, t = 2 * np.pi * 2.0, np.arange(3000) * STEP
    assert pushes[0] == pytest.approx(-0.3 * w * w * 0.1)
    crossings = t[1:][np.diff(np.sign(pushes)) != 0]
    assert np.diff(crossings).mean() == pytest.approx(0.25 / np.sqrt(1 - 0.05**2), rel=0.01)
    peaks = np.abs(pushes).reshape(6, 500).max(axis=1)
    assert np.log(peaks[1] / peaks[4]) / 1.5 == pytest.approx(0.05 * w, rel=0.05)


def test_more_outside_effects() -> None:
    """Damp with the angle; leak between channels and leave their own; repeat readings in spells only."""
    phi = 0.1 + 1e-5 * np.arange(2000)  # a hundredth of a radian a second
    added = follow(PlaceDamper(0, 3.0, 4 * K), phi)[500:, 0]
    np.testing.assert_allclose(added, -3.0 * phi[500:] * 1e-5 / STEP, rtol=1e-3)
    fast = follow(PlaceDamper(0, 3.0, 4 * K), [0.1, 0.1001])[1, 0]  # within a step the mount takes nearly all of it
    assert -4 * K * 1e-4 < fast < -0.85 * 4 * K * 1e-4
    rng = np.random.default_rng(3)
    seen = Readings(np.arange(101) * 0.04, *(rng.normal(size=(2, 101, n)) for n in (3, 3, 3, 4)))
    leaked = MORE["cross_talk"](rng, scale(), 0).make(0.2).sense(seen).force
    matrix = np.linalg.lstsq(seen.force.reshape(-1, 3), leaked.reshape(-1, 3), rcond=None)[0]
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    assert np.abs(matrix - np.eye(3)).max() == pytest.approx(0.2)
    stale = MORE["dropouts"](rng, scale(), 0).make(0.1).sense(seen).moved
    same = (stale == seen.moved).all(axis=-1)
    repeated = (stale[:, 1:] == stale[:, :-1]).all(axis=-1)
    assert 0.3 < same.mean() < 1.0 and (same[:, 1:] | repeated).all()
