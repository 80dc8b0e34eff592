"""How well ``bough robot serve`` keeps its 60 Hz, and how soon the arm stands when its client is gone.

The service is a process of its own with a twin among branches. Periods between ticks are those of its log: alone, and
while a client steers it over the stream, two watch, and as many HTTP requests come as two more can send without a
pause. Then clients that move the arm are killed with -9, some over the stream and some over HTTP; counted is the time
from the tick at which the last command was accepted to that at which every joint is below 0.02 rad/s.

Run: ``python benchmarks/robots/robot.py [--quick] [--seed n]``
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import measuring
import numpy as np
from bough.learn.robot.log import joint_columns
from measuring import Figure
from oracles.robot.service import CLIENT, Served, moving_client

POLL = """
import sys, urllib.request
port, headers = sys.argv[1], {"Authorization": f"Bearer {sys.argv[2]}"}
while True:
    request = urllib.request.Request(f"http://127.0.0.1:{port}/fetch_kinova_metrics", headers=headers)
    urllib.request.urlopen(request).read()
"""
WATCH = """
import sys
from websockets.sync.client import connect
socket = connect(f"ws://127.0.0.1:{sys.argv[1]}/stream", additional_headers={"Authorization": f"Bearer {sys.argv[2]}"})
while True:
    socket.recv()
"""


def measured(options: argparse.Namespace) -> list[Figure]:
    """Measure and print."""
    seconds, kills = (5.0, 2) if options.quick else (60.0, 20)
    with tempfile.TemporaryDirectory() as folder:
        served = Served(Path(folder), "--seed", str(options.seed))
        try:
            time.sleep(2.0)  # what the start has to do besides
            figures = paced(served, "alone", seconds, [])
            figures += paced(served, "busy", seconds, [CLIENT, WATCH, WATCH, POLL, POLL])
            return [*figures, standing(served, kills)]
        finally:
            served.end(signal.SIGINT)


def paced(served: Served, case: str, seconds: float, programs: list[str]) -> list[Figure]:
    """Return median, 99th percentile and greatest period between ticks [ms] while clients run."""
    where = [str(served.port), served.token]
    clients = [subprocess.Popen([sys.executable, "-c", text, *where, "stream"]) for text in programs]
    time.sleep(3.0)
    first, taken = len(served.log()["tick"]), served.ask("/status")[1]["accepted"]
    time.sleep(seconds)
    rows = np.diff(np.array(served.log()["time_s"][first:], float)) * 1e3
    taken = served.ask("/status")[1]["accepted"] - taken
    for client in clients:
        client.kill()
        client.wait()
    middle, late = np.percentile(rows, (50, 99))
    periods = f"median {middle:.2f}, 99th percentile {late:.2f}, greatest {rows.max():.2f} ms of {len(rows)}"
    print(f"{case}: period {periods}; {taken} commands taken; load of the machine {os.getloadavg()[0]:.1f}")
    return [Figure(case, "99th percentile of the period", float(late), "ms"),
            Figure(case, "median period", float(middle), "ms")]  # fmt: skip


def standing(served: Served, kills: int) -> Figure:
    """Return the longest time until the arm stood after its client was killed [ms]."""
    found = []
    for n in range(kills):
        served.settled()
        client = moving_client(served, ("stream", "http")[n % 2])
        client.kill()
        client.wait()
        time.sleep(0.5)
        log = served.log()
        time_s, accepted = np.array(log["time_s"], float), np.array(log["accepted"], int)
        speed = np.abs(joint_columns(log, "dq{}_rad_s")).max(axis=1)
        last = np.flatnonzero(np.diff(accepted, prepend=0))[-1]
        found.append(1e3 * (time_s[np.flatnonzero(speed > 0.02)[-1] + 1] - time_s[last]))
    print(f"standing {np.median(found):.0f} ms after the last command (median of {kills}), {max(found):.0f} at most")
    return Figure("client killed", "time to standstill", float(max(found)), "ms")


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    return measuring.quick_and_seed(__doc__, "5 seconds instead of 60, 2 kills instead of 20")


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "robot"))
