"""A joint, or a grasp point, whose motion is prescribed: what a hidden law sees, and what it has added."""

from __future__ import annotations

import numpy as np
from bough.learn.hidden import branch as geometry
from bough.learn.hidden.parts import Scale

K, STEP, RATE = 20.0, 1e-3, 25.0


class Held:
    """A joint, or a grasp point, whose motion is prescribed: what a law sees, and what it has added."""

    def __init__(self) -> None:
        self.step, self.time, self.datas = STEP, np.zeros(1), [None]
        self.phi, self.w = np.zeros((1, 3)), np.zeros((1, 3))
        self.moved, self.velocity, self.force = np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3))
        self.grip_axis, self.grip_spin = np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 3))
        self.push, self.couple, self.torque = np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 3))

    def angle(self, joint: int) -> np.ndarray:
        return self.phi.copy()

    def rate(self, joint: int) -> np.ndarray:
        return self.w.copy()

    def twist(self, joint: int, torque: np.ndarray) -> None:
        self.torque = self.torque + torque


def follow(law, angles) -> np.ndarray:
    """Return the torques [T, 3] that a law adds along angles [T, 3] or, about the first axis, [T]."""
    angles = np.asarray(angles, dtype=float)
    angles = np.outer(angles, [1.0, 0.0, 0.0]) if angles.ndim == 1 else angles
    held, out = Held(), []
    held.phi = angles[:1]
    law.begin(held)
    for angle in angles:
        held.phi, held.torque = angle[None], np.zeros((1, 3))
        law.act(held)
        out.append(held.torque[0])
    return np.array(out)


def triangle(size: float, count: int = 4000) -> np.ndarray:
    """Return angles that go up, down and up again, three times, in steps of ``4 size / count``."""
    u = np.linspace(0, 3, 3 * count + 1)
    return size * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * u))


def rod(gravity: float = 0.0, damping: float = 1.0) -> geometry.Branch:
    """One level cylinder along x: spring K, 0.4 m, held at 0.3 m."""
    return geometry.Branch([0.4], [0.01], [0.01], [0.0], [0.0], [K], [damping], 800.0, 0.3, gravity, ["rod"])


def held_by(force, samples: int = 200) -> np.ndarray:
    """Return a force [1, T, 3] that rises in a second and stays."""
    return (np.clip(np.arange(samples) / RATE, 0, 1)[:, None] * np.asarray(force))[None]


def scale() -> Scale:
    """Return a scale of round numbers."""
    pushes = np.array([[0.0, 1.0, 0.0]])
    return Scale(rod(9.81), np.array([0.2]), np.array([2.0]), 10.0, 0.1, 1.0, pushes, np.array([0.0, 30.0]), 4.0, 101)
