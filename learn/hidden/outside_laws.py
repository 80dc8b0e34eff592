"""Hidden effects that are not among the known ones: the right verdict is unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .branch import Array, unit
from .joint_laws import Turned
from .parts import Draft, Law, Now, Part, Readings, Scale

Random = np.random.Generator


@dataclass
class ChangingSpring(Law):
    """Springs whose stiffness changes with the time on the clock: K (1 + drift (t - t0) / T + swing sin(2 pi f t)).

    Attributes:
        stiffness: Segment to K [N m/rad].
        drift: Change from the first recording's start t0 to the last one's.
        span: t0 and T [s].
        swing: Amplitude of the oscillation.
        frequency: f [Hz].
    """

    stiffness: dict[int, float]
    drift: float = 0.0
    span: tuple[float, float] = (0.0, 1.0)
    swing: float = 0.0
    frequency: float = 0.0

    def act(self, now: Now) -> None:
        """Add the torques."""
        change = self.drift * (now.time - self.span[0]) / self.span[1]
        change = change + self.swing * np.sin(2 * np.pi * self.frequency * now.time)
        for segment, k in self.stiffness.items():
            now.twist(segment, -k * change[:, None] * now.angle(segment))


@dataclass
class CubicDamper(Law):
    """Torque -c |w|^2 w at a joint, no steeper beyond a rate.

    Attributes:
        joint: Segment whose lower joint it is.
        damping: c [N m s^3/rad^3].
        most: Largest |w| of the coefficient c |w|^2, which the explicit law must not make too large [rad/s].
    """

    joint: int
    damping: float
    most: float

    def act(self, now: Now) -> None:
        """Add the torque."""
        rate = now.rate(self.joint)
        square = np.minimum(self.most**2, (rate**2).sum(axis=1, keepdims=True))
        now.twist(self.joint, -self.damping * square * rate)


@dataclass
class Neighbour(Law):
    """Another branch that the grasp point touches on one side: a spring k with a damper, pushing only.

    Attributes:
        stiffness: k [N/m].
        direction: Towards the neighbour, shape [3].
        gap: Its distance [m].
    """

    stiffness: float
    direction: Array
    gap: float

    def act(self, now: Now) -> None:
        """Push back."""
        into = now.moved @ self.direction - self.gap
        speed = now.velocity @ self.direction
        push = np.where(into > 0, np.maximum(0.0, self.stiffness * (into + 0.02 * speed)), 0.0)
        now.push -= push[:, None] * self.direction


@dataclass
class Tether(Law):
    """A rope from the grasp point to a fixed point, slack at rest, that pulls only.

    Attributes:
        stiffness: [N/m].
        reach: From the rest position to the fixed point [m], shape [3].
        slack: Length beyond that [m].
    """

    stiffness: float
    reach: Array
    slack: float

    def act(self, now: Now) -> None:
        """Pull."""
        way = self.reach - now.moved
        length = np.sqrt((way**2).sum(axis=1))
        stretch = np.maximum(0.0, length - np.sqrt(self.reach @ self.reach) - self.slack)
        now.push += (self.stiffness * stretch / length)[:, None] * way


@dataclass
class FluidMemory(Law):
    """A drag at the grasp point on the velocity less its own past: the fluid is carried along after a time T.

    Attributes:
        drag: [N s/m].
        time: T [s].
    """

    drag: float
    time: float
    fading = True

    def begin(self, now: Now) -> None:
        """Bring the fluid to rest."""
        self._carried = np.zeros((len(now.datas), 3))

    def act(self, now: Now) -> None:
        """Drag."""
        velocity = now.velocity
        self._carried = velocity + (self._carried - velocity) * np.exp(-now.step / self.time)
        now.push -= self.drag * (velocity - self._carried)


def _sign(rng: Random) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def gain_error(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw displacement and velocity with another gain on every axis; the strength is the largest error."""
    lean = rng.uniform(-1, 1, 3)
    lean /= np.abs(lean).max()

    def make(strength: float) -> Part:
        """Return gains 1 + strength x lean of displacement and velocity, shape [3]."""
        gain = 1 + strength * lean
        return Part({"gain": gain.tolist()},
                    sense=lambda seen: seen.but(moved=gain * seen.moved, velocity=gain * seen.velocity))  # fmt: skip

    return Draft(make, 0.01, 0.2, 0.8)


def frame_misalignment(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a force sensor whose frame is turned; the strength is the angle [rad]."""
    axis = unit(rng.normal(size=3))
    across = np.cross(np.eye(3), axis)

    def make(strength: float) -> Part:
        """Return forces seen in a frame turned by the strength [rad] about the axis (Rodrigues)."""
        turn = np.eye(3) + np.sin(strength) * across + (1 - np.cos(strength)) * across @ across
        return Part({"axis": axis.tolist(), "angle_rad": strength},
                    sense=lambda seen: seen.but(force=seen.force @ turn))  # fmt: skip

    return Draft(make, 0.01, 0.2, 1.2)


def stiffness_drift(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw springs that all stiffen or soften over the hours of the experiment; the strength is the share."""
    sign, span = _sign(rng), (float(scale.clock[0]), float(scale.clock[-1] - scale.clock[0]))
    springs = dict(enumerate(scale.branch.stiffness))

    def make(strength: float) -> Part:
        """Return springs whose K changes by the strength, a share, from the first recording to the last."""
        return Part({"drift": sign * strength}, law=lambda: ChangingSpring(springs, sign * strength, span))

    return Draft(make, 0.02, 0.3, 0.7)


def parametric_stiffness(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a spring whose stiffness oscillates; the strength is the amplitude."""
    frequency, k = float(rng.uniform(0.3, 1.5)), scale.branch.stiffness[joint]

    def make(strength: float) -> Part:
        """Return a spring whose K oscillates by the strength, a share of it."""
        law = ChangingSpring({joint: k}, swing=strength, frequency=frequency)
        return Part({"amplitude": strength, "frequency_Hz": frequency}, joint, lambda: law)

    return Draft(make, 0.02, 0.3, 0.9)


def cubic_velocity_damping(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a damper that grows with the square of the rate; the strength is its torque at the largest rate over K's."""
    unit_damping = scale.torque(joint) / float(scale.rate[joint]) ** 3

    def make(strength: float) -> Part:
        """Return a damper c |w|^2 w, c = strength x K a / largest rate^3 [N m s^3/rad^3]."""
        value = strength * unit_damping
        most = 1.3 * float(scale.rate[joint])
        return Part({"damping_Nms3prad3": value}, joint, lambda: CubicDamper(joint, value, most))

    return Draft(make, 0.02, 0.5, 1.5)


def neighbour_stop(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a neighbour on one side of the branch; the strength is its stiffness over force per displacement."""
    direction = scale.pushes[int(rng.integers(len(scale.pushes)))]
    gap = float(rng.uniform(0.2, 0.5) * scale.moved)

    def make(strength: float) -> Part:
        """Return a neighbour of stiffness strength x force / displacement [N/m], a gap away."""
        k = strength * scale.force / scale.moved
        params = {"stiffness_Npm": k, "gap_m": gap, "direction": direction.tolist()}
        return Part(params, law=lambda: Neighbour(k, direction, gap))

    return Draft(make, 0.02, 0.7, 20.0)


def tether(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a rope to a fixed point; the strength is its stiffness over force per displacement."""
    away = -scale.pushes[int(rng.integers(len(scale.pushes)))] + 0.3 * rng.normal(size=3)
    reach, slack = float(rng.uniform(0.3, 1.2)) * unit(away), float(rng.uniform(0.0, 0.2) * scale.moved)

    def make(strength: float) -> Part:
        """Return a rope of stiffness strength x force / displacement [N/m]."""
        k = strength * scale.force / scale.moved
        params = {"stiffness_Npm": k, "reach_m": reach.tolist(), "slack_m": slack}
        return Part(params, law=lambda: Tether(k, reach, slack))

    return Draft(make, 0.02, 0.5, 20.0)


def fluid_memory(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a fluid with memory at the grasp point; the strength is its drag at the largest speed."""
    time = float(np.exp(rng.uniform(np.log(0.05), np.log(0.6))))

    def make(strength: float) -> Part:
        """Return a fluid of drag strength x force / speed [N s/m] that is carried along after its time."""
        drag = strength * scale.force / scale.speed
        return Part({"drag_Nspm": drag, "memory_s": time}, law=lambda: FluidMemory(drag, time))

    return Draft(make, 0.01, 0.3, 5.0)


def clock_jitter(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw displacement and velocity taken early or late; the strength is the clock's deviation in samples."""
    wander = np.zeros((len(scale.clock), scale.samples))
    for n in range(1, scale.samples):
        wander[:, n] = 0.9 * wander[:, n - 1] + np.sqrt(1 - 0.9**2) * rng.normal(size=len(wander))

    def make(strength: float) -> Part:
        """Return readings taken early or late by a wander of strength samples' deviation."""
        return Part({"deviation_samples": strength}, sense=lambda seen: _resampled(seen, strength * wander))

    return Draft(make, 0.1, 1.0, 8.0)


def _resampled(seen: Readings, late: Array) -> Readings:
    """Displacement and velocity ``late`` samples [N, T] after their time, straight between samples."""
    at = np.clip(np.arange(len(seen.time)) + late, 0, len(seen.time) - 1)
    low = np.minimum(at.astype(int), len(seen.time) - 2)
    part, row = (at - low)[..., None], np.arange(len(late))[:, None]
    moved, velocity = (
        (1 - part) * values[row, low] + part * values[row, low + 1] for values in (seen.moved, seen.velocity)
    )
    return seen.but(moved=moved, velocity=velocity)


def displacement_saturation(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a displacement sensor that ends before the motion does; the strength is the share that it lacks."""

    def make(strength: float) -> Part:
        """Return displacements cut at (1 - strength) of the largest one [m]."""
        limit = (1 - strength) * scale.moved
        return Part({"limit_m": limit}, sense=lambda seen: seen.but(moved=np.clip(seen.moved, -limit, limit)))

    return Draft(make, 0.02, 0.5, 0.95)


RECIPES = {
    "displacement_gain_error": gain_error,
    "frame_misalignment": frame_misalignment,
    "stiffness_drift": stiffness_drift,
    "parametric_stiffness": parametric_stiffness,
    "cubic_velocity_damping": cubic_velocity_damping,
    "neighbour_stop": neighbour_stop,
    "tether": tether,
    "fluid_memory": fluid_memory,
    "clock_jitter": clock_jitter,
    "displacement_saturation": displacement_saturation,
}


@dataclass
class HangingMass(Law):
    """A mass on a spring and a damper beside the grasp point, as of a fruit or a lamp: it swings by itself.

    Attributes:
        mass: [kg].
        frequency: Of the mass on its spring [Hz].
        ratio: Of damping to critical.
    """

    mass: float
    frequency: float
    ratio: float
    fading = True

    def begin(self, now: Now) -> None:
        """Bring the mass to rest."""
        self._place, self._speed = now.moved, np.zeros((len(now.datas), 3))

    def act(self, now: Now) -> None:
        """Pull at the grasp point, and let the mass move on (semi-implicit)."""
        w = 2 * np.pi * self.frequency
        pull = w * w * (now.moved - self._place) + 2 * self.ratio * w * (now.velocity - self._speed)
        self._speed = self._speed + now.step * pull
        self._place = self._place + now.step * self._speed
        now.push -= self.mass * pull


@dataclass
class PlaceDamper(Turned):
    """A damper that grows with the joint's angle, as of a sleeve that tightens, on a mount: torque -c |phi| w if slow.

    The mount's turn l obeys l' = w - l / T, T = c |phi| / M. Without it the explicit law would be too stiff for the
    small inertia about a link's own axis.

    Attributes:
        joint: Segment whose lower joint it is.
        damping: c [N m s/rad^2].
        mount: M [N m/rad].
    """

    damping: float
    mount: float

    def act(self, now: Now) -> None:
        """Add the torque; the step is exact for a steady rate."""
        size = np.sqrt((now.angle(self.joint) ** 2).sum(axis=1, keepdims=True))
        steps = np.maximum(self.damping * size / self.mount / now.step, 1e-9)
        left = np.exp(-1 / steps)
        self._z = self._z * left + self.turn(now) * steps * (1 - left)
        now.twist(self.joint, -self.mount * self._z)


def hanging_mass(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a mass that swings beside the grasp point; the strength is its share of the branch's mass."""
    whole, frequency, ratio = (
        float(scale.branch.mass().sum()),
        float(rng.uniform(0.8, 4)),
        float(rng.uniform(0.02, 0.2)),
    )

    def make(strength: float) -> Part:
        """Return a swinging mass of strength x the branch's mass [kg]."""
        mass = strength * whole
        params = {"mass_kg": mass, "frequency_Hz": frequency, "damping_ratio": ratio}
        return Part(params, law=lambda: HangingMass(mass, frequency, ratio))

    return Draft(make, 0.01, 0.2, 3.0)


def place_damping(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a damper that grows with the angle; the strength is its torque at the largest angle and rate over K's."""
    size, mount = scale.torque(joint) / float(scale.angle[joint] * scale.rate[joint]), 4 * scale.branch.stiffness[joint]

    def make(strength: float) -> Part:
        """Return a damper c |phi| w, c = strength x K / largest rate [N m s/rad^2]."""
        value = strength * size
        return Part({"damping_Nmsprad2": value}, joint, lambda: PlaceDamper(joint, value, mount))

    return Draft(make, 0.02, 0.6, 20.0)


def cross_talk(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a force sensor whose channels leak into one another; the strength is the largest leak."""
    leak = rng.uniform(-1, 1, (3, 3)) * (1 - np.eye(3))
    leak /= np.abs(leak).max()

    def make(strength: float) -> Part:
        """Return forces mixed by 1 + strength x leak, shape [3, 3]."""
        mixed = np.eye(3) + strength * leak
        return Part({"leak": (strength * leak).tolist()},
                    sense=lambda seen: seen.but(force=seen.force @ mixed.T))  # fmt: skip

    return Draft(make, 0.01, 0.2, 0.9)


def dropouts(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a camera that now and then repeats its last reading; the strength is the longest such spell over T."""
    count = 6
    start, part = rng.uniform(0, 1, (len(scale.clock), count)), rng.uniform(0.3, 1.0, (len(scale.clock), count))

    def make(strength: float) -> Part:
        """Return a camera whose spells last up to the strength, a share of the recording."""

        def sense(seen: Readings) -> Readings:
            """Return the readings with the last displacement and velocity repeated through every spell."""
            now = np.arange(len(seen.time))
            since = now[:, None] / len(now) - start[:, None]
            stale = ((since > 0) & (since < strength * part[:, None])).any(axis=-1)
            at, row = np.maximum.accumulate(np.where(stale, 0, now), axis=1), np.arange(len(start))[:, None]
            return seen.but(moved=seen.moved[row, at], velocity=seen.velocity[row, at])

        return Part({"spell": strength}, sense=sense)

    return Draft(make, 0.01, 0.1, 0.6)


#: More of them, for exams with other forms.
MORE = {
    "hanging_mass": hanging_mass,
    "place_damping": place_damping,
    "cross_talk": cross_talk,
    "dropouts": dropouts,
}
