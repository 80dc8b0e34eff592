"""Hidden faults of the force sensor: the motion is unchanged, the recorded force differs from the true one."""

from __future__ import annotations

import numpy as np

from .branch import Array, unit
from .parts import Draft, Part, Readings, Scale

Random = np.random.Generator


def force_bias(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw an offset in world axes, also with the gripper open; the strength is over the largest force."""
    direction = unit(rng.normal(size=3))

    def make(strength: float) -> Part:
        """Return an offset of strength x the largest force [N]."""
        bias = strength * scale.force * direction
        return Part({"force_N": bias.tolist()}, sense=lambda seen: seen.but(force=seen.force + bias))

    return Draft(make, 0.002, 0.05, 1.0)


def force_scale(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a wrong gain; the strength is the size of its logarithm."""
    sign = 1.0 if rng.random() < 0.5 else -1.0

    def make(strength: float) -> Part:
        """Return a gain exp(+- strength)."""
        gain = float(np.exp(sign * strength))
        return Part({"scale": gain}, sense=lambda seen: seen.but(force=gain * seen.force))

    return Draft(make, 0.01, 0.15, 0.65)


def time_delay(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a late recording; the strength is the delay in samples."""

    def make(strength: float) -> Part:
        """Return a force that is late by strength samples."""
        lag = strength * scale.sample_time

        def sense(seen: Readings) -> Readings:
            """Return the readings with the force as it was a lag [s] before."""
            return seen.but(force=shifted(seen.time, seen.force, lag))

        return Part({"lag_s": lag, "samples": strength}, sense=sense)

    return Draft(make, 0.1, 1.0, 3.9)


def shifted(time: Array, values: Array, lag: float) -> Array:
    """Values [N, T, C] at ``time - lag``, straight between the samples, the first one before them."""
    steps = np.clip((time - lag - time[0]) / (time[1] - time[0]), 0, len(time) - 1)
    low = np.minimum(steps.astype(int), len(time) - 2)
    part = (steps - low)[:, None]
    return np.asarray((1 - part) * values[:, low] + part * values[:, low + 1])


def gravity_comp_error(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw the weight of something on the gripper that was tared, in part, where the branch rests.

    The strength is the weight over the largest force.
    """
    tared = float(rng.uniform(0.0, 0.9))
    sign = 1.0 if rng.random() < 0.7 else -1.0

    def make(strength: float) -> Part:
        """Return a weight of strength x the largest force [N], tared in part at rest."""
        mass = sign * strength * scale.force / scale.branch.gravity
        weight = np.array([0.0, 0.0, -mass * scale.branch.gravity])

        def sense(seen: Readings) -> Readings:
            """Return the readings plus the weight, less the tared part as the gripper turns it [N]."""
            return seen.but(force=seen.force + weight - tared * turned(seen.turn, weight))

        return Part({"mass_kg": mass, "tared": tared}, sense=sense)

    return Draft(make, 0.003, 0.1, 3.0)


def turned(quaternions: Array, v: Array) -> Array:
    """Turn a vector by unit quaternions [..., 4]; shape [..., 3]."""
    w, u = quaternions[..., :1], quaternions[..., 1:]
    t = 2 * np.cross(u, v)
    return np.asarray(v + w * t + np.cross(u, t))


RECIPES = {
    "force_bias": force_bias,
    "force_scale": force_scale,
    "time_delay": time_delay,
    "gravity_comp_error": gravity_comp_error,
}
