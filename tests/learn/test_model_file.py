"""``model.yaml``: written, read, refused where it cannot be, and simulated by the command line."""

import numpy as np
import pytest
import torch
import yaml
from bough.cli import main
from bough.learn.acting import Acting
from bough.learn.model_file import BranchModel, read_model, write_model
from bough.learn.plant_branch import Unknowns
from bough.learn.rollout import Rollout, recordings
from bough.sim.errors import InputError
from oracles.effect_case import stick_case

EFFECTS = (Acting("dry_friction", 0, {"torque_Nm": 0.3}), Acting("tip_mass", None, {"mass_kg": 0.1}))
MODEL = BranchModel("found", ("stick",), np.array([20.0]), np.array([1 / 3]), EFFECTS)


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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "branch-model/2"}, "format"),
        ({"extra": 1}, "a key that this format does not have"),
        ({"segments": []}, "segments"),
        ({"effects": [{"name": "friction", "joint": 0, "parameters": {}}]}, "'friction'"),
        ({"effects": [{"name": "dry_friction", "joint": 0, "parameters": {}}]}, "no torque_Nm"),
        ({"effects": [{"name": "dry_friction", "joint": 1, "parameters": {"torque_Nm": 1.0}}]}, "0 to 0"),
        ({"effects": [{"name": "dry_friction", "joint": 0, "parameters": {"torque_Nm": "much"}}]}, "much"),
        ({"effects": [{"name": "tip_mass", "joint": None, "parameters": {"mass_kg": 1.0, "m": 2.0}}]}, "'m'"),
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
    np.testing.assert_allclose(held - held[:1], wanted, atol=1e-6)  # float32 of a metre
    assert np.abs(wanted).max() > 0.02


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
