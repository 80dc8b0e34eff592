"""Other published forms of what a joint's spring may lack: nonlinear, one-sided, loose, directed, and damage.

All are in the frame of the joint's segment, angles from the rest pose, and add to the torque of the spring K. Strengths
are relative to the largest angle a that the joint has without the effect.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .branch import Array
from .joint_laws import Directed, Random
from .parts import Draft, Law, Now, Part, Scale

#: Largest turn, over a, to which laws that would bend back or grow without end are followed; constant beyond.
FAR = 2.5


@dataclass
class Spring(Law):
    """A torque that the angle alone decides.

    Attributes:
        joint: Segment whose lower joint it is.
        torque: Angles [rad] to torques [N m], both of shape [N, 3].
    """

    joint: int
    torque: Callable[[Array], Array]

    def act(self, now: Now) -> None:
        """Add the torque."""
        now.twist(self.joint, self.torque(now.angle(self.joint)))


@dataclass
class Set(Law):
    """An elastic spring K per axis in series with a slider; what has slipped stays.

    The elastic angle less the back angle x stays below y(alpha), alpha the whole slip so far; x' = C p' - gamma x
    |p'| (Armstrong and Frederick). With a time T the excess goes down with exp(-t / T) (Norton) and not at once.

    Attributes:
        joint: Segment whose lower joint it is.
        stiffness: K [N m/rad].
        yields: alpha to y, both in rad.
        slope: Of ``yields`` where alpha is zero.
        back: C, and gamma [1/rad].
        time: T [s]; zero: at once.
    """

    joint: int
    stiffness: float
    yields: Callable[[Array], Array]
    slope: float
    back: tuple[float, float] = (0.0, 0.0)
    time: float = 0.0
    lasting = True
    setting = True
    slip: Array = field(default_factory=lambda: np.zeros((1, 3)))
    moved: Array = field(default_factory=lambda: np.zeros((1, 3)))
    total: Array = field(default_factory=lambda: np.zeros((1, 3)))

    def act(self, now: Now) -> None:
        """Slip, and add the torque K p that this takes away."""
        elastic = now.angle(self.joint) - self.slip - self.moved
        excess = np.maximum(0.0, np.abs(elastic) - self.yields(self.total))
        rate = -np.expm1(-now.step / self.time) if self.time else 1.0
        more = rate * excess / (1 + self.slope + self.back[0])
        turn = more * np.sign(elastic)
        self.slip, self.total = self.slip + turn, self.total + more
        self.moved = self.moved + self.back[0] * turn - self.back[1] * self.moved * more
        now.twist(self.joint, self.stiffness * self.slip)


@dataclass
class Damage(Law):
    """A spring that loses a share of K which grows with what it has been through; the pre-load stays, or goes with it.

    Attributes:
        joint: Segment whose lower joint it is.
        stiffness: K [N m/rad].
        limit: Angle from which on there is damage [rad].
        lost: Share of K that is lost after the largest angle so far, or, with ``worn``, after a turn beyond the limit.
        worn: Whether every turn beyond the limit counts.
        sags: Whether as much of the pre-load is lost.
    """

    joint: int
    stiffness: float
    limit: float
    lost: Callable[[float], float]
    worn: bool = False
    sags: bool = False
    lasting = True
    state: float = 0.0
    _last: float = 0.0

    def act(self, now: Now) -> None:
        """Take damage, and add the torque that is gone."""
        angle = now.angle(self.joint)
        size = float(np.sqrt((angle**2).sum()))
        if self.worn:
            self.state += max(0.0, size - max(self._last, self.limit))
            self._last = size
        else:
            self.state = max(self.state, size)
        gone = self.stiffness * angle - (now.preload(self.joint) if self.sags else 0.0)
        now.twist(self.joint, self.lost(self.state) * gone)


def _sign(rng: Random, plus: float = 0.5) -> float:
    return 1.0 if rng.random() < plus else -1.0


def _axis(rng: Random) -> tuple[Array, float]:
    turn = float(rng.uniform(0, np.pi))
    return np.array([np.cos(turn), np.sin(turn), 0.0]), turn


def _spring(joint: int, params: dict[str, float], torque: Callable[[Array], Array]) -> Part:
    return Part(params, joint, lambda: Spring(joint, torque))


def _at(scale: Scale, joint: int) -> tuple[float, float]:
    """Return a joint's K and its largest angle."""
    return scale.branch.stiffness[joint], float(scale.angle[joint])


# ---- cubic_stiffness -----------------------------------------------------------------------------------------------


def exponential(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a spring K sinh(b phi) / b about each axis (Fung); the strength is what it adds at the angle a, nearly."""
    k, a = _at(scale, joint)

    def make(strength: float) -> Part:
        """Return the torque -K (sinh(b phi) / b - phi), b = sqrt(6 strength) / a."""
        b = np.sqrt(6 * strength) / a
        return _spring(joint, {"rate_prad": b}, lambda phi: -k * (np.sinh(np.clip(b * phi, -4, 4)) / b - phi))

    return Draft(make, 0.02, 0.5, 3.0)


def softening(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a spring K tanh(b phi) / b about each axis; the strength is what it lacks at the angle a, nearly."""
    k, a = _at(scale, joint)

    def make(strength: float) -> Part:
        """Return the torque K (phi - tanh(b phi) / b), b = sqrt(3 strength) / a."""
        b = np.sqrt(3 * strength) / a
        return _spring(joint, {"rate_prad": b}, lambda phi: k * (phi - np.tanh(b * phi) / b))

    return Draft(make, 0.02, 0.5, 3.0)


def quintic(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw K s (phi / a)^4 phi about each axis."""
    (k, a), sign = _at(scale, joint), _sign(rng, 0.65)

    def make(strength: float) -> Part:
        """Return the torque -K s (phi / a)^4 phi, s the strength with its sign."""
        s = sign * strength
        return _spring(joint, {"relative": s, "angle_rad": a},
                       lambda phi: -k * s * np.clip(phi / a, -FAR, FAR) ** 4 * phi)  # fmt: skip

    return Draft(make, 0.02, 0.5, 2.5 if sign > 0 else 0.5)


def radial(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw K s |phi|^2 / a^2 phi, alike in all directions."""
    (k, a), sign = _at(scale, joint), _sign(rng, 0.65)

    def make(strength: float) -> Part:
        """Return the torque -K s |phi|^2 / a^2 phi, s the strength with its sign."""
        s = sign * strength
        return _spring(joint, {"relative": s, "angle_rad": a},
                       lambda phi: -k * s * (phi**2).sum(axis=-1, keepdims=True) / a**2 * phi)  # fmt: skip

    return Draft(make, 0.02, 0.5, 2.5 if sign > 0 else 0.6)


# ---- bilinear_stiffness --------------------------------------------------------------------------------------------


def _one_sided(
    rng: Random, scale: Scale, joint: int, shape: Callable[[Array], Array], params: dict[str, float]
) -> Draft:
    """Draw K s a shape(u / a) about one axis across the segment, u the angle about it towards a side."""
    (k, a), (axis, turn) = _at(scale, joint), _axis(rng)
    sign, side = _sign(rng), _sign(rng)

    def make(strength: float) -> Part:
        """Return the one-sided torque of share s, the strength with its sign."""
        s = sign * strength

        def torque(phi: Array) -> Array:
            """Return -K s a shape(u / a) about the axis, towards its side, for angles phi [N, 3]."""
            u = side * (phi @ axis) / a
            return np.asarray(-s * k * a * side * shape(u)[:, None] * axis)

        return _spring(joint, {"relative": s, "axis_rad": turn, "side": side, **params}, torque)

    return Draft(make, 0.02, 0.5, 2.5 if sign > 0 else 0.8)


def smooth_corner(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a spring that changes over an angle w: (u + sqrt(u^2 + w^2) - w) / 2."""
    w = float(rng.uniform(0.1, 0.35))
    return _one_sided(rng, scale, joint, lambda u: (u + np.sqrt(u * u + w * w) - w) / 2, {"width": w})


def quadratic(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a spring K (1 + s u / a): stiffer the farther to one side, softer the farther to the other."""
    return _one_sided(rng, scale, joint, lambda u: np.clip(u, -1.2, FAR) ** 2, {})


def late_corner(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a spring that changes at an angle beyond the rest pose: the wood's own flaw closes or opens there."""
    corner = float(rng.uniform(0.1, 0.35))
    return _one_sided(rng, scale, joint, lambda u: np.maximum(0.0, u - corner), {"corner": corner})


# ---- backlash ------------------------------------------------------------------------------------------------------


def _loose(scale: Scale, joint: int, lack: Callable[[Array, float], Array], params: dict[str, float]) -> Draft:
    """Draw a spring that lacks K lack(phi, g) about each axis; the strength is the half width g over a."""
    k, a = _at(scale, joint)

    def make(strength: float) -> Part:
        """Return the torque K lack(phi, g) with the half width g = strength x a [rad]."""
        gap = strength * a
        return _spring(joint, {"gap_rad": gap, **params}, lambda phi: k * lack(phi, gap))

    return Draft(make, 0.005, 0.1, 0.8)


def dead_zone(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw no spring at all inside the gap, the whole one outside."""
    return _loose(scale, joint, lambda phi, gap: np.clip(phi, -gap, gap), {})


def soft_edges(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a gap in which a share of the spring stays."""
    stays = float(rng.uniform(0.08, 0.3))
    return _loose(scale, joint, lambda phi, gap: (1 - stays) * np.clip(phi, -gap, gap), {"stays": stays})


def hertz(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw contact beyond the gap by Hertz: K (|phi| - g)^1.5 / sqrt(a)."""
    a = float(scale.angle[joint])

    def lack(phi: Array, gap: float) -> Array:
        """Return phi - sign(phi) max(0, |phi| - g)^1.5 / sqrt(a), what the contact's spring lacks [rad]."""
        return np.asarray(phi - np.sign(phi) * np.maximum(0.0, np.abs(phi) - gap) ** 1.5 / np.sqrt(a))

    return _loose(scale, joint, lack, {})


# ---- anisotropic_stiffness, bending_torsion_coupling ---------------------------------------------------------------


def section(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw an oval section: K (1 + s) about one axis across the segment, K (1 - s) about the other."""
    k, (axis, turn) = scale.branch.stiffness[joint], _axis(rng)
    other = np.cross([0.0, 0.0, 1.0], axis)

    def make(strength: float) -> Part:
        """Return the torque of the stiffness s K (n n^T - m m^T), n and m the two axes, s the strength."""
        matrix = strength * k * (np.outer(axis, axis) - np.outer(other, other))
        return Part({"relative": strength, "axis_rad": turn}, joint, lambda: Directed(joint, matrix))

    return Draft(make, 0.02, 0.3, 0.8)


def orthotropic(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw another K about one axis across the segment, and another one in twist."""
    k, (axis, turn), sign = scale.branch.stiffness[joint], _axis(rng), _sign(rng)
    twist = sign * float(rng.uniform(-0.5, 0.5))

    def make(strength: float) -> Part:
        """Return the torque of s K n n^T and a share of it in twist, s the strength with its sign."""
        matrix = sign * strength * k * np.outer(axis, axis) + twist * strength * k * np.diag([0.0, 0.0, 1.0])
        params = {"relative": sign * strength, "axis_rad": turn, "twist": twist}
        return Part(params, joint, lambda: Directed(joint, matrix))

    return Draft(make, 0.02, 0.4, 2.5 if sign > 0 else 0.8)


def turning_axes(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw the energy K s (phi n)^2 / 2 of an axis n across the segment that turns with the size of the bend."""
    (k, a), (_, turn), sign = _at(scale, joint), _axis(rng), _sign(rng)
    turns = _sign(rng) * float(rng.uniform(0.2, 0.6))

    def make(strength: float) -> Part:
        """Return the torque of an axis that turns with the bend, s the strength with its sign."""

        def torque(phi: Array) -> Array:
            """Return minus the gradient of K s (phi n)^2 / 2 by phi [N, 3], n(|bend|) turned."""
            bend = phi * [1.0, 1.0, 0.0]
            size = np.sqrt((bend**2).sum(axis=1))
            now = turn + turns * size / a
            axis = np.stack([np.cos(now), np.sin(now), 0 * now], axis=1)
            other = np.stack([-np.sin(now), np.cos(now), 0 * now], axis=1)
            u, v = ((phi * n).sum(axis=1, keepdims=True) for n in (axis, other))
            swing = turns / a * v * bend / np.maximum(size, 1e-12)[:, None]
            return np.asarray(-sign * strength * k * u * (axis + swing))

        return _spring(joint, {"relative": sign * strength, "axis_rad": turn, "turns_rad": turns}, torque)

    return Draft(make, 0.02, 0.4, 2.5 if sign > 0 else 0.8)


def quadratic_coupling(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw the energy K s u^2 t / a of a bend u and a twist t: twist follows the bend, whichever way it goes."""
    (k, a), (axis, turn), sign = _at(scale, joint), _axis(rng), _sign(rng)
    along = np.array([0.0, 0.0, 1.0])

    def make(strength: float) -> Part:
        """Return the torque of the energy K s u^2 t / a, s the strength with its sign."""

        def torque(phi: Array) -> Array:
            """Return -K s (2 u t n + u^2 e_z) / a, bend u and twist t of phi [N, 3] bounded."""
            u, t = np.clip(phi @ axis, -FAR * a, FAR * a)[:, None], np.clip(phi[:, 2:], -a, a)
            return np.asarray(-sign * strength * k / a * (2 * u * t * axis + u * u * along))

        return _spring(joint, {"coupling": sign * strength, "axis_rad": turn}, torque)

    return Draft(make, 0.02, 0.3, 0.9)


def saturating_coupling(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw the energy K s a^2 tanh(u / a) tanh(t / a) of a bend u and a twist t."""
    (k, a), (axis, turn), sign = _at(scale, joint), _axis(rng), _sign(rng)
    along = np.array([0.0, 0.0, 1.0])

    def make(strength: float) -> Part:
        """Return the torque of the energy K s a^2 tanh(u / a) tanh(t / a), s the strength with its sign."""

        def torque(phi: Array) -> Array:
            """Return minus the gradient of that energy by phi [N, 3], in bend n and twist e_z."""
            u, t = np.tanh(phi @ axis / a)[:, None], np.tanh(phi[:, 2:] / a)
            return np.asarray(-sign * strength * k * a * ((1 - u * u) * t * axis + (1 - t * t) * u * along))

        return _spring(joint, {"coupling": sign * strength, "axis_rad": turn}, torque)

    return Draft(make, 0.02, 0.4, 1.0)


# ---- plastic_set, partial_rupture ----------------------------------------------------------------------------------


def _yielding(scale: Scale, joint: int, rng: Random) -> tuple[float, float, float]:
    """Return K, the largest angle, and a yield angle."""
    k, a = _at(scale, joint)
    return k, a, float(rng.uniform(0.25, 0.6)) * a


def voce(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a yield angle that saturates: y + Q (1 - exp(-b alpha)) (Voce); b Q is 1 / strength - 1."""
    k, a, y = _yielding(scale, joint, rng)
    more = float(rng.uniform(1.0, 1.6)) * a

    def make(strength: float) -> Part:
        """Return a set of yield angle y + Q (1 - exp(-b alpha)), b = (1 / strength - 1) / Q."""
        b = (1 / strength - 1) / more
        params = {"yield_rad": y, "saturation_rad": more, "rate_prad": b}
        return Part(params, joint, lambda: Set(joint, k, lambda w: y - more * np.expm1(-b * w), b * more))

    return Draft(make, 0.02, 0.3, 0.9)


def chaboche(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw hardening of which a part moves the elastic range (Chaboche); in all 1 / strength - 1."""
    k, a, y = _yielding(scale, joint, rng)
    part, gamma = float(rng.uniform(0.2, 0.5)), 1 / a

    def make(strength: float) -> Part:
        """Return a set of hardening h = 1 / strength - 1, a share of it kinematic and the rest isotropic."""
        h = 1 / strength - 1
        params = {"yield_rad": y, "isotropic": (1 - part) * h, "kinematic": part * h, "gamma_prad": gamma}
        grown = (1 - part) * h
        return Part(params, joint, lambda: Set(joint, k, lambda w: y + grown * w, grown, (part * h, gamma)))

    return Draft(make, 0.02, 0.3, 0.9)


def norton(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw hardening by 1 / strength - 1 that takes time: the excess of the angle over y goes down exponentially."""
    k, _, y = _yielding(scale, joint, rng)
    time = float(rng.uniform(0.01, 0.06)) * scale.duration

    def make(strength: float) -> Part:
        """Return a set of yield angle y + h alpha, h = 1 / strength - 1, reached with a time constant [s]."""
        h = 1 / strength - 1
        params = {"yield_rad": y, "hardening": h, "time_s": time}
        return Part(params, joint, lambda: Set(joint, k, lambda w: y + h * w, h, time=time))

    return Draft(make, 0.02, 0.3, 0.9)


def _breaking(
    rng: Random, scale: Scale, joint: int, lost: Callable[[float, float], float], *, worn: bool = False,
    sags: bool = False,
) -> Draft:  # fmt: skip
    """Draw damage beyond a limit; ``lost`` is of the angle over the limit, the strength the most that can be lost."""
    k, a = _at(scale, joint)
    limit = float(rng.uniform(0.4, 0.7)) * a

    def make(strength: float) -> Part:
        """Return the damage of which at most the strength, a share of K, can be lost."""

        def share(state: float) -> float:
            """Return the share of K that is lost after a largest angle, or after a turn beyond the limit [rad]."""
            return strength * lost(state / limit, limit / a)

        return Part({"share": strength, "limit_rad": limit}, joint, lambda: Damage(joint, k, limit, share, worn, sags))

    return Draft(make, 0.02, 0.35, 0.9)


def stepwise(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a bundle of fibres that break one after the other, a step of 15 % of the limit apart (Daniels)."""
    count = int(rng.integers(2, 5))
    return _breaking(rng, scale, joint, lambda x, _: min(1.0, np.floor(max(0.0, (x - 1) / 0.15 + 1)) / count))


def gradual(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw damage 1 - exp(-(x - 1) / w) of the largest angle x, over the limit (Mazars)."""
    w = float(rng.uniform(0.1, 0.35))
    return _breaking(rng, scale, joint, lambda x, _: -np.expm1(-max(0.0, x - 1) / w))


def fatigue(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw damage 1 - exp(-w / (n a)) of the whole way w beyond the limit, cycle after cycle (Lemaitre)."""
    cycles = float(rng.uniform(0.5, 1.5))
    return _breaking(rng, scale, joint, lambda x, part: -np.expm1(-x * part / cycles), worn=True)


def sagging(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw fibres that part at once and no longer carry their share of the weight."""
    return _breaking(rng, scale, joint, lambda x, _: float(x > 1), sags=True)


FORMS = {
    "cubic_stiffness": {"exponential": exponential, "softening": softening, "quintic": quintic, "radial": radial},
    "bilinear_stiffness": {"smooth_corner": smooth_corner, "quadratic": quadratic, "late_corner": late_corner},
    "backlash": {"dead_zone": dead_zone, "soft_edges": soft_edges, "hertz": hertz},
    "anisotropic_stiffness": {"section": section, "orthotropic": orthotropic, "turning_axes": turning_axes},
    "bending_torsion_coupling": {"quadratic": quadratic_coupling, "saturating": saturating_coupling},
    "plastic_set": {"voce": voce, "chaboche": chaboche, "norton": norton},
    "partial_rupture": {"stepwise": stepwise, "gradual": gradual, "fatigue": fatigue, "sagging": sagging},
}
