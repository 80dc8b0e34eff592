"""``model.yaml`` from the outside: what a diagnosis has found goes into the next identification and into a forest."""

import json
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from bough.learn.replay.simulated_case import Experiment, random_branch, write_simulated_case
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from bough.learn.systems.model_file import BranchModel, write_model
from oracles.oscillator import write_case

SPRING, DAMPER = 40.0, 0.5
FRICTION = {
    "torque_Nm": 0.5,
    "bend_rad": 0.001,
    "gradual": 0.0,
    "stribeck": -0.5,
    "stribeck_radps": 0.2,
    "kept": 0.5,
    "load": 0.02,
}
MASS = {"mass_kg": 0.15, "aside_x_m": 0.02, "aside_y_m": 0.0, "spread": 0.0}
EFFECTS = (
    Acting("dry_friction", 0, FRICTION),
    Acting("tip_mass", None, MASS),
)
WARNING = "left out: dry_friction@0, tip_mass: trees have springs and dampers alone\n"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder with the case of a stick that has friction and a mass at its tip, and its model.yaml."""
    folder = tmp_path_factory.mktemp("made")
    truth = {"stiffness": np.array([SPRING]), "damping": np.array([DAMPER])}
    experiment = Experiment(samples=60, rate=25.0, noise=0.01)
    case = write_simulated_case(folder / "case", random_branch(np.random.default_rng(3), 1), truth, experiment,
                                trajectories=5, seed=3, unknowns=Unknowns(effects=EFFECTS))  # fmt: skip
    size = np.column_stack([case.length, case.radius])
    springs = np.array([SPRING]), np.array([DAMPER])
    write_model(folder / "model.yaml", BranchModel("stick", case.segment_name, *springs, EFFECTS, size))
    return folder


@pytest.fixture
def here(made, tmp_path):
    """Return a folder with a copy of case and model that a test may spoil; the test runs in it."""
    return Path(shutil.copytree(made, tmp_path, dirs_exist_ok=True))


def rewrite(change):
    """Change the content of model.yaml in the present folder."""
    path = Path("model.yaml")
    content = yaml.safe_load(path.read_text())
    change(content)
    path.write_text(yaml.safe_dump(content, sort_keys=False))


def test_known_effects_act_while_springs_are_learnt(bough, here):
    """Explain the motion to its noise, find the true spring and damper, and say which effects act."""
    done = bough("identify", "case", "--particles", 24, "--model", "model.yaml", "--out", "out")
    assert done.code == 0 and done.err == "", done.out + done.err
    report = json.loads(Path("out/report.json").read_text())
    assert report["misfit_over_noise"] < 1.3
    # Noise of 1 % in 240 points of each channel; without the effects the damper comes out at twice its value.
    for name, true in (("stiffness twig", SPRING), ("damping twig", DAMPER)):
        assert report["parameters"][name]["median"] == pytest.approx(true, rel=0.01)
    assert report["settings"]["effects"] == [
        {"name": "dry_friction", "joint": 0, "parameters": FRICTION},
        {"name": "tip_mass", "joint": None, "parameters": MASS},
    ]
    page = Path("out/report.html").read_text()
    said = ", ".join(f"{name} {value:g}" for name, value in FRICTION.items())
    assert page.count(f"dry_friction@0 ({said}), tip_mass (mass_kg 0.15, aside_x_m 0.02, aside_y_m 0, spread 0)") == 1


def test_models_that_do_not_fit_the_case(bough, here):
    """Refuse another branch's model, and one of a branch beside joints, in one line; nothing is written or left."""
    write_case(Path("joints"), [(0.5, 0.0), (-0.2, 1.0)])
    done = bough("identify", "joints", "--model", "model.yaml", "--out", "out")
    done.refused("model.yaml", "format", "branch-model/1", "joint-model/1")
    rewrite(lambda content: content["segments"][0].update(name="limb"))
    done = bough("identify", "case", "--model", "model.yaml", "--out", "out")
    done.refused("model.yaml", "segments", "limb", "the case's, base first: twig")
    assert not Path("out").exists() and not Path(".out.unfinished").exists()


def stiffness_by_hand(tree):
    """K of every ball joint of an MJCF file by E = 2 K l / (pi r^4) of the stick, and K itself; both [joints]."""
    stick = yaml.safe_load(Path("model.yaml").read_text())["segments"][0]
    radius = (stick["radius_base_m"] + stick["radius_tip_m"]) / 2
    young = 2 * SPRING * stick["length_m"] / (np.pi * radius**4)
    model = mujoco.MjModel.from_xml_path(str(tree))
    first = [int(model.body_geomadr[b]) for b in model.jnt_bodyid]
    r, half = model.geom_size[first, :2].T
    return young * np.pi * r**4 / (4 * half), model.jnt_stiffness, model.dof_damping[::3]


def test_a_forest_of_the_model(bough, here):
    """Give C MuJoCo the stick's E and D / K in every link, and say in one line that its effects are left out."""
    done = bough("forest", "--model", "model.yaml", "--count", 2, "--picture-width", 0, "--out", "out")
    assert done.code == 0 and done.err == f"bough: warning: model.yaml: {WARNING}"
    wanted, found, damping = stiffness_by_hand("out/tree_0001.xml")
    np.testing.assert_allclose(found, wanted, rtol=1e-6)  # lengths and radii are printed with fewer digits
    np.testing.assert_allclose(damping, DAMPER / SPRING * found, rtol=1e-9)
    listed = json.loads(Path("out/forest.json").read_text())
    assert listed["options"]["model"] == "model.yaml" and listed["options"]["stiffness"] is None


def test_a_forest_of_a_model_that_is_not_claimed(bough, here):
    """Say in one line that the springs stand beside effects that the diagnosis does not claim."""
    rewrite(lambda content: content.update(claimed=False))
    done = bough("forest", "--model", "model.yaml", "--count", 1, "--picture-width", 0, "--out", "out")
    first = "bough: warning: model.yaml: springs beside effects that the diagnosis does not claim\n"
    assert done.code == 0 and done.err == f"{first}bough: warning: model.yaml: {WARNING}"


def test_a_forest_of_a_diagnosis_posterior(bough, here):
    """Take springs and dampers from a posterior with columns of effects, and name what is left out."""
    stick = yaml.safe_load(Path("model.yaml").read_text())["segments"][0]
    names = ["stiffness twig", "damping twig", "dry_friction@0 torque_Nm", "tip_mass mass_kg"]
    np.savez(
        "posterior.npz", names=np.array(names), units=np.array(["N m/rad", "N m s/rad", "N m", "kg"]),
        particles=np.array([[SPRING, DAMPER, 0.5, 0.15]]), segment_name=np.array(["twig"]),
        segment_length_m=np.array([stick["length_m"]]),
        segment_radius_m=np.array([[stick["radius_base_m"], stick["radius_tip_m"]]]),
    )  # fmt: skip
    done = bough("forest", "--posterior", "posterior.npz", "--count", 2, "--picture-width", 0, "--out", "out")
    assert done.code == 0 and done.err == f"bough: warning: posterior.npz: {WARNING}"
    wanted, found, _ = stiffness_by_hand("out/tree_0001.xml")
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


def test_models_that_no_forest_can_be_of(bough, here):
    """Refuse a model beside other springs, one without sizes and one without a damper; nothing is written."""
    both = bough("forest", "--model", "model.yaml", "--stiffness", "beam", "--out", "out")
    both.refused("--model", "--stiffness beam", "one of the two")
    rewrite(lambda content: content["segments"][0].update(damping_Nmsprad=0.0))
    bough("forest", "--model", "model.yaml", "--out", "out").refused("model.yaml", "twig damping_Nmsprad", "found 0")
    rewrite(lambda content: [content["segments"][0].pop(k) for k in ("length_m", "radius_base_m", "radius_tip_m")])
    bough("forest", "--model", "model.yaml", "--out", "out").refused("model.yaml", "no length_m", "bough diagnose")
    assert not Path("out").exists()
