"""``bough hide``, ``bough diagnose`` and ``bough exam`` from the outside."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from oracles import json_page

SMALL = ("--segments", 1, "--samples", 60)
#: Few names make a small kernel.
FEW = ("--effects", "force_scale", "dry_friction")


@pytest.fixture(scope="module")
def hidden(bough, tmp_path_factory):
    """Folder of a case with a wrong force scale, as ``bough hide`` writes it."""
    out = tmp_path_factory.mktemp("hidden") / "case"
    done = bough("hide", "--effects", "force_scale", "--size", 0.25, *SMALL, "--seed", 3, "--out", out)
    assert done.code == 0, done.err
    return out


@pytest.fixture(scope="module")
def diagnosed(bough, hidden, tmp_path_factory):
    """Folder that ``bough diagnose`` wrote, and what it said."""
    out = tmp_path_factory.mktemp("diagnosed") / "out"
    done = bough("diagnose", hidden, *FEW, "--out", out)
    assert done.code == 0, done.out + done.err
    return out, done


def test_hidden_effect_is_found_and_shown(diagnosed):
    """Name it in the printed line, the verdict file and the page; draw every figure that the page promises."""
    out, done = diagnosed
    verdict = json.loads((out / "verdict.json").read_text())
    json_page.check("diagnose", verdict)
    assert verdict["verdict"] == "effects" and [e["name"] for e in verdict["effects"]] == ["force_scale"]
    assert verdict["gap"]["repaired"] < 0.7 * verdict["gap"]["base"]
    scale = verdict["effects"][0]["parameters"]["scale"]
    assert scale["low"] <= scale["median"] <= scale["high"] and scale["unit"] == "1"
    assert len(done.out.splitlines()) == 1 and "force_scale" in done.out and "report.html" in done.out
    page = (out / "report.html").read_text()
    assert verdict["sentence"].split(":")[0] in page and not re.search(r'(src|href)="http', page)
    assert {"heat.png", "before_after.png", "loops.png", "ranking.png", "parts.png", "gap.png"} <= {
        p.name for p in out.iterdir()
    }


def test_repaired_model_has_the_gap_that_is_claimed(bough, hidden, diagnosed):
    """Print by simulate the held-out RMSE of the verdict, and find it in what it writes; one set of numbers."""
    out, _ = diagnosed
    done = bough("simulate", hidden, "--model", out / "model.yaml", "--out", "motion")
    assert done.code == 0, done.err
    verdict = json.loads((out / "verdict.json").read_text())
    assert f"held-out RMSE {verdict['gap']['repaired']:.3g} m (" in done.out
    moved = np.load("motion/trajectory.npz")["grasp_displacement"]
    files = re.search(r"\((.*), not used in its fit\)", done.out)[1].split(", ")
    paths = sorted(hidden.glob("traj*.csv"))
    held = [k for k, p in enumerate(paths) if p.name in files]
    recorded = np.stack([_table(p)[1][:, 4:7] for p in paths], axis=1)
    left = np.sqrt(np.mean((moved - recorded)[:, held] ** 2))
    assert left == pytest.approx(verdict["gap"]["repaired"], rel=1e-5)  # recordings are read in 9 digits
    model = yaml.safe_load((out / "model.yaml").read_text())
    for effect, claimed in zip(model["effects"], verdict["effects"], strict=True):
        medians = {name: row["median"] for name, row in claimed["parameters"].items()}
        assert (effect["name"], effect["joint"], effect["parameters"]) == (claimed["name"], claimed["joint"], medians)


def _table(path):
    """Return the head line of a recording and its numbers."""
    return path.read_text().splitlines()[0], np.loadtxt(path, delimiter=",", skiprows=1)


def _changed(case, change):
    """Write every recording anew with force and motion changed."""
    for path in case.glob("traj*.csv"):
        head, numbers = _table(path)
        numbers[:, 1:] = change(numbers[:, 1:])
        np.savetxt(path, numbers, fmt="%.9g", delimiter=",", header=head, comments="")


def test_a_killed_diagnosis_reaches_the_same_verdict(bough, hidden, diagnosed):
    """Kill a run when it has reached something; --resume ends with the same file."""
    options = ["diagnose", hidden, *FEW, "--out", "killed"]
    state = Path(".killed.unfinished")
    run = subprocess.Popen([sys.executable, "-m", "bough", *map(str, options)], stdout=subprocess.DEVNULL,
                           stderr=subprocess.DEVNULL)  # fmt: skip
    while run.poll() is None and not list(state.glob("search*")):
        time.sleep(0.02)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    assert list(state.glob("search*")) and not Path("killed").exists()
    bough(*options, "--resume", "--seed", 4).refused("--resume", "other settings")
    file = next(state.glob("search*"))
    kept = file.read_bytes()
    file.write_bytes(b"garbage")
    bough(*options, "--resume").refused(file.name, "damaged", "begin anew without --resume")
    file.write_bytes(kept)
    done = bough(*options, "--resume")
    assert done.code == 0, done.err
    assert Path("killed/verdict.json").read_text() == (diagnosed[0] / "verdict.json").read_text()
    assert not state.exists()


def _quiet(case):
    """Take force and motion from every recording."""
    _changed(case, np.zeros_like)


def _noisy(case):
    """Put noise three times the motion on every recording."""
    rng = np.random.default_rng(0)
    size = np.std(np.concatenate([_table(p)[1][:, 1:] for p in case.glob("traj*.csv")]), axis=0)
    _changed(case, lambda x: x + 3.0 * size * rng.normal(size=x.shape))


def _single(case):
    """Leave one recording."""
    meta = yaml.safe_load((case / "meta.yaml").read_text())
    meta["trajectories"] = meta["trajectories"][:1]
    (case / "meta.yaml").write_text(yaml.safe_dump(meta))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [(_quiet, "push the branch"), (_noisy, "push harder"), (_single, "push in two more directions")],
)
def test_a_poor_case_gets_a_reason_instead_of_a_name(inside, hidden, tmp_path, spoil, words):
    """Say unknown, why, and which probe is missing; write a verdict all the same."""
    case = Path(shutil.copytree(hidden, tmp_path / "poor"))
    spoil(case)
    done = inside("diagnose", case, *FEW, "--out", "out")
    assert done.code == 0, done.err
    verdict = json.loads(Path("out/verdict.json").read_text())
    assert verdict["verdict"] == "unknown" and verdict["effects"] == []
    assert words in verdict["next_experiment"] and words in done.out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--effects", "dry_frction"), ("dry_frction", "dry_friction")),
        (("--tolerance", 2), ("--tolerance",)),
        (("--max-effects", 0), ("--max-effects",)),
        (("--seed", -1), ("--seed",)),
    ],
)
def test_impossible_diagnoses(bough, hidden, options, words):
    """Refuse in one line; nothing is written, nothing is left."""
    bough("diagnose", hidden, *options, "--out", "out").refused(*words)
    assert not Path("out").exists() and not Path(".out.unfinished").exists()


def test_exam_of_branches_is_marked(bough):
    """Hold an exam of one branch, print its table, and write it with who was called what; refuse none."""
    done = bough("exam", "--cases", 1, "--jobs", 1, "--out", "out")
    assert done.code == 0 and "false alarm on null" in done.out, done.err
    json_page.check("exam", json.loads(Path("out/exam.json").read_text()))
    assert (Path("out/confusion.png")).stat().st_size > 10_000
    bough("exam", "--cases", 0, "--out", "out").refused("--cases")


def test_exam_on_joints_is_marked_and_goes_on(bough):
    """Hold a short exam of joints, then a longer one that takes over what was done; refuse a noise of its own.

    Its table has intervals. Where nothing is left to do the same table is printed.
    """
    exam = ("exam", "--joints", "--jobs", 1, "--seed", 5, "--out", "joints")
    assert bough(*exam, "--cases", 1).code == 0
    first = Path("joints/results.jsonl").read_text()
    done = bough(*exam, "--cases", 2)
    assert done.code == 0, done.err
    assert Path("joints/results.jsonl").read_text().startswith(first)
    rows = [json.loads(line) for line in Path("joints/results.jsonl").read_text().splitlines()]
    assert [r["kind"] for r in rows] == ["null", "single"]
    assert all(r["verdict"]["fit"]["method"] in ("replay", "torque") for r in rows)
    assert "| measured joints | wanted |" in done.out and "intervals of named parameters" in done.out
    again = bough(*exam, "--cases", 2, "--json")  # nothing is left to do
    assert json.loads(again.out) == json.loads(Path("joints/exam.json").read_text())
    bough("exam", "--joints", "--noise", 0.03, "--out", "other").refused("--noise")


def test_torques_that_were_not_measured_are_refused(bough, hidden):
    """Say in one line that a branch has no torques to fit."""
    bough("diagnose", hidden, "--fit", "torque", "--out", "torques").refused("--fit")
