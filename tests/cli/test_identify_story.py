"""``bough identify`` from the outside."""

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

QUICK = ("--particles", 24)
MAKEFILE = Path(__file__).parents[2] / "Makefile"


@pytest.fixture(scope="module")
def identified(bough, measured, tmp_path_factory):
    """Folder that one quick ``bough identify`` wrote."""
    out = tmp_path_factory.mktemp("identified") / "out"
    done = bough("identify", measured[0], *QUICK, "--out", out)
    assert done.code == 0, done.out + done.err
    return out


def test_identify_writes_posterior_and_report(identified, measured):
    """Learn a small case and write the promised files and numbers; the springs come out near the truth."""
    truth = measured[1]
    report = json.loads((identified / "report.json").read_text())
    json_page.check("identify", report)
    assert {"coverage_95", "interval_95_width_m", "rms_misfit_m", "noise_floor_m", "mean_crps_m"} <= report.keys()
    assert report["converged"] is True
    assert all(p["low"] <= p["median"] <= p["high"] for p in report["parameters"].values())
    curve = [report["coverage_curve"][q] for q in sorted(report["coverage_curve"])]
    assert curve == sorted(curve)
    page = (identified / "report.html").read_text()
    assert "<html" in page and page.count('class="copy"') >= 2 and "The motion, measured and foretold" in page
    learnt = [report["parameters"][f"stiffness {name}"]["median"] for name in truth["branch"]["names"]]
    # Wood that bends inside a segment makes the fitted springs a few percent soft; 12 % is what the project allows.
    np.testing.assert_allclose(learnt, truth["K"], rtol=0.12)


def test_the_branch_of_make_demo_is_learnt(inside):
    """Hide nothing in a branch and learn it, by the lines that `make demo` types: the sampler converges."""
    typed = re.findall(r"^\t\$\(BIN\)/bough ((?:hide|identify) .*/case\b.*)$", MAKEFILE.read_text(), re.MULTILINE)
    assert [line.split()[0] for line in typed] == ["hide", "identify"]
    for line in typed:
        done = inside(*line.replace("$(DEMO)/", "").split())
        assert done.code == 0, done.out + done.err


def test_posterior_feeds_a_forest_and_the_next_case(bough, inside, identified, measured):
    """Randomise a forest by a posterior, and take it as the prior of another run, whose intervals do not widen."""
    posterior = identified / "posterior.npz"
    done = bough("forest", "--posterior", posterior, "--count", 3, "--picture-width", 0, "--out", "forest")
    assert done.code == 0, done.err
    done = inside("identify", measured[0], *QUICK, "--prior", posterior, "inequality", "--out", "next")
    assert done.code == 0, done.out + done.err
    before, after = (json.loads((p / "report.json").read_text())["parameters"] for p in (identified, Path("next")))
    width = {name: [np.log(r[name]["high"] / r[name]["low"]) for r in (before, after)] for name in before}
    assert np.mean([b / a for a, b in width.values()]) < 0.95


@pytest.mark.parametrize(
    "options",
    [
        ("--method", "nnsvgd", *QUICK),
        ("--joints", "revolute", "--shared", "damping", *QUICK),
        ("--infer", "stiffness", "damping", "density", "--prior", "geometry", "lognormal", *QUICK),
        ("--loss", "published", "--temperature", 0.05, *QUICK),
    ],
)
def test_options_run(inside, brief, options):
    """Every kind of option makes a report; some honestly do not converge on so short a run."""
    done = inside("identify", brief, *options, "--out", "out")
    assert done.code in (0, 3), done.err
    report = json.loads(Path("out/report.json").read_text())
    assert report["converged"] is (done.code == 0)


def test_short_chains_did_not_converge(inside, brief):
    """Say so in the first line of the report and by exit code 3; results are there all the same."""
    done = inside("identify", brief, "--method", "mh", "--particles", 16, "--iterations", 30, "--out", "out")
    assert done.code == 3
    assert "did not converge" in done.out
    page = Path("out/report.html").read_text()
    assert "did not converge" in page[page.index("<h1") : page.index("</h1>")]
    assert len(np.load("out/posterior.npz")["particles"]) == 64


def test_cross_validation_predicts_every_trajectory(inside, brief):
    """Hold every trajectory out once."""
    done = inside("identify", brief, *QUICK, "--cv", 2, "--out", "out")
    assert done.code == 0, done.out + done.err
    report = json.loads(Path("out/report.json").read_text())
    files = yaml.safe_load((brief / "meta.yaml").read_text())["trajectories"]
    assert sorted(report["trajectories"]["test"]) == list(range(1, len(files) + 1))


def test_a_killed_run_goes_on_to_the_same_bits(bough, inside, brief):
    """Kill a run when it has reached something; --resume ends where the undisturbed run does."""
    options = ["identify", brief, "--particles", 24, "--iterations", 60, "--out"]
    assert bough(*options, "whole").code == 0
    state = Path(".killed.unfinished/posterior.sampler")
    command = [sys.executable, "-m", "bough", *map(str, options), "killed"]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while run.poll() is None and not state.exists():
        time.sleep(0.02)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    assert state.exists() and not Path("killed").exists()
    inside("identify", brief, *QUICK, "--out", "killed", "--resume").refused("--resume", "other settings")
    kept = state.read_bytes()
    state.write_bytes(b"garbage")
    inside(*options, "killed", "--resume").refused("posterior.sampler", "damaged", "begin anew without --resume")
    state.write_bytes(kept)
    done = bough(*options, "killed", "--resume")
    assert done.code == 0, done.err
    a, b = (np.load(f"{name}/posterior.npz")["particles"] for name in ("whole", "killed"))
    assert (a == b).all()
    steps, both = (json.loads(Path(f"{name}/report.json").read_text())["world_steps"] for name in ("whole", "killed"))
    assert steps <= both <= 1.5 * steps  # of both processes; what was done after the last write is done again
    assert not Path(".killed.unfinished").exists()


def test_resume_without_anything_to_resume_begins(inside, brief):
    """A run that was killed before it had reached anything begins anew."""
    assert inside("identify", brief, *QUICK, "--out", "out", "--resume").code == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--box", "stiffness=200:5"), ("stiffness=200:5", "LOW below HIGH")),
        (("--box", "stifness=5:200"), ("stifness", "stiffness")),
        (("--box", "stiffness=high"), ("stiffness=high",)),
        (("--box", "damping=0:1"), ("above 0",)),
        (("--box", "stiffness=1000:2000"), ("beyond the end of its box", "--box")),
        (("--cv", 30), ("trajectories", "30 folds")),
        (("--cv", 1), ("--cv",)),
        (("--prior", "inequalty"), ("inequalty", "inequality")),
        (("--prior", "absent.npz"), ("absent.npz",)),
        (("--shared", "density"), ("--shared", "density")),
        (("--particles", 9), ("--particles", "two for each")),
        (("--temperature", 0), ("--temperature",)),
        (("--box", "stiffness=1e-300:1e300"), ("--box", "1e-300 to 1e+300", "between 1e-15 and 1e+15")),
        (("--box", "stiffness=5:200", "stiffness=6:100"), ("--box", "bounds twice")),
        (("--seed", 2**64), ("--seed", str(2**64), "0 to 9223372036854775807")),
        (("--seed", -1), ("--seed", "-1")),
        (("--particles", 10**9), ("1000000000 particles", "GiB")),
    ],
)
def test_impossible_options(inside, brief, options, words):
    """Refuse in one line; nothing is written, nothing is left."""
    inside("identify", brief, *options, "--out", "out").refused(*words)
    assert not Path("out").exists() and not Path(".out.unfinished").exists()


def spoil(case: Path, columns: slice) -> None:
    """Zero some columns of the first trajectory."""
    path = case / "traj_01.csv"
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    rows[:, columns] = 0.0
    np.savetxt(path, rows, delimiter=",", header=path.read_text().splitlines()[0], comments="")


def test_trajectories_without_motion_or_force(inside, case):
    """Name the file that has none."""
    kept = Path(shutil.copytree(case, "kept"))
    spoil(case, slice(4, 10))
    inside("identify", case, "--out", "out").refused("traj_01.csv", "no motion")
    spoil(kept, slice(1, 4))
    inside("identify", kept, "--out", "out").refused("traj_01.csv", "no force")
