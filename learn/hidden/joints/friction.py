"""Friction and drag at a joint, in the forms in which papers state them.

Torques are the strength times ``size`` [N m].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .rig import Array, Law, Now


def way(now: Now, torque: Array, soft: float = 0.0) -> Array:
    """Return the sign of the rate, rounded where friction would stop the joint within two steps, or below ``soft``."""
    return now.rate / np.maximum(np.abs(now.rate), np.maximum(2.0 * np.abs(torque) * now.step / now.inertia, soft))


@dataclass
class Coulomb(Law):
    """T sign(w), Coulomb (1785); T grows by ``static`` at rest, exp(-(w / w_s)^2), Stribeck (1902, Armstrong 1994).

    ``lopsided`` is the difference of the two directions; ``load`` the share that grows with the torque that is carried
    (Bittencourt & Gunnarsson 2012, J. Dyn. Sys. Meas. Control 134).
    """

    size: float
    speed: float = 1.0
    static: float = 0.0
    lopsided: float = 0.0
    load: float = 0.0

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        size = self.strength * self.size * (1.0 + self.static * np.exp(-((now.rate / self.speed) ** 2)))
        size = size * (1.0 - self.load + self.load * np.abs(now.effort) / self.size)
        return -size * (way(now, size) + self.lopsided)


@dataclass
class Bristle(Law):
    """LuGre: z' = w - |w| z / g(w), torque s0 z + s1 z'; Canudas de Wit et al. 1995, IEEE TAC 40:419. Dahl: g constant.

    In units of the torque: z = T g(w) / s0 in a steady slip, bristles as long as ``bend`` [rad].
    """

    size: float
    bend: float
    speed: float = 1.0
    static: float = 0.0
    damped: float = 0.0

    def begin(self, angle: Array, rate: Array) -> None:
        """Relax the bristles."""
        self._z = np.zeros_like(angle)

    def torque(self, now: Now) -> Array:
        """Return the torque [B]; between steps z goes to its steady value exactly."""
        steady = self.bend * (1.0 + self.static * np.exp(-((now.rate / self.speed) ** 2)))
        turn = now.rate * now.step
        before, goal = self._z, steady * np.sign(turn)
        self._z = goal + (before - goal) * np.exp(-np.abs(turn) / steady)
        middle, speed = 0.5 * (before + self._z), (self._z - before) / now.step
        return -self.strength * self.size / self.bend * (middle + self.damped * speed)


@dataclass
class Drag(Law):
    """C |w|^p sign(w) over a typical rate: p = 2 is Rayleigh's, 1.7 a turbulent boundary layer's."""

    size: float
    speed: float
    power: float = 2.0

    def torque(self, now: Now) -> Array:
        """Return the torque [B]."""
        return -self.strength * self.size * np.sign(now.rate) * np.abs(now.rate / self.speed) ** self.power
