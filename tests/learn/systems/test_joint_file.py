"""``model.yaml`` of joints: written, read, refused where it cannot be, simulated and identified with."""

import numpy as np
import pytest
import yaml
from bough.cli.main import main
from bough.learn.cases.case import load_case
from bough.learn.inference.identify import Settings, identify
from bough.learn.replay.recording import recordings
from bough.learn.systems.acting import Acting
from bough.learn.systems.choose import system_of
from bough.learn.systems.joint_file import JointModel
from bough.learn.systems.model_file import model_of, write_model
from bough.sim.base.errors import InputError
from oracles.oscillator import decay, write_case

FRICTION = {"torque_Nm": 0.3, "bend_rad": 0.002, "gradual": 0.5, "stribeck": 0.2, "stribeck_radps": 0.7, "load": 0.1}
SPRING, DAMPER = {"name": "stiffness hinge", "value": 80.0, "unit": "N m/rad"}, "damping hinge"
MODEL = JointModel("decay", "replay", (("hinge", "revolute"),), ("stiffness hinge", "damping hinge"),
                   ("N m/rad", "N m s/rad"), np.array([80.0, 4.5 / 3]))  # fmt: skip
RUNS = [(0.5, 0.0), (-0.2, 1.0), (0.3, -2.0), (0.4, 1.0)]


@pytest.fixture
def case(tmp_path):
    """Return a case of free decays without noise; K = 80 N m/rad, D = 1.5 N m s/rad, J = 2 kg m^2."""
    return load_case(write_case(tmp_path / "case", RUNS))


def slide(folder):
    """Write and load the same case with a joint that slides."""
    write_case(folder, RUNS[:2])
    meta = yaml.safe_load((folder / "meta.yaml").read_text())
    meta["mechanism"]["joints"][0]["type"] = "prismatic"
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return load_case(folder)


def test_written_is_read(tmp_path, case):
    """Keep every number to the last bit, with effects and without."""
    for effects in ((), (Acting("dry_friction", 0, FRICTION),)):
        write_model(tmp_path / "model.yaml", JointModel(**{**vars(MODEL), "effects": effects}))
        again = model_of(tmp_path / "model.yaml", case)
        assert (again.values == MODEL.values).all() and again.effects == effects
        assert (again.names, again.units, again.fit, again.claimed) == (MODEL.names, MODEL.units, "replay", True)


#: Units of friction along a slide.
UNITS = {"torque_Nm": "N", "bend_rad": "m", "gradual": "1", "stribeck": "1", "stribeck_radps": "m/s", "load": "1"}


def test_a_joint_that_slides_has_newtons_and_metres(tmp_path):
    """Give a slide's spring, damper and friction N/m, N s/m, N and m, in the system and in the file."""
    case = slide(tmp_path / "case")
    from bough.learn.systems.branch import Unknowns

    system = system_of(case, Unknowns(effects=(Acting("dry_friction", 0),)))
    assert [p.unit for p in system.parameters] == ["N/m", "N s/m", "N", "m", "1", "1", "m/s", "1"]
    names, units = MODEL.names, ("N/m", "N s/m")
    model = JointModel("cart", "replay", (("hinge", "prismatic"),), names, units, MODEL.values,
                       (Acting("dry_friction", 0, FRICTION),))  # fmt: skip
    write_model(tmp_path / "model.yaml", model)
    content = yaml.safe_load((tmp_path / "model.yaml").read_text())
    assert content["effects"][0]["units"] == UNITS
    assert model_of(tmp_path / "model.yaml", case).effects == model.effects
    content["effects"][0]["units"]["torque_Nm"] = "N m"
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match="found N m; allowed: N"):
        model_of(tmp_path / "model.yaml", case)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "branch-model/1"}, "joint-model/1"),
        ({"fit": "guess"}, "fit"),
        ({"extra": 1}, "a key that this format does not have"),
        (
            {"joints": [{"name": "knee", "type": "revolute"}]},
            "knee (revolute); allowed: the case's, in its order: hinge",
        ),
        ({"joints": [{"name": "hinge", "type": "prismatic"}]}, "hinge (prismatic)"),
        ({"parameters": [SPRING]}, "no damping hinge"),
        ({"parameters": [SPRING, SPRING]}, "stiffness hinge a second time"),
        ({"parameters": [{**SPRING, "name": "mass hinge"}]}, "'mass hinge'"),
        ({"parameters": [{**SPRING, "unit": "N/m"}]}, "N/m; allowed: N m/rad"),
        ({"parameters": [{**SPRING, "value": 0.0}]}, "a number above 0"),
        ({"parameters": [{**SPRING, "value": float("nan")}]}, "value"),
        ({"effects": [{"name": "tip_mass", "parameters": {"mass_kg": 1.0}}]}, "'tip_mass'"),
        ({"effects": [{"name": "dry_friction", "joint": 1, "parameters": FRICTION}]}, "0 to 0"),
        ({"effects": [{"name": "dry_friction", "joint": 0, "parameters": {}}]}, "no torque_Nm"),
        ({"effects": [{"name": "dry_friction", "joint": 0, "parameters": FRICTION, "units": {"a": "N"}}]}, "'a'"),
    ],
)
def test_faulty_models_are_one_line(tmp_path, case, change, words):
    """Name the file and the key, what was found and what is allowed."""
    path = tmp_path / "model.yaml"
    write_model(path, MODEL)
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **change}))
    with pytest.raises(InputError) as e:
        model_of(path, case)
    assert "model.yaml" in str(e.value) and words in str(e.value) and "\n" not in str(e.value)


def test_simulate_takes_the_model(tmp_path, case, capsys):
    """Write the closed form of the decay for every recording, held out or not, and print how little is missed."""
    write_model(tmp_path / "model.yaml", MODEL)
    arguments = ["simulate", str(tmp_path / "case"), "--model", str(tmp_path / "model.yaml"), "--out", "out"]
    assert main(arguments) == 0
    written = np.load("out/trajectory.npz")
    exact = np.stack([decay(written["time"], 2.0, 80.0, 1.5, *run)[0] for run in RUNS], axis=1)
    np.testing.assert_allclose(written["measured"][..., 0], exact, atol=1e-8)
    np.testing.assert_allclose(
        written["simulated"][..., 0], exact, atol=1e-3
    )  # float32, and a tenth of a percent of phase
    assert written["channel"].tolist() == ["position hinge"]
    missed = float(capsys.readouterr().out.split("held-out RMSE ")[1].split(" rad (run_4.csv, not used")[0])
    left = written["simulated"][:, 3, 0] - written["measured"][:, 3, 0]
    assert missed == pytest.approx(np.sqrt(np.mean(left**2)), rel=5e-3)


def test_simulate_refuses_what_joints_do_not_have(tmp_path, case, capsys):
    """Exit with code 2 and one line: no model, and a part of the time."""
    write_model(tmp_path / "model.yaml", MODEL)
    assert main(["simulate", str(tmp_path / "case"), "--out", "out"]) == 2
    assert "--model model.yaml with a case of joints" in capsys.readouterr().err
    given = ["--model", str(tmp_path / "model.yaml"), "--seconds", "1", "--out", "out"]
    assert main(["simulate", str(tmp_path / "case"), *given]) == 2
    assert "--seconds" in capsys.readouterr().err


def test_known_effects_act_while_springs_are_learnt(tmp_path, case):
    """Find a damper that is less than without the friction that takes part of the swing; say nothing of the springs."""
    effects = (Acting("dry_friction", 0, {"torque_Nm": 1.0, "bend_rad": 1e-3, "gradual": 0.0}),)
    write_model(tmp_path / "model.yaml", JointModel(**{**vars(MODEL), "effects": effects}))
    assert len(recordings(case)) == 4
    settings = Settings(particles=18, iterations=10)
    found = identify(case, tmp_path / "out", settings, model=tmp_path / "model.yaml")
    assert [a.name for a in found.settings.effects] == ["dry_friction"]
    assert found.posterior.interval()[0][1] < 1.4
