"""The twin on a clock of its own: the service's guard and the loop's code without a network."""

from __future__ import annotations

from collections import deque

import numpy as np

from ...sim.base.types import Array
from ..robot.backend import Sample
from ..robot.client import SILENT, State, StoppedError
from ..robot.guard import PERIOD, Command, Guard
from ..robot.limits import Limits
from ..robot.workspace import Workspace
from .stage import Stage
from .truth import Facts

_WHO = "simulated"


class SimulatedTwin:
    """A stage behind a guard: what a `learn.deploy.loop.Runner` steers, and what is true (`learn.deploy.truth.Truth`).

    As over the network, a command that answers a tick is looked at in the next one.

    Attributes:
        now: The clock [s].
        stage: The world.
        guard: Its guard.
    """

    def __init__(self, stage: Stage, limits: Limits, *, delay: float = 0.0, rate: float = 30.0) -> None:
        """Take a stage and what its arm is held to.

        Args:
            stage: The world.
            limits: As the service's.
            delay: How old the truth is when it is told [s].
            rate: How often it is told anew [Hz].
        """
        self.now, self.stage = 0.0, stage
        self._limits, self._arm = limits, stage.task.simulator.arm
        self._delay, self._every, self._told = delay, 1.0 / rate, -np.inf
        self._facts: deque[tuple[float, Facts]] = deque(maxlen=64)
        self._number = self._sequence = 0
        self._restart()

    def _restart(self) -> None:
        self.guard = Guard(self._limits, Workspace(self._arm, self._limits.workspace_low,
                                                   self._limits.workspace_high).clearance, armed=True)  # fmt: skip
        self._facts.clear()
        self._told = -np.inf
        self.state = self._tick()

    def clock(self) -> float:
        """Return the time [s]."""
        return self.now

    # ---- the arm -----------------------------------------------------------------------------------------------------

    @property
    def latest(self) -> State:
        """The newest state."""
        return self.state

    def next(self, after: State | None = None, timeout: float = SILENT) -> State:
        """Let one tick pass; return the state in it."""
        self.state = self._tick()
        return self.state

    def send(self, velocity: Array, state: State) -> int:
        """Ask for joint speeds [rad/s], [D].

        Raises:
            StoppedError: A stop holds.
        """
        self.check(state)
        self._sequence += 1
        self.guard.command(self.now, Command(_WHO, "velocity", np.asarray(velocity, float), self._sequence, 0.0))
        return self._sequence

    def check(self, state: State) -> State:
        """Return a state in which no stop holds.

        Raises:
            StoppedError: One holds.
        """
        stop = self.guard.stop
        if stop is not None:
            raise StoppedError(stop.number, stop.cause)
        return state

    def stop(self) -> int:
        """Stop the arm; return the stop's number."""
        self.guard.halt(self.now, "asked for")
        assert self.guard.stop is not None
        return self.guard.stop.number

    def arm(self, number: int | None = None) -> None:
        """Re-arm what has stopped: scenes begin armed here."""

    def _tick(self) -> State:
        self.now += PERIOD
        self._number += 1
        sample = self.stage.read(self.now)
        velocity = self.guard.step(self.now, sample)
        self.stage.send(velocity)
        return self._state(sample)

    def _state(self, s: Sample) -> State:
        stop = self.guard.stop
        number, cause = (0, "") if stop is None else (stop.number, stop.cause)
        return State(self._number, self.now, self.now, s.q, s.qd, s.torque, s.hand_position, s.hand_rotation, 0.0,
                     "stopped" if number else "ready", number, cause, {}, s.gripper, s.force, s.tag)  # fmt: skip

    # ---- the truth ---------------------------------------------------------------------------------------------------

    def begin(self, number: int) -> Facts:
        """Begin the scene of a number, armed; return what is true of it."""
        self.stage.begin(number)
        self._restart()
        return self.told()[1]

    def told(self) -> tuple[float, Facts]:
        """Return what was true ``delay`` ago or before, and when [s]."""
        if self.now - self._told >= self._every - 1e-6:
            self._told = self.now
            self._facts.append((self.now, self.stage.truth()))
        old = [found for found in self._facts if found[0] <= self.now - self._delay + 1e-6]
        return old[-1] if old else self._facts[0]

    def close(self) -> None:
        """End."""
