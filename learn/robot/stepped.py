"""An arm without a network or a clock: a guard and a backend, stepped as `client.RobotClient` is used.

For studies and tests of what steers an arm. Every turn of `SteppedRobot.paced` is so many ticks of a sixtieth of a
second, in which the commands between the turns act as they would over the network, guard included. What is not here is
what a network does: lateness, loss, a service that ends.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ...sim.base.types import Array
from .backend import Backend, Gripping
from .client import LostError, RobotClient, State, state_of
from .guard import PERIOD, Command, Guard
from .limits import Limits
from .wire import Ask, read


class SteppedRobot(RobotClient):
    """Steers a backend directly.

    Attributes:
        url: A name for messages.
        guard: What keeps it to its limits.
    """

    def __init__(self, backend: Backend, limits: Limits, clearance: Callable[[Array], Array] | None = None) -> None:
        """Take an arm.

        Args:
            backend: The arm.
            limits: What it is kept to.
            clearance: As for `guard.Guard`; None for an arm that has room everywhere.
        """
        self.url, self._backend, self._now = "a stepped arm", backend, 0.0
        self.guard = Guard(limits, clearance or (lambda q: np.ones(len(q))), armed=True)
        self.guard.grips = isinstance(backend, Gripping)
        self._tick, self._gripped = 0, None
        self._begin()
        self._advance()

    _gripped: float | None

    def close(self) -> None:
        """Let go of the arm."""
        self.guard.release(self._now, "stepped")

    def next(self, after: State | None = None, timeout: float = 0.0) -> State:
        """Return the state of the next tick."""
        self._advance()
        return self.latest

    def paced(self, rate: float = 60.0) -> Iterator[State]:
        """Yield the newest state, and let 1/rate seconds pass after every turn; as `RobotClient.paced` otherwise."""
        while True:
            yield self.check(self.latest)
            for _ in range(max(1, round(1.0 / (rate * PERIOD)))):
                self._advance()

    def stop(self) -> int:
        """Stop the arm; return the stop's number."""
        self.guard.halt(self._now, "asked for")
        assert self.guard.stop is not None
        return self.guard.stop.number

    def _post(self, message: dict[str, Any]) -> None:
        ask: Ask = read(Ask, json.dumps(message).encode())
        assert ask.kind is not None
        reply = self.guard.command(self._now, Command("stepped", ask.kind, ask.values, ask.seq))
        said = {"accepted": reply.accepted, "clipped": reply.clipped, "reason": reply.reason, "error": reply.text}
        self._answered(said, self._now)

    def _advance(self) -> None:
        self._now += PERIOD
        try:
            sample = self._backend.read(self._now)
        except RuntimeError as error:
            raise LostError(str(error)) from None
        velocity = self.guard.step(self._now, sample)
        self._backend.send(velocity)
        if self.guard.grip is not None and self.guard.grip != self._gripped and isinstance(self._backend, Gripping):
            self._backend.grip(self.guard.grip)
            self._gripped = self.guard.grip
        self._tick += 1
        assert sample is not None
        stop = self.guard.stop
        said = {
            "tick": self._tick, "time_s": self._now, "robot_dof_pos": sample.q, "robot_dof_vel": sample.qd,
            "robot_dof_torque": sample.torque, "hand_pos": sample.hand_position,
            "hand_rot": sample.hand_rotation[[1, 2, 3, 0]], "sent": velocity.tolist(),
            "stop": stop.number if stop else 0, "cause": stop.cause if stop else "",
            "state": "stopped" if stop else "ready",
            "robot_gripper": sample.gripper, "hand_force": sample.force, "tag_pos": sample.tag,
        }  # fmt: skip
        self._latest = state_of(said, self._now)
        for listener in self.listeners:
            listener(self._latest)
