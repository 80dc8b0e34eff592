"""Where a model is wrong is located as by hand; a diagnosis is written whole, readable and self-contained."""

from __future__ import annotations

import base64
import json
import math
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bough.learn.gap import figures
from bough.learn.gap.consistent import readable
from bough.learn.gap.diagnosis import Diagnosis, Gap, Interval, Rival, Settings, Share
from bough.learn.gap.report import bare, content, write_diagnosis
from bough.learn.gap.where import grasp_response, joint_torque, locate, noise_seen, parts_of, phases, regime
from bough.learn.replay.recording import recordings
from bough.learn.systems.acting import Acting

sys.path.insert(0, str(Path(__file__).parents[2] / "oracles"))
from effect_case import resting, stick_case, swing_case

SAMPLES, OPEN = 100, slice(70, 100)
SIGMA = np.array([1e-3] * 3 + [1e-2] * 3)
SPRING = 30.0
HISTORY = np.interp(np.arange(SAMPLES), [0, 10, 30, 50, 70], [0, 0, 1, 1, 0])


def push(direction, *, size=3.0):
    """Rest, load, hold, release, then an open gripper: force [T, 3] [N]."""
    return size * HISTORY[:, None] * np.asarray(direction, dtype=float)


def probed(folder: Path, count: int = 3):
    """Return a stick's case and recordings in which displacement follows the force; every second one is reversed."""
    forces = [push([(-1.0) ** k, 0.0, 0.0], size=3.0 + 0.1 * k) for k in range(count)]
    case = stick_case(folder, forces, opened=[(1.4, 1.98)])
    outputs = [np.hstack([0.01 * f, np.gradient(0.01 * f, case.dt, axis=0)]) for f in forces]
    return case, [replace(r, output=y) for r, y in zip(recordings(case), outputs, strict=True)]


def missed(recorded, size):
    """Return simulated channels [R, T, C] that miss what was measured by ``size`` [R, T] times the noise."""
    sign = np.where(np.arange(6) % 2, -1.0, 1.0)
    return np.stack([r.output - s[:, None] * sign * SIGMA for r, s in zip(recorded, size, strict=True)])


def sizes(count: int = 3, *, late: float = 4.0):
    """Misfit over noise [R, T]: one, and more with the gripper open; twice that in the second recording."""
    out = np.ones((count, SAMPLES))
    out[:, OPEN] = late
    out[1] *= 2.0
    return out


def diagnosis(folder: Path, verdict: str, *, count: int = 3, posterior=None) -> Diagnosis:
    """Return a diagnosis of a stick, by hand."""
    case, recorded = probed(folder, count)
    base, best = missed(recorded, sizes(count)), missed(recorded, np.ones((count, SAMPLES)))
    named = verdict == "effects"
    effects = (Acting("dry_friction", 0), Acting("tip_mass")) if named else ()
    parameters = {"dry_friction@0": {"torque_Nm": Interval(0.2111, 0.1893, 0.2334, "N m")},
                  "tip_mass": {"mass_kg": Interval(0.051, 0.043, 0.059, "kg")}}  # fmt: skip
    ranking = (Rival(("dry_friction@0", "tip_mass"), 1.02, 0.0, 0.97, 1.1), Rival(("plastic_set@0",), 1.9, 35.0, 0.6),
               Rival((), 4.4, 812.0, 0.0, 4.9))  # fmt: skip
    return Diagnosis(
        case=case, settings=Settings(), recordings=recorded, sigma=SIGMA, verdict=verdict,
        sentence=f"This is what a person reads first: {verdict}.", effects=effects,
        parameters=parameters if named else {},
        alternatives={"dry_friction@0": ("hysteresis_boucwen",)} if named else {},
        nearest="plastic_set" if verdict == "unknown" else None,
        where=locate(case, recorded, SIGMA, base, np.array([SPRING])), gap=Gap(0.0123, 0.00214, 0.00198, "m", (1,)),
        ranking=ranking, explained=0.97, base_reduced_chi2=1.3 if verdict == "none" else 4.4, motion=30.0,
        p_null=0.0204 if verdict == "none" else 0.00204, base_output=base, best_output=best,
        base_values={"stiffness stick": 30.0}, best_values={"stiffness stick": 31.0, "tip_mass mass_kg": 0.051},
        next_experiment="Release it from a large and a small deflection.", posterior=posterior,
        world_steps=123456, seconds={"scan": 1.25, "fits": 2.5},
    )  # fmt: skip


# ---- where ----------------------------------------------------------------------------------------------------------


def test_phases_follow_the_force(tmp_path: Path) -> None:
    """Rest, loading, holding, release and the open gripper are told by the force and by the contact alone."""
    _, recorded = probed(tmp_path / "case", 1)
    found = phases(recorded[0])
    for at, name in ((3, "without force"), (20, "loading"), (40, "hold"), (60, "release"), (85, "gripper open")):
        assert set(found[at - 3 : at + 4]) == {name}
    assert set(found[OPEN]) == {"gripper open"} and (found == "gripper open").sum() == 30


def test_heat_and_shares_equal_the_misfit_put_in(tmp_path: Path) -> None:
    """Windows and parts hold the root mean square of what was put in; the worst recording and window are named."""
    case, recorded = probed(tmp_path / "case")
    put_in = sizes()
    where = locate(case, recorded, SIGMA, missed(recorded, put_in))
    at = np.clip(np.searchsorted(where.edges, recorded[0].t, side="right") - 1, 0, where.heat.shape[1] - 1)
    for w in range(where.heat.shape[1]):
        np.testing.assert_allclose(where.heat[:, w], np.sqrt((put_in[:, at == w] ** 2).mean(axis=1)))
    labels = {kind: np.concatenate(own) for kind, own in parts_of(case, recorded).items()}
    flat = put_in.ravel()
    for share in where.shares:
        own = labels[share.by] == share.part
        assert share.samples == own.sum()
        np.testing.assert_allclose(share.ratio, np.sqrt((flat[own] ** 2).mean()))
    by = {(s.by, s.part): s for s in where.shares}
    np.testing.assert_allclose(by["phase", "gripper open"].ratio, math.sqrt((16 + 64 + 16) / 3))
    assert by["direction", "towards -x"].ratio == pytest.approx(2.0)
    assert by["direction", "towards +x"].ratio == pytest.approx(1.0)
    assert where.trajectories == (1,) and where.torque is None and where.joints == ()
    assert [w[0] for w in where.windows] == [1] and where.windows[0][1:] == pytest.approx((1.4, 1.98), abs=0.13)
    assert where.regime.startswith("with the gripper open, on pushes towards -x")


def test_noise_alone_is_nowhere(tmp_path: Path) -> None:
    """A misfit of the noise's size names no recording, window, joint or part; noise may differ number by number."""
    case, recorded = probed(tmp_path / "case")
    put_in = sizes()
    seen = SIGMA * put_in[:, :, None]
    turns = np.where(np.arange(SAMPLES) % 2, -1.0, 1.0)
    where = locate(case, recorded, seen, missed(recorded, put_in * turns), np.array([SPRING]))
    np.testing.assert_allclose(where.heat, 1.0)
    assert (where.trajectories, where.windows, where.joints) == ((), (), ())
    assert where.regime == "nowhere above 1.3 times the noise" and max(s.ratio for s in where.shares) < 1.01


def test_lengths_may_differ_and_planes_are_left_out(tmp_path: Path) -> None:
    """Past a recording's end there is no misfit; channels without noise do not count."""
    case, recorded = probed(tmp_path / "case", 2)
    output = missed(recorded, np.full((2, SAMPLES), 3.0))
    cut = {name: getattr(recorded[1], name)[:50] for name in ("t", "input", "output", "contact")}
    output[:, :, [1, 4]] = 7.0
    planar = SIGMA * np.array([1, 0, 1, 1, 0, 1])
    where = locate(case, [recorded[0], replace(recorded[1], **cut)], planar, output)
    np.testing.assert_allclose(where.heat[0], 3.0)
    np.testing.assert_allclose(where.heat[1, :8], 3.0)
    assert np.isnan(where.heat[1, 9:]).all() and where.regime == "everywhere alike"


def test_regime_names_parts_beyond_the_rest_of_their_kind() -> None:
    """Phases are joined, of the other kinds the strongest part is named; few samples and mere noise do not count."""
    shares = [
        Share("phase", "loading", 1.0, 50), Share("phase", "release", 3.0, 30), Share("phase", "gripper open", 4.0, 30),
        Share("phase", "hold", 40.0, 3), Share("speed", "low", 1.0, 50), Share("speed", "medium", 2.4, 50),
        Share("speed", "high", 3.0, 50), Share("amplitude", "small", 2.0, 50), Share("amplitude", "large", 2.1, 50),
        Share("direction", "upwards", 1.2, 50), Share("direction", "downwards", 0.5, 50),
    ]  # fmt: skip
    assert regime(shares[:3] + shares[4:]) == "during release and with the gripper open, at high speed"
    assert "holding" not in regime(shares)


def test_torque_is_what_moves_the_grasp_point(tmp_path: Path) -> None:
    """A torque's response is that of a stick on a spring; the torque of a misfit is displacement K / lever, shrunk."""
    case, recorded = probed(tmp_path / "case")
    force = np.array([0.02, 0.05, -0.01])
    lever = 0.4 * case.axis[0]
    still = replace(case, gravity=0.0)
    moved = resting(still, lambda phi: -SPRING * phi, lambda _: force)
    response = grasp_response(case, recorded[0], np.array([SPRING]))
    np.testing.assert_allclose(response @ np.cross(lever, force), moved, atol=1e-3 * np.linalg.norm(moved))
    across = np.cross(case.axis[0], [0.0, 0.0, 1.0])
    across *= 0.005 / np.linalg.norm(across)
    output = np.stack([r.output for r in recorded])
    output[:, :, :3] -= across
    torque, noise = joint_torque(case, recorded, SIGMA, output, np.array([SPRING]))
    shrunk = 1.0 + 0.01 * 2 / 3  # ridge over the two directions in which a stick can be moved
    np.testing.assert_allclose(torque, 0.005 * SPRING / 0.4 / shrunk, rtol=1e-9)
    windows = np.diff(np.linspace(0, 1.98, 17)).mean() / case.dt
    np.testing.assert_allclose(noise, math.sqrt(2.0 / windows) * 1e-3 * SPRING / 0.4 / shrunk, rtol=0.05)
    where = locate(case, recorded, SIGMA, output, np.array([SPRING]))
    assert where.joints == (0,) and where.torque is not None and where.torque.shape == (3, 1)
    share = next(s for s in where.shares if s.by == "joint")
    assert share.part == "0: stick" and share.ratio == pytest.approx(torque[0, 0] / noise[0, 0])


def test_noise_of_the_force_is_added_to_the_sensors() -> None:
    """Without a colour the noise is the channels' own; with one its variance comes on top."""
    import torch

    class Colour:
        def variance(self, shape):
            return torch.full((2, *shape), 3.0, dtype=torch.float64)

    class Stub:
        sigma, colour, measured = torch.tensor([0.1, 0.2]), None, torch.zeros(2, 5, 2)

    np.testing.assert_allclose(noise_seen(Stub), [0.1, 0.2], rtol=1e-6)
    Stub.colour = Colour()
    np.testing.assert_allclose(noise_seen(Stub), np.broadcast_to([0.2, 0.4], (2, 5, 2)), rtol=1e-6)


# ---- what is written ------------------------------------------------------------------------------------------------

FIGURES = {"gap.png", "heat.png", "before_after.png", "loops.png", "ranking.png", "parts.png"}


STATUS = {"none": "good", "effects": "warning", "unknown": "bad"}
PLAIN = {
    "none": "Nothing is missing that these data can show.|Nothing that matters here is missing.",
    "effects": "The model lacks dry friction and a mass at the tip. With that it misses what was measured by 0.21 cm"
    " instead of 1.2; the sensors alone leave 0.2.",
    "unknown": "Something is missing, and these data cannot say what.",
}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Return a diagnosis of each verdict, by name, with the folder that it was written to; one is really rendered."""
    out = {}
    for verdict in STATUS:
        folder = tmp_path_factory.mktemp(verdict)
        out[verdict] = folder, diagnosis(tmp_path_factory.mktemp("case") / "case", verdict)
        with pytest.MonkeyPatch.context() as patch:
            if verdict != "effects":
                patch.setattr("bough.learn.reports.page.png", lambda _: b"drawn elsewhere")
            write_diagnosis(*out[verdict])
    return out


@pytest.mark.parametrize("verdict", STATUS)
def test_diagnosis_is_written_whole(written, verdict: str) -> None:
    """Verdict file, figures and a page that loads nothing, whose first heading is the verdict."""
    out, made = written[verdict]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert {p.name for p in out.iterdir()} == {"verdict.json", "report.html", *FIGURES}
    assert json.loads((out / "verdict.json").read_text()) == json.loads(json.dumps(made.verdict_file()))
    assert not re.search(r"https?:|//cdn|@import|url\(|<link|src=\"[^d]", page)
    sources = re.findall(r'src="([^"]+)"', page)
    assert verdict != "effects" or all((out / name).read_bytes().startswith(b"\x89PNG") for name in FIGURES)
    assert {base64.b64decode(s.removeprefix("data:image/png;base64,")) for s in sources} == {
        (out / name).read_bytes() for name in FIGURES
    }
    assert re.search(rf'<h1 class="{STATUS[verdict]}"><span>(?:{PLAIN[verdict]})', page)
    assert f'<p class="precisely">This is what a person reads first: {verdict}' in page
    order = [
        "Key numbers",
        "Go on",
        "The motion",
        "heat.png",
        "ranking.png",
        "parts.png",
        "Exact values",
        "Fitted values",
    ]
    assert [page.index(part) for part in order] == sorted(page.index(part) for part in order)
    for part in ("base model", "plastic_set@0", "not computed", "812", "123,456", "scan 1.2, fits 2.5"):
        assert part in page


def test_first_screen_says_what_to_do(written) -> None:
    """Gap, place and next probe always; parameters and rivals with effects; the nearest name with unknown alone."""
    first = {}
    for verdict, (out, made) in written.items():
        page = (out / "report.html").read_text(encoding="utf-8")
        first[verdict] = page[: page.index("</table>")]
        for part in ("1.23 cm", "0.214 cm", "0.198 cm", "Recording 2,", "Release it from a large"):
            assert part in first[verdict]
        p_value, said = ("0.0204", "Above 0.01") if verdict == "none" else ("0.00204", "Below 0.01")
        exact = page[page.index("<summary>Exact values") :]
        assert p_value in exact and said in exact and p_value not in first[verdict]
        assert ("97 %" in exact[: exact.index("</table>")]) == (verdict != "none")
        assert made.where.regime in first[verdict] and "recording 2 (run_1.csv)" in first[verdict]
    for part in ("dry_friction@0 torque<", "0.211 N m", "0.189 to 0.233", "tip_mass mass<", "hysteresis_boucwen"):
        assert part in first["effects"] and part not in first["none"] and part not in first["unknown"]
    assert "plastic_set, which is not claimed" in first["unknown"]
    assert "Nearest candidate" not in first["none"] + first["effects"]


def test_a_parameter_at_its_bound_is_called_so(tmp_path: Path) -> None:
    """Say at which end of its box a parameter is, on the page and in the file, and nothing of one that is inside."""
    made = diagnosis(tmp_path / "stick", "effects")
    mass = {"mass_kg": replace(made.parameters["tip_mass"]["mass_kg"], at_bound="high")}
    made = replace(made, parameters=made.parameters | {"tip_mass": mass})
    said = {k.label: k.explanation for k in content(made, drawn=False).numbers}
    assert "0.0590, at the high end of its box" in said["tip_mass mass"]
    assert "end of its box" not in said["dry_friction@0 torque"]
    found = {e["name"]: e["parameters"] for e in made.verdict_file()["effects"]}
    assert found["tip_mass"]["mass_kg"]["at_bound"] == "high"
    assert found["dry_friction"]["torque_Nm"]["at_bound"] is None


@pytest.mark.parametrize("other", ["torque", "replay", ""])
def test_the_other_way_to_fit_is_offered(tmp_path: Path, other: str) -> None:
    """Say on the page of joints which way was taken and why, and give the command of the other where there is one."""
    fit = {"method": "replay", "reason": "errors live for 2 s", "other": other}
    shown = content(replace(diagnosis(tmp_path / "stick", "effects"), fit=fit), drawn=False)
    told = next(k for k in shown.numbers if k.label == "Fitted")
    assert told.value == "replay" and told.explanation.startswith("errors live for 2 s.")
    assert (f"The other way: --fit {other}." in told.explanation) == bool(other)
    commands = [command for command, _ in shown.commands]
    assert any(f"--fit {other} " in c for c in commands) if other else not any("--fit" in c for c in commands)


def test_joints_are_drawn_against_their_motion(tmp_path: Path) -> None:
    """A joint's case has parts by amplitude and speed, no torque, and its residual is drawn against the motion."""
    case = swing_case(tmp_path / "case", [(0.3, 0.5), (-0.2, 0.4)])
    recorded = recordings(case)
    sigma = np.array([1e-3, 1e-2])
    base = np.stack([r.output + 0.01 * np.abs(r.output[:, :1]) for r in recorded])
    best = np.stack([r.output for r in recorded])
    where = locate(case, recorded, sigma, base, np.array([1.0]))
    assert {s.by for s in where.shares} == {"amplitude", "speed"} and where.torque is None
    assert "large amplitude" in where.regime
    (out := tmp_path / "out").mkdir()
    made = replace(
        diagnosis(tmp_path / "stick", "unknown"), case=case, recordings=recorded, sigma=sigma, where=where,
        gap=Gap(0.01, 0.002, 0.001, "rad", (1,)), base_output=base, best_output=best,
    )  # fmt: skip
    page = write_diagnosis(out, made).read_text(encoding="utf-8")
    assert (out / "motion.png").exists() and not (out / "loops.png").exists() and "0.573 deg" in page


# ---- figures --------------------------------------------------------------------------------------------------------


def test_figures_draw_the_numbers_given() -> None:
    """Heat, bars and loops hold what they were given; names that are too long lose their middle."""
    heat = np.array([[1.0, 8.0], [2.0, np.nan]])
    drawn = figures.heat_figure(heat, np.ones((2, 2)), np.array([0.0, 1.0, 2.0]), titles=["a", "b" * 60], noise=0.1)
    mesh = drawn.axes[0].collections[0].get_array()
    assert mesh.mask.tolist() == [[False, False], [False, True]] and mesh.max() == 8.0
    scales = [((0.5, 20.0), 1.0, 1.0), ((0.5, 20.0), 1e-9, 0.5), ((1e-9, 20.0), 1e-9, 0.02), ((0.1, 0.2), 50.0, 0.2)]
    assert [figures.heat_scale(np.array(shares), noise)[0] for shares, noise, _ in scales] == [
        low for *_, low in scales
    ]
    assert [len(t.get_text()) for t in drawn.axes[0].get_yticklabels()] == [1, figures.LONGEST]
    ranks = figures.ranking_figure(["x", "y + z", ""], np.array([0.0, 12.0, 400.0]), np.array([0.9, 0.5, 0.0]))
    assert [p.get_width() for p in ranks.axes[0].patches] == [0.0, 12.0, 400.0]
    assert [t.get_text() for t in ranks.axes[0].texts] == ["preferred, 90% explained", "50% explained", "0% explained"]
    gap = figures.gap_figure(3.0, 2.0, 1.0, unit="cm")
    assert [p.get_width() for p in gap.axes[0].patches] == [3.0, 2.0, 1.0]
    repeated = figures.gap_figure(3.0, 2.0, 1e-6, unit="cm", scatter=1.9)
    assert [p.get_width() for p in repeated.axes[0].patches] == [3.0, 2.0, 1e-6, 1.9]
    force, moved = HISTORY[:, None] * [0.0, -0.6, 0.8], HISTORY[:, None] * [0.0, -0.06, 0.08]
    loops = figures.loops_figure([force], [moved], [0.5 * moved], [2.0 * moved], titles=["run"])
    for line, factor in zip(loops.axes[0].lines, (10.0, 5.0, 20.0), strict=True):
        np.testing.assert_allclose(line.get_xydata(), np.column_stack([factor * HISTORY, HISTORY]), atol=1e-9)


def test_units_are_those_that_people_read() -> None:
    """Metres in centimetres, angles in degrees, everything else as it is, spelt out."""
    assert readable("m") == (100.0, "cm") and readable("rad")[1] == "deg" and readable("m_per_s") == (1.0, "m/s")


def test_parameters_are_named_without_units() -> None:
    """Leave the unit out of a name where it stands beside it, and keep two names apart that differ by it alone."""
    assert bare("dry_friction@0 torque_Nm") == "dry_friction@0 torque" and bare("stiffness limb") == "stiffness limb"
    assert bare("dry_friction@0 stribeck") == "dry_friction@0 stribeck"
    assert bare("dry_friction@0 stribeck_radps") == "dry_friction@0 stribeck rate"
