"""Springs that are not straight lines, and springs that relax, at one joint; K is the joint's own spring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .rig import Array, Law, Now


@dataclass
class Curved(Law):
    """K q changed to K (q + s q^3 / a^2) (Duffing 1918), to K a tanh(s q / a) / s, or to K a sinh(s q / a) / s."""

    stiffness: float
    angle: float
    form: str = "cubic"

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        x = now.angle / self.angle
        if self.form == "cubic":
            more = self.strength * x**3
        else:
            s = np.sqrt(3.0 * np.maximum(self.strength, 1e-9))
            more = (np.tanh(s * x) if self.form == "tanh" else np.sinh(np.minimum(s * np.abs(x), 5.0)) * np.sign(x)) / s
            more = more - x
        return -self.stiffness * self.angle * more


@dataclass
class OneSided(Law):
    """A further spring s K for positive angles only (Shaw & Holmes 1983)."""

    stiffness: float
    side: float = 1.0

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        return -self.strength * self.stiffness * np.where(self.side * now.angle > 0, now.angle, 0.0)


@dataclass
class DeadZone(Law):
    """No spring within s a of rest, hard (Nordin & Gutman 2002) or rounded by a softplus of the given share of it."""

    stiffness: float
    angle: float
    soft: float = 0.0

    def torque(self, now: Now) -> Array:
        """Return what the spring lacks [B]."""
        gap = self.strength * self.angle
        size = np.abs(now.angle)
        if self.soft:
            width = self.soft * gap + 1e-12
            left = width * (np.logaddexp(0.0, (size - gap) / width) - np.logaddexp(0.0, -gap / width))
        else:
            left = np.maximum(0.0, size - gap)
        return self.stiffness * np.sign(now.angle) * (size - left)


@dataclass
class Maxwell(Law):
    """Springs s K in series with dashpots of relaxation times T, in equal shares (Zener 1948; Wiechert)."""

    stiffness: float
    times: tuple[float, ...]

    def begin(self, angle: Array, rate: Array) -> None:
        """Relax."""
        self._z = [np.zeros_like(angle) for _ in self.times]

    def torque(self, now: Now) -> Array:
        """Return the torque [B]; z' = w - z / T, exactly for a constant rate."""
        total = np.zeros_like(now.angle)
        for k, time in enumerate(self.times):
            keep = np.exp(-now.step / time)
            before = self._z[k]
            self._z[k] = before * keep + now.rate * time * (1.0 - keep)
            total = total + 0.5 * (before + self._z[k])
        return -self.strength * self.stiffness * total / len(self.times)
