"""Log, access, touch and a backend of one's own: the service's parts by themselves, and over TLS."""

import json
import ssl
import subprocess
import sys
import textwrap
import time
import urllib.request

import numpy as np
import pytest
from bough.learn.robot.access import Access, is_loopback
from bough.learn.robot.backend import Sample
from bough.learn.robot.guard import Guard
from bough.learn.robot.limits import RAMP, default_limits
from bough.learn.robot.log import joint_columns, read_log
from bough.learn.robot.service import Service
from bough.learn.robot.workspace import Workspace
from bough.learn.touch.read import read_recordings
from bough.sim.arms.jaco2 import jaco2
from bough.sim.base.errors import InputError

ARM = jaco2()
LIMITS = default_limits(ARM)


class Arm:
    """An arm that does what it is told, until it is spoilt."""

    num_dofs = 6

    def __init__(self):
        self.q, self.velocity, self.then, self.fails = ARM.home.copy(), np.zeros(6), None, False

    def read(self, now):
        if self.fails:
            raise OSError("cable off")
        self.q = self.q + self.velocity * (0.0 if self.then is None else now - self.then)
        self.then = now
        return Sample(now, self.q, self.velocity, np.zeros(6), np.zeros(3), np.array([1.0, 0, 0, 0]))

    def send(self, velocity):
        self.velocity = velocity

    def close(self):
        assert not self.velocity.any()


def service_of(folder, arm):
    clearance = Workspace(ARM, LIMITS.workspace_low, LIMITS.workspace_high).clearance
    return Service(arm, Guard(LIMITS, clearance, True), folder)


def run(service, seconds, done=lambda: False):
    end = time.monotonic() + seconds
    while time.monotonic() < end and not done():
        time.sleep(0.01)


def test_the_log_is_whole_and_read_by_touch(tmp_path):
    """Log every tick once, with what was sent; leave a torn line out; let `bough touch` read the same file."""
    service = service_of(tmp_path, Arm())
    service.start()
    run(service, 10.0, lambda: service.latest and service.latest.number > 5)
    service.command('a, "b"\n', "velocity", np.full(6, 0.05))
    run(service, 0.3)
    service.close()
    log = read_log(tmp_path)
    assert list(map(int, log["tick"])) == list(range(1, len(log["tick"]) + 1))
    assert joint_columns(log, "dq_cmd{}_rad_s").max() == pytest.approx(0.05) and "a   b  " in log["controller"]
    (recording,) = read_recordings(tmp_path)
    assert recording.command.max() == pytest.approx(0.05) and recording.num_dofs == 6
    whole = (tmp_path / "ticks.csv").read_bytes()
    (tmp_path / "ticks.csv").write_bytes(whole[:-7])
    assert read_log(tmp_path)["tick"] == log["tick"][:-1]
    with pytest.raises(InputError, match="never overwritten"):
        service_of(tmp_path, Arm())
    (tmp_path / "ticks.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="line 1"):
        read_log(tmp_path)


def test_an_arm_that_fails_stops_and_one_that_comes_back_stays_stopped(tmp_path):
    """Stop when the driver raises, say its words, refuse to arm until it is back, and move for nobody until armed."""
    arm = Arm()
    service = service_of(tmp_path, arm)
    service.start()
    run(service, 10.0, lambda: service.latest and service.latest.number > 5)
    arm.fails = True
    run(service, 10.0, lambda: service.guard.stop)
    assert "cable off" in service.guard.stop.cause and not service.arm(1).accepted
    arm.fails = False
    run(service, 10.0, lambda: not service.guard.danger)
    assert service.guard.stop and service.command("a", "velocity", np.full(6, 0.1))[0].reason == "stopped"
    assert service.arm(1).accepted
    service.close()


class SlowArm(Arm):
    """An arm whose reads take 40 ms, which keeps what it was sent and when."""

    def __init__(self):
        super().__init__()
        self.sent = []

    def read(self, now):
        time.sleep(0.04)
        return super().read(now)

    def send(self, velocity):
        super().send(velocity)
        self.sent.append((time.monotonic(), np.abs(velocity).max()))


def test_a_lease_that_ends_while_the_arm_is_read_has_ended(tmp_path):
    """Read an arm slowly: each tick is logged at the time of the guard's step, and no lease outlives its deadline.

    The command is taken while a read goes on. A guard that is stepped with the time of the tick's beginning keeps the
    arm moving up to a read's 40 ms beyond the deadline, and logs the command with a tick from before it was sent.
    """
    arm = SlowArm()
    service = service_of(tmp_path, arm)
    service.start()
    run(service, 10.0, lambda: service.latest and service.latest.number > 5)
    taken, done = [], []
    for _ in range(40):  # half a second of leases, begun anywhere in a tick
        taken.append(time.monotonic())
        assert service.command("a", "velocity", np.full(6, 0.2))[0].accepted
        done.append(time.monotonic())
        time.sleep(0.0137)
    run(service, 10.0, lambda: arm.sent[-1][0] > done[-1] + 0.4)
    service.close()
    log = read_log(tmp_path)
    accepted, stamps = np.array(log["accepted"], int), np.array(log["time_s"], float) + service._began
    counted = np.searchsorted(taken, stamps + 1e-4, side="right")  # begun before a tick's time; the log rounds
    assert (accepted <= counted).all() and accepted[-1] == 40
    assert joint_columns(log, "dq_cmd{}_rad_s").max() > 0.1
    speeds = joint_columns(log, "dq_cmd{}_rad_s")[stamps > done[-1] + LIMITS.lease + RAMP + 1e-4]
    assert len(speeds) > 2 and not speeds.any()


def test_a_fault_of_our_own_sends_zeros(tmp_path, monkeypatch):
    """Let the guard itself fail in a motion: the arm is sent zeros, the loop goes on, and it stops for that reason."""
    arm = Arm()
    service = service_of(tmp_path, arm)
    service.start()
    run(service, 10.0, lambda: service.latest and service.latest.number > 5)
    service.command("a", "velocity", np.full(6, 0.2))
    run(service, 10.0, lambda: arm.velocity.any())
    right = service.guard.step
    monkeypatch.setattr(service.guard, "step", lambda *_: 1 / 0)
    run(service, 10.0, lambda: not arm.velocity.any())
    assert not arm.velocity.any()
    monkeypatch.setattr(service.guard, "step", right)
    run(service, 10.0, lambda: service.guard.stop)
    assert "ZeroDivisionError" in service.guard.stop.cause
    service.close()


@pytest.mark.parametrize(
    ("headers", "token", "status"),
    [
        ({"host": "localhost:3738"}, None, 200),
        ({"host": "127.0.0.1"}, None, 200),
        ({"host": "[::1]:3738"}, None, 200),
        ({"host": "[::1]"}, None, 200),
        ({"host": "rebound.example.org:3738"}, None, 403),
        ({"host": "127.0.0.1.example.org"}, None, 403),
        ({}, None, 403),
        ({"host": "localhost", "origin": "null"}, None, 403),
        ({"host": "robot.lan", "authorization": "Bearer right-right-right"}, "right-right-right", 200),
        ({"host": "robot.lan", "authorization": "bearer right-right-right"}, "right-right-right", 200),
        ({"host": "robot.lan", "authorization": "Basic eDpyaWdodC1yaWdodC1yaWdodA=="}, "right-right-right", 200),
        ({"host": "robot.lan", "authorization": "Basic !!!"}, "right-right-right", 401),
        ({"host": "robot.lan", "authorization": "right-right-right"}, "right-right-right", 401),
        ({"host": "localhost"}, "right-right-right", 401),
    ],
)
def test_who_is_let_in(headers, token, status):
    """Let in loopback by its names alone, or the token alone; never a page in a browser."""
    import asyncio

    sent, counted = [], []

    async def app(_scope, _receive, send):
        await send({"type": "http.response.start", "status": 200})

    async def receive():
        return {"type": "http.request"}

    async def send(message):
        sent.append(message)

    scope = {"type": "http", "headers": [(k.encode(), v.encode()) for k, v in headers.items()]}
    asyncio.run(Access(app, token, counted.append)(scope, receive, send))
    assert sent[0]["status"] == status and len(counted) == (status != 200)


def test_loopback():
    """Tell this machine's own addresses from others."""
    assert all(map(is_loopback, ("127.0.0.1", "127.8.8.8", "::1", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.168.1.5", "localhost.example.org", "")))


def test_touch_is_told_as_in_recordings():
    """Tell the same probability of touch sample by sample as the model tells of a whole recording at its rate."""
    pytest.importorskip("sklearn")
    from bough.learn.robot.touch import Feeler
    from bough.learn.touch.forest import grow_forest
    from bough.learn.touch.free_motion import FreeMotion
    from bough.learn.touch.model import TouchModel
    from bough.learn.touch.recording import Recording

    rng = np.random.default_rng(0)
    forest = grow_forest(rng.normal(size=(300, 90)), rng.integers(0, 2, 300), 0)
    model = TouchModel(FreeMotion(np.zeros((6, 5)), np.ones(6)), forest, "forest", 10.0, 0.4, ())
    torque, velocity, command = (rng.normal(size=(180, 6)) for _ in range(3))
    feeler, now = Feeler(model), np.arange(180) / 60.0
    told = [feeler.feel(t, Sample(t, ARM.home, v, tau, np.zeros(3), np.zeros(4)), c)
            for t, v, tau, c in zip(now, velocity, torque, command, strict=True)]  # fmt: skip
    rows = np.arange(0, 180, 6)
    means = np.array([command[max(k - 5, 0) : k + 1].mean(axis=0) for k in rows])
    whole = Recording("", now[rows], torque[rows], velocity[rows], means, np.zeros((30, 6)), np.zeros(30, int))
    assert np.array(told)[rows] == pytest.approx(model.probability(whole), abs=1e-6)
    assert len(set(told)) > 5


OWN = """
import sys
from pathlib import Path
import numpy as np
from bough.learn.robot.backend import Sample
from bough.learn.robot.limits import default_limits
from bough.learn.robot.serve import Address, serve
from bough.sim.arms.jaco2 import jaco2

class Still:
    num_dofs = 6
    def read(self, now):
        return Sample(now, jaco2().home, np.zeros(6), np.zeros(6), np.zeros(3), np.array([1.0, 0, 0, 0]))
    def send(self, velocity):
        pass
    def close(self):
        print("closed", flush=True)

arm, folder = jaco2(), Path(sys.argv[1])
address = Address(port=0, certificate=folder / "cert.pem", key=folder / "key.pem")
serve(Still, arm, default_limits(arm), address, folder / "log", armed=False, ready=lambda url: print(url, flush=True))
"""


def test_a_backend_of_one_s_own_over_tls(tmp_path):
    """Serve a class of three methods over https; begin stopped; close it at the end."""
    pytest.importorskip("fastapi")
    pytest.importorskip("uvicorn")
    make = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-keyout", "key.pem", "-out", "cert.pem",
            "-days", "2", "-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1"]  # fmt: skip
    try:
        subprocess.run(make, cwd=tmp_path, check=True, capture_output=True)
    except FileNotFoundError:
        pytest.skip("openssl makes the certificate")
    script = tmp_path / "own.py"
    script.write_text(textwrap.dedent(OWN))
    process = subprocess.Popen([sys.executable, script, tmp_path], stdout=subprocess.PIPE, text=True)
    try:
        url = process.stdout.readline().strip()
        assert url.startswith("https://127.0.0.1:")
        trusted = ssl.create_default_context(cafile=tmp_path / "cert.pem")
        said = json.loads(urllib.request.urlopen(f"{url}/status", context=trusted, timeout=20).read())
        assert (said["state"], said["cause"]) in (("stopped", "not armed yet"), ("starting", "not armed yet"))
    finally:
        process.terminate()
        out, _ = process.communicate(timeout=20)
    assert out == "closed\n"
