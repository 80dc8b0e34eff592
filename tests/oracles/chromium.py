"""A headless Chromium, driven over its DevTools protocol: opens pages, moves the mouse, keeps what is logged."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

_FLAGS = (
    "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-extensions",
    "--use-angle=gl-egl", "--ignore-gpu-blocklist",  # Mesa's llvmpipe: 400 times as fast as Chromium's own software GL
    "--remote-debugging-port=0", "--remote-allow-origins=*", "--mute-audio",
)  # fmt: skip


def chromium_or_skip() -> str:
    """Return the browser's path; skip the test where there is none."""
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        pytest.skip("no Chromium on this machine (Debian: apt-get install chromium)")
    return found


class Chromium:
    """One tab.

    Attributes:
        errors: What the page logged as an error or did not catch, in order.
    """

    def __init__(self, folder: Path, size: tuple[int, int] = (1000, 700)) -> None:
        from websockets.sync.client import connect

        self.errors: list[str] = []
        command = [chromium_or_skip(), *_FLAGS, f"--user-data-dir={folder}", f"--window-size={size[0]},{size[1]}",
                   "about:blank"]  # fmt: skip
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port = _until(lambda: _port(folder / "DevToolsActivePort"), 30.0)
        tabs = json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/json"))
        tab = next(t for t in tabs if t["type"] == "page")
        self._socket = connect(tab["webSocketDebuggerUrl"], max_size=None)
        self._number = itertools.count(1)
        for name in ("Page", "Runtime", "Log"):
            self.call(f"{name}.enable")
        width, height = size
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def call(self, method: str, **given: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        number = next(self._number)
        self._socket.send(json.dumps({"id": number, "method": method, "params": given}))
        while True:
            message = json.loads(self._socket.recv(timeout=60.0))
            self._note(message)
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]

    def _note(self, message: dict[str, Any]) -> None:
        given = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.errors.append(str(given["exceptionDetails"]))
        if message.get("method") == "Log.entryAdded" and given["entry"]["level"] == "error":
            self.errors.append(given["entry"]["text"] + " " + given["entry"].get("url", ""))
        if message.get("method") == "Runtime.consoleAPICalled" and given["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(a.get("value", a.get("description"))) for a in given["args"]))

    def open(self, url: str) -> None:
        """Go to a page."""
        self.call("Page.navigate", url=url)

    def value(self, expression: str) -> Any:
        """Return what a JavaScript expression is, promises awaited."""
        found = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, expression: str, seconds: float = 60.0) -> None:
        """Wait until a JavaScript expression is true."""
        _until(lambda: self.value(f"!!({expression})"), seconds)

    def picture(self, file: Path) -> bytes:
        """Return and write a PNG of the tab."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        file.write_bytes(data)
        return data

    def mouse(self, kind: str, x: float, y: float, *, pressed: bool = False) -> None:
        """Send ``mousePressed``, ``mouseMoved`` or ``mouseReleased``."""
        button = "left" if pressed or kind != "mouseMoved" else "none"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=int(pressed), clickCount=1)

    def key(self, name: str, code: int) -> None:
        """Press and release a key by its name and its virtual key code."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=name, code=name, windowsVirtualKeyCode=code)

    @property
    def process(self) -> int:
        """Number of the browser's process."""
        return self._process.pid

    def close(self) -> None:
        """End the browser."""
        self._socket.close()
        self._process.terminate()
        self._process.wait(timeout=20.0)


def _port(file: Path) -> str | None:
    return file.read_text().splitlines()[0] if file.exists() and file.read_text() else None


def _until(found: Callable[[], Any], seconds: float) -> Any:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        value = found()
        if value:
            return value
        time.sleep(0.1)
    raise AssertionError(f"not within {seconds:g} s")
