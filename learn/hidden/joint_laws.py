"""Hidden laws at one joint, in the frame of its segment: two axes across it and one along it.

A law adds a torque to that of the joint's own spring K and damper. All are written axis by axis, as one would for
hinges; angles are those from the rest pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .branch import Array
from .parts import Draft, Law, Now, Part, Scale

Random = np.random.Generator


@dataclass
class Elastic(Law):
    """Torque -K (a phi_k^3 + g) per axis, with g = -gap tanh(phi_k / gap): a Duffing spring, or play.

    Attributes:
        joint: Segment whose lower joint it is.
        stiffness: K [N m/rad].
        cubic: a [1/rad^2].
        gap: Half the play, rounded; none if zero [rad].
    """

    joint: int
    stiffness: float
    cubic: float = 0.0
    gap: float = 0.0

    def act(self, now: Now) -> None:
        """Add the torque."""
        angle = now.angle(self.joint)
        lack = self.gap * np.tanh(angle / self.gap) if self.gap else 0.0
        now.twist(self.joint, self.stiffness * (lack - self.cubic * angle**3))


@dataclass
class Directed(Law):
    """Torque -M phi of a full 3 by 3 stiffness, for positive angles about an axis only if it is one-sided.

    Attributes:
        joint: Segment whose lower joint it is.
        matrix: M in the segment's frame [N m/rad], shape [3, 3].
        side: Axis whose negative angles do not count, shape [3], None if all do.
    """

    joint: int
    matrix: Array
    side: Array | None = None

    def act(self, now: Now) -> None:
        """Add the torque."""
        angle = now.angle(self.joint)
        if self.side is not None:
            angle = angle * (angle @ self.side > 0)[:, None]
        now.twist(self.joint, -angle @ self.matrix.T)


@dataclass
class Turned(Law):
    """A law that knows of the joint's turn from step to step and not of time, with a state z an axis [rad].

    Attributes:
        joint: Segment whose lower joint it is.
    """

    joint: int
    fading = True

    def begin(self, now: Now) -> None:
        """Forget."""
        self._last = now.angle(self.joint)
        self._z = np.zeros_like(self._last)

    def turn(self, now: Now) -> Array:
        """Return the turn since the last step, about the segment's axes [rad]."""
        before, self._last = self._last, now.angle(self.joint)
        return self._last - before


@dataclass
class Hysteresis(Turned):
    """Bouc and Wen's element per axis: z' = w - beta |w| z - gamma w |z|, exponent one, torque -k z.

    Attributes:
        joint: Segment whose lower joint it is.
        stiffness: k [N m/rad].
        beta: [1/rad].
        gamma: [1/rad].
    """

    stiffness: float
    beta: float
    gamma: float

    def act(self, now: Now) -> None:
        """Add the torque; the equation does not know of time, so it is stepped by the angle."""
        turn, z = self.turn(now), self._z
        self._z = z + turn - self.beta * np.abs(turn) * z - self.gamma * turn * np.abs(z)
        now.twist(self.joint, -self.stiffness * self._z)


@dataclass
class Bristles(Turned):
    """Dahl's friction, LuGre's without velocity: bristles bend with the joint and slip at T, whichever way it turns.

    Between steps exactly z = s + (z - s) exp(-|turn| / bend), s = bend turn / |turn|; the torque is -T z / bend.
    MuJoCo's own frictionloss needs an impedance of 0.9999 here (dof_solimp): at its default of 0.9 the constraint gives
    way long before a joint of a light chain is held, and the motion hardly depends on T.

    Attributes:
        joint: Segment whose lower joint it is.
        torque: T [N m].
        bend: Angle within which the bristles stick [rad].
    """

    torque: float
    bend: float

    def act(self, now: Now) -> None:
        """Add the torque."""
        turn = self.turn(now)
        way = np.sqrt((turn**2).sum(axis=-1, keepdims=True))
        slipping = self.bend * turn / np.maximum(way, 1e-300)
        self._z = slipping + (self._z - slipping) * np.exp(-way / self.bend)
        now.twist(self.joint, -self.torque / self.bend * self._z)


@dataclass
class Creep(Law):
    """A Maxwell element per axis: its dashpot x follows the angle with the time T, exactly between steps.

    Attributes:
        joint: Segment whose lower joint it is.
        stiffness: Of the element's spring [N m/rad].
        relaxation: T [s].
    """

    joint: int
    stiffness: float
    relaxation: float
    fading = True

    def begin(self, now: Now) -> None:
        """Relax."""
        self._dashpot = now.angle(self.joint)

    def act(self, now: Now) -> None:
        """Add the torque."""
        angle = now.angle(self.joint)
        self._dashpot = angle + (self._dashpot - angle) * np.exp(-now.step / self.relaxation)
        now.twist(self.joint, -self.stiffness * (angle - self._dashpot))


@dataclass
class Yielding(Law):
    """An elastic spring per axis in series with a slider that hardens by what it has slipped, either way.

    The elastic angle phi - p stays below y + h alpha, where alpha is the whole slip so far.

    Attributes:
        joint: Segment whose lower joint it is.
        stiffness: K [N m/rad].
        yields: y [rad].
        hardening: h, of K.
    """

    joint: int
    stiffness: float
    yields: float
    hardening: float
    lasting = True
    setting = True
    slip: Array | None = None
    total: Array | float = 0.0

    def act(self, now: Now) -> None:
        """Return to the yield surface and add the torque K p that the slip takes away."""
        angle = now.angle(self.joint)
        slip = np.zeros_like(angle) if self.slip is None else self.slip
        elastic = angle - slip
        more = np.maximum(0.0, np.abs(elastic) - self.yields - self.hardening * self.total) / (1 + self.hardening)
        self.slip, self.total = slip + more * np.sign(elastic), self.total + more
        now.twist(self.joint, self.stiffness * self.slip)


@dataclass
class Rupture(Law):
    """A spring that loses a share at once and for good when its angle first exceeds a limit; the pre-load stays.

    Attributes:
        joint: Segment whose lower joint it is.
        stiffness: K [N m/rad].
        limit: [rad].
        share: Of K.
    """

    joint: int
    stiffness: float
    limit: float
    share: float
    lasting = True
    broken: bool = False

    def act(self, now: Now) -> None:
        """Break, or add the torque that is gone."""
        angle = now.angle(self.joint)
        self.broken = self.broken or bool(np.abs(angle).max() > self.limit and (angle**2).sum() > self.limit**2)
        if self.broken:
            now.twist(self.joint, self.share * self.stiffness * angle)


def _sign(rng: Random, plus: float = 0.5) -> float:
    return 1.0 if rng.random() < plus else -1.0


def _across(rng: Random) -> tuple[Array, float]:
    """Draw a random axis across the segment, in its frame, and its angle from the first [rad]."""
    turn = float(rng.uniform(0, np.pi))
    return np.array([np.cos(turn), np.sin(turn), 0.0]), turn


def cubic(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a Duffing spring; the strength is the change of the torque at the largest angle."""
    sign, k, a = _sign(rng, 0.65), scale.branch.stiffness[joint], float(scale.angle[joint])

    def make(strength: float) -> Part:
        """Return a spring with the cubic term s / a^2 [1/rad^2], s the strength with its sign."""
        value = sign * strength / a**2
        return Part({"cubic_radm2": value}, joint, lambda: Elastic(joint, k, cubic=value))

    return Draft(make, 0.02, 0.5, 2.5 if sign > 0 else 0.6)


def backlash(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw rounded play; the strength is its half width over the largest angle."""
    k, a = scale.branch.stiffness[joint], float(scale.angle[joint])

    def make(strength: float) -> Part:
        """Return play of half width strength x a [rad]."""
        gap = strength * a
        return Part({"gap_rad": gap}, joint, lambda: Elastic(joint, k, gap=gap))

    return Draft(make, 0.005, 0.1, 0.8)


def bilinear(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a spring about one axis across the segment that changes where the angle changes sign."""
    (axis, turn), sign, k = _across(rng), _sign(rng), scale.branch.stiffness[joint]
    side = _sign(rng)

    def make(strength: float) -> Part:
        """Return the stiffness s K about the axis, on one side of rest alone, s the strength with its sign."""
        part = sign * strength
        law = Directed(joint, part * k * np.outer(axis, axis), side * axis)
        return Part({"relative": part, "axis_rad": turn, "side": side}, joint, lambda: law)

    return Draft(make, 0.02, 0.5, 2.5 if sign > 0 else 0.8)


def anisotropic(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a principal axis across the segment, of another stiffness."""
    (axis, turn), sign, k = _across(rng), _sign(rng), scale.branch.stiffness[joint]

    def make(strength: float) -> Part:
        """Return the stiffness s K n n^T about the axis n, s the strength with its sign."""
        law = Directed(joint, sign * strength * k * np.outer(axis, axis))
        return Part({"relative": sign * strength, "axis_rad": turn}, joint, lambda: law)

    return Draft(make, 0.02, 0.4, 2.5 if sign > 0 else 0.8)


def coupled(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a stiffness between bending about one axis and twist."""
    (axis, turn), sign, k = _across(rng), _sign(rng), scale.branch.stiffness[joint]
    off = np.outer(axis, [0.0, 0.0, 1.0])

    def make(strength: float) -> Part:
        """Return the stiffness s K (n e_z^T + e_z n^T) of bend and twist, s the strength with its sign."""
        law = Directed(joint, sign * strength * k * (off + off.T))
        return Part({"coupling": sign * strength, "axis_rad": turn}, joint, lambda: law)

    return Draft(make, 0.02, 0.4, 0.9)


def bouc_wen(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a hysteretic spring beside the joint's own; the strength is its share of K."""
    yields = float(rng.uniform(0.08, 0.5) * scale.angle[joint])
    blend, k = float(rng.uniform(0.5, 0.8)), scale.branch.stiffness[joint]

    def make(strength: float) -> Part:
        """Return a hysteretic spring of strength x K, which yields at an angle [rad]."""
        params = {"share": strength, "yield_rad": yields, "beta_share": blend}
        return Part(params, joint, lambda: Hysteresis(joint, strength * k, blend / yields, (1 - blend) / yields))

    return Draft(make, 0.02, 0.5, 2.5)


def creep(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a Maxwell element beside the joint's spring; the strength is its share of K."""
    time, k = float(np.exp(rng.uniform(np.log(0.04), np.log(0.4))) * scale.duration), scale.branch.stiffness[joint]

    def make(strength: float) -> Part:
        """Return a Maxwell element of strength x K and a relaxation time [s]."""
        params = {"share": strength, "relaxation_s": time}
        return Part(params, joint, lambda: Creep(joint, strength * k, time))

    return Draft(make, 0.02, 0.4, 2.5)


def plastic(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a yielding spring; the strength is the share of a turn beyond the yield angle that stays."""
    yields, k = float(rng.uniform(0.25, 0.6) * scale.angle[joint]), scale.branch.stiffness[joint]

    def make(strength: float) -> Part:
        """Return a yielding spring K with hardening 1 / strength - 1."""
        hardening = 1 / strength - 1
        params = {"share": strength, "yield_rad": yields, "hardening": hardening}
        return Part(params, joint, lambda: Yielding(joint, k, yields, hardening))

    return Draft(make, 0.02, 0.3, 0.9)


def rupture(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a spring that breaks in part; the strength is the share that it loses."""
    limit, k = float(rng.uniform(0.45, 0.85) * scale.angle[joint]), scale.branch.stiffness[joint]

    def make(strength: float) -> Part:
        """Return a spring that loses the strength, a share of K, once its angle passes the limit [rad]."""
        params = {"share": strength, "limit_rad": limit}
        return Part(params, joint, lambda: Rupture(joint, k, limit, strength))

    return Draft(make, 0.02, 0.25, 0.85)


def friction(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw dry friction; the strength is over the largest torque."""
    size, bend = scale.torque(joint), float(rng.uniform(0.008, 0.02) * scale.angle[joint])

    def make(strength: float) -> Part:
        """Return dry friction of strength x the joint's largest torque [N m]."""
        params = {"torque_Nm": strength * size, "bend_rad": bend}
        return Part(params, joint, lambda: Bristles(joint, strength * size, bend))

    return Draft(make, 0.003, 0.1, 0.8)


RECIPES = {
    "cubic_stiffness": cubic,
    "bilinear_stiffness": bilinear,
    "dry_friction": friction,
    "hysteresis_boucwen": bouc_wen,
    "viscoelastic_sls": creep,
    "backlash": backlash,
    "plastic_set": plastic,
    "partial_rupture": rupture,
    "anisotropic_stiffness": anisotropic,
    "bending_torsion_coupling": coupled,
}
