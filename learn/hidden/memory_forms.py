"""Other published forms of what a joint remembers: friction, hysteresis and creep.

All are about the segment's own axes and add to the torque of the joint's spring K.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from .branch import Array, unit
from .joint_laws import Random, Turned
from .parts import Draft, Law, Now, Part, Scale

#: Level of friction, over T: of angles [rad], rates [rad/s] and turns of a step [rad], all [N, 3], to [N, 1].
Level = Callable[[Array, Array, Array], Array]


@dataclass
class Slider(Turned):
    """Coulomb's friction behind an elastic contact (Jenkins): it bends with the joint and slips at T times a level.

    Attributes:
        torque: T [N m].
        bend: Angle within which the contact sticks at level one [rad].
        level: What T depends on.
        soft: Whether it creeps before it slips, as LuGre's bristles do, and not only from T on.
    """

    torque: float
    bend: float
    level: Level
    soft: bool = False

    def act(self, now: Now) -> None:
        """Add the torque."""
        turn = self.turn(now)
        most = self.bend * self.level(now.angle(self.joint), now.rate(self.joint), turn)
        if self.soft:
            way = np.sqrt((turn**2).sum(axis=-1, keepdims=True))
            slipping = most * turn / np.maximum(way, 1e-300)
            self._z = slipping + (self._z - slipping) * np.exp(-way / most)
        else:
            bent = self._z + turn
            size = np.sqrt((bent**2).sum(axis=-1, keepdims=True))
            self._z = bent * np.minimum(1.0, most / np.maximum(size, 1e-300))
        now.twist(self.joint, -self.torque / self.bend * self._z)


@dataclass
class Creeper(Turned):
    """Friction T tanh(w / v) behind an elastic contact: nothing sticks, any torque makes it give way.

    The contact bends by b tanh(u) at the torque T tanh(u), at which it slides at v u; u is found by bisection for the
    end of the step.

    Attributes:
        torque: T [N m].
        bend: b [rad].
        rate: v [rad/s].
    """

    torque: float
    bend: float
    rate: float

    def act(self, now: Now) -> None:
        """Add the torque."""
        bent = self._z + self.turn(now)
        size = np.sqrt((bent**2).sum(axis=-1, keepdims=True))
        slide = self.rate * now.step
        low, high = np.zeros_like(size), size / slide
        for _ in range(40):
            u = 0.5 * (low + high)
            less = self.bend * np.tanh(u) + slide * u < size
            low, high = np.where(less, u, low), np.where(less, high, u)
        self._z = self.bend * np.tanh(low) * bent / np.maximum(size, 1e-300)
        now.twist(self.joint, -self.torque / self.bend * self._z)


@dataclass
class Stops(Turned):
    """Springs per axis, each of which slips at an angle of its own (Prandtl and Ishlinskii; Iwan).

    Attributes:
        stiffness: Of each spring [N m/rad].
        yields: Angle at which each slips [rad].
    """

    stiffness: Array
    yields: Array

    def begin(self, now: Now) -> None:
        """Forget."""
        super().begin(now)
        self._bent = np.zeros((len(self.yields), *self._z.shape))

    def act(self, now: Now) -> None:
        """Add the torques."""
        most = self.yields[:, None, None]
        self._bent = np.clip(self._bent + self.turn(now), -most, most)
        now.twist(self.joint, -np.tensordot(self.stiffness, self._bent, axes=1))


@dataclass
class Powered(Turned):
    """Bouc and Wen's element with an exponent n: z' = w (1 - |z / y|^n (c + (1 - c) sign(w z))), torque -k z.

    Attributes:
        stiffness: k [N m/rad].
        yields: y [rad].
        exponent: n.
        blend: c.
    """

    stiffness: float
    yields: float
    exponent: float
    blend: float

    def act(self, now: Now) -> None:
        """Add the torque."""
        turn, z = self.turn(now), self._z
        away = 1 - self.blend + self.blend * np.sign(turn * z)
        self._z = z + turn * (1 - np.minimum(1.0, np.abs(z / self.yields)) ** self.exponent * away)
        now.twist(self.joint, -self.stiffness * self._z)


@dataclass
class Prony(Law):
    """Maxwell elements side by side, per axis: each dashpot follows the angle with its own time.

    Attributes:
        joint: Segment whose lower joint it is.
        stiffness: Of the elements' springs [N m/rad].
        times: Of the elements [s].
    """

    joint: int
    stiffness: Array
    times: Array
    fading = True

    def begin(self, now: Now) -> None:
        """Relax."""
        self._dashpots = np.repeat(now.angle(self.joint)[None], len(self.times), axis=0)

    def act(self, now: Now) -> None:
        """Add the torque."""
        angle = now.angle(self.joint)
        self._dashpots = angle + (self._dashpots - angle) * np.exp(-now.step / self.times)[:, None, None]
        now.twist(self.joint, -np.tensordot(self.stiffness, angle - self._dashpots, axes=1))


def prony(relaxation: Callable[[Array], Array], start: float, end: float, count: int = 8) -> tuple[Array, Array]:
    """Fit a relaxation function by a sum of exponentials whose weights are not negative.

    Args:
        relaxation: Times [s] to what is left of a unit step.
        start: First time that matters [s].
        end: Last one [s].
        count: Number of exponentials.

    Returns:
        Weights, and times [s].
    """
    times = np.geomspace(start / 2, 4 * end, count)
    t = np.geomspace(start, end, 12 * count)
    wanted = relaxation(t)
    # Relative errors, so that the tail counts as much as the start.
    weights, _ = nnls(np.exp(-t[:, None] / times) / wanted[:, None], np.ones_like(t))
    return weights, times


# ---- dry_friction --------------------------------------------------------------------------------------------------


def _friction(
    rng: Random, scale: Scale, joint: int, level: Level, soft: bool = False, **params: float | list[float]
) -> Draft:
    """Draw friction; the strength is T over the largest torque."""
    size, bend = scale.torque(joint), float(rng.uniform(0.01, 0.02) * scale.angle[joint])

    def make(strength: float) -> Part:
        """Return friction of T = strength x the joint's largest torque [N m]."""
        torque = strength * size
        said = {"torque_Nm": torque, "bend_rad": bend, **params}
        return Part(said, joint, lambda: Slider(joint, torque, bend, level, soft))

    return Draft(make, 0.003, 0.1, 0.8)


def coulomb(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw Coulomb's friction with a sharp limit."""
    return _friction(rng, scale, joint, lambda phi, w, turn: np.ones((len(phi), 1)))


def stribeck(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw LuGre's friction: T (1 + s exp(-(|w| / v)^2)), larger while it hardly moves."""
    more, speed = float(rng.uniform(0.2, 0.6)), float(rng.uniform(0.03, 0.15)) * float(scale.rate[joint])

    def level(phi: Array, w: Array, turn: Array) -> Array:
        """Return 1 + s exp(-(|w| / v)^2) for rates w [N, 3], [N, 1]."""
        return np.asarray(1 + more * np.exp(-(w**2).sum(axis=-1, keepdims=True) / speed**2))

    return _friction(rng, scale, joint, level, True, more=more, speed_radps=speed)


def asymmetric(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw friction that is larger one way about an axis than the other."""
    axis, more = unit(rng.normal(size=3)), float(rng.uniform(0.15, 0.4))

    def level(phi: Array, w: Array, turn: Array) -> Array:
        """Return 1 + s or 1 - s, [N, 1], by the way that the step turns about the axis."""
        return np.asarray(1 + more * np.sign(turn @ axis)[:, None])

    return _friction(rng, scale, joint, level, more=more, axis=axis.tolist())


def loaded(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw friction that grows with the spring's torque, as in gears: T (1 + s |phi| / a)."""
    more, a = float(rng.uniform(0.3, 1.0)), float(scale.angle[joint])

    def level(phi: Array, w: Array, turn: Array) -> Array:
        """Return 1 + s |phi| / a for angles phi [N, 3], [N, 1]."""
        return np.asarray(1 + more * np.sqrt((phi**2).sum(axis=-1, keepdims=True)) / a)

    return _friction(rng, scale, joint, level, more=more)


def creeping(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw friction T tanh(w / v), a damper where it hardly moves; the strength is T over the largest torque."""
    size, bend = scale.torque(joint), float(rng.uniform(0.005, 0.01) * scale.angle[joint])
    rate = float(rng.uniform(0.05, 0.2) * scale.rate[joint])

    def make(strength: float) -> Part:
        """Return friction T tanh(w / v), T = strength x the joint's largest torque [N m]."""
        said = {"torque_Nm": strength * size, "bend_rad": bend, "speed_radps": rate}
        return Part(said, joint, lambda: Creeper(joint, strength * size, bend, rate))

    return Draft(make, 0.003, 0.1, 0.8)


# ---- hysteresis_boucwen --------------------------------------------------------------------------------------------


def prandtl_ishlinskii(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw eight springs that slip at evenly spaced angles up to a share of the largest angle."""
    most, k = float(rng.uniform(0.2, 0.8) * scale.angle[joint]), scale.branch.stiffness[joint]
    yields = most * np.arange(1, 9) / 8

    def make(strength: float) -> Part:
        """Return eight slipping springs that share strength x K evenly."""
        stiff = np.full(8, strength * k / 8)
        return Part({"share": strength, "yield_rad": most}, joint, lambda: Stops(joint, stiff, yields))

    return Draft(make, 0.02, 0.5, 2.5)


def iwan(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw Segalman's density of sliders r^chi between no angle and a largest one: loss goes with size^(3 + chi)."""
    most, k = float(rng.uniform(0.2, 0.8) * scale.angle[joint]), scale.branch.stiffness[joint]
    chi = float(rng.uniform(-0.8, -0.2))
    edges = most * np.geomspace(0.02, 1.0, 11)
    yields, share = np.sqrt(edges[1:] * edges[:-1]), np.diff(edges ** (1 + chi))
    share = share / share.sum()

    def make(strength: float) -> Part:
        """Return ten slipping springs that share strength x K by the density of sliders."""
        params = {"share": strength, "yield_rad": most, "chi": chi}
        return Part(params, joint, lambda: Stops(joint, strength * k * share, yields))

    return Draft(make, 0.02, 0.5, 2.5)


def bouc_wen_power(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw Bouc and Wen's equation with another exponent than one: a sharper knee, or a rounder one."""
    yields, k = float(rng.uniform(0.08, 0.5) * scale.angle[joint]), scale.branch.stiffness[joint]
    n, blend = float(rng.choice([0.6, 2.0, 3.0])), float(rng.uniform(0.5, 0.9))

    def make(strength: float) -> Part:
        """Return Bouc and Wen's element of stiffness strength x K and exponent n."""
        params = {"share": strength, "yield_rad": yields, "exponent": n, "beta_share": blend}
        return Part(params, joint, lambda: Powered(joint, strength * k, yields, n, blend))

    return Draft(make, 0.02, 0.5, 2.5)


# ---- viscoelastic_sls ----------------------------------------------------------------------------------------------


def _creeping(scale: Scale, joint: int, weights: Array, times: Array, **params: float) -> Draft:
    """Draw Maxwell elements of these weights; the strength is the share of K that they have together."""
    k, weights = scale.branch.stiffness[joint], weights / weights.sum()

    def make(strength: float) -> Part:
        """Return Maxwell elements that share strength x K by their weights."""
        return Part({"share": strength, **params}, joint, lambda: Prony(joint, strength * k * weights, times))

    return Draft(make, 0.02, 0.4, 3.0)


def _middle(rng: Random, scale: Scale, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))) * scale.duration)


def two_times(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw two Maxwell elements, one of which is five to fifteen times slower."""
    fast, ratio, part = _middle(rng, scale, 0.02, 0.1), float(rng.uniform(5, 15)), float(rng.uniform(0.3, 0.7))
    times, weights = np.array([fast, ratio * fast]), np.array([part, 1 - part])
    return _creeping(scale, joint, weights, times, relaxation_s=fast, ratio=ratio, part=part)


def fractional(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a springpot: relaxation goes with t^-alpha from a hundredth of the duration on."""
    alpha, start = float(rng.uniform(0.25, 0.6)), 0.01 * scale.duration
    weights, times = prony(lambda t: (t / start) ** -alpha, start, scale.duration)
    return _creeping(scale, joint, weights, times, order=alpha)


def stretched(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a relaxation exp(-(t / T)^b) (Kohlrausch)."""
    time, b = _middle(rng, scale, 0.04, 0.3), float(rng.uniform(0.4, 0.75))
    weights, times = prony(lambda t: np.exp(-((t / time) ** b)), time / 50, 3 * time)
    return _creeping(scale, joint, weights, times, relaxation_s=time, exponent=b)


FORMS = {
    "dry_friction": {
        "coulomb": coulomb,
        "stribeck": stribeck,
        "asymmetric": asymmetric,
        "loaded": loaded,
        "creeping": creeping,
    },
    "hysteresis_boucwen": {
        "prandtl_ishlinskii": prandtl_ishlinskii,
        "iwan": iwan,
        "bouc_wen_power": bouc_wen_power,
    },
    "viscoelastic_sls": {"two_times": two_times, "fractional": fractional, "stretched": stretched},
}
