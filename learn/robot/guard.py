"""The guard between controllers and an arm: a state machine that is stepped with the time as an argument.

It holds no clock, thread, file or socket, so that every rule can be tested by itself. What comes out of `Guard.step`
are joint speeds v [rad/s], found in this order, each rule only able to make a speed smaller:

    wanted    the command whose lease still runs, 0 where none does
    followed  |v - v_before| <= a dt                                          acceleration
    capped    |v| <= speed clip((deadline - now - dt)/RAMP, 0, 1)             leases and stops
    held      k (lower - q) <= v <= k (upper - q), 0 between them             joint limits
    scaled    no point of q + s v/k, 0 <= s <= 1, outside of the workspace    workspace

The deadline is RAMP after the lease's end, or after a stop: whatever happens, v is zero from there on.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...sim.base.types import Array
from .backend import Sample
from .limits import RAMP, Limits

PERIOD = 1.0 / 60.0
"""Time between two ticks [s]."""

REASONS = ("malformed", "not finite", "implausible", "outside", "stopped", "held", "duplicate", "out of order", "late",
           "not let in", "not stopped")  # fmt: skip
"""Why a command is refused; counted by these words."""

_IMPLAUSIBLE = 4.0  # times the speed limit: degrees taken for radians are 57 times
_PARTS = np.linspace(0.0, 1.0, 9)  # of the way that is looked ahead in the workspace
_CONTROLLERS = 256  # whose last number is remembered
_ARRIVED, _STILL = 0.01, 0.05  # rad from a goal, rad/s: what a servo with friction still reaches


@dataclass(frozen=True)
class Command:
    """What a controller asks for.

    Attributes:
        controller: Who asks.
        kind: Whether ``values`` are joint speeds [rad/s], joint positions to go to [rad], or how far the gripper is to
            be closed (0 to 1).
        values: [D], or [1] for the gripper.
        sequence: Number that grows from command to command; None for a client that does not number.
        age: How old the state was that the command answers [s]; None for a client that does not say.
    """

    controller: str
    kind: Literal["velocity", "position", "gripper"]
    values: Array
    sequence: int | None = None
    age: float | None = None


@dataclass(frozen=True)
class Reply:
    """Whether something was accepted; if not, the reason (one of `REASONS`) and a sentence; if so, what was cut."""

    accepted: bool
    reason: str = ""
    text: str = ""
    clipped: bool = False


@dataclass(frozen=True)
class Stop:
    """A stop that holds until it is re-armed by its number."""

    number: int
    cause: str


class Guard:
    """Holds one arm of D joints to its limits, whatever controllers send.

    Attributes:
        limits: What it holds the arm to.
        stop: The stop that holds now, None while armed.
        danger: What would stop the arm now, "" where nothing would; with it a stop cannot be re-armed.
        controller: Who holds the arm, "" for nobody.
        velocity: What the last step gave [rad/s], [D].
        asked: What the last step was asked for [rad/s], [D].
        arrived: Whether the goal of the command that runs is reached.
        accepted: Commands that were accepted.
        refused: Commands that were refused, by reason.
        clipped: Commands of which something was cut at a speed limit.
        last_refusal: Reason of the last refusal.
        grips: Whether the arm has a gripper that takes commands.
        grip: What its gripper was last asked for, None for nothing yet. It has no lease, and a stop leaves it as it is:
            a hand that let go, or closed, by itself would be no safer.
    """

    def __init__(self, limits: Limits, clearance: Callable[[Array], Array], armed: bool) -> None:
        """Take limits and the workspace.

        Args:
            limits: For D joints.
            clearance: Distance of an arm inside its workspace [m], [N], of joint positions [N, D].
            armed: Whether it begins armed. Otherwise it begins with stop 1.
        """
        self.limits, self._clearance = limits, clearance
        self.stop: Stop | None = None
        self.danger = "no measurement yet"
        self.controller, self._held_until = "", -np.inf
        self.velocity, self.asked = np.zeros(limits.num_dofs), np.zeros(limits.num_dofs)
        self.arrived = False
        self.grips, self.grip = False, None
        self.accepted, self.clipped, self.last_refusal = 0, 0, ""
        self.refused: Counter[str] = Counter()
        self._numbers: OrderedDict[str, int] = OrderedDict()
        self._stops = 0
        self._command: Command | None = None
        self._until = self._deadline = -np.inf
        self._last: float | None = None
        self._sample: Sample | None = None
        if not armed:
            self.halt(-np.inf, "not armed yet")

    grip: float | None

    @property
    def running(self) -> Command | None:
        """The command whose lease runs, None where none does."""
        return self._command if self._last is None or self._last < self._until else None

    # ---- what controllers do -------------------------------------------------------------------------------------

    def command(self, now: float, command: Command) -> Reply:
        """Take or refuse a command at time ``now`` [s]; it holds for the lease from now on."""
        reply = self._refusal(now, command)
        if reply is not None:
            return reply
        values, limits = command.values, self.limits
        clipped = command.kind == "velocity" and bool((np.abs(values) > limits.speed * 1.000001).any())
        if command.sequence is not None:
            self._remember(command.controller, command.sequence)
        self.controller, self._held_until = command.controller, now + limits.hold
        self.accepted += 1
        if command.kind == "gripper":  # beside a motion, whose lease goes on
            self.grip = float(values[0])
            return Reply(True)
        self.arrived = False
        self._command, self._until = command, now + limits.lease
        self._deadline = self._until + RAMP
        self.clipped += clipped
        return Reply(True, clipped=clipped)

    def _refusal(self, now: float, command: Command) -> Reply | None:
        """Return why a command is refused, None where it is not."""
        last = self._numbers.get(command.controller)
        number = command.sequence
        if self.stop is not None:
            return self.refuse("stopped", f"stop {self.stop.number} holds: {self.stop.cause}")
        if command.controller != self.controller and now < self._held_until:
            return self.refuse("held", "another controller holds the arm")
        if number is not None and last is not None and number <= last:
            reason = "duplicate" if number == last else "out of order"
            return self.refuse(reason, f"number {number} after {last}")
        if command.age is not None and command.age > self.limits.lease:
            allowed = f"{self.limits.lease * 1e3:.0f} ms at most"
            return self.refuse("late", f"it answers a state {command.age * 1e3:.0f} ms old; {allowed}")
        return self._wrong_values(command)

    def _wrong_values(self, command: Command) -> Reply | None:
        values, limits = command.values, self.limits
        gripper = command.kind == "gripper"
        if gripper and not self.grips:
            return self.refuse("malformed", "this arm has no gripper that takes commands")
        count = 1 if gripper else limits.num_dofs
        if values.shape != (count,):
            return self.refuse("malformed", f"{values.size} numbers; allowed: {count}")
        if not np.isfinite(values).all():
            return self.refuse("not finite", "a number that is not finite")
        if gripper:
            open_to_closed = 0.0 <= values[0] <= 1.0
            return None if open_to_closed else self.refuse("outside", f"{values[0]:g}; a gripper closes from 0 to 1")
        if command.kind == "velocity":
            if (np.abs(values) > _IMPLAUSIBLE * limits.speed).any():
                found = f"{np.abs(values).max():.3g} rad/s, beyond {_IMPLAUSIBLE:g} times the limit"
                return self.refuse("implausible", f"{found}: are these radians?")
            return None
        near = values if self._sample is None else self._sample.q
        if ((values < limits.lower) | (values > limits.upper) | (np.abs(values - near) > 2.0 * np.pi)).any():
            return self.refuse("outside", "a position outside the joints' limits or more than a turn away")
        return None

    def refuse(self, reason: str, text: str) -> Reply:
        """Count a refusal and return it; also for what could not be read as a command at all."""
        self.refused[reason] += 1
        self.last_refusal = reason
        return Reply(False, reason, text)

    def _remember(self, controller: str, number: int) -> None:
        self._numbers[controller] = number
        self._numbers.move_to_end(controller)
        if len(self._numbers) > _CONTROLLERS:
            self._numbers.popitem(last=False)

    def keep(self, now: float, command: Command) -> bool:
        """Renew the lease of a command that runs; return whether it still runs or has arrived.

        Once superseded, stopped or released it is never taken up again.
        """
        if self._command is not command:
            return False
        self._until = now + self.limits.lease
        self._deadline, self._held_until = self._until + RAMP, now + self.limits.hold
        return True

    def release(self, now: float, controller: str) -> None:
        """Let go of the arm, if it is this controller's: it comes to a standstill and is free for others."""
        if controller == self.controller:
            self._end(now)
            self.controller, self._held_until = "", -np.inf

    # ---- stopping ------------------------------------------------------------------------------------------------

    def halt(self, now: float, cause: str) -> None:
        """Stop; the first cause stays until the stop is re-armed."""
        self._end(now)
        if self.stop is None:
            self._stops += 1
            self.stop = Stop(self._stops, cause)
            self.controller, self._held_until = "", -np.inf

    def _end(self, now: float) -> None:
        self._command = None
        self._until = min(self._until, now)
        self._deadline = min(self._deadline, now + RAMP)

    def arm(self, number: int) -> Reply:
        """Re-arm the stop of this number; refused (and counted) while its danger lasts or the arm still moves.

        The number keeps a request that was sent for one stop, and comes late or twice, from undoing another.
        """
        if self.stop is None or number != self.stop.number:
            holds = "none holds" if self.stop is None else f"stop {self.stop.number} holds"
            return self.refuse("stopped", f"no stop {number} holds: {holds}")
        if self.danger:
            return self.refuse("stopped", f"still so: {self.danger}")
        if self._sample is None or (np.abs(self._sample.qd) > _STILL).any() or self.velocity.any():
            return self.refuse("stopped", "the arm still moves")
        self.stop = None
        return Reply(True)

    def stage(self) -> Reply:
        """Take or refuse a new scene of a twin: accepted while a stop holds, so that it surprises no command."""
        if self.stop is None:
            return self.refuse("not stopped", "a new scene takes a stop first")
        self.accepted += 1
        return Reply(True)

    # ---- the tick ------------------------------------------------------------------------------------------------

    def step(self, now: float, sample: Sample | None, touch: float = 0.0, trouble: str = "") -> Array:
        """Return the joint speeds to send now [rad/s], [D].

        Args:
            now: Time [s], not before that of the last step.
            sample: Newest measurement.
            touch: Probability of touch.
            trouble: What else forbids to move: a log that cannot be written, an arm that does not answer.
        """
        elapsed = PERIOD if self._last is None else max(now - self._last, 0.0)
        self._last = now
        self.danger = self._danger(now, elapsed, sample, touch, trouble)
        self._sample = sample if sample is not None and _finite(sample) else None
        if self.danger:
            self.halt(now, self.danger)
        if now >= self._held_until:
            self.controller = ""
        self.asked = self._wanted(now)
        self.velocity = self._allowed(now, min(elapsed, 2.0 * PERIOD))
        return self.velocity

    def _danger(self, now: float, elapsed: float, sample: Sample | None, touch: float, trouble: str) -> str:
        limits = self.limits
        if trouble:
            return trouble
        if elapsed > limits.stall:
            return f"the control loop stood for {elapsed:.2f} s"
        if sample is None:
            return "no measurement"
        if not _finite(sample):
            return "a measurement that is not finite"
        if now - sample.time > limits.stale:
            return f"no measurement for {now - sample.time:.2f} s"
        over = np.abs(sample.torque) - limits.torque
        if (over > 0).any():
            joint = int(np.argmax(over))
            return f"torque of joint {joint + 1}: {sample.torque[joint]:.1f} N m over {limits.torque[joint]:g}"
        fast = np.abs(sample.qd) - 1.5 * limits.speed
        if (fast > 0).any():
            joint = int(np.argmax(fast))
            return f"joint {joint + 1} runs away at {sample.qd[joint]:.2f} rad/s"
        if not touch <= limits.touch:
            return f"touch with a probability of {touch:.2f} over {limits.touch:g}"
        return ""

    def _wanted(self, now: float) -> Array:
        """Joint speeds that the command whose lease still runs asks for [rad/s], [D]."""
        limits, command = self.limits, self._command
        if command is None or now >= self._until or self._sample is None:
            return np.zeros(limits.num_dofs)
        if command.kind == "velocity":
            return command.values
        left = command.values - self._sample.q
        self.arrived = bool((np.abs(left) < _ARRIVED).all() and (np.abs(self._sample.qd) < _STILL).all())
        return np.asarray(np.clip(limits.approach * left, -limits.speed, limits.speed))

    def _allowed(self, now: float, dt: float) -> Array:
        limits = self.limits
        change = limits.acceleration * dt
        v = np.clip(self.asked, self.velocity - change, self.velocity + change)
        most = limits.speed * np.clip((self._deadline - now - dt) / RAMP, 0.0, 1.0)
        v = np.clip(v, -most, most)
        if self._sample is None or not v.any():
            return np.zeros(limits.num_dofs)
        q = self._sample.q + self.velocity * np.clip(now - self._sample.time, 0.0, limits.stale)
        low, high = (np.nan_to_num(limits.approach * (x - q), posinf=np.inf, neginf=-np.inf)
                     for x in (limits.lower, limits.upper))  # fmt: skip
        v = np.clip(v, np.minimum(low, 0.0), np.maximum(high, 0.0))
        return v * self._room(q, v)

    def _room(self, q: Array, v: Array) -> float:
        """Share of the way ahead that stays in the workspace, or leads no further out of it."""
        inside = self._clearance(q + _PARTS[:, None] * v / self.limits.approach)
        least = min(0.0, float(inside[0]))
        out = np.nonzero(inside < least)[0]
        if not len(out):
            return 1.0
        k = int(out[0])
        share = (inside[k - 1] - least) / (inside[k - 1] - inside[k])
        return float(_PARTS[k - 1] + share * (_PARTS[k] - _PARTS[k - 1]))


def _finite(sample: Sample) -> bool:
    return bool(np.isfinite(np.concatenate([sample.q, sample.qd, sample.torque])).all())
