"""``bough record`` from the outside: a twin that is served, a recorder that is stopped, killed and out of room."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from oracles import json_page

pytest.importorskip("fastapi", reason="the service needs pip install 'bough[robot]'")
pytest.importorskip("uvicorn")
pytest.importorskip("rosbags", reason="bags need pip install 'bough[touch]'")

from bough.learn.recordings.bag import read_bag
from bough.learn.robot.log import joint_columns
from oracles.robot.service import Served, limit_files


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Serve a twin without a tree."""
    service = Served(tmp_path_factory.mktemp("robot"), "--away", "10")
    yield service
    service.end(signal.SIGINT)


def _take_signals() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background job would ignore


class Recorder:
    """A recorder as a process of its own."""

    def __init__(self, served: Served, out: Path, *options: object) -> None:
        command = [sys.executable, "-m", "bough", "record", f"http://127.0.0.1:{served.port}", "--out", str(out),
                   "--token-file", str(served.out.parent / "token"), *map(str, options)]  # fmt: skip
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                                        preexec_fn=_take_signals)  # fmt: skip
        assert "recording into" in self.process.stderr.readline()

    def end(self, number: int) -> tuple[int, str, str]:
        """Send a signal; return the exit code and what was printed."""
        self.process.send_signal(number)
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err


def ticks_of(served: Served, file: Path) -> int:
    """Find every tick of a bag in the service's own log, at its time and with its joints; return how many there are."""
    states = read_bag(file).streams["/joint_states"]
    t, q, _ = states.arrays()
    log = served.log()
    times, logged = np.array(log["time_s"], dtype=float), joint_columns(log, "q{}_rad")
    # stamps are the service's clock but for a constant, which the motion gives away: the log's row of the first tick
    errors = []
    for row in np.flatnonzero(np.abs(logged - q[0]).max(axis=1) < 2e-5):
        near = np.abs(times[row] + (t - t[0]) - times[:, None]).argmin(axis=0)
        late = np.abs(times[row] + (t - t[0]) - times[near]).max()
        errors.append((np.abs(logged[near] - q).max() + late, near))
    error, rows = min(errors, key=lambda pair: pair[0])
    # the log prints six digits of angles up to 7 rad, the stream microseconds; a moving tick turns by 0.005 rad
    assert error < 5e-5 and (np.diff(rows) > 0).all()
    return len(rows)


def move(served: Served, by: float) -> None:
    """Turn the first joint."""
    q = served.ask("/fetch_kinova_metrics")[1]["robot_dof_pos"]
    assert served.ask("/set_dof_pos", {"robot_dof_pos": [q[0] + by, *q[1:]]})[0] == 200


def test_until_ctrl_c_as_mcap(served, tmp_path):
    """Record a motion until Ctrl-C, turn it into MCAP, find each tick in the service's log; refuse the folder again."""
    recorder = Recorder(served, tmp_path / "bag", "--mcap")
    move(served, 0.2)
    code, out, err = recorder.end(signal.SIGINT)
    assert code == 0 and "ticks in" in out, err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bag"]
    assert sorted(p.name for p in (tmp_path / "bag").iterdir()) == ["bag.mcap", "metadata.yaml"]
    count = ticks_of(served, tmp_path / "bag")
    assert count == int(out.split()[0]) and count > 20


def test_killed_or_out_of_room_what_came_is_there(served, inside, tmp_path):
    """Kill a recorder, and take the room of another: every tick before is there, and one line says what happened."""
    killed, full = Recorder(served, tmp_path / "killed"), Recorder(served, tmp_path / "full")
    move(served, -0.2)
    time.sleep(0.2)
    assert killed.end(signal.SIGKILL)[0] == -signal.SIGKILL
    assert not (tmp_path / "killed" / "metadata.yaml").exists()
    assert ticks_of(served, tmp_path / "killed" / "killed.db3") > 20
    file = tmp_path / "full" / "full.db3"
    limit_files(full.process.pid, file.stat().st_size + 20_000)
    move(served, 0.1)
    out, err = full.process.communicate(timeout=60)
    assert full.process.returncode == 1 and out == "" and len(err.splitlines()) == 1
    assert "full.db3" in err and "ticks before are in it" in err
    assert ticks_of(served, file) == int(err.split(" ticks before")[0].split()[-1])
    inside("record", f"http://127.0.0.1:{served.port}", "--out", tmp_path / "full").refused("never overwritten")


def test_seconds_and_what_is_refused(served, inside, tmp_path):
    """End by the service's clock; refuse a wrong token, an address without a service and one that is none."""
    url, token = f"http://127.0.0.1:{served.port}", served.out.parent / "token"
    handler = signal.getsignal(signal.SIGTERM)
    done = inside("record", url, "--token-file", token, "--seconds", 0.5, "--out", tmp_path / "bag", "--json")
    signal.signal(signal.SIGTERM, handler)
    assert done.code == 0 and 20 <= json.loads(done.out)["ticks"] <= 31
    json_page.check("record", json.loads(done.out))
    inside("record", url, "--out", tmp_path / "other").refused("status 40", "--token-file")
    inside("record", "http://127.0.0.1:9", "--out", tmp_path / "other").refused("nothing that answers")
    inside("record", "robot:3738", "--out", tmp_path / "other").refused("http://HOST:PORT")
    assert not (tmp_path / "other").exists()
