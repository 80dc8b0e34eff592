"""Loops that do not depend on the rate: Bouc and Wen, Prandtl and Ishlinskii, Preisach, and yielding with hardening."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .rig import Array, Law, Now


class Turned(Law):
    """A law that knows of the joint's turn from step to step."""

    def begin(self, angle: Array, rate: Array) -> None:
        """Forget."""
        self._last = angle.copy()
        self._z = np.zeros_like(angle)

    def turned(self, now: Now) -> Array:
        """Return the turn since the last step [rad], shape [B]."""
        before, self._last = self._last, now.angle
        return now.angle - before


@dataclass
class BoucWen(Turned):
    """z' = w (1 - |z / y|^n (beta + gamma sign(w z))), torque s K z; Wen 1976, beta + gamma = 1."""

    stiffness: float
    yields: float
    exponent: float = 1.0
    blend: float = 0.5

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        turn, z = self.turned(now), self._z
        share = np.abs(z / self.yields) ** self.exponent
        self._z = z + turn * (1.0 - share * (self.blend + (1.0 - self.blend) * np.sign(turn * z)))
        return -self.strength * self.stiffness * self._z


@dataclass
class Stops(Turned):
    """Elastic sliders side by side, each with a yield angle and a share of s K (Prandtl 1928, Iwan 1966)."""

    stiffness: float
    yields: tuple[float, ...]

    def begin(self, angle: Array, rate: Array) -> None:
        """Forget."""
        super().begin(angle, rate)
        self._each = np.zeros((len(self.yields), *angle.shape))

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        most = np.array(self.yields)[:, None]
        self._each = np.clip(self._each + self.turned(now), -most, most)
        return -self.strength * self.stiffness * self._each.mean(axis=0)


@dataclass
class Relays(Turned):
    """A spring in series with a slip made of relays, which switch up at c + r and down at c - r.

    They are weighted over a half plane (Preisach 1935; Mayergoyz 2003). The torque is that of the angle less the slip.
    """

    torque_scale: float
    angle: float
    count: int = 14

    def begin(self, angle: Array, rate: Array) -> None:
        """Set the relays to where the angle has them, half of the undecided ones up."""
        super().begin(angle, rate)
        centre, half = np.meshgrid(np.linspace(-1.0, 1.0, self.count), np.linspace(0.05, 0.8, self.count // 2))
        self._up, self._down = (self.angle * (centre + half)).ravel(), (self.angle * (centre - half)).ravel()
        weight = np.exp(-(centre**2) - (2.0 * half) ** 2).ravel()
        self._weight = weight / weight.sum()
        self._state = np.where(angle[:, None] > 0.5 * (self._up + self._down), 1.0, -1.0)

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        x = now.angle[:, None]
        self._state = np.where(x > self._up, 1.0, np.where(x < self._down, -1.0, self._state))
        return -self.strength * self.torque_scale * (now.angle / self.angle - self._state @ self._weight)


@dataclass
class Yielding(Turned):
    """The joint's own spring in series with a slider: of the turn beyond y the share s stays.

    Hardening is kinematic, or isotropic in the share given (Simo & Hughes 1998, box 1.5).
    """

    stiffness: float
    yields: float
    isotropic: float = 0.0

    def begin(self, angle: Array, rate: Array) -> None:
        """Relax."""
        self._slip, self._sum = np.zeros_like(angle), np.zeros_like(angle)

    def torque(self, now: Now) -> Array:
        """Return to the yield surface; return the torque that the slip takes away [B]."""
        share = np.clip(self.strength, 1e-6, 0.95)
        hard = 1.0 / share - 1.0
        trial = now.angle - self._slip - (1.0 - self.isotropic) * hard * self._slip
        over = np.maximum(0.0, np.abs(trial) - self.yields - self.isotropic * hard * self._sum)
        more = over / (1.0 + hard)
        self._slip, self._sum = self._slip + np.sign(trial) * more, self._sum + more
        return self.stiffness * self._slip
