"""`bough robot serve` as a process with real sockets, clients that can be killed, and a wire that can be cut."""

from __future__ import annotations

import base64
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
from bough.learn.robot.log import joint_columns, read_log
from websockets.sync.client import connect

TOKEN = "a token of plain letters"


class Served:
    """A service of the twin with a token, and what is asked of it."""

    def __init__(self, folder: Path, *options: object, settle: bool = True) -> None:
        """Start it and wait until it listens."""
        self.out = folder / "log"
        secret = folder / "token"
        secret.write_text(TOKEN.replace(" ", "-"))
        secret.chmod(0o600)
        self.token = secret.read_text()
        command = [sys.executable, "-m", "bough", "robot", "serve", "--out", str(self.out), "--port", "0",
                   "--token-file", str(secret), *map(str, options)]  # fmt: skip
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                                        preexec_fn=_take_signals)  # fmt: skip
        line = self.process.stdout.readline()
        assert line.startswith("Serving http://127.0.0.1:"), line + self.process.stderr.read()
        self.port = int(line.split()[1].rsplit(":", 1)[1])
        if settle:
            self.settled()

    def ask(self, path: str, body: object = None, *, token: str | None = "", basic: bool = False, **headers: str):
        """Return the status and the JSON of an answer; GET without a body, POST with one."""
        data = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", data, headers)
        if token is not None:
            token = token or self.token
            basic64 = base64.b64encode(f"robot:{token}".encode()).decode()
            request.add_header("Authorization", f"Basic {basic64}" if basic else f"Bearer {token}")
        try:
            with urllib.request.urlopen(request, timeout=30) as answer:
                return answer.status, json.loads(answer.read())
        except urllib.error.HTTPError as error:
            return error.code, json.loads(error.read() or b"{}")

    def stream(self, port: int | None = None):
        """Return a connection to the stream, through another port where one is given."""
        headers = {"Authorization": f"Bearer {self.token}"}
        return connect(f"ws://127.0.0.1:{port or self.port}/stream", additional_headers=headers, close_timeout=0.5)

    def settled(self) -> dict:
        """Wait until the arm stands still, armed and free; return the status. Re-arms what stopped."""
        end = time.monotonic() + 30.0
        while time.monotonic() < end:
            status = self.ask("/status")[1]
            if status["state"] == "ready" and not status["controller"]:
                return status
            if status["state"] == "stopped":
                self.ask("/arm", {"stop": status["stop"]})
            time.sleep(0.05)
        raise AssertionError(status)

    def home(self) -> None:
        """Bring the arm to where it began, as tests leave it, and wait until it stands there and is free.

        It has arrived before it stands: what moves it for a while yet would pass for a client that is slow to start.
        """
        self.settled()
        status, said = self.ask("/set_dof_pos", {"robot_dof_pos": HOME})
        assert status == 200, said
        self.settled()

    def log(self) -> dict[str, list[str]]:
        """Return the log as it is now."""
        return read_log(self.out)

    def end(self, number: int) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(number)
        return self.process.wait(timeout=30)


HOME = [4.8046852, 2.92482, 1.002, 4.2031852, 1.4458, 1.3233]


def _take_signals() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background job would ignore


CLIENT = """
import json, sys, time, urllib.request
port, token, kind = int(sys.argv[1]), sys.argv[2], sys.argv[3]
headers = {"Authorization": f"Bearer {token}"}
speeds = [0.3, 0.0, 0.0, 0.3, 0.0, 0.0]
if kind == "stream":
    from websockets.sync.client import connect
    socket = connect(f"ws://127.0.0.1:{port}/stream", additional_headers=headers)
    for n in range(100000):
        state = json.loads(socket.recv())
        if "tick" in state:
            socket.send(json.dumps({"robot_dof_vel": speeds, "seq": n, "tick": state["tick"]}))
elif kind == "http":
    while True:
        body = json.dumps({"robot_dof_vel": speeds}).encode()
        urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}/set_dof_vel", body, headers)).read()
        time.sleep(1 / 60)
else:
    body = json.dumps({"robot_dof_pos": [6.8, 2.92482, 1.002, 4.2031852, 1.4458, 1.3233]}).encode()
    urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}/set_dof_pos", body, headers)).read()
"""


def moving_client(served: Served, kind: str) -> subprocess.Popen:
    """Start a client that moves the arm without end, and wait until it moves."""
    client = subprocess.Popen([sys.executable, "-c", CLIENT, str(served.port), served.token, kind])
    end = time.monotonic() + 30.0
    while served.ask("/status")[1]["state"] != "moving":
        assert time.monotonic() < end and client.poll() is None
        time.sleep(0.02)
    time.sleep(0.3)
    return client


def keeps_still(served: Served, grace: float = 0.150) -> None:
    """Check a log: speeds sent are zero 150 ms after the last accepted command, and the joints stand with them.

    Times are those of the log's own ticks, which are waited for, so that a slow machine cannot fail this: the guard
    caps speeds by the time, however many ticks there were. A joint may need two ticks to stand after the first zero:
    the servo's time constant is some 10 ms.
    """
    end = time.monotonic() + 20.0
    while True:
        log = served.log()
        time_s, accepted = np.array(log["time_s"], float), np.array(log["accepted"], int)
        last = np.flatnonzero(np.diff(accepted, prepend=0))[-1]
        after = time_s > time_s[last] + grace
        if after.sum() > 3:
            break
        assert time.monotonic() < end, f"{after.sum()} ticks in 20 s"
        time.sleep(0.05)
    sent, speed = joint_columns(log, "dq_cmd{}_rad_s"), joint_columns(log, "dq{}_rad_s")
    assert not sent[after].any()
    zero = np.flatnonzero(~sent.any(axis=1) & (np.arange(len(sent)) > last))[0]
    assert np.abs(speed[zero + 3 :]).max() < 0.02


def keeps_limits(log: dict[str, list[str]]) -> None:
    """Check a log: speeds sent are within 36 and 48 degrees a second and grow by 5 rad/s^2 at most."""
    sent, most = joint_columns(log, "dq_cmd{}_rad_s"), np.radians([36, 36, 36, 48, 48, 48])
    assert np.isfinite(sent).all() and (np.abs(sent) <= most + 1e-6).all()
    grew = np.diff(np.abs(sent), axis=0).max(axis=1)
    assert (grew <= 5.0 * np.minimum(np.diff(np.array(log["time_s"], float)), 1 / 30) + 1e-5).all()


class Wire:
    """A port that passes bytes on to another, and holds them back while it is paused."""

    def __init__(self, port: int) -> None:
        """Listen at a free port for one client."""
        self._flows = threading.Event()
        self._flows.set()
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._to = port
        threading.Thread(target=self._run, daemon=True).start()

    def pause(self) -> None:
        """Hold bytes back."""
        self._flows.clear()

    def resume(self) -> None:
        """Pass on what was held back, and what comes."""
        self._flows.set()

    def _run(self) -> None:
        near, _ = self._listening.accept()
        far = socket.create_connection(("127.0.0.1", self._to))
        other = {near: far, far: near}
        while True:
            for ready in select.select([near, far], [], [], 1.0)[0]:
                data = ready.recv(65536)
                self._flows.wait()
                if not data:
                    near.close()
                    far.close()
                    return
                other[ready].sendall(data)


def limit_files(process: int, size: int) -> None:
    """Let a process write no file beyond a size [bytes], -1 for any: what a full disk does, for one process."""
    import resource

    most = resource.RLIM_INFINITY
    resource.prlimit(process, resource.RLIMIT_FSIZE, (most if size < 0 else size, most))


def size_of(path: Path) -> int:
    """Return a file's size [bytes]."""
    return os.stat(path).st_size
