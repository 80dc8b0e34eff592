"""`bough run` as users and their broken machines meet it: real processes, a twin in real time, two logs."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("fastapi", reason="the service needs the extra robot")
pytest.importorskip("rsl_rl", reason="policies need the extra train")

from bough.learn.deploy.log import read_run
from bough.learn.robot.log import joint_columns
from oracles import json_page
from oracles.robot.service import Served, keeps_limits, keeps_still, limit_files, moving_client, size_of


@pytest.fixture(scope="module")
def policies(tmp_path_factory, inside):
    """Train a policy of each task for one iteration: it moves, to no purpose."""
    folder = tmp_path_factory.mktemp("policies")
    for task in ("powerline", "reach"):
        options = ("--preset", "cpu", "--iterations", "1", "--num-envs", "4")
        assert inside("train", task, *options, "--out", folder / task).code == 0
    return folder


@pytest.fixture(scope="module")
def served(tmp_path_factory, policies):
    """Serve a twin that holds the scene of the clearing policy."""
    service = Served(tmp_path_factory.mktemp("robot"), "--scene", policies / "powerline")
    yield service
    assert service.end(signal.SIGINT) == 0
    keeps_limits(service.log())


def where(served):
    return f"http://user:{served.token}@127.0.0.1:{served.port}"


def started(served, *arguments):
    """Start ``bough run`` in a process of its own and wait until it moves the arm."""
    served.settled()
    command = [sys.executable, "-m", "bough", "run", *map(str, arguments), "--robot", where(served)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 120
    while served.ask("/status")[1]["state"] != "moving":
        assert process.poll() is None and time.monotonic() < end, process.communicate()
        time.sleep(0.05)
    return process


def children(process):
    """Return the numbers of the processes that one has started, oldest first."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            status = (folder / "stat").read_text().rpartition(")")[2].split()
            words = (folder / "cmdline").read_text()
        except OSError:
            continue
        if int(status[1]) == process.pid and "spawn_main" in words:
            found.append(int(folder.name))
    return sorted(found)


def stands(served, cause=""):
    """Check that a stop holds, that nothing moves any more, and that it is the one that was asked for."""
    end = time.monotonic() + 20
    while served.ask("/status")[1]["state"] != "stopped":
        assert time.monotonic() < end
        time.sleep(0.02)
    assert cause in served.ask("/status")[1]["cause"]
    time.sleep(0.5)
    assert served.ask("/status")[1]["state"] == "stopped"
    assert not joint_columns(served.log(), "dq_cmd{}_rad_s")[-10:].any()


def test_a_policy_runs_in_two_scenes_with_log_report_and_film(served, policies, tmp_path, bough):
    """Run two episodes of a second: every tick answered is in the log, the page and the pictures are there."""
    served.settled()
    out, policy = tmp_path / "out", policies / "powerline"
    options = ("--camera", "truth", "--touch", "truth", "--episodes", 2, "--seconds", 1, "--film", "png", "--fps", 2)
    ran = bough("run", policy, "--robot", where(served), "--out", out, *options, "--json")
    assert ran.code == 0, ran.err
    told = json.loads(ran.out)
    assert told == json.loads((out / "run.json").read_text()) and told["film"] == "frames"
    json_page.check("run", told)
    assert (told["episodes"], told["task"], told["trouble"]) == (2, "powerline", "") and len(told["interval"]) == 2
    log, ticks = read_run(out), served.log()
    assert set(log["episode"]) == {0, 1} and told["period_s"]["count"] == len(log["tick"]) - 2
    assert set(log["tick"]) <= set(np.array(ticks["tick"], float)) and log["age_s"].max() < 0.5
    speeds = np.stack([log[f"dq_asked{k}_rad_s"] for k in range(1, 7)], axis=1)
    asked = joint_columns(ticks, "dq_asked{}_rad_s")
    assert np.abs(speeds).max() > 0.01 and np.abs(speeds).max() == pytest.approx(np.abs(asked).max(), abs=0.05)
    assert "episodes succeeded" in (out / "report.html").read_text() and len(list((out / "frames").glob("*.png"))) > 1
    bough("run", policy, "--robot", where(served), "--out", out, *options).refused("--out", "never overwritten")


def test_a_dry_run_prints_what_it_would_send_and_sends_nothing(served, policies, bough):
    """Look for a fifth of a second: lines of speeds, and the service has accepted no command."""
    served.settled()
    before = served.ask("/status")[1]["accepted"]
    options = ("--camera", "truth", "--touch", "none", "--dry-run", "--seconds", "0.2")
    ran = bough("run", policies / "powerline", "--robot", where(served), *options)
    assert ran.code == 0 and ran.out.count("would send") >= 2 and "Sent nothing" in ran.out, ran.err
    assert served.ask("/status")[1]["accepted"] == before


def test_a_run_that_is_killed_leaves_the_arm_standing_and_its_log_whole(served, policies, tmp_path):
    """Kill a run with -9 while it moves the arm: still within 150 ms, both logs whole, nothing starts again."""
    process = started(served, policies / "powerline", "--camera", "truth", "--touch", "none", "--out", tmp_path / "out")
    time.sleep(0.5)
    process.kill()
    process.wait()
    time.sleep(1.0)
    keeps_still(served)
    rows = read_run(tmp_path / "out")
    assert len(rows["tick"]) > 5 and (tmp_path / "out" / "run.csv").read_bytes().endswith(b"\n")
    assert served.ask("/status")[1]["state"] == "ready"


def test_a_full_disk_stops_the_arm(served, policies, tmp_path):
    """Fill the disk of a run: the arm is stopped, one line names the file, exit code 1, whole lines are left."""
    if not sys.platform.startswith("linux"):
        pytest.skip("a limit on another process's files is Linux's")
    process = started(served, policies / "powerline", "--camera", "truth", "--touch", "none", "--out", tmp_path / "out")
    log = tmp_path / "out" / "run.csv"
    limit_files(process.pid, size_of(log) + 3000)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1 and "run.csv" in err.splitlines()[-1], err
    stands(served, "asked for")
    assert log.read_bytes().endswith(b"\n") and len(read_run(log)["tick"]) > 5


def test_a_new_scene_takes_a_stop_over_the_network(served):
    """Ask for a scene while armed, by words that are none, and once stopped: counted like other commands."""
    served.settled()
    before = served.ask("/status")[1]
    assert served.ask("/twin/episode", {"number": 1})[1]["reason"] == "not stopped"
    assert served.ask("/twin/episode", {"number": -1})[1]["reason"] == "malformed"
    served.ask("/stop", {})
    assert served.ask("/twin/episode", {"number": 1})[0] == 200
    after = served.ask("/status")[1]
    assert after["state"] == "stopped" and after["accepted"] == before["accepted"] + 1
    assert served.ask("/twin/truth", token="wrong-token-wrong-token")[0] == 401


@pytest.mark.parametrize("fault, word", [("frozen", "old"), ("killed", "")])
def test_a_camera_that_fails_stops_the_arm(served, policies, tmp_path, fault, word):
    """Freeze the camera's process, or kill the segmenter's with -9: the arm is stopped, and the run says why."""
    options = ("--camera", "twin", "--touch", "none", "--most-age", 2)
    process = started(served, policies / "powerline", *options, "--out", tmp_path / "out")
    camera, segmenter = children(process)
    os.kill(*((camera, signal.SIGSTOP) if fault == "frozen" else (segmenter, signal.SIGKILL)))
    try:
        _, err = process.communicate(timeout=90)
    finally:
        with contextlib.suppress(ProcessLookupError):  # the run has ended what it had started
            os.kill(camera, signal.SIGKILL)
    assert process.returncode == 1 and "the run ended early, the arm stands" in err and word in err, err
    stands(served, "asked for")
    assert read_run(tmp_path / "out")["age_s"].max() < 2.2


def test_options_that_cannot_be_are_refused(served, policies, tmp_path, inside):
    """Refuse, in one line and before anything moves, what no run can be made of; a controller keeps others out."""
    served.settled()
    clearing, reaching, out = policies / "powerline", policies / "reach", ("--out", tmp_path / "out")

    def run(policy, *options):
        return inside("run", policy, "--robot", where(served), *options)

    run(clearing).refused("--out")
    run(clearing, *out, "--touch", "none").refused("--camera", "none given")
    run(clearing, *out, "--camera", "truth").refused("--touch", "none given")
    run(reaching, *out, "--touch", tmp_path / "no.npz").refused("no.npz", "does not exist")
    run(clearing, *out, "--camera", "nowhere", "--touch", "none").refused("nowhere")
    run(reaching, *out, "--camera", "truth", "--touch", "none").refused("--camera", "sees nothing")
    run(reaching, *out, "--touch", "none").refused("without a target")
    run(clearing, *out, "--episodes", 0).refused("--episodes")
    run(tmp_path / "none", *out).refused("no such folder")
    inside("run", clearing, "--robot", "http://127.0.0.1:9", *out, "--camera", "truth", "--touch", "none").refused("9")
    served.settled()
    client = moving_client(served, "stream")
    try:
        run(clearing, *out, "--camera", "truth", "--touch", "none").refused("held", "nobody holds")
    finally:
        client.kill()
        client.wait()
    served.ask("/stop", {})
    run(clearing, *out, "--camera", "truth", "--touch", "none").refused("stop", "armed")
    assert served.ask("/status")[1]["state"] == "stopped", "no run re-arms what it has not stopped"
    assert not (tmp_path / "out").exists()
