"""The control loop: a thread that 60 times a second measures, asks the guard, sends, and hands the tick to the log.

Nothing in it waits for a network, a disk or a lock that is held for longer than a command takes to be checked.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...sim.base.types import Array
from .backend import Backend, Gripping, Sample, Staged
from .guard import PERIOD, Command, Guard, Reply
from .log import Log, Tick
from .wire import Kind

if TYPE_CHECKING:
    from .touch import Feeler

_REMEMBERED = 256  # ticks whose time is known, four seconds
_PERIODS = 3600  # of which `Service.pace` tells, a minute


class Service:
    """An arm behind a guard.

    Methods may be called from any thread.

    Attributes:
        guard: Its guard; look at it, and change it only through this class.
        latest: The newest tick that is in the log, None before the first.
    """

    def __init__(self, backend: Backend, guard: Guard, folder: Path, feeler: Feeler | None = None) -> None:
        """Take an arm and begin a log; `start` starts the loop.

        Args:
            backend: The arm.
            guard: For as many joints.
            folder: Where the log goes.
            feeler: Tells touch from torques; None for an arm that stops at torques alone.

        Raises:
            InputError: There is a log in the folder already.
        """
        self.guard, self.latest = guard, None
        self._backend, self._feeler = backend, feeler
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._listeners: list[Callable[[Tick], None]] = []
        self._times: deque[float] = deque(maxlen=_REMEMBERED)
        self._periods: deque[float] = deque(maxlen=_PERIODS)
        self._began, self._number = time.monotonic(), 0
        self._unread = self._unsent = self._broken = ""
        self._gripped: float | None = None
        guard.grips = isinstance(backend, Gripping)
        self._log = Log(folder, backend.num_dofs, self._tell)
        self._thread = threading.Thread(target=self._run, name="control", daemon=True)

    latest: Tick | None

    def start(self) -> None:
        """Start the loop."""
        self._thread.start()

    def close(self) -> None:
        """Bring the arm to a standstill, end the loop, close the log, and let go of the arm."""
        self.stop("the service ends")
        time.sleep(6 * PERIOD)
        self._ended.set()
        self._thread.join()
        self._log.close()
        self._backend.close()

    def listen(self, listener: Callable[[Tick], None]) -> None:
        """Call a function with every tick from now on, in the log's thread; it must not wait."""
        self._listeners.append(listener)

    # ---- what the network asks for -----------------------------------------------------------------------------------

    def command(
        self,
        controller: str,
        kind: Kind,
        values: Array,
        sequence: int | None = None,
        tick: int | None = None,
    ) -> tuple[Reply, Command]:
        """Hand a command to the guard; ``tick`` is the number of the tick that it answers."""
        with self._lock:
            now = time.monotonic()
            command = Command(controller, kind, values, sequence, self._age(now, tick))
            return self.guard.command(now, command), command

    def _age(self, now: float, tick: int | None) -> float | None:
        """Age of a tick [s]: infinite for one that is long ago or has not been."""
        if tick is None:
            return None
        back = self._number - tick
        return now - self._times[-1 - back] if 0 <= back < len(self._times) else np.inf

    def keep(self, command: Command) -> bool:
        """Renew the lease of a command that runs; see `Guard.keep`."""
        with self._lock:
            return self.guard.keep(time.monotonic(), command)

    def release(self, controller: str) -> None:
        """Let go of the arm, if it is this controller's."""
        with self._lock:
            self.guard.release(time.monotonic(), controller)

    def stop(self, cause: str) -> None:
        """Stop the arm until it is re-armed."""
        with self._lock:
            self.guard.halt(time.monotonic(), cause)

    def arm(self, number: int) -> Reply:
        """Re-arm the stop of this number."""
        with self._lock:
            return self.guard.arm(number)

    def refuse(self, reason: str, text: str) -> Reply:
        """Count what could not be read as a command."""
        with self._lock:
            return self.guard.refuse(reason, text)

    @property
    def twin(self) -> Staged | None:
        """The arm, where it is a twin that holds scenes."""
        return self._backend if isinstance(self._backend, Staged) else None

    def stage(self, number: int) -> Reply:
        """Begin the scene of a number on a twin that holds scenes, while a stop holds; waits until it is there."""
        assert self.twin is not None
        with self._lock:
            reply = self.guard.stage()
        if reply.accepted:
            self.twin.begin(number)
        return reply

    @property
    def scene(self) -> Callable[[], bytes] | None:
        """What returns a twin's world for cameras (`sim.cameras.described`); None for an arm that is real."""
        return getattr(self._backend, "scene", None)

    @property
    def pace(self) -> dict[str, float]:
        """Periods of the last minute's ticks [s]: median, 99th percentile, greatest; and their number."""
        periods = np.array(self._periods)
        if not len(periods):
            return {"ticks": 0}
        middle, late = np.percentile(periods, (50, 99))
        return {"median_s": float(middle), "p99_s": float(late), "max_s": float(periods.max()), "ticks": len(periods)}

    # ---- the loop ----------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        # where the system allows it, this thread comes before all that is no control loop
        with contextlib.suppress(AttributeError, OSError):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
        due = last = time.monotonic()
        while not self._ended.is_set():
            now = time.monotonic()
            if self._number:
                self._periods.append(now - last)
            last = now
            try:
                self._tick(now)
            except Exception as error:  # a fault of our own must not leave the arm with its last speeds
                self._broken = f"the service failed: {error!r}"
                self._send(np.zeros(self._backend.num_dofs))
            due += PERIOD
            wait = due - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            else:  # too late for this one: go on from here instead of hurrying after it
                due = time.monotonic()

    def _tick(self, began: float) -> None:
        sample = self._read(began)
        touch = 0.0 if self._feeler is None else self._feeler.feel(began, sample, self.guard.velocity)
        with self._lock:
            # a lease that ends while the arm is read has ended: the guard's time, and the log's, is that of its step
            now = time.monotonic()
            velocity = self.guard.step(now, sample, touch, self._trouble)
            self._number += 1
            self._times.append(began)
            tick = self._described(now, sample, touch)
        self._send(velocity)
        self._grip()
        self._log.put(tick)

    @property
    def _trouble(self) -> str:
        return self._broken or self._unread or self._unsent or self._log.problem

    def _read(self, now: float) -> Sample | None:
        try:
            sample = self._backend.read(now)
            self._unread = ""
        except Exception as error:  # whatever a driver raises, its arm is lost until it can be read again
            self._unread = f"the arm is lost: {error}"
            return None
        return sample

    def _send(self, velocity: Array) -> None:
        try:
            self._backend.send(velocity)
            self._unsent = ""
        except Exception as error:  # as above
            self._unsent = f"the arm cannot be asked: {error}"

    def _grip(self) -> None:
        """Hand on what the gripper was asked for, once."""
        asked = self.guard.grip
        if asked is None or asked == self._gripped or not isinstance(self._backend, Gripping):
            return
        try:
            self._backend.grip(asked)
            self._gripped = asked
        except Exception as error:  # as above
            self._unsent = f"the gripper cannot be asked: {error}"

    def _described(self, now: float, sample: Sample | None, touch: float) -> Tick:
        guard, none = self.guard, np.full(self._backend.num_dofs, np.nan)
        state = "stopped" if guard.stop else "moving" if guard.velocity.any() else "ready"
        command = guard.running
        tick = Tick(
            self._number, now - self._began, time.time(), np.inf, none, none, none, guard.asked, guard.velocity,
            np.full(3, np.nan), np.full(4, np.nan), touch, state, guard.stop.number if guard.stop else 0,
            guard.stop.cause if guard.stop else "", guard.controller,
            -1 if command is None or command.sequence is None else command.sequence,
            guard.accepted, guard.refused.total(), guard.last_refusal,
        )  # fmt: skip
        if sample is None:
            return tick
        return replace(tick, age=now - sample.time, q=sample.q, qd=sample.qd, torque=sample.torque,
                       hand_position=sample.hand_position, hand_rotation=sample.hand_rotation,
                       gripper=sample.gripper, force=sample.force, tag=sample.tag)  # fmt: skip

    def _tell(self, tick: Tick) -> None:
        self.latest = tick
        for listener in self._listeners:
            listener(tick)
