"""Laws that are on no list: what a verdict must call unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .friction import way
from .rig import Array, Law, Now


@dataclass
class Ripple(Law):
    """A torque of the angle alone: cogging of a motor's poles, sin(n q + p), or the weight of an eccentric, n = 1."""

    torque_scale: float
    poles: float
    phase: float

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        return -self.strength * self.torque_scale * np.sin(self.poles * now.angle + self.phase)


@dataclass
class Detent(Law):
    """A magnet that pulls a joint into one place, x exp(-x^2) of the distance over its width [rad]."""

    torque_scale: float
    place: float
    width: float

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        x = (now.angle - self.place) / self.width
        return -self.strength * self.torque_scale * 2.3 * x * np.exp(-(x**2))


@dataclass
class Saturated(Law):
    """An actuator that gives no more than its most, which falls with the strength; the command is what is recorded."""

    torque_scale: float

    def torque(self, now: Now) -> Array:
        """Return what is missing of the command [B]."""
        most = self.torque_scale * (1.0 - self.strength)
        return np.clip(now.effort, -most, most) - now.effort


@dataclass
class Lagging(Law):
    """The torque follows its command with the time constant L / R of a winding [s], which grows with the strength."""

    time: float

    def begin(self, angle: Array, rate: Array) -> None:
        """Start with the current that the first command asks for."""
        self._given: Array | None = None

    def torque(self, now: Now) -> Array:
        """Return what the current lacks [B]."""
        if self._given is None:
            self._given = now.effort.copy()
        self._given = now.effort + (self._given - now.effort) * np.exp(-now.step / (self.strength * self.time))
        return self._given - now.effort


@dataclass
class Resonant(Law):
    """A mass behind a belt: inertia s J on a spring and a damper, which the joint carries along."""

    inertia: float
    frequency: float

    def begin(self, angle: Array, rate: Array) -> None:
        """Start with the belt relaxed."""
        self._x, self._w = angle.copy(), rate.copy()

    def torque(self, now: Now) -> Array:
        """Return the belt's torque [B]."""
        own = self.strength * self.inertia
        k, d = own * self.frequency**2, 0.06 * own * self.frequency
        pull = k * (self._x - now.angle) + d * (self._w - now.rate)
        self._w = self._w - now.step * pull / own
        self._x = self._x + now.step * self._w
        return pull


@dataclass
class Warming(Law):
    """A damper that a warming grease takes off: -c w exp(-t / T) beside the joint's own."""

    torque_scale: float
    speed: float
    time: float

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        return -self.strength * self.torque_scale * now.rate / self.speed * np.exp(-now.time / self.time)


@dataclass
class RubbingSpot(Law):
    """Friction over a part of the turn only, where a seal is worn: a bump of the angle."""

    torque_scale: float
    place: float
    width: float

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        size = self.strength * self.torque_scale * np.exp(-(((now.angle - self.place) / self.width) ** 2))
        return -size * way(now, size)


@dataclass
class WornTeeth(Law):
    """Impulses where a damaged tooth comes by: short bumps of the angle that push back and then forth."""

    torque_scale: float
    pitch: float
    phase: float

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        x = (now.angle / self.pitch + self.phase) % 1.0 - 0.5
        return -self.strength * self.torque_scale * 2.3 * (x / 0.06) * np.exp(-((x / 0.06) ** 2))


@dataclass
class Diode(Law):
    """A spring that leaks one way: what it holds beyond an angle drains, as a capacitor does through a diode.

    The slip p obeys p' = max(0, q - p - on) s / T, and a fifth of that the other way.
    """

    stiffness: float
    opens: float
    time: float

    def begin(self, angle: Array, rate: Array) -> None:
        """Start with nothing drained."""
        self._slip = np.zeros_like(angle)

    def torque(self, now: Now) -> Array:
        """Return the torque that the spring has lost [B]."""
        held = now.angle - self._slip
        drain = np.maximum(0.0, held - self.opens) - 0.2 * np.maximum(0.0, -held - self.opens)
        self._slip = self._slip + now.step * self.strength / self.time * drain
        return self.stiffness * self._slip
