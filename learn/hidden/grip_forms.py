"""Other forms of what happens at the ends of the branch: the trunk, the tip, the grip and the force sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from .branch import TRUNK_PIVOT, Array, unit
from .joint_laws import Random
from .parts import Draft, Now, Part, Readings, Scale
from .rig import Trunk
from .sensor_laws import shifted, turned
from .world_laws import Slip

# ---- base_compliance, tip_mass -------------------------------------------------------------------------------------


def _trunk(rng: Random, scale: Scale, depth: float, parts: int = 1, lag: tuple[float, float] = (0.01, 0.03)) -> Draft:
    """Draw a trunk; the strength is the compliance of its joints together over the first joint's, as at `TRUNK_PIVOT`.

    The base of a deep trunk moves more: its springs are stiffer with the square of the depth.
    """
    first, mass, time = scale.branch.stiffness[0], float(rng.uniform(0.3, 1.2)), float(rng.uniform(*lag))
    lever = max(1.0, (depth / TRUNK_PIVOT) ** 2)

    def make(strength: float) -> Part:
        """Return a trunk of joints with k = K_1 x parts x lever / strength [N m/rad], damped by k times a time [s]."""
        k = first / strength * lever * parts
        params = {"stiffness_Nmprad": k, "relaxation_s": time, "trunk_mass_kg": mass, "depth_m": depth, "parts": parts}
        return Part(params, trunk=Trunk(k, k * time, mass, depth, parts))

    return Draft(make, 0.003, 0.08, 1.5)


def deep(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a trunk that turns in the ground, farther down than is known: the base shifts more than it turns."""
    return _trunk(rng, scale, float(rng.uniform(1.6, 3.0)) * TRUNK_PIVOT)


def bending(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a trunk that bends along its length, cut into three."""
    return _trunk(rng, scale, TRUNK_PIVOT, parts=3)


def damped(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a trunk not far below the base, whose damper is heavy."""
    return _trunk(rng, scale, float(rng.uniform(0.5, 0.9)) * TRUNK_PIVOT, lag=(0.05, 0.15))


def _ball(scale: Scale, make: Callable[[float], tuple[tuple[Array, float], ...]]) -> Draft:
    """Draw masses at the tip; the strength is their share of the branch's mass."""
    whole = float(scale.branch.mass().sum())

    def part(strength: float) -> Part:
        """Return masses at the tip that make up the strength, a share of the branch's mass."""
        twig = make(strength * whole)
        places = [place.round(5).tolist() for place, _ in twig]
        return Part({"mass_kg": strength * whole, "places_m": places}, twig=twig)

    return Draft(part, 0.01, 0.1, 2.0)


def off_axis(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a mass that hangs beside the tip."""
    place = float(rng.uniform(0.02, 0.07)) * unit(rng.normal(size=3))
    return _ball(scale, lambda mass: ((place, mass),))


def twig(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a thin twig that goes on beyond the tip, as five balls."""
    along = unit(scale.branch.axes()[-1] + 0.4 * rng.normal(size=3)) * float(rng.uniform(0.05, 0.2))
    return _ball(scale, lambda mass: tuple((along * (k + 0.5) / 5, mass / 5) for k in range(5)))


# ---- grasp_slip ----------------------------------------------------------------------------------------------------


@dataclass
class Slide(Slip):
    """A grip that slides at a rate of its own.

    Attributes:
        rate: Forces [N] and axes of the held segment, both [N, 3], and the slide so far over the room [N], to the rate
            over the mobility [N], shape [N].
    """

    rate: Callable[[Array, Array], Array] | None = None

    def act(self, now: Now) -> None:
        """Slide, and add the couple."""
        assert self.rate is not None
        before = self.slide
        way = now.step * self.mobility * self.rate(now.force, now.grip_axis)
        self.slide = np.clip(before + way, -self.room[0], self.room[1])
        self.speed = (self.slide - before) / now.step
        now.couple += np.cross(self.slide[:, None] * now.grip_axis, now.force)


def _slide(scale: Scale, rate: Callable[[Array, Array], Array], way: float, **params: float) -> Draft:
    """Draw a sliding grip; the strength is its mobility over segment length per largest force and duration."""
    end = scale.branch.length[-1]
    room = (0.9 * scale.branch.grasp_distance, 0.98 * end - scale.branch.grasp_distance)

    def make(strength: float) -> Part:
        """Return a slide of mobility strength x length / (force x duration) [m/(N s)], negative towards the base."""
        mobility = way * strength * end / (scale.force * scale.duration)
        return Part({"mobility_mpNs": mobility, **params}, law=lambda: Slide(mobility, 0.0, 0.0, room, rate))

    return Draft(make, 0.01, 1.0, 100.0)


def _way(rng: Random) -> float:
    return 1.0 if rng.random() < 0.25 else -1.0


def threshold(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a rate that is linear in what exceeds the limit, with a sharp onset (Bingham)."""
    limit = float(rng.uniform(0.15, 0.5)) * scale.force

    def rate(force: Array, axis: Array) -> Array:
        """Return max(0, |F| - limit) [N] of forces [N, 3]."""
        return np.maximum(0.0, np.sqrt((force**2).sum(axis=1)) - limit)

    return _slide(scale, rate, _way(rng), limit_N=limit)


def creeping(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a soft grip without a limit, whose rate goes with the square of the force."""

    def rate(force: Array, axis: Array) -> Array:
        """Return |F|^2 over the largest force [N] of forces [N, 3]."""
        return np.asarray((force**2).sum(axis=1) / scale.force)

    return _slide(scale, rate, _way(rng))


def rubbing(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a grip whose limit is lower the more the force points along the segment."""
    limit, weight = float(rng.uniform(0.15, 0.45)) * scale.force, float(rng.uniform(0.3, 0.8))

    def rate(force: Array, axis: Array) -> Array:
        """Return max(0, |F| + weight |F along the segment| - limit) [N] of forces [N, 3]."""
        along = np.abs((force * axis).sum(axis=1))
        return np.maximum(0.0, np.sqrt((force**2).sum(axis=1)) + weight * along - limit)

    return _slide(scale, rate, _way(rng), limit_N=limit, weight=weight)


def dragged(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a grip that slides where the force along the segment points, as fast as that exceeds a limit."""
    limit = float(rng.uniform(0.05, 0.2)) * scale.force

    def rate(force: Array, axis: Array) -> Array:
        """Return the force along the segment less the limit, with its sign [N], 0 within the limit."""
        along = (force * axis).sum(axis=1)
        return np.asarray(np.sign(along) * np.maximum(0.0, np.abs(along) - limit))

    return _slide(scale, rate, 1.0, limit_N=limit)


def jerking(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a grip that jerks once, when the force reaches a limit, and holds again.

    The strength is the way over the segment's length; it takes 30 ms.
    """
    limit, end, towards = float(rng.uniform(0.2, 0.6)) * scale.force, scale.branch.length[-1], _way(rng)
    room = 0.9 * scale.branch.grasp_distance if towards < 0.0 else 0.98 * end - scale.branch.grasp_distance

    def rate(force: Array, axis: Array) -> Array:
        """Return 1 N where |F| is beyond the limit, else 0, of forces [N, 3]."""
        return np.asarray(np.sqrt((force**2).sum(axis=1)) > limit, dtype=np.float64)

    def make(strength: float) -> Part:
        """Return a slide by strength x length [m], towards the tip or the base, within the segment."""
        way = min(strength * end, room)
        return Part({"way_m": towards * way, "limit_N": limit},
                    law=lambda: Slide(towards * way / 0.03, 0.0, 0.0, (way, way), rate))  # fmt: skip

    return Draft(make, 0.002, 0.03, 0.5)


# ---- force_bias, force_scale, time_delay, gravity_comp_error -------------------------------------------------------


def _sensed(params: dict[str, float | list[float]], sense: Callable[[Array], Array]) -> Part:
    return Part(params, sense=lambda seen: seen.but(force=sense(seen.force)))


def warming(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw an offset that drifts as the sensor warms up: B (1 + d (1 - exp(-t / T))) over the recordings."""
    direction, more = unit(rng.normal(size=3)), float(rng.choice([-1, 1]) * rng.uniform(0.1, 0.3))
    span = max(1e-9, float(scale.clock[-1] - scale.clock[0]))
    level = 1 - more * np.expm1(-3 * (scale.clock - scale.clock[0]) / span)[:, None, None]

    def make(strength: float) -> Part:
        """Return an offset of strength x largest force [N] that drifts over the recordings."""
        bias = strength * scale.force * direction
        return _sensed({"force_N": bias.tolist(), "drift": more}, lambda force: force + level * bias)

    return Draft(make, 0.002, 0.05, 1.0)


def rezeroed(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw an offset that every zeroing between recordings changes a little."""
    direction, share = unit(rng.normal(size=3)), float(rng.uniform(0.1, 0.25))
    other = direction + share * rng.normal(size=(len(scale.clock), 3)) / np.sqrt(3)

    def make(strength: float) -> Part:
        """Return an offset of strength x largest force [N], scattered from recording to recording."""
        size = strength * scale.force
        said: dict[str, float | list[float]] = {"force_N": (size * direction).tolist(), "scatter": share}
        return _sensed(said, lambda force: force + size * other[:, None])

    return Draft(make, 0.002, 0.05, 1.0)


def per_axis(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a gain that differs a little from axis to axis; the strength is the size of its logarithm."""
    sign, lean = float(rng.choice([-1, 1])), 1 + rng.uniform(-0.2, 0.2, 3)

    def make(strength: float) -> Part:
        """Return gains exp(+- strength x lean), one an axis."""
        gain = np.exp(sign * strength * lean)
        return _sensed({"scale": float(np.exp(sign * strength)), "axes": gain.tolist()}, lambda force: force * gain)

    return Draft(make, 0.01, 0.15, 0.6)


def curved(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a gain that falls off a little towards the largest force: exp(s) (1 - c |F| / Fmax)."""
    sign, curve = float(rng.choice([-1, 1])), float(rng.uniform(0.1, 0.25))

    def make(strength: float) -> Part:
        """Return a gain exp(+- strength) that falls off by curve x strength at the largest force."""
        gain = float(np.exp(sign * strength))

        def sense(force: Array) -> Array:
            """Return g (1 - c |F| / Fmax) F of forces [N, T, 3], in N."""
            size = np.sqrt((force**2).sum(axis=-1, keepdims=True)) / scale.force
            return np.asarray(gain * (1 - curve * strength * size) * force)

        return _sensed({"scale": gain, "curve": curve * strength}, sense)

    return Draft(make, 0.01, 0.15, 0.6)


def low_pass(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a sensor that follows with a first-order filter; the strength is its time constant in samples."""

    def make(strength: float) -> Part:
        """Return a filter y_k = (1 - d) F_k + d y_k-1, d = exp(-1 / strength), along each recording."""
        left = float(np.exp(-1 / max(strength, 1e-6)))
        return _sensed({"lag_s": strength * scale.sample_time, "samples": strength},
                       lambda force: np.asarray(lfilter([1 - left], [1, -left], force, axis=1)))  # fmt: skip

    return Draft(make, 0.15, 1.0, 0.1 * scale.samples)


def unsteady(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a delay that is another one in every recording, within a fifth; the strength is its mean in samples."""
    each = 1 + rng.uniform(-0.2, 0.2, len(scale.clock))

    def make(strength: float) -> Part:
        """Return a delay of strength samples in the mean, another one in every recording."""
        lag = strength * scale.sample_time

        def sense(seen: Readings) -> Readings:
            """Return the readings with the force of every recording late by its own delay [s]."""
            late = [shifted(seen.time, seen.force[k : k + 1], lag * part) for k, part in enumerate(each)]
            return seen.but(force=np.concatenate(late))

        return Part({"lag_s": lag, "samples": strength}, sense=sense)

    return Draft(make, 0.1, 1.0, 0.1 * scale.samples)


def _weight(rng: Random, scale: Scale, read: Callable[[Readings, Array], Array], **params: float) -> Draft:
    """Draw a weight on the gripper; ``read`` is what the sensor makes of it; the strength is over the largest force."""
    sign = 1.0 if rng.random() < 0.7 else -1.0

    def make(strength: float) -> Part:
        """Return a weight of strength x largest force [N] that is added to the readings as ``read`` has it."""
        mass = sign * strength * scale.force / scale.branch.gravity
        weight = np.array([0.0, 0.0, -mass * scale.branch.gravity])
        return Part({"mass_kg": mass, **params},
                    sense=lambda seen: seen.but(force=seen.force + read(seen, weight)))  # fmt: skip

    return Draft(make, 0.003, 0.1, 3.0)


def other_pose(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a weight that was tared in part with the gripper turned by 10 to 35 degrees."""
    tared, lean = float(rng.uniform(0.3, 0.9)), float(np.radians(rng.uniform(10, 35)))
    axis = unit(rng.normal(size=3) * [1.0, 1.0, 0.0])
    turn = Rotation.from_rotvec(lean * axis)

    def read(seen: Readings, weight: Array) -> Array:
        """Return the weight less the part tared in a leaning pose, as the gripper turns it, [N, T, 3], in N."""
        return weight - tared * turned(seen.turn, turn.apply(weight))

    return _weight(rng, scale, read, tared=tared, lean_rad=lean)


def late_pose(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a weight that is taken away in part by the pose of a few hundredths of the recording ago."""
    tared, lag = float(rng.uniform(0.2, 0.8)), float(rng.uniform(0.01, 0.04)) * scale.duration

    def read(seen: Readings, weight: Array) -> Array:
        """Return the weight less the tared part in the pose of a lag ago, [N, T, 3], in N."""
        return weight - tared * shifted(seen.time, turned(seen.turn, weight), lag)

    return _weight(rng, scale, read, tared=tared, lag_s=lag)


FORMS = {
    "base_compliance": {"deep": deep, "bending": bending, "damped": damped},
    "tip_mass": {"off_axis": off_axis, "twig": twig},
    "grasp_slip": {
        "threshold": threshold,
        "creeping": creeping,
        "rubbing": rubbing,
        "dragged": dragged,
        "jerking": jerking,
    },
    "force_bias": {"warming": warming, "rezeroed": rezeroed},
    "force_scale": {"per_axis": per_axis, "curved": curved},
    "time_delay": {"low_pass": low_pass, "unsteady": unsteady},
    "gravity_comp_error": {"other_pose": other_pose, "late_pose": late_pose},
}
