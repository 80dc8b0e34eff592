"""Hidden effects that do not act at a joint: added bodies, air, grip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .branch import Array, unit
from .parts import AIR, Draft, Law, Now, Part, Scale
from .rig import Trunk

Random = np.random.Generator


@dataclass
class Gust(Law):
    """Air whose dynamic pressure swings at a frequency that is itself modulated; u = V sgn(s) sqrt(|s|) d.

    Attributes:
        speed: V, largest speed of the air [m/s].
        direction: d, horizontal, shape [3].
        frequency: [Hz].
        phase: [rad].
        wobble: Amplitude of the phase modulation [rad].
        slow: Its frequency [Hz].
    """

    speed: float
    direction: Array
    frequency: float
    phase: float
    wobble: float
    slow: float
    fading = True

    def gust(self, time: Array) -> Array:
        """Return the velocity of the air."""
        turn = 2 * np.pi * np.asarray(time)
        swing = np.sin(self.frequency * turn + self.phase + self.wobble * np.sin(self.slow * turn))
        return np.asarray((self.speed * np.sign(swing) * np.sqrt(np.abs(swing)))[:, None] * self.direction)


@dataclass
class Slip(Law):
    """A grip that slides along the segment while the whole force exceeds a limit, and is not put back.

    The rate is the mobility times e^2 / (e + w), e = |F| - limit: it sets in smoothly and is w short of e far above. A
    slide s along the axis a gives the held link the couple s a x F, and the sensors the point s a from the marked one.

    Attributes:
        mobility: Towards the tip; negative: towards the base [m/(N s)].
        limit: [N].
        onset: w [N].
        room: Farthest slide towards the base and the tip [m].
    """

    mobility: float
    limit: float
    onset: float
    room: tuple[float, float]
    fading = True

    def begin(self, now: Now) -> None:
        """Grip the marked point again."""
        self.slide, self.speed = np.zeros(len(now.datas)), np.zeros(len(now.datas))

    def act(self, now: Now) -> None:
        """Slide, and add the couple."""
        excess = np.maximum(0.0, np.sqrt((now.force**2).sum(axis=1)) - self.limit)
        rate = self.mobility * excess**2 / (excess + self.onset)
        before = self.slide
        self.slide = np.clip(before + now.step * rate, -self.room[0], self.room[1])
        self.speed = (self.slide - before) / now.step
        now.couple += np.cross(self.slide[:, None] * now.grip_axis, now.force)

    def beside(self, now: Now) -> Array:
        """Return where the grip has slid, and the velocity of the slide and of the link's turn at that arm."""
        axis = now.grip_axis
        offset = self.slide[:, None] * axis
        return np.hstack([offset, self.speed[:, None] * axis + np.cross(now.grip_spin, offset)])


def tip_mass(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a small ball at the tip; the strength is its share of the branch's mass."""
    whole = float(scale.branch.mass().sum())

    def make(strength: float) -> Part:
        """Return a ball of strength x the branch's mass [kg]."""
        return Part({"mass_kg": strength * whole}, tip_mass=strength * whole)

    return Draft(make, 0.01, 0.1, 2.0)


def base_compliance(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a trunk on a ball joint; the strength is its compliance over the first joint's."""
    first, mass, time = scale.branch.stiffness[0], float(rng.uniform(0.3, 1.2)), float(rng.uniform(0.01, 0.03))

    def make(strength: float) -> Part:
        """Return a trunk on a ball joint of stiffness K_1 / strength [N m/rad]."""
        k = first / strength
        params = {"stiffness_Nmprad": k, "compliance_radpNm": 1 / k, "relaxation_s": time, "trunk_mass_kg": mass}
        return Part(params, trunk=Trunk(k, k * time, mass))

    return Draft(make, 0.003, 0.08, 1.5)


def quadratic_drag(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a fluid at rest, by MuJoCo's inertia-box model; the strength is its density [kg/m^3].

    The density stands for leaves and twigs too, whose area is many times that of the bare wood.
    """
    return Draft(lambda s: Part({"density_kgpm3": s}, density=s), 0.5, 20.0, 4000.0)


def steady_wind(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw air that blows steadily, mostly level; the strength is its dynamic pressure [Pa]."""
    direction = unit(rng.normal(size=3) * [1.0, 1.0, 0.4])

    def make(strength: float) -> Part:
        """Return air of velocity sqrt(2 strength / rho) [m/s] along the direction."""
        velocity = np.sqrt(2 * strength / AIR) * direction
        return Part({"velocity_mps": velocity.tolist(), "pressure_Pa": strength}, wind=velocity)

    return Draft(make, 0.1, 20.0, 2000.0)


def wind_gust(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw air that swings about calm; the strength is its largest dynamic pressure [Pa]."""
    turn, phase = rng.uniform(0, 2 * np.pi, 2)
    direction = np.array([np.cos(turn), np.sin(turn), 0.0])
    frequency, wobble, slow = (
        float(rng.uniform(0.35, 1.6)),
        float(rng.uniform(0.02, 0.1)),
        float(rng.uniform(0.02, 0.1)),
    )

    def make(strength: float) -> Part:
        """Return a gust whose largest speed is sqrt(2 strength / rho) [m/s]."""
        speed = float(np.sqrt(2 * strength / AIR))
        params = {
            "speed_mps": speed, "pressure_Pa": strength, "direction_rad": float(turn), "frequency_Hz": frequency,
            "phase_rad": float(phase), "wobble_rad": wobble, "slow_Hz": slow,
        }  # fmt: skip
        law = Gust(speed, direction, frequency, float(phase), wobble, slow)
        return Part(params, law=lambda: law, wind=np.zeros(3))

    return Draft(make, 0.1, 15.0, 1500.0)


def grasp_slip(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a sliding grip; the strength is its mobility over segment length per largest force and duration.

    Mostly it slides towards the base, where there is more room.
    """
    limit, end = float(rng.uniform(0.15, 0.5)) * scale.force, scale.branch.length[-1]
    way, onset = 1.0 if rng.random() < 0.25 else -1.0, float(rng.uniform(0.02, 0.1)) * limit
    room = (0.9 * scale.branch.grasp_distance, 0.98 * end - scale.branch.grasp_distance)

    def make(strength: float) -> Part:
        """Return a slide of mobility strength x length / (force x duration) [m/(N s)], negative towards the base."""
        mobility = way * strength * end / (scale.force * scale.duration)
        params = {"mobility_mpNs": mobility, "limit_N": limit, "onset_N": onset}
        return Part(params, law=lambda: Slip(mobility, limit, onset, room))

    return Draft(make, 0.01, 1.0, 50.0)


RECIPES = {
    "quadratic_drag": quadratic_drag,
    "tip_mass": tip_mass,
    "base_compliance": base_compliance,
    "grasp_slip": grasp_slip,
    "steady_wind": steady_wind,
    "wind_gust": wind_gust,
}
