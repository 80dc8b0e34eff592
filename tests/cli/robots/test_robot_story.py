"""`bough robot serve` as users and their broken clients meet it: a real process, real sockets, the log as witness."""

import json
import signal
import socket
import sys
import time

import numpy as np
import pytest
import yaml
from oracles import json_page

pytest.importorskip("fastapi", reason="the service needs the extra robot")
pytest.importorskip("uvicorn")

from bough.learn.robot.log import joint_columns
from bough.sim.arms.jaco2 import jaco2
from oracles.mujoco_arm import document
from oracles.robot.peer import Peer
from oracles.robot.service import (
    HOME,
    Served,
    Wire,
    keeps_limits,
    keeps_still,
    limit_files,
    moving_client,
    size_of,
)
from websockets.exceptions import InvalidStatus

STILL = [0.0] * 6


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Serve a twin without a tree; end it as a user does."""
    service = Served(tmp_path_factory.mktemp("robot"), "--away", "10")
    yield service
    assert service.end(signal.SIGINT) == 0
    assert "The arm stands still" in service.process.stdout.read()
    log = service.log()
    keeps_limits(log)
    assert log["state"][-1] == "stopped" and not joint_columns(log, "dq_cmd{}_rad_s")[-1].any()


def send(stream, **message):
    """Send a command and return its answer, passing over ticks."""
    stream.send(json.dumps(message))
    while "accepted" not in (said := json.loads(stream.recv(timeout=10))):
        pass
    return said


def newest(stream):
    """Return the next tick of a stream."""
    while "tick" not in (said := json.loads(stream.recv(timeout=10))):
        pass
    return said


@pytest.fixture
def ended():
    """Return what takes processes that must not outlive a test, however it ends."""
    processes = []
    yield processes.append
    for process in processes:
        process.kill()
        process.wait()


def some_touch_model(folder):
    """Write a model that knows nothing, whose probabilities are about a half."""
    pytest.importorskip("sklearn")
    from bough.learn.touch.forest import grow_forest
    from bough.learn.touch.free_motion import FreeMotion
    from bough.learn.touch.model import TouchModel

    rng = np.random.default_rng(0)
    forest = grow_forest(rng.normal(size=(300, 90)), rng.integers(0, 2, 300), 0)
    TouchModel(FreeMotion(np.zeros((6, 5)), np.ones(6)), forest, "forest", 10.0, 0.4, ()).write(folder / "model.npz")
    return folder / "model.npz"


def refused(served):
    return sum(served.ask("/status")[1]["refused"].values())


def test_published_fields_and_their_units(served):
    """Answer in the published names and units: MuJoCo's hand at these joints; rad, rad/s, quaternion x, y, z, w."""
    import mujoco

    served.home()
    status, said = served.ask("/fetch_kinova_metrics", basic=True)
    assert status == 200
    assert {k: len(v) for k, v in said.items()} == {
        "robot_dof_pos": 6, "robot_dof_vel": 6, "robot_dof_torque": 6, "hand_pos": 3, "hand_rot": 4,
    }  # fmt: skip
    assert said["robot_dof_pos"] == pytest.approx(HOME, abs=0.02)
    arm = jaco2()
    model = mujoco.MjModel.from_xml_string(document(arm, servo=False))
    data = mujoco.MjData(model)
    data.qpos[:6] = said["robot_dof_pos"]
    mujoco.mj_forward(model, data)
    hand = data.body(arm.tree.link_name[5])
    turn = hand.xmat.reshape(3, 3)
    assert said["hand_pos"] == pytest.approx(hand.xpos + turn @ arm.end_position, abs=1e-4)
    x, y, z, w = said["hand_rot"]
    expected = np.zeros(4)
    mujoco.mju_mulQuat(expected, hand.xquat, arm.end_rotation)
    assert abs(np.dot([w, x, y, z], expected)) == pytest.approx(1.0, abs=1e-6)
    before = said["robot_dof_pos"]
    for _ in range(30):
        assert served.ask("/set_dof_vel", {"robot_dof_vel": [0, 0, 0, 0, 0, 0.4]})[0] == 200
        time.sleep(1 / 60)
    after = served.ask("/fetch_kinova_metrics")[1]["robot_dof_pos"]
    log = served.log()
    path = np.trapezoid(joint_columns(log, "dq_cmd{}_rad_s")[:, 5], np.array(log["time_s"], float))
    assert after[5] - before[5] > 0.1 and path == pytest.approx(after[5] - HOME[5], abs=0.03)


@pytest.mark.parametrize("kind", ["stream", "http", "move"])
def test_a_client_that_is_killed_leaves_the_arm_standing(served, kind):
    """Kill a client with -9 in the middle of a motion: still within 150 ms, and still a second later."""
    served.home()
    client = moving_client(served, kind)
    client.kill()
    client.wait()
    time.sleep(1.0)
    log = served.log()
    keeps_limits(log)
    if kind == "move":  # its leases are renewed by the service while the request lives
        assert not joint_columns(log, "dq_cmd{}_rad_s")[-30:].any()
        assert float(log["q1_rad"][-1]) < 6.5
    else:
        keeps_still(served)


def test_a_paused_network_stops_the_arm_and_its_late_commands_are_refused(served):
    """Hold a client's bytes back for half a second: still within 150 ms; refuse what comes late in one burst."""
    served.home()
    wire = Wire(served.port)
    with served.stream(wire.port) as stream:
        tick = newest(stream)
        for n in range(15):
            assert send(stream, robot_dof_vel=[0.3, 0, 0, 0, 0, 0], seq=n, tick=tick["tick"])["accepted"]
            tick = newest(stream)
        wire.pause()
        late = served.ask("/status")[1]["refused"].get("late", 0)
        for n in range(15, 30):
            stream.send(json.dumps({"robot_dof_vel": [0.3, 0, 0, 0, 0, 0], "seq": n, "tick": tick["tick"]}))
        time.sleep(0.5)
        keeps_still(served)
        wire.resume()
        end = time.monotonic() + 20
        while served.ask("/status")[1]["refused"].get("late", 0) < late + 15 and time.monotonic() < end:
            time.sleep(0.02)
        assert served.ask("/status")[1]["refused"]["late"] == late + 15
        keeps_still(served)


def test_bad_commands_are_refused_with_a_reason_and_counted(served):
    """Refuse late, doubled, out of order, NaN, malformed and implausible commands; none of them moves the arm."""
    served.home()
    with served.stream() as stream:
        first = newest(stream)["tick"]
        assert send(stream, robot_dof_vel=STILL, seq=5)["accepted"]
        time.sleep(0.15)
        table = {
            "late": {"tick": first, "seq": 6}, "duplicate": {"seq": 5}, "out of order": {"seq": 4},
            "not finite": {"robot_dof_vel": [float("nan")] * 6}, "implausible": {"robot_dof_vel": [36.0] * 6},
            "malformed": {"robot_dof_vel": [0.1] * 5},
        }  # fmt: skip
        for reason, spoilt in table.items():
            before = refused(served)
            said = send(stream, **{"robot_dof_vel": [0.2] * 6, "seq": 50, **spoilt})
            assert (said["accepted"], said["reason"]) == (False, reason) and said["error"]
            assert refused(served) == before + 1
        assert send(stream, robot_dof_vel=[0.2] * 6, seq=51, tick=10**9)["reason"] == "late"
        assert send(stream, robot_dof_vel=[0.2] * 6, sequence=1)["reason"] == "malformed"
        assert send(stream, robot_dof_vel=["0.2"] * 6, seq=52)["reason"] == "malformed"
        assert send(stream, robot_dof_vel=[True] * 6, seq=53)["reason"] == "malformed"
    speeds = joint_columns(served.log(), "dq_cmd{}_rad_s")
    assert not speeds[-5:].any()
    for body in (b"", b"{", b"[" * 4000, b'{"robot_dof_vel": [1e999,0,0,0,0,0]}', b"x" * 5000, b"\xff\xfe", b"null"):
        status, said = served.ask("/set_dof_vel", body)
        assert status == 400 and said["error"] and len(said["error"]) < 200
    assert served.ask("/set_dof_vel", {"robot_dof_pos": HOME})[0] == 400
    assert served.ask("/set_dof_pos", {"robot_dof_pos": [0.0] * 6})[1]["reason"] == "outside"


def test_commands_over_the_limits_are_cut(served):
    """Ask for twice the speed limit towards a joint's end: limits of speed, acceleration and position hold."""
    served.home()
    with served.stream() as stream:
        for n in range(90):
            tick = newest(stream)
            said = send(stream, robot_dof_vel=[1.2, 0, 1.2, -1.6, 0, 0], seq=n, tick=tick["tick"])
            assert not said["accepted"] or said["clipped"]
    log = served.log()
    keeps_limits(log)
    sent = joint_columns(log, "dq_cmd{}_rad_s")
    assert sent[:, 0].max() == pytest.approx(np.radians(36), abs=1e-5)
    assert sent[:, 3].min() == pytest.approx(-np.radians(48), abs=1e-5)


def test_one_controller_at_a_time(served):
    """Refuse a second controller while the first holds the arm; let it in when the first is gone."""
    served.home()
    with served.stream() as second:
        with served.stream() as first:
            assert send(first, robot_dof_vel=STILL, seq=1)["accepted"]
            assert send(second, robot_dof_vel=[0.2] * 6, seq=1)["reason"] == "held"
            assert served.ask("/set_dof_vel", {"robot_dof_vel": [0.2] * 6})[0] == 409
            assert not newest(second)["sent"][0]
        end = time.monotonic() + 10
        while not send(second, robot_dof_vel=STILL, seq=int(time.monotonic() * 1e6))["accepted"]:
            assert time.monotonic() < end


def test_a_stop_holds_until_it_is_armed_again(served):
    """Stop a motion from another client: still, refused, not undone by an arming of another stop or by itself."""
    served.home()
    client = moving_client(served, "http")
    number = served.ask("/stop", {})[1]["stop"]
    assert client.wait(timeout=20) != 0, "the client was told"
    log = served.log()
    assert served.ask("/set_dof_vel", {"robot_dof_vel": [0.2] * 6})[1]["reason"] == "stopped"
    assert served.ask("/arm", {"stop": number - 1})[0] == 409 and served.ask("/arm", b"{}")[0] == 400
    time.sleep(0.5)
    assert served.ask("/status")[1]["state"] == "stopped"
    assert served.ask("/arm", {"stop": number})[0] == 200 and served.ask("/arm", {"stop": number})[0] == 409
    keeps_limits(log)
    time.sleep(0.3)
    assert not joint_columns(served.log(), "dq_cmd{}_rad_s")[-10:].any()


def test_strangers_are_kept_out(served):
    """Answer 401 without the right token, on the stream too, and 403 to pages in a browser; serve no way to end it."""
    for wrong in (None, "another token of letters", served.token[:-1], served.token + "x"):
        status, said = served.ask("/set_dof_vel", {"robot_dof_vel": [0.2] * 6}, token=wrong)
        assert status == 401 and "token" in said["error"]
    right, served.token = served.token, "wrong-token-wrong-token"
    with pytest.raises(InvalidStatus), served.stream():
        pass
    served.token = right
    assert served.ask("/status", Origin="http://example.org")[0] == 403
    assert served.ask("/status")[1]["refused"]["not let in"] >= 6
    for path in ("/shutdown", "/docs", "/openapi.json", "/"):
        assert served.ask(path)[0] == 404
    assert served.ask("/status")[0] == 200


def test_many_requests_leave_the_loop_its_rate(served):
    """Keep 60 ticks a second over some hundred requests: the median period is a sixtieth."""
    before = int(served.log()["tick"][-1])
    for _ in range(300):
        served.ask("/fetch_kinova_metrics")
    pace = served.ask("/status")[1]["pace"]
    assert int(served.log()["tick"][-1]) > before
    assert pace["median_s"] == pytest.approx(1 / 60, rel=0.05)


def test_a_full_disk_stops_the_arm_and_kill_leaves_a_whole_log(tmp_path, ended):
    """Fill the disk in a motion: stop, keep the log readable, stay stopped with room again; then kill with -9."""
    if not sys.platform.startswith("linux"):
        pytest.skip("a limit on another process's files is Linux's")
    limits = tmp_path / "limits.yaml"
    limits.write_text("format: robot-limits/1\nspeed_degps: [10, 10, 10, 10, 10, 10]\n")
    served = Served(tmp_path, "--away", "10", "--limits", limits, "--touch", some_touch_model(tmp_path))
    ended(served.process)
    client = moving_client(served, "stream")
    ended(client)
    log = served.out / "ticks.csv"
    limit_files(served.process.pid, size_of(log) + 5000)
    end = time.monotonic() + 20
    while served.ask("/status")[1]["state"] != "stopped":
        assert time.monotonic() < end
        time.sleep(0.02)
    status = served.ask("/status")[1]
    assert "log cannot be written" in status["cause"] and served.ask("/arm", {"stop": 1})[0] == 409
    whole = served.log()
    assert whole["state"][-1] == "moving"
    end = time.monotonic() + 1.0
    while not log.read_bytes().endswith(b"\n"):  # a part of a line stands there until it is cut, at once
        assert time.monotonic() < end
    time.sleep(0.5)
    limit_files(served.process.pid, -1)
    time.sleep(0.5)
    assert served.ask("/status")[1]["state"] == "stopped", "room alone restarts nothing"
    client.kill()
    assert served.ask("/arm", {"stop": 1})[0] == 200
    with served.stream() as stream:
        for n in range(30):
            seen = newest(stream)
            send(stream, robot_dof_vel=[0.1] * 6, seq=n, tick=seen["tick"])
        assert served.end(signal.SIGKILL) == -signal.SIGKILL
    after = served.log()
    ticks = np.array(after["tick"], int)
    assert ticks[-1] >= seen["tick"], "what a client saw is in the log"
    gaps = np.flatnonzero(np.diff(ticks) != 1)
    assert len(gaps) == 1 and ticks[gaps[0]] == int(whole["tick"][-1])
    keeps_limits({k: v[gaps[0] + 1 :] for k, v in after.items()})
    assert np.abs(joint_columns(after, "dq_cmd{}_rad_s")).max() == pytest.approx(np.radians(10), abs=1e-5)
    assert 0.0 < max(map(float, after["touch"])) < 0.9


def test_a_robot_behind_rosbridge(tmp_path):
    """Serve a scripted rosbridge: begin stopped, move once armed, in degrees, stop at a torque, end by SIGTERM."""
    pytest.importorskip("roslibpy")
    peer = Peer(
        [f"j2n6s200_joint_{k}" for k in range(1, 7)], lambda m: [np.radians(m[f"joint{k}"]) for k in range(1, 7)]
    )
    options = ("--backend", "rosbridge", "--rosbridge", f"127.0.0.1:{peer.port}", "--robot-name", "j2n6s200")
    served = Served(tmp_path, *options, settle=False)
    try:
        assert served.ask("/set_dof_vel", {"robot_dof_vel": [0.1] * 6})[1]["reason"] == "stopped"
        served.settled()
        before = peer.q.copy()
        for _ in range(30):
            assert served.ask("/set_dof_vel", {"robot_dof_vel": [0, 0, 0, 0, 0, -0.3]})[0] == 200
            time.sleep(1 / 60)
        assert set(peer.advertised) == {"/j2n6s200_driver/in/joint_velocity"}
        assert peer.q[5] < before[5] - 0.05 and peer.q[:5] == pytest.approx(before[:5])
        assert served.ask("/fetch_kinova_metrics")[1]["robot_dof_pos"][0] == pytest.approx(peer.q[0])
        peer.spoil = {"effort": [0.0, 0.0, 33.0, 0.0, 0.0, 0.0]}
        end = time.monotonic() + 20
        while served.ask("/status")[1]["state"] != "stopped":
            assert time.monotonic() < end
        assert served.ask("/status")[1]["cause"].startswith("torque of joint 3: 33.0 N m over 32")
        assert served.ask("/arm", {"stop": 2})[1]["error"].startswith("still so: torque")
    finally:
        assert served.end(signal.SIGTERM) == 0
        peer.close()
    assert not any(peer.published[-1][2].values())
    assert min(m[2]["joint6"] for m in peer.published) == pytest.approx(np.degrees(-0.3))


def test_options_that_cannot_be_are_refused(inside, tmp_path):
    """Say in one line what is wrong with an address, a token, limits, a log that is there, and write nothing."""
    out = tmp_path / "log"

    def serve(*options):
        return inside("robot", "serve", "--out", out, "--port", 0, *options)

    serve("--host", "0.0.0.0").refused("--host", "--token-file")
    short, shared = tmp_path / "short", tmp_path / "shared"
    short.write_text("secret")
    shared.write_text("a-token-that-is-long-enough")
    shared.chmod(0o644)
    serve("--token-file", short).refused("6 characters", "16 or more")
    serve("--token-file", shared).refused("others may read", "chmod 600")
    serve("--certificate", shared).refused("--certificate", "--key")
    serve("--certificate", shared, "--key", shared).refused("--certificate", "no pair")
    limits = tmp_path / "limits.yaml"
    for text, words in {
        "speed_degps: [37, 36, 36, 48, 48, 48]": ("speed_degps", "36"),
        "torque_Nm: [1, 1]": ("torque_Nm", "above zero, [50"),  # 1.25 times the servo's 40 N m
        "lower_deg: [0, 0, 0, 0, 0, 0]": ("lower_deg", "47"),
        "lease_s: 0.5": ("lease_s", "0.1"),
        "workspace_low_m: [2, 0, 0]": ("workspace_low_m", "low below high"),
        "sped: 1": ("sped",),
    }.items():
        limits.write_text(f"format: robot-limits/1\n{text}\n")
        serve("--limits", limits).refused("line 2", *words)
    serve("--away", -1).refused("--away")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        inside("robot", "serve", "--out", out, "--port", taken.getsockname()[1]).refused("--port", "in use")
    out.mkdir()
    (out / "ticks.csv").write_text("")
    serve().refused("ticks.csv", "never overwritten")
    (out / "ticks.csv").unlink()
    out.rmdir()
    serve("--backend", "rosbridge", "--rosbridge", "nowhere").refused("HOST:PORT")
    assert not out.exists()
    printed = inside("robot", "limits")
    limits.write_text(printed.out)
    as_json, as_yaml = json.loads(inside("robot", "limits", "--json").out), yaml.safe_load(printed.out)
    assert as_json["torque_Nm"] == as_yaml["torque_Nm"] and as_json["lower_deg"][:2] == [None, 47]
    json_page.check("robot limits", as_json)
    assert printed.code == 0
    from bough.learn.robot.limits import default_limits, read_limits

    read, default = read_limits(limits, jaco2()), default_limits(jaco2())
    assert read.speed == pytest.approx(default.speed) and read.lower == pytest.approx(default.lower)
    wide = inside("robot", "limits", "--scene", "powerline")
    limits.write_text(wide.out)
    read = read_limits(limits, jaco2())
    # actions are joint speeds, ten a second: from one limit of the speed to the other in a tenth of a second
    assert read.acceleration == pytest.approx(20.0 * jaco2().velocity_limit, rel=1e-5)
    assert (read.torque > jaco2().torque_limit).all() and read.lease == default.lease
    assert read.workspace_low[2] < 0.0 == default.workspace_low[2]  # tasks have no table
    inside("robot", "limits", "--scene", "nowhere").refused("robot limits", "--scene", "nowhere", "powerline, reach")
