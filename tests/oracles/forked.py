"""Programs in processes of their own that need not import torch, Warp and MuJoCo again: three seconds of each command.

A server imports them once and forks for every program. Nothing has run there before: no device, no thread, no file is
open. What a program prints, its exit code and its end are those of ``python -m bough`` or ``python file.py``.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

#: Imported before the fork: what commands import when they are run.
AHEAD = (
    "torch", "warp", "mujoco", "scipy.optimize", "scipy.stats", "matplotlib.pyplot", "bough.cli.main",
    "bough.learn.gap.diagnose", "bough.learn.gap.report", "bough.learn.inference.report", "bough.learn.policies.train",
    "bough.sim.engine.simulator",
)  # fmt: skip
#: Seconds after which a program that hangs is ended. The longest, an exam of one hard case, takes 210 s beside another
#: worker without AVX-512.
LIMIT = 600


class Forked:
    """Runs programs in the present folder, one at a time; the server begins with the first."""

    def __init__(self) -> None:
        self._server: subprocess.Popen | None = None
        self._environment: dict[str, str] = {}

    def suits(self) -> bool:
        """Return whether the environment is that of the server: some variables are read when a library is imported."""
        return self._server is None or self._environment == _environment()

    def run(self, *words: object) -> subprocess.CompletedProcess:
        """Run ``bough`` with words, or a file if the first ends in ``.py``; return exit code and what was printed."""
        server = self._start()
        with tempfile.TemporaryDirectory() as folder:
            request = {"words": [str(w) for w in words], "cwd": os.getcwd(), "out": folder}
            request["test"] = os.environ.get("PYTEST_CURRENT_TEST", "")
            server.stdin.write(json.dumps(request) + "\n")
            server.stdin.flush()
            code = int(server.stdout.readline())
            out, err = ((Path(folder) / name).read_text() for name in ("out", "err"))
        return subprocess.CompletedProcess(words, code, out, err)

    def _start(self) -> subprocess.Popen:
        if self._server is None:
            self._environment = _environment()
            self._server = subprocess.Popen([sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                            text=True)  # fmt: skip
        return self._server

    def close(self) -> None:
        """End the server."""
        if self._server is not None:
            self._server.communicate()


def _environment() -> dict[str, str]:
    return {k: v for k, v in os.environ.items() if k not in ("PYTEST_CURRENT_TEST", "PWD")}


def serve() -> dict | None:
    """Answer requests until there are no more; in a forked process return its request."""
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            return json.loads(line)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
    return None


def become(request: dict) -> None:
    """Be the program that was asked for."""
    signal.alarm(LIMIT)
    os.chdir(request["cwd"])
    os.environ["PYTEST_CURRENT_TEST"] = request["test"]
    for number, path in ((0, os.devnull), (1, f"{request['out']}/out"), (2, f"{request['out']}/err")):
        os.dup2(os.open(path, os.O_RDWR | os.O_CREAT, 0o600), number)
    name = request["words"][0] if request["words"] else ""
    if name.endswith(".py"):
        sys.argv, sys.path[0] = request["words"], str(Path(name).parent)
        runpy.run_path(name, run_name="__main__")
    else:
        sys.argv, sys.path[0] = ["bough", *request["words"]], os.getcwd()
        runpy.run_module("bough", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    for module in AHEAD:
        importlib.import_module(module)
    gc.collect()
    gc.freeze()  # else the end of a program would copy all memory to take it apart, 1.7 s
    asked = serve()
    if asked is not None:
        become(asked)
