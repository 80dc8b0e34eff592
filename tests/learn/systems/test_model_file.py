"""``model.yaml``: written, read, refused where it cannot be, simulated and identified with."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml
from bough.cli.main import main
from bough.learn.inference.identify import Settings, identify
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.replay.simulated_case import Experiment, random_branch, write_simulated_case
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from bough.learn.systems.model_file import BranchModel, check_fits, read_model, write_model
from bough.sim.base.errors import InputError
from oracles.effect_case import stick_case

FRICTION = {
    "torque_Nm": 0.3,
    "bend_rad": 0.002,
    "gradual": 0.5,
    "stribeck": -0.4,
    "stribeck_radps": 0.7,
    "kept": 0.6,
    "load": 0.1,
}
MASS = {"mass_kg": 0.1, "aside_x_m": 0.01, "aside_y_m": -0.02, "spread": 0.3}
EFFECTS = (Acting("dry_friction", 0, FRICTION), Acting("tip_mass", None, MASS))
MODEL = BranchModel("found", ("stick",), np.array([20.0]), np.array([1 / 3]), EFFECTS)
QUICK = Settings(particles=16, iterations=20)
SIZE = np.array([[0.5, 0.012, 0.010]])  # of the stick
STICK = {"name": "stick", "stiffness_Nmprad": 20.0, "damping_Nmsprad": 0.5}
SIZED = {**STICK, "length_m": 0.5, "radius_base_m": 0.012, "radius_tip_m": 0.01}


def push():
    """Return one push that is let go, [T, 3]."""
    t = np.arange(60) * 0.02
    return np.where(t < 0.8, np.interp(t, [0.1, 0.4], [0, 1]), 0.0)[:, None] * np.array([2.0, -3.0, 1.5])


def test_written_is_read(tmp_path):
    """Keep every number to the last bit."""
    write_model(tmp_path / "model.yaml", MODEL)
    again = read_model(tmp_path / "model.yaml")
    assert (again.stiffness == MODEL.stiffness).all() and (again.damping == MODEL.damping).all()
    assert again.effects == MODEL.effects and (again.name, again.segment_name) == ("found", ("stick",))
    assert again.size is None and again.claimed
    written = (tmp_path / "model.yaml").read_text()
    assert "claimed" not in written and again.held_out is None and "held_out" not in written
    write_model(tmp_path / "model.yaml", replace(MODEL, held_out=("run_1.csv",)))
    assert read_model(tmp_path / "model.yaml").held_out == ("run_1.csv",)
    write_model(tmp_path / "model.yaml", replace(MODEL, claimed=False))
    assert not read_model(tmp_path / "model.yaml").claimed
    write_model(tmp_path / "model.yaml", replace(MODEL, size=SIZE / 3))
    assert (read_model(tmp_path / "model.yaml").size == SIZE / 3).all()


def test_refinements_may_be_left_out(tmp_path):
    """Take the neutral value of a parameter that only refines an effect, as files of earlier versions do."""
    hysteresis = {"name": "hysteresis_boucwen", "joint": 0, "parameters": {"share": 0.3, "yield_rad": 0.05}}
    content = {"format": "branch-model/1", "name": "found", "segments": [STICK], "effects": [hysteresis]}
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(content))
    known = read_model(tmp_path / "model.yaml").effects[0].known
    refined = {"exponent": 2.0, "loading": 1.0, "separate": 0.0, "twist": 1.0, "kept": 1.0}
    refined |= {"second_share": 0.0, "second_yield_rad": 1.0}
    assert known == {"share": 0.3, "yield_rad": 0.05} | refined


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "branch-model/2"}, "format"),
        ({"extra": 1}, "a key that this format does not have"),
        ({"segments": []}, "segments"),
        ({"held_out": []}, "held_out"),
        ({"effects": [{"name": "friction", "joint": 0, "parameters": {}}]}, "'friction'"),
        ({"effects": [{"name": "dry_friction", "joint": 0, "parameters": {}}]}, "no torque_Nm"),
        ({"effects": [{"name": "dry_friction", "joint": 1, "parameters": {"torque_Nm": 1.0}}]}, "0 to 0"),
        ({"effects": [{"name": "dry_friction", "joint": 0, "parameters": {"torque_Nm": "much"}}]}, "much"),
        ({"effects": [{"name": "tip_mass", "joint": None, "parameters": {"mass_kg": 1.0, "m": 2.0}}]}, "'m'"),
        ({"effects": [{"name": "tip_mass", "joint": 0, "parameters": {"mass_kg": 1.0}}]}, "the whole branch"),
        ({"effects": [{"name": "dry_friction", "parameters": {"torque_Nm": 1.0}}]}, "no joint; allowed: a joint, 0"),
        ({"effects": [{"name": "dry_friction", "joint": 0, "parameters": {"torque_Nm": -1.0}}]}, "0 or more"),
        ({"effects": [{"name": "tip_mass", "parameters": {"mass_kg": 1.0}}] * 2}, "tip_mass a second time"),
        ({"segments": [STICK, STICK]}, "stick a second time"),
        ({"segments": [{**STICK, "length_m": 0.5}]}, "no radius_base_m"),
        ({"segments": [SIZED, {**STICK, "name": "twig"}]}, "no length_m; allowed: length_m, radius_base_m, radius"),
        ({"segments": [{**SIZED, "radius_tip_m": 10.0}]}, "less than the length, in metres"),
        ({"segments": [{**SIZED, "length_m": 500.0}]}, "in metres"),
    ],
)
def test_faulty_models_are_one_line(tmp_path, change, words):
    """Name the file and the key, what was found and what is allowed."""
    path = tmp_path / "model.yaml"
    write_model(path, MODEL)
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **change}))
    with pytest.raises(InputError) as e:
        read_model(path)
    assert "model.yaml" in str(e.value) and words in str(e.value) and "\n" not in str(e.value)


def test_simulate_takes_the_model(tmp_path, capsys):
    """Write what the rollout predicts, with bodies that hold the same grasp point."""
    stick_case(tmp_path / "case", [push(), -push()])
    write_model(tmp_path / "model.yaml", MODEL)
    arguments = ["simulate", str(tmp_path / "case"), "--model", str(tmp_path / "model.yaml"), "--out", "out"]
    assert main(arguments) == 0
    written = np.load("out/trajectory.npz")
    case = stick_case(tmp_path / "case", [push(), -push()])
    predicted = Rollout(case, recordings(case), 1, unknowns=Unknowns(effects=EFFECTS))(torch.tensor([[20.0, 1 / 3]]))
    wanted = predicted[0, :, :, :3].double().numpy().swapaxes(0, 1)
    np.testing.assert_array_equal(written["grasp_displacement"], wanted)
    w, x, y, z = np.moveaxis(written["body_quat"][:, :, 0], -1, 0)
    axis = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], -1)
    held = written["body_pos"][:, :, 0] + 0.4 * axis
    np.testing.assert_allclose(held - held[:1], wanted - wanted[:1], atol=1e-6)  # float32 of a metre
    assert np.abs(wanted).max() > 0.02


@pytest.mark.parametrize(
    ("named", "held"),
    [
        (("run_0.csv",), "run_0.csv"),
        (("run_0.csv", "run_1.csv"), "run_0.csv, run_1.csv"),
        (None, "run_2.csv"),
        (("of_another_case.csv",), "run_2.csv"),
        (("run_0.csv", "run_1.csv", "run_2.csv"), "run_2.csv"),
    ],
)
def test_simulate_holds_out_what_the_model_was_not_fitted_to(tmp_path, capsys, named, held):
    """Print the RMSE of the recordings that the file names; without them, or of another case, of the last one."""
    stick_case(tmp_path / "case", [push(), -push(), 0.5 * push()])
    write_model(tmp_path / "model.yaml", replace(MODEL, held_out=named))
    assert main(["simulate", str(tmp_path / "case"), "--model", str(tmp_path / "model.yaml"), "--out", "out"]) == 0
    assert f"({held}, not used in its fit)" in capsys.readouterr().out


def test_simulate_refuses_a_model_that_does_not_fit(tmp_path, capsys):
    """Exit with code 2 and one line: another branch's model, or a file's tree with a model."""
    stick_case(tmp_path / "case", [push()])
    write_model(tmp_path / "model.yaml", BranchModel("other", ("limb",), MODEL.stiffness, MODEL.damping))
    arguments = ["--model", str(tmp_path / "model.yaml"), "--out", "out"]
    assert main(["simulate", str(tmp_path / "case"), *arguments]) == 2
    assert "limb; allowed: the case's, base first: stick" in capsys.readouterr().err
    (tmp_path / "tree.xml").write_text("<mujoco/>")
    assert main(["simulate", str(tmp_path / "tree.xml"), *arguments]) == 2
    assert "--model" in capsys.readouterr().err


def test_sizes_tell_branches_apart(tmp_path):
    """Take a model without sizes or with the case's to four digits; refuse another branch's of the same names."""
    case = stick_case(tmp_path / "case", [push()])
    for size in (None, SIZE, SIZE * (1 + 5e-5)):
        check_fits(replace(MODEL, size=size), case, "model.yaml")
    with pytest.raises(InputError, match=r"model\.yaml: segments, stick radius_tip_m: found 0.011; .* case's, 0\.01$"):
        check_fits(replace(MODEL, size=SIZE + np.array([0, 0, 1e-3])), case, "model.yaml")


class StoppedError(Exception):
    """What stops a run."""


def stop(stage, done):
    """Stop a run when the first modes are reported."""
    raise StoppedError


@pytest.fixture(scope="module")
def plastic(tmp_path_factory):
    """Return a case of a stick whose joint yields for good, and its model."""
    folder = tmp_path_factory.mktemp("plastic")
    truth = {"stiffness": np.array([40.0]), "damping": np.array([0.5])}
    acting = (
        Acting("plastic_set", 0, {"share": 0.4, "yield_rad": 0.1, "isotropic": 0.3, "separate": 0.2, "flow_s": 0.05}),
    )
    case = write_simulated_case(folder / "case", random_branch(np.random.default_rng(3), 1), truth,
                                Experiment(samples=60, rate=25.0, noise=0.01), trajectories=4, seed=3,
                                unknowns=Unknowns(effects=acting))  # fmt: skip
    return case, BranchModel("stick", case.segment_name, truth["stiffness"], truth["damping"], acting)


def test_damage_lasts_from_one_recording_to_the_next(plastic, tmp_path):
    """Find spring and damper to a percent beside a plastic set, which makes the spring a quarter softer otherwise."""
    case, model = plastic
    write_model(tmp_path / "model.yaml", model)
    outcome = identify(case.folder, "out", QUICK, model=tmp_path / "model.yaml")
    np.testing.assert_allclose(outcome.posterior.interval()[0], [40.0, 0.5], rtol=0.01)
    assert outcome.ratio < 1.3 and outcome.settings.effects == model.effects


def test_another_model_is_not_gone_on_with(plastic, tmp_path):
    """Refuse to resume a run with a model that differs in an effect or a spring, or without one."""
    case, model = plastic
    names = ("first.yaml", "spring.yaml", "effect.yaml")
    models = (model, replace(model, stiffness=2 * model.stiffness), replace(model, effects=()))
    for name, one in zip(names, models, strict=True):
        write_model(tmp_path / name, one)
    with pytest.raises(StoppedError):
        identify(case.folder, "out", QUICK, model="first.yaml", progress=stop)
    for other in ("spring.yaml", "effect.yaml", None):
        with pytest.raises(InputError, match=r"--resume: found an unfinished run of another case or other settings"):
            identify(case.folder, "out", QUICK, model=other, resume=True)
    with pytest.raises(StoppedError):
        identify(case.folder, "out", QUICK, model="first.yaml", resume=True, progress=stop)
