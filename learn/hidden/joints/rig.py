"""A planar chain of links on hinges: its equations of motion in closed form, and their integration.

In absolute angles theta (zero hangs down) a chain obeys

    sum_j b_ij cos(theta_i - theta_j) theta_j'' + b_ij sin(theta_i - theta_j) theta_j'^2 + G_i sin(theta_i) = Q_i

with constants b and G of its masses and lengths; joints turn by differences of theta. The step is of second order:
half a step of the angles, one of the rates by what acts there, half a step of the angles.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]
#: Efforts [B, n] from time, angles [B, n] and rates [B, n].
Drive = Callable[[float, Array, Array], Array]


@dataclass(frozen=True)
class Chain:
    """N links, base first.

    Attributes:
        mass: [kg], shape [n].
        reach: Distance of a link's centre of mass from its joint [m], shape [n].
        length: Distance of the next joint from its own [m], shape [n].
        central: Moment of inertia about the centre of mass [kg m^2], shape [n].
        armature: Inertia of rotors at the joints [kg m^2], shape [n].
        stiffness: Springs, relaxed at zero [N m/rad], shape [n].
        damping: Dampers [N m s/rad], shape [n].
        gravity: [m/s^2].
    """

    mass: Array
    reach: Array
    length: Array
    central: Array
    armature: Array
    stiffness: Array
    damping: Array
    gravity: float = 9.81
    coupling: Array = field(init=False, repr=False)
    weight: Array = field(init=False, repr=False)
    turn: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Work out b [n, n], G [n] and the matrix from joint angles to absolute ones."""
        n = len(self.mass)
        beyond = np.array([self.mass[i + 1 :].sum() for i in range(n)])
        carried = self.mass * self.reach + self.length * beyond
        b = np.array([[self.length[min(i, j)] * carried[max(i, j)] for j in range(n)] for i in range(n)])
        np.fill_diagonal(b, self.central + self.mass * self.reach**2 + self.length**2 * beyond)
        object.__setattr__(self, "coupling", b)
        object.__setattr__(self, "weight", self.gravity * carried)
        object.__setattr__(self, "turn", np.tril(np.ones((n, n))))

    @property
    def count(self) -> int:
        """Number of joints n."""
        return len(self.mass)

    def acceleration(self, q: Array, v: Array, effort: Array) -> Array:
        """Return joint accelerations [B, n] under efforts beside springs, dampers and gravity, shape [B, n]."""
        effort = effort - self.stiffness * q - self.damping * v
        if self.count == 1:
            return (effort - self.weight * np.sin(q)) / (self.coupling[0, 0] + self.armature[0])
        matrix, bias = self.equations(q, v)
        solved: Array = np.linalg.solve(matrix, (effort - bias)[..., None])[..., 0]
        return solved

    def equations(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the mass matrix [B, n, n] and the efforts of gravity and rates [B, n], in joint angles."""
        theta, rate = q @ self.turn.T, v @ self.turn.T
        apart = theta[:, :, None] - theta[:, None, :]
        matrix = self.turn.T @ (self.coupling * np.cos(apart)) @ self.turn + np.diag(self.armature)
        bias = (self.coupling * np.sin(apart) * (rate**2)[:, None, :]).sum(2) + self.weight * np.sin(theta)
        return matrix, bias @ self.turn

    def inertia(self, q: Array) -> Array:
        """Return the inertia that each joint feels alone [B, n], kg m^2."""
        matrix, _ = self.equations(q, np.zeros_like(q))
        return np.diagonal(matrix, axis1=1, axis2=2)

    def fastest(self, stiff: Array, damped: Array) -> float:
        """Return the fastest rate [1/s] of small motions about hanging, with further gains of angle and rate [n].

        Of decays it is the decay's rate, of oscillations the circular frequency; no posture has less inertia.
        """
        inverse = np.linalg.inv(self.equations(np.zeros((1, self.count)), np.zeros((1, self.count)))[0][0])
        springs = np.linalg.eigvals(inverse @ np.diag(self.stiffness + stiff))
        dampers = np.linalg.eigvals(inverse @ np.diag(self.damping + damped))
        return float(max(np.abs(springs).max() ** 0.5, np.abs(dampers).max()))

    def energy(self, q: Array, v: Array) -> Array:
        """Return kinetic and potential energy of links, rotors and springs [B], J."""
        matrix, _ = self.equations(q, v)
        moving = 0.5 * np.einsum("bi,bij,bj->b", v, matrix, v)
        lifted = (self.weight * (1 - np.cos(q @ self.turn.T))).sum(1)
        stored: Array = moving + lifted + 0.5 * (self.stiffness * q**2).sum(1)
        return stored


@dataclass
class Now:
    """What a law may know: of its joint, at the middle of a step.

    Attributes:
        time: [s].
        step: [s].
        angle, rate: Of the joint [rad, rad/s], shape [B].
        effort: What drives it [N m], shape [B].
        inertia: Least inertia that it feels [kg m^2].
        chain_angle: Angles of all joints [rad], shape [B, n].
    """

    time: float
    step: float
    angle: Array
    rate: Array
    effort: Array
    inertia: float
    chain_angle: Array


@dataclass
class Law(ABC):
    """A torque at one joint beside its spring and damper.

    Attributes:
        joint: Which, base 0.
        strength: Of every run, shape [B].
    """

    joint: int
    strength: Array = field(default_factory=lambda: np.ones(1), kw_only=True)

    def begin(self, angle: Array, rate: Array) -> None:  # noqa: B027
        """Forget, at the start of runs, whose angles and rates are given [B]."""

    @abstractmethod
    def torque(self, now: Now) -> Array:
        """Return the torque [B] and go on by a step [N m]."""


@dataclass(frozen=True)
class Motion:
    """What runs did, at the samples.

    Attributes:
        time: [s], shape [T].
        angle, rate, effort: Of all joints, shapes [T, B, n].
        law: Torque of the laws at all joints, in the middle of the step after each sample, shape [T, B, n].
    """

    time: Array
    angle: Array
    rate: Array
    effort: Array
    law: Array


def move(
    chain: Chain, start: Array, rate: Array, drive: Drive, laws: Sequence[Law], *, seconds: float, step: float,
    every: int = 1,
) -> Motion:  # fmt: skip
    """Integrate B runs from angles and rates [B, n]; every ``every``-th step is a sample."""
    count = round(seconds / step) + 1
    q, v = start.copy(), rate.copy()
    for law in laws:
        law.begin(q[:, law.joint], v[:, law.joint])
    out = [np.empty((-(-count // every), *q.shape)) for _ in range(4)]
    least = [float(x) for x in _least_inertia(chain)]
    gained = np.zeros_like(v)
    for k in range(count):
        time = k * step
        middle, about = q + 0.5 * step * v, v + 0.5 * step * gained
        effort = drive(time + 0.5 * step, middle, about)
        given = np.zeros_like(q)
        for law in laws:
            j = law.joint
            now = Now(time + 0.5 * step, step, middle[:, j], about[:, j], effort[:, j], least[j], middle)
            given[:, j] += law.torque(now)
        if k % every == 0:  # the effort of this moment: that of the step is half a step late
            for store, value in zip(out, (q, v, drive(time, q, v), given), strict=True):
                store[k // every] = value
        gained = chain.acceleration(middle, about, effort + given)
        v = v + step * gained
        q = middle + 0.5 * step * v
    return Motion(step * every * np.arange(len(out[0])), *out)


def _least_inertia(chain: Chain) -> Array:
    """Return a lower bound of what each joint feels when the others are free [kg m^2], shape [n]."""
    inverse = np.linalg.inv(chain.equations(np.zeros((1, chain.count)), np.zeros((1, chain.count)))[0][0])
    return 1.0 / np.diagonal(inverse)
