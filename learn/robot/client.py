"""A client of ``bough robot serve`` in Python: what a policy or an experiment steers an arm with.

    with RobotClient("http://localhost:3738", token=None) as robot:
        robot.latest                          # newest State; a thread of the client's own keeps it so
        state = robot.next(after=state)       # waits for a tick later than that of ``state``
        for state in robot.paced(60.0):       # the newest state, on this process's own clock
            robot.send(velocity, state)       # rad/s, numbered, answering ``state``: held-up commands are refused
        robot.wait_free()                     # until no other controller holds the arm
        robot.move_to(q, speed=0.3)           # rad/s, along a straight way in joints; returns the state there
        robot.grip(1.0)                       # closes the gripper (0 opens it) and waits until it is; arm at rest
        robot.halt()                          # zero speed, and wait until the arm stands
        robot.status()                        # GET /status
        robot.stop(); robot.arm()             # latch a stop; re-arm the one that holds
        robot.accepted, robot.refused         # how many commands were; Counter of refusals by reason

All of it is one controller, the stream's: one lease of 100 ms a command, and nothing here says a command again.
Whoever stops sending lets the arm come to a standstill. A stop raises `StoppedError` at the next call, a refusal that
does not pass within a lease `RefusedError`, a service that is gone `LostError`; what was never right (an address, a
token) is an `InputError`.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import ssl
import threading
import time
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

import numpy as np

from ...sim.base.errors import InputError, shortened
from ...sim.base.extras import install_hint
from ...sim.base.types import Array
from .backend import unmeasured

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

SILENT = 3.0
"""Longest wait for a tick [s]; a service ticks 60 times a second."""

NEEDED = ("tick", "time_s", "robot_dof_pos", "robot_dof_vel", "robot_dof_torque", "hand_pos", "hand_rot")
"""Fields without which a message is no tick."""

_CLOSED, _GRIPPED = 0.05, 1.0  # share of the way; s for which fingers that hold something do not move
_NEAR, _STILL = 0.01, 0.05  # rad from a goal, rad/s: as the guard has them
_FADING = ("late",)  # what is refused now and then on a busy machine, and forgotten with the next command
_PATIENCE = 0.5  # s that refusals of another kind may last
_APPROACH = 2.0  # 1/s: rate at which the last of a way shrinks


class RobotError(Exception):
    """Why an arm could not be steered further; one line."""


class StoppedError(RobotError):
    """A stop holds.

    Attributes:
        number: Its number, for `RobotClient.arm`.
        cause: Why.
    """

    def __init__(self, number: int, cause: str) -> None:
        super().__init__(f"stop {number}: {cause}")
        self.number, self.cause = number, cause


class RefusedError(RobotError):
    """A command was refused for good.

    Attributes:
        reason: A word of `learn.robot.guard.REASONS`.
    """

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(f"{reason}: {text}")
        self.reason = reason


class LostError(RobotError):
    """The service is gone or silent."""


@dataclass(frozen=True)
class State:
    """A tick of the service.

    Attributes:
        tick: Its number.
        time: On the service's clock [s].
        received: When it came, on this process's clock (`time.monotonic`) [s].
        q: Joint positions [rad], [D].
        qd: Joint speeds [rad/s], [D].
        torque: Joint torques without what carries the arm [N m], [D].
        hand_position: Of the end-effector in the base frame [m], [3].
        hand_rotation: Its orientation, w, x, y, z, [4].
        touch: Probability of touch.
        state: ``ready``, ``moving`` or ``stopped``.
        stop: Number of the stop that holds, 0 for none.
        cause: Why it holds.
        said: The whole message.
        gripper: How far it is closed, 0 to 1; NaN for an arm without one.
        force: Of the hand on what it holds, by a sensor [N], [3]; NaN without one.
        tag: Where a camera sees a tag [m], [3]; NaN without one.
    """

    tick: int
    time: float
    received: float
    q: Array
    qd: Array
    torque: Array
    hand_position: Array
    hand_rotation: Array
    touch: float
    state: str
    stop: int
    cause: str
    said: dict[str, Any]
    gripper: float = np.nan
    force: Array = field(default_factory=unmeasured)
    tag: Array = field(default_factory=unmeasured)


def state_of(said: dict[str, Any], received: float) -> State:
    """Return a message of the stream as a state; numbers that were not finite are NaN."""
    q, qd, torque, hand, turn = (_numbers(said[key]) for key in NEEDED[2:])
    force, tag = (_numbers(said.get(key, [None] * 3)) for key in ("hand_force", "tag_pos"))
    return State(
        int(said["tick"]), float(said["time_s"]), received, q, qd, torque, hand, turn[[3, 0, 1, 2]],
        float(said.get("touch") or 0.0), str(said.get("state", "")), int(said.get("stop") or 0),
        str(said.get("cause", "")), said, float(said.get("robot_gripper", np.nan)), force, tag,
    )  # fmt: skip


def _numbers(values: list[float | None]) -> Array:
    return np.array([np.nan if v is None else v for v in values], dtype=np.float64)


class RobotClient:
    """Steers the arm behind a service; use it in a ``with``, from one thread.

    Attributes:
        url: Address of the service, without a token.
        accepted: Commands that were accepted.
        clipped: Of those the ones of which a speed was cut.
        refused: Commands that were refused, by reason.
        listeners: Called with every state that comes, in the client's own thread; they must not wait.
    """

    def __init__(self, url: str, token: str | None = None, certificate: Path | None = None) -> None:
        """Connect, and wait for the first tick.

        Args:
            url: ``http://HOST:PORT`` or ``https://HOST:PORT``; ``http://user:TOKEN@HOST:PORT`` says a token too.
            token: What the service wants clients to say, None where it wants none.
            certificate: PEM file that vouches for a service over https, None for those that the machine trusts.

        Raises:
            InputError: There is no service, it wants a token, or it speaks otherwise.
        """
        self.url, own = _split(url)
        self._token = token or own
        self._trust = trusted(self.url, certificate)
        self._begin()
        self._socket = connect_stream(self.url, self._token, self._trust)
        self._thread = threading.Thread(target=self._listen, name="robot client", daemon=True)
        self._thread.start()
        try:
            self.next()
        except LostError as error:
            self.close()
            raise InputError(self.url, "", str(error), "a running bough robot serve") from None

    def _begin(self) -> None:
        self.accepted = self.clipped = 0
        self.refused: Counter[str] = Counter()
        self.listeners: list[Callable[[State], None]] = []
        self._latest: State | None = None
        self._refusal: tuple[str, str, float] | None = None  # reason, sentence, since when without one accepted
        self._problem = ""
        self._numbers = itertools.count(1)
        self._news = threading.Condition()

    def __enter__(self) -> RobotClient:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let go of the arm: the service brings it to a standstill."""
        self.close()

    def close(self) -> None:
        """Close the connection; the service lets the arm stand."""
        self._socket.close()
        self._thread.join(timeout=2.0)

    # ---- what the arm does -------------------------------------------------------------------------------------------

    @property
    def latest(self) -> State:
        """The newest state.

        Raises:
            LostError: The service is gone.
        """
        if self._latest is None or self._problem:
            raise LostError(self._problem or "no tick yet")
        return self._latest

    def next(self, after: State | None = None, timeout: float = SILENT) -> State:
        """Return the newest state once there is one later than ``after``, or than the newest now.

        Raises:
            LostError: None came in time.
        """
        with self._news:
            known = after if after is not None else self._latest
            number = -1 if known is None else known.tick
            came = self._news.wait_for(lambda: self._problem or self._has(number), timeout)
        if not came:
            raise LostError(f"no tick for {timeout:g} s")
        return self.latest

    def _has(self, number: int) -> bool:
        return self._latest is not None and self._latest.tick > number

    def paced(self, rate: float = 60.0) -> Iterator[State]:
        """Yield the newest state ``rate`` times a second of this process's clock, as long as no stop holds.

        A turn that came too late is left out. Ends by an error alone.

        Raises:
            LostError: The service is gone or silent.
            StoppedError: A stop holds.
        """
        due = time.monotonic()
        while True:
            state = self.latest
            if time.monotonic() - state.received > SILENT:
                raise LostError(f"no tick for {SILENT:g} s")
            self.check(state)
            yield state
            due += 1.0 / rate
            wait = due - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
            else:
                due = time.monotonic()

    def check(self, state: State) -> State:
        """Return a state in which no stop holds.

        Raises:
            StoppedError: One holds.
        """
        if state.stop:
            raise StoppedError(state.stop, state.cause)
        return state

    # ---- what it is asked for ----------------------------------------------------------------------------------------

    def send(self, velocity: Array, state: State | None = None) -> int:
        """Ask for joint speeds [rad/s], [D], for the next 100 ms; return the command's number.

        Its answer is not waited for: refusals are counted, and raised by a later call if they last.

        Args:
            velocity: Joint speeds.
            state: What it answers; the newest if not given.

        Raises:
            StoppedError: A stop holds.
            RefusedError: Commands have been refused for half a second.
            LostError: The service is gone.
        """
        return self._say({"robot_dof_vel": [float(v) for v in velocity]}, state)

    def _say(self, command: dict[str, Any], state: State | None) -> int:
        answered = self.latest if state is None else state
        self.check(self.latest)
        refusal, now = self._refusal, time.monotonic()
        if refusal is not None and refusal[0] not in _FADING and now - refusal[2] > _PATIENCE:
            raise RefusedError(refusal[0], refusal[1])
        number = next(self._numbers)
        self._post(command | {"seq": number, "tick": answered.tick})
        return number

    def _post(self, message: dict[str, Any]) -> None:
        try:
            self._socket.send(json.dumps(message))
        except Exception as error:  # closed, reset, broken: the service is gone whatever the library calls it
            raise LostError(self._problem or f"the service is gone ({type(error).__name__})") from None

    def wait_free(self, timeout: float = 5.0) -> State:
        """Wait until no other controller holds the arm, by asking for zero speed; return the state then.

        Raises:
            RefusedError: Another one held it for all that time.
            StoppedError, LostError: As for `send`.
        """
        begin, before = self.latest.time, self.accepted
        for state in self.paced(20.0):
            if self.accepted > before:
                return state
            if self._refusal is not None and state.time - begin > timeout:
                raise RefusedError(*self._refusal[:2])
            self._refusal = None
            self.send(np.zeros(len(state.q)), state)
        raise AssertionError  # paced ends by errors alone

    def move_to(self, q: Array, *, speed: float = 0.4, within: float = _NEAR, slack: float = 10.0) -> State:
        """Move all joints along a straight way to positions, arriving together; return the state there.

        Args:
            q: Joint positions [rad], [D].
            speed: Of the joint that goes furthest [rad/s].
            within: How near every joint has to come [rad].
            slack: Seconds beyond the way's own time after which it is given up.

        Raises:
            RefusedError: It was not reached in time, or commands are refused.
            StoppedError, LostError: As for `send`.
        """
        goal = np.asarray(q, dtype=np.float64)
        allowed = 2.0 * float(np.abs(goal - self.latest.q).max()) / speed + slack
        begin = self.latest.time
        for state in self.paced():
            left = goal - state.q
            if (np.abs(left) < within).all() and (np.abs(state.qd) < _STILL).all():
                return self.halt()
            if state.time - begin > allowed:
                raise RefusedError("outside", f"{np.abs(left).max():.3f} rad from the goal after {allowed:.0f} s")
            wanted = _APPROACH * left
            self.send(wanted / max(1.0, float(np.abs(wanted).max()) / speed), state)
        raise AssertionError  # paced ends by errors alone

    def grip(self, closed: float, timeout: float = 10.0) -> State:
        """Close the gripper so far, 0 to 1, the arm at rest; return the state once it is, or holds something.

        Raises:
            RefusedError: The arm has no gripper, or it did not get there in time.
            StoppedError, LostError: As for `send`.
        """
        if np.isnan(self.latest.gripper):
            raise RefusedError("malformed", "this arm has no gripper that tells how far it is closed")
        self.ask_gripper(closed)
        begin, at, since = self.latest.time, self.latest.gripper, self.latest.time
        for state in self.paced():
            self.send(np.zeros(len(state.q)), state)
            if abs(state.gripper - at) > _CLOSED:
                at, since = state.gripper, state.time
            if abs(state.gripper - closed) < _CLOSED or (closed > at and state.time - since > _GRIPPED):
                return state
            if state.time - begin > timeout:
                raise RefusedError("outside", f"the gripper is at {state.gripper:.2f} after {timeout:g} s")
        raise AssertionError  # paced ends by errors alone

    def ask_gripper(self, closed: float, state: State | None = None) -> int:
        """Ask the gripper to close so far, 0 to 1, without waiting, beside a motion; as `send` otherwise."""
        return self._say({"robot_gripper": float(closed)}, state)

    def halt(self) -> State:
        """Ask for zero speed until the arm stands; return the state then.

        Raises:
            StoppedError, RefusedError, LostError: As for `send`.
        """
        for state in self.paced():
            self.send(np.zeros(len(state.q)), state)
            if (np.abs(state.qd) < 0.2 * _STILL).all() and not any(state.said.get("sent") or ()):
                return state
        raise AssertionError  # paced ends by errors alone

    # ---- over HTTP ---------------------------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Return what ``GET /status`` says: state, stop, danger, counts, periods."""
        return self._ask("/status", None)

    def stop(self) -> int:
        """Stop the arm, whoever holds it; return the stop's number."""
        return int(self._ask("/stop", {})["stop"])

    def arm(self, number: int | None = None) -> None:
        """Re-arm the stop of a number, or the one that holds; nothing where none holds.

        Raises:
            RefusedError: Its danger lasts, or the arm still moves.
        """
        if number is None:
            number = int(self.status()["stop"])
            if not number:
                return
        self._ask("/arm", {"stop": number})
        while self.next().stop == number:  # so that the next command does not meet the stop's last tick
            pass

    def _ask(self, path: str, body: dict[str, Any] | None) -> dict[str, Any]:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.url + path, data, authorization(self._token))
        try:
            with urllib.request.urlopen(request, timeout=10.0, context=self._trust) as answer:
                return dict(json.loads(answer.read()))
        except urllib.error.HTTPError as error:
            said = _said(error.read())
            raise RefusedError(said.get("reason", str(error.code)), said.get("error", error.reason)) from None
        except (OSError, ValueError) as error:
            raise LostError(f"{path} is not answered ({' '.join(str(error).split())[:80]})") from None

    # ---- the stream --------------------------------------------------------------------------------------------------

    def _listen(self) -> None:
        """Take what the service says until it ends."""
        try:
            while True:
                said = json.loads(self._socket.recv())
                self._take(said, time.monotonic())
        except Exception as error:  # closed, reset, or no service of ours: told by the next call
            with self._news:
                self._problem = f"the service is gone ({type(error).__name__})"
                self._news.notify_all()

    def _take(self, said: dict[str, Any], now: float) -> None:
        if "accepted" in said:
            self._answered(said, now)
            return
        if not set(NEEDED) <= set(said):
            raise ValueError("no tick")
        state = state_of(said, now)
        for listener in self.listeners:
            listener(state)
        with self._news:
            self._latest = state
            self._news.notify_all()

    def _answered(self, said: dict[str, Any], now: float) -> None:
        if said["accepted"]:
            self._refusal = None
            self.accepted += 1
            self.clipped += bool(said.get("clipped"))
            return
        reason = str(said.get("reason", ""))
        self.refused[reason] += 1
        since = now if self._refusal is None else self._refusal[2]
        self._refusal = (reason, str(said.get("error", "")), since)


# ---- connecting ------------------------------------------------------------------------------------------------------


def connect_stream(url: str, token: str | None, trust: ssl.SSLContext | None) -> ClientConnection:
    """Return a connection to the stream of a service.

    Args:
        url: ``http://HOST:PORT`` or ``https://HOST:PORT``.
        token: What clients say, or None.
        trust: As `trusted` returns it.

    Raises:
        InputError: There is no service, or it wants a token.
    """
    try:
        from websockets.exceptions import InvalidStatus, WebSocketException
        from websockets.sync.client import connect
    except ImportError:
        raise InputError(url, "", "no websockets library", install_hint("robot")) from None
    try:
        return connect(_stream_of(url), open_timeout=10, ssl=trust, close_timeout=1.0,
                       additional_headers=authorization(token))  # fmt: skip
    except InvalidStatus as error:
        allowed = "a running bough robot serve, and its --token-file"
        raise InputError(url, "", f"status {error.response.status_code}", allowed) from None
    except (OSError, WebSocketException, ValueError) as error:
        found = f"nothing that answers ({' '.join(str(error).split())[:80]})"
        raise InputError(url, "", found, "the address of a running bough robot serve") from None


def trusted(url: str, certificate: Path | None) -> ssl.SSLContext | None:
    """Return what vouches for a service over https, None for one over http.

    Raises:
        InputError: The certificate cannot be read.
    """
    if urlsplit(url).scheme != "https":
        return None
    try:
        return ssl.create_default_context(cafile=None if certificate is None else str(certificate))
    except (ssl.SSLError, OSError) as error:
        raise InputError(str(certificate), "", f"no certificate ({error.strerror or error})", "a PEM file") from None


def authorization(token: str | None) -> dict[str, str]:
    """Return the header that says a token; none without one."""
    return {} if token is None else {"Authorization": f"Bearer {token}"}


def _split(url: str) -> tuple[str, str | None]:
    """Return an address without a token, and the token that it says."""
    _stream_of(url)
    parts = urlsplit(url)
    bare = f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}"
    return bare, None if parts.password is None else unquote(parts.password)


def _stream_of(url: str) -> str:
    parts = urlsplit(url)
    port: int | None = -1
    with contextlib.suppress(ValueError):
        port = parts.port
    if parts.scheme not in ("http", "https") or not parts.hostname or port == -1:
        raise InputError("robot", "URL", shortened(url), "http://HOST:PORT or https://HOST:PORT")
    return f"{'wss' if parts.scheme == 'https' else 'ws'}://{parts.netloc}/stream"


def _said(data: bytes) -> dict[str, Any]:
    with contextlib.suppress(ValueError):
        said = json.loads(data)
        return said if isinstance(said, dict) else {}
    return {}
