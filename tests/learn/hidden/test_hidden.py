"""Cases with hidden effects as a whole: what is written, what depends on what, and that nothing of bough's is in it."""

from __future__ import annotations

import ast
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from bough.cli.hide import Hide
from bough.learn.cases.case import load_case
from bough.learn.hidden import NAMES, OUTSIDE, exam_plan, hide
from bough.learn.hidden.branch import random_branch
from bough.learn.hidden.drive import drive
from bough.learn.hidden.parts import Readings
from bough.learn.hidden.probes import Experiment, make_branch_case
from bough.learn.hidden.rig import build
from bough.learn.hidden.sizing import ratio, scaled, visible_gap
from bough.sim.base.errors import InputError
from bough.sim.effects import effects

ROOT = Path(__file__).resolve().parents[3]
#: One segment, few samples: a second a case.
SMALL = {"segments": 1, "samples": 50, "rate": 25.0, "dt": 2e-3}


def texts(folder: Path) -> dict[str, str]:
    """Return the files of a folder by name."""
    return {path.name: path.read_text() for path in sorted(folder.iterdir())}


# ---- what is written ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*NAMES, *OUTSIDE])
def test_every_effect_is_visible(tmp_path: Path, name: str) -> None:
    """Hide each name: a finite case that loads, an effect near its size that springs and dampers do not take up."""
    outside = {"outside": name} if name in OUTSIDE else {"effects": (name,)}
    answer = hide(tmp_path / "case", **outside, seed=11, noise=0.0, size=0.15, **SMALL)
    assert [e["name"] for e in answer["effects"]] == [name]
    assert 0.05 < answer["size_raw"][name] < 0.35
    assert 0.005 < answer["visible_gap"] < 1.6 * answer["size_raw"][name]
    assert answer == json.loads((tmp_path / "case_answer.json").read_text())
    case = load_case(tmp_path / "case")
    assert case.warnings == () and not list((tmp_path / "case").glob("*answer*"))
    assert all(np.isfinite(item.displacement).all() for item in case.trajectories)


def test_nothing_hidden_is_the_null_case(tmp_path: Path) -> None:
    """Write what the generator of null cases writes, bit for bit."""
    answer = hide(tmp_path / "a", seed=5, **SMALL)
    make_branch_case(tmp_path / "b", 5, **SMALL)
    assert texts(tmp_path / "a") == texts(tmp_path / "b")
    assert answer["null"] and answer["visible_gap"] == 0.0 and answer["effects"] == []


def test_seed_decides_everything(tmp_path: Path) -> None:
    """Write the same files for the same seed, and another case for another."""
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        hide(tmp_path / name, effects=("viscoelastic_sls", "force_bias"), seed=seed, **SMALL)
    first, again, other = (texts(tmp_path / name) for name in "abc")
    assert first == again and first != other
    assert (tmp_path / "a_answer.json").read_text() == (tmp_path / "b_answer.json").read_text()


def test_sensor_fault_leaves_the_motion(tmp_path: Path) -> None:
    """A bias changes the recorded force, and neither the displacement nor the branch."""
    bias = hide(tmp_path / "a", effects=("force_bias",), seed=3, noise=0.0, **SMALL)
    hide(tmp_path / "b", effects=("force_scale",), seed=3, noise=0.0, **SMALL)
    one, two = (load_case(tmp_path / name).trajectories[0] for name in "ab")
    np.testing.assert_array_equal(one.displacement, two.displacement)
    table = np.loadtxt(tmp_path / "a" / "traj_01.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[0, 1:4], bias["effects"][0]["params"]["force_N"], rtol=1e-6)


def test_refit_takes_up_springs_and_dampers() -> None:
    """Leave less than one percent of a branch that only has other springs and dampers; the start misses by 15 %."""
    experiment = Experiment(2, 2, 25.0, 60, 0.22)
    options = {"sub": 3, "wood": 0.08}
    other = scaled(experiment.branch, np.array([0.2, -0.15, 0.3, -0.3]))
    moved = drive(other, experiment.forces, 25.0, dt=2e-3, **options)
    seen = Readings(experiment.time, experiment.forces, moved.moved, moved.velocity, moved.turn)
    before = drive(experiment.branch, experiment.forces, 25.0, dt=2e-3, **options).moved
    assert ratio(moved.moved - before, moved.moved) > 0.15
    assert visible_gap(experiment, seen, options) < 0.01


def test_wood_may_be_rigid_and_the_grasp_anywhere() -> None:
    """Weld sub-links whose wood does not bend; put one grasp site on whichever sub-link is held."""
    branch = random_branch(np.random.default_rng(1), 2)
    model, data = build(branch, wood=0.0)
    assert model.nv == 6 and np.isfinite(data.qacc).all()
    for share in (0.1, 1 / 3, 0.5, 2 / 3, 1.0):
        branch.grasp_distance = share * branch.length[-1]
        _, data = build(branch)
        np.testing.assert_allclose(data.sensordata[:3], branch.grasp(), atol=1e-12)


# ---- exams -------------------------------------------------------------------------------------------------------


def test_exam_goes_round_all_names() -> None:
    """Mix 3 : 3 : 1 : 1, name every effect before one comes twice, and decide by the seed alone."""
    specs = exam_plan(160, 4)
    assert Counter(s.kind for s in specs) == {"null": 60, "single": 60, "pair": 20, "outside": 20}
    singles = Counter(s.effects[0] for s in specs if s.kind == "single")
    assert set(singles) == set(NAMES) and set(singles.values()) == {3}
    assert {s.outside for s in specs if s.kind == "outside"} == set(OUTSIDE)
    assert all(len(set(s.effects)) == 2 for s in specs if s.kind == "pair")
    assert specs == exam_plan(160, 4) != exam_plan(160, 5)
    assert len({s.seed for s in specs}) == 160


# ---- the command and bad input -----------------------------------------------------------------------------------


def test_command_says_what_it_hid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Write the case and one line."""
    command = Hide(out=tmp_path / "case", effects=("tip_mass",), segments=1, samples=40, rate=25.0)
    assert command.run() == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 and lines[0].startswith("tip_mass, ") and "case_answer.json" in lines[0]
    assert (tmp_path / "case" / "meta.yaml").is_file() and (tmp_path / "case_answer.json").is_file()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"effects": ("friction",)}, "dry_friction"),
        ({"effects": ("tip_mass", "tip_mass")}, "each name once"),
        ({"outside": "tip_mass"}, "tether"),
        ({"effects": ("tip_mass",), "joint": 1}, "0 to 0"),
        ({"segments": 0}, "1 to 6"),
        ({"noise": -0.1}, "0.0 to 0.5"),
        ({"noise": float("nan")}, "0.0 to 0.5"),
        ({"rate": 0.0}, "5.0 to 500.0"),
    ],
)
def test_bad_input_writes_nothing(tmp_path: Path, wrong: dict, said: str) -> None:
    """Say what is allowed in one line and leave no file."""
    with pytest.raises(InputError) as error:
        hide(tmp_path / "case", seed=1, **{**SMALL, **wrong})
    assert said in str(error.value) and "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_folder_that_cannot_be_written(tmp_path: Path) -> None:
    """Refuse a file where the folder should be, or a folder where the answer should be, and leave both."""
    (tmp_path / "file").write_text("x")
    (tmp_path / "case_answer.json").mkdir()
    for name in ("file", "case"):
        with pytest.raises(InputError):
            hide(tmp_path / name, seed=1, **SMALL)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["case_answer.json", "file"]


# ---- independence ------------------------------------------------------------------------------------------------


def imports(path: Path, package: tuple[str, ...]) -> set[str]:
    """Return the modules that a file imports, those of the package as bough.room.module."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            head = ("bough", *package)[: len(package) + 2 - node.level] if node.level else ()
            base = ".".join([*head, *([node.module] if node.module else [])])
            found |= {base} if node.module else {f"{base}.{alias.name}" for alias in node.names}
    return found


def test_hidden_laws_share_nothing_with_the_simulator() -> None:
    """Import from bough only errors and files into the hidden laws, and nothing of them into effects or kernels."""
    allowed = {"bough.sim.base.errors", "bough.sim.base.files", "bough.sim.base.console", "bough.sim.base.mujoco_log"}
    own = sorted((ROOT / "learn" / "hidden").glob("*.py"))
    assert len(own) > 5
    for path in own:
        for name in imports(path, ("learn", "hidden")):
            if name.split(".")[0] == "bough":
                assert name in allowed or name.startswith("bough.learn.hidden."), f"{path.name} imports {name}"
            assert name.split(".")[0] not in {"warp", "torch", "newton"}, f"{path.name} imports {name}"
    rooms = (("kernels",), ("sim", "effects"))
    for package in rooms:
        for path in sorted(ROOT.joinpath(*package).glob("*.py")):
            assert not any("hidden" in name for name in imports(path, package)), path.name


def test_names_are_those_of_the_registry() -> None:
    """Hide every name that bough knows of branches, and call nothing outside that is inside."""
    assert set(NAMES) == {e.name for e in effects() if e.branch} and not set(NAMES) & set(OUTSIDE)
    assert len(NAMES) == 20 and len(OUTSIDE) >= 8
