"""Training at the command line: what is refused in one line, and a run in a forest of a diagnosed branch's wood."""

import json
from pathlib import Path

import numpy as np
import yaml
from bough.sim.effects import effect_of
from oracles import json_page
from oracles.contact_case import LAWS
from oracles.oscillator import write_case

TINY = ("--preset", "cpu", "--device", "cpu", "--num-envs", 12)
#: Laws besides friction and a tip mass, and the joint of each: with them the kernel is one that other tests have.
OTHERS = {"quadratic_drag": None, "wind_gust": None, "cubic_stiffness": 1, "plastic_set": 1}
SEGMENTS = [
    {"name": "branch", "stiffness_Nmprad": 74.2, "damping_Nmsprad": 1.31, "length_m": 0.52, "radius_base_m": 0.014,
     "radius_tip_m": 0.012},
    {"name": "twig", "stiffness_Nmprad": 15.1, "damping_Nmsprad": 0.27, "length_m": 0.41, "radius_base_m": 0.010,
     "radius_tip_m": 0.008},
]  # fmt: skip


def write_branch(effects=(), segments=SEGMENTS) -> None:
    """Write a model.yaml as `bough diagnose` does."""
    content = {"format": "branch-model/1", "name": "branch_7", "segments": segments, "effects": list(effects)}
    Path("model.yaml").write_text(yaml.safe_dump(content))


def whole(name: str) -> dict[str, float]:
    """Return all parameters of a law that `LAWS` has: its own, the others neutral."""
    return {p.name: p.neutral for p in effect_of(name).law("branch").parameters} | LAWS[name]


def settings(run: Path) -> dict:
    """Return the task's settings of a run folder."""
    return json.loads((run / "config.json").read_text())["task"]["settings"]


def test_bad_commands_are_refused(bough, tmp_path):
    """Zero worlds, a run that is there already, no run: one line, exit code 2, nothing written or changed."""
    out = tmp_path / "run"
    bough("train", "powerline", "--out", out, "--num-envs", 0).refused("--num-envs", "1 or more")
    bough("evaluate", out).refused("no such folder")
    assert not out.exists()
    out.mkdir()
    (out / "config.json").write_text("{}")
    bough("train", "powerline", "--out", out).refused("a run", "--resume")
    assert [p.name for p in out.iterdir()] == ["config.json"] and (out / "config.json").read_text() == "{}"


def test_models_that_no_worlds_can_be_of(inside, tmp_path):
    """No file, a case of joints, no sizes, wood too stiff to push, a faulty effect; nothing is written."""

    def refused(*words, model="model.yaml"):
        inside("train", "powerline", *TINY, "--model", model, "--out", "run").refused(*words)
        assert not Path("run").exists()

    refused("model.yaml", "no such file")
    write_case(tmp_path / "joints", [(0.5, 0.0), (-0.2, 1.0)])
    refused("meta.yaml", "line 1", "joint-gap-case/1", "branch-model/1", model="joints/meta.yaml")
    write_branch(segments=[{k: v for k, v in s.items() if not k.endswith("_m")} for s in SEGMENTS])
    refused("model.yaml", "no length_m", "bough diagnose")
    write_branch(segments=[s | {"stiffness_Nmprad": 1e4} for s in SEGMENTS])
    refused("firm", "softer")
    write_branch([{"name": "dry_friction", "joint": 7, "parameters": {"torque_Nm": 0.21}}])
    refused("model.yaml", "joint", "7")


def test_a_run_among_branches_with_effects(bough, tmp_path):
    """Train and test in trees that have a diagnosed branch's laws, such as friction; a delay is the measurement's."""
    others = [{"name": name, "joint": joint, "parameters": whole(name)} for name, joint in OTHERS.items()]
    write_branch([
        *others[:2],
        {"name": "dry_friction", "joint": 1, "parameters": {"torque_Nm": 0.21}},
        {"name": "tip_mass", "joint": None, "parameters": {"mass_kg": 0.08}},
        {"name": "time_delay", "joint": None, "parameters": {"lag_s": 0.02}},
        *others[2:],
    ])  # fmt: skip
    out = tmp_path / "run"
    done = bough("train", "powerline", *TINY, "--iterations", 1, "--model", "model.yaml", "--out", out)
    assert done.code == 0 and "left out: time_delay: of the measurement" in done.err, done.err
    spring = SEGMENTS[1]["stiffness_Nmprad"]
    expected = [["tip_mass", "mass_kg", 0.08], ["tip_mass", "aside_x_m", 0.0], ["tip_mass", "aside_y_m", 0.0],
                ["tip_mass", "spread", 0.0],
                ["dry_friction", "torque_Nm", 0.21 / spring],
                *(["dry_friction", *rest] for rest in (["bend_rad", 5e-4], ["gradual", 0.0], ["stribeck", 0.0],
                                                       ["stribeck_radps", 1.0], ["kept", 0.0],
                                                       ["load", 0.0]))]  # fmt: skip
    given = settings(out)["scene"]["effects"]
    assert [row for row in given if row[0] not in OTHERS] == expected
    rest = {(name, key): value for name, key, value in given if name in OTHERS}
    own = {(name, key): value for name in OTHERS for key, value in whole(name).items()}
    assert own.pop(("wind_gust", "rms_Pa")) == 0.0 and rest == own  # a course belongs to recordings
    report = (out / "report.html").read_text()
    rest = "bend_rad 0.0005, gradual 0, stribeck 0, stribeck_radps 1, kept 0, load 0"
    friction = f"dry_friction (torque_Nm over its spring {0.21 / spring:.3g}, {rest})"
    assert f"tip_mass (mass_kg 0.08, aside_x_m 0, aside_y_m 0, spread 0), {friction}" in report
    done = bough("evaluate", out, "--sets", 1, "--worlds", 8, "--device", "cpu", "--json")
    assert done.code == 0, done.err
    json_page.check("evaluate", json.loads(done.out))
    done = bough("train", "powerline", "--out", out, "--resume", "--iterations", 2, "--json")
    assert done.code == 0, done.err
    json_page.check("train", json.loads(done.out))


def test_a_run_in_a_diagnosed_branch_s_wood(bough, tmp_path):
    """Keep E = 2 K l / (pi r^4) and D / K in the run, through going on and a test; refuse to go on with others."""
    write_branch()
    out = tmp_path / "run"
    done = bough("train", "powerline", *TINY, "--iterations", 1, "--model", "model.yaml", "--out", out)
    assert done.code == 0, done.err
    k, d, length, *ends = np.array([list(s.values())[1:] for s in reversed(SEGMENTS)]).T
    radius = np.mean(ends, axis=0)
    rows = np.column_stack([radius, 2 * k * length / (np.pi * radius**4), d / k])
    kept = settings(out)
    np.testing.assert_allclose(kept["scene"]["wood"], rows, rtol=1e-12)
    assert "0.601 GPa, 0.0179 s at 9 mm; 0.86 GPa, 0.0177 s at 13 mm" in (out / "report.html").read_text()
    write_branch(segments=[s | {"stiffness_Nmprad": 30.0} for s in SEGMENTS])
    again = ("train", "powerline", "--out", out, "--resume")
    bough(*again, "--model", "model.yaml").refused("--model", "other settings", "another --out")
    Path("model.yaml").unlink()  # the run has all that it needs
    assert bough(*again, "--iterations", 2).code == 0
    assert settings(out) == kept
    tested = bough("evaluate", out, "--sets", 1, "--worlds", 12, "--device", "cpu", "--baselines")
    assert tested.code == 0, tested.err
    assert (out / "evaluation.json").exists()
    written = bough("export", out, "--out", tmp_path / "policy")
    assert written.code == 0 and "powerline, iteration 2" in written.out, written.err
    said = json.loads((tmp_path / "policy" / "policy.json").read_text())
    assert said["observation"]["size"] == 88 and said["observation"]["columns"]["occlusion"] == 87
    bough("export", tmp_path / "policy", "--out", tmp_path / "other").refused("config.json")
    assert sorted(p.name for p in tmp_path.iterdir() if p.name.startswith("other")) == []
    page = (out / "evaluation.md").read_text()
    assert page in tested.out and "| arm and arm " in page and "many pairs %: 0.0" in page
    every = bough("evaluate", out, "--sets", 1, "--worlds", 12, "--device", "cpu", "--baselines", "--all-scenes")
    assert every.code == 0, every.err
    found = json.loads((out / "evaluation_all_scenes.json").read_text())
    assert found["scenes"]["any %"] > 50.0 and (out / "evaluation_all_scenes.md").read_text() in every.out
    assert (out / "evaluation.md").read_text() == page
