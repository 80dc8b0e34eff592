"""What is true in a twin, over its service: perfect clouds, forces, where the target is, and whether it was reached."""

from __future__ import annotations

import contextlib
import json
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Protocol

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..cameras.frames import Clouds
from ..robot.client import LostError, RefusedError, authorization, trusted
from ..robot.wire import unpacked

FAST, SLOW = 30.0, 5.0
"""How often the truth is asked for [Hz]: as a camera would be, and where only the end of an episode is waited for."""

Facts = dict[str, Array]


class Truth(Protocol):
    """What is true in a twin."""

    def begin(self, number: int) -> Facts:
        """Begin the scene of a number, while a stop holds; return what is true of it."""
        ...

    def told(self) -> tuple[float, Facts]:
        """Return what was true last and when [s], on the loop's clock."""
        ...

    def close(self) -> None:
        """End."""
        ...


class TwinTruth:
    """Asks a service's twin again and again, in a thread of its own (`Truth`)."""

    def __init__(self, url: str, token: str | None, certificate: Path | None, rate: float = FAST) -> None:
        """Ask for the first time.

        Args:
            url: Address of the service, without a token.
            token: What it wants clients to say, None for nothing.
            certificate: PEM file that vouches for it, None for those that the machine trusts.
            rate: How often to ask [Hz].

        Raises:
            InputError: It has no twin that holds a scene.
        """
        self._url, self._token, self._trust, self.rate = url, token, trusted(url, certificate), rate
        self._problem = ""
        self._ended = threading.Event()
        try:
            self._latest = self._asked()
        except RefusedError as error:
            raise InputError(url, "", str(error), "bough robot serve --scene, which knows what is true") from None
        self._thread = threading.Thread(target=self._run, name="truth", daemon=True)
        self._thread.start()

    def begin(self, number: int) -> Facts:
        """Begin the scene of a number, while a stop holds; return what is true of it.

        Raises:
            RefusedError: No stop holds, or there is no such scene.
            LostError: The service is gone.
        """
        self._ask("/twin/episode", json.dumps({"number": number}).encode())
        self._latest = self._asked()
        return self._latest[1]

    def told(self) -> tuple[float, Facts]:
        """Return what was true last, and when it was asked for [s].

        Raises:
            LostError: The service is gone.
        """
        if self._problem:
            raise LostError(self._problem)
        return self._latest

    def close(self) -> None:
        """Ask no more."""
        self._ended.set()
        self._thread.join(timeout=2.0)

    def _run(self) -> None:
        while not self._ended.wait(1.0 / self.rate):
            try:
                self._latest = self._asked()
            except (LostError, RefusedError) as error:
                self._problem = str(error)
                return

    def _asked(self) -> tuple[float, Facts]:
        now = time.monotonic()
        try:
            return now, unpacked(self._ask("/twin/truth", None))
        except ValueError:
            raise LostError("/twin/truth is answered otherwise") from None

    def _ask(self, path: str, body: bytes | None) -> bytes:
        request = urllib.request.Request(self._url + path, body, authorization(self._token))
        try:
            with urllib.request.urlopen(request, timeout=60.0, context=self._trust) as answer:
                data: bytes = answer.read()
                return data
        except urllib.error.HTTPError as error:
            said: dict[str, str] = {}
            with contextlib.suppress(ValueError):
                said = json.loads(error.read())
            raise RefusedError(said.get("reason", str(error.code)), said.get("error", error.reason)) from None
        except OSError as error:
            raise LostError(f"{path} is not answered ({' '.join(str(error).split())[:80]})") from None


class TruthClouds:
    """The twin's own points as a source of clouds (`learn.cameras.frames.CloudSource`), a perfect camera's.

    Attributes:
        trouble: Always empty.
    """

    trouble = ""

    def __init__(self, truth: Truth) -> None:
        """Take what asks for the truth."""
        self._truth = truth

    def latest(self) -> Clouds | None:
        """Return the newest points; None for a scene without a line."""
        when, facts = self._truth.told()
        if "line" not in facts:
            return None
        return Clouds(when, facts["branches"].astype(np.float32), facts["line"].astype(np.float32))

    def tell(self, time: float, q: Array) -> None:
        """Take the arm's joints, which nothing has to be cut out with."""

    def close(self) -> None:
        """Leave the truth to whoever has opened it."""


def succeeded(facts: Facts) -> bool:
    """Return whether the task's own measure says success so far."""
    return bool(facts.get("measure success", np.zeros(())) > 0)
