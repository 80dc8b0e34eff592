"""``bough probe`` as a user has it: a twin that is served, a probing that is killed and goes on, wrong input."""

import json
import signal
import subprocess
import sys
import time

import pytest
import yaml

pytest.importorskip("fastapi", reason="the service needs the extra robot")
pytest.importorskip("uvicorn")

from bough.learn.cases.case import load_case
from oracles.robot.service import Served


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Serve a twin that grasps a branch of two segments, with drag hidden in it."""
    service = Served(tmp_path_factory.mktemp("robot"), "--backend", "branch", "--segments", "2", "--seed", "4",
                     "--effect", "quadratic_drag:size=0.3")  # fmt: skip
    yield service
    service.end(signal.SIGINT)


def words_of(served, out, *options):
    """Return a command line of a probing whose diagnosis is quick: two laws, short recordings."""
    return ["probe", "--branch", served.out / "branch.yaml", "--out", out, "--robot", f"http://127.0.0.1:{served.port}",
            "--token-file", served.out.parent / "token", "--effects", "quadratic_drag", "dry_friction",
            "--max-effects", "1", "--samples", "180", "--budget", "3", *options]  # fmt: skip


def lines(path):
    """Return how many lines a file has, 0 where there is none."""
    return path.read_text().count("\n") if path.exists() else 0


def waited(done, seconds=240.0):
    """Wait until something is so."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_killed_probing_goes_on_and_loses_nothing(served, inside, tmp_path):
    """Kill -9 in the second pull; resume from the hand as it is: the first recording stays, the cut one is kept."""
    served.settled()
    out = tmp_path / "probe"
    command = [sys.executable, "-m", "bough", *map(str, words_of(served, out))]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    waited(lambda: lines(out / "pull_2_1.csv.part") > 20 or process.poll() is not None)
    assert process.poll() is None, process.stderr.read()
    process.kill()
    process.wait()
    first = (out / "pull_1_1.csv").read_bytes()
    inside(*words_of(served, out)).refused("--out", "--resume")
    inside(*words_of(served, out, "--resume", "--force", "9")).refused("--resume", "another force")
    told = inside(*words_of(served, out, "--resume", "--json"))
    assert told.code == 0, told.err
    assert (out / "pull_1_1.csv").read_bytes() == first and lines(out / "pull_2_1.cut-1.csv") > 10
    result = json.loads((out / "result.json").read_text())
    assert json.loads(told.out) == result and 2 <= result["recordings"] <= 3
    case = load_case(out / "case")
    assert len(case.trajectories) == result["recordings"] and all(len(t.t) == 180 for t in case.trajectories)
    assert any(t.no_contact.any() for t in case.trajectories) and case.base_position[2] != 0.0
    verdict = json.loads((out / "diagnosis" / "verdict.json").read_text())
    assert (verdict["verdict"], len(verdict["effects"])) == (result["verdict"], len(result["effects"]))
    assert (out / "diagnosis" / "report.html").exists()
    assert json.loads((out / "round_2.json").read_text()) == result["rounds"][0]


def test_a_stop_ends_it_with_its_cause(served, tmp_path):
    """Stop the arm while it works: exit code 1, the cause in a line, what was recorded kept; fingers stay closed."""
    served.settled()
    out = tmp_path / "probe"
    command = [sys.executable, "-m", "bough", *map(str, words_of(served, out))]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    waited(lambda: lines(out / "pull_1_1.csv.part") > 10 or process.poll() is not None)
    served.ask("/stop", {})
    _, said = process.communicate(timeout=120)
    assert process.returncode == 1 and "asked for over HTTP" in said and "--resume goes on" in said
    assert lines(out / "pull_1_1.cut-1.csv") > 5 and not (out / "pull_1_1.csv").exists()
    assert served.ask("/set_gripper", {"robot_gripper": 0.0})[1]["reason"] == "stopped"
    assert float(served.log()["gripper"][-1]) > 0.9
    served.settled()
    assert served.ask("/set_gripper", {"robot_gripper": 1.5})[1]["reason"] == "outside"
    assert served.ask("/set_gripper", {"robot_dof_vel": [0.0] * 6})[0] == 400
    assert served.ask("/set_gripper", {"robot_gripper": 0.0})[0] == 200
    waited(lambda: float(served.log()["gripper"][-1]) < 0.1)


def test_what_cannot_be_is_refused(inside, tmp_path):
    """Say in one line what is wrong with a branch, an option or an address, and write nothing."""
    branch, out = tmp_path / "branch.yaml", tmp_path / "probe"
    content = {
        "format": "branch-gap-case/1", "gravity_mps2": 9.81, "density_kgpm3": 850.0, "base_position_m": [0.0, 0.0, 0.1],
        "segments": [{"name": "stem", "length_m": 0.6, "radius_base_m": 0.018, "radius_tip_m": 0.016,
                      "elevation_deg": 30.0, "azimuth_deg": 0.0, "mass_kg": 0.46}],
        "grasp": {"segment": "stem", "distance_from_lower_end_m": 0.5},
    }  # fmt: skip
    branch.write_text(yaml.safe_dump(content))

    def probe(*options):
        return inside("probe", "--branch", branch, "--out", out, "--robot", "http://127.0.0.1:9", *options)

    probe("--budget", 1).refused("--budget", "2 to 100")
    probe("--width", -1).refused("--width")
    probe("--force", 0).refused("--force", "0.1 to 100")
    probe("--effects", "magic").refused("--effects", "magic")
    probe().refused("127.0.0.1:9", "nothing that answers")
    branch.write_text(yaml.safe_dump(content | {"grasp": {"segment": "leaf", "distance_from_lower_end_m": 0.5}}))
    probe().refused("branch.yaml", "grasp", "stem")
    inside("probe", "--branch", tmp_path / "none.yaml", "--out", out).refused("none.yaml")
    inside("robot", "serve", "--out", out, "--backend", "branch", "--effect", "time_delay").refused(
        "time_delay", "backlash"
    )
    inside("robot", "serve", "--out", out, "--backend", "branch", "--segments", 9).refused("--segments", "1 to 6")
    assert not out.exists()
