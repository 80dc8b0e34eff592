"""A law by itself: values to try it with, a closed path, and what it answers along it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ...kernels.effects.along import joint_law_kernel, link_law_kernel
from ...kernels.effects.terms import PARAMETERS
from ...sim.base.types import Array
from ...sim.effects import EffectParameter, Law, Setting, in_setting
from ..systems.system import Parameter

#: A branch of half a metre that is pushed by hand: what boxes of priors are relative to where no case is given.
SETTING = Setting(
    torque=3.0, angle=0.3, rate=3.0, force=8.0, speed=1.2, area=0.012, mass=0.4, length=0.5, dt=0.02, duration=2.0,
    end=2.0, moments=(0.7,),
)  # fmt: skip
#: Samples of the closed path, and its length [s]. Memories are of first order in the step, 0.1 ms.
SAMPLES, SECONDS = 20_000, 2.0


@dataclass(frozen=True)
class Answer:
    """What a law at a joint answers along M motions of T samples.

    Attributes:
        torque: Without the damper's [N m], shape [M, T, 3].
        stiffness: Beyond the joint's spring [N m/rad], shape [M, T].
        damping: [N m s/rad], shape [M, T].
    """

    torque: Array
    stiffness: Array
    damping: Array


def parameter_in(spec: EffectParameter, setting: Setting) -> Parameter:
    """Return a parameter with its box in numbers."""
    low, high = (in_setting(end, setting) for end in (spec.low, spec.high))
    typical = None if spec.typical is None else in_setting(spec.typical, setting)
    return Parameter(spec.name, spec.unit, low, high, typical, spec.scale)


def value_in(spec: EffectParameter, setting: Setting) -> float:
    """Return a value to try a parameter with, see `value_of`."""
    return value_of(parameter_in(spec, setting), spec.neutral)


def value_of(p: Parameter, neutral: float) -> float:
    """Return a value to try a parameter with: its typical one, else the middle of the box, off the neutral value.

    Of a linear box it is half way from neutral to the end that is farther away.
    """
    if p.typical is not None:
        return p.typical
    if p.scale == "log":
        return math.sqrt(p.low * p.high)
    end = p.high if p.high - neutral >= neutral - p.low else p.low
    return neutral + 0.5 * (end - neutral)


def values_in(law: Law, setting: Setting = SETTING) -> list[float]:
    """Return a value to try every parameter of a law with."""
    return [value_in(p, setting) for p in law.parameters]


def closed_path(angle: float, axes: int, samples: int = SAMPLES) -> tuple[Array, Array]:
    """Return a way out and back that ends where it began, at rest: positions and rates, shapes [T, 3].

    phi_k(t) = A sin^2(pi t / T) sin(2 pi n_k t / T + p_k), the first ``axes`` of k. The way back is not the way out, in
    space or in time, so that a law that gives energy on one of them does not take it again on the other.
    """
    t = np.arange(samples) / (samples - 1)
    turns, phase, kept = np.array([2, 3, 1]), np.array([0.4, 1.1, 1.9]), np.arange(3) < axes
    at = 2.0 * np.pi * t[:, None] * turns + phase
    rise, grows = np.sin(np.pi * t) ** 2, np.pi * np.sin(2.0 * np.pi * t)
    waves, slopes = np.sin(at), 2.0 * np.pi * turns * np.cos(at)
    where = angle * rise[:, None] * waves * kept
    rate = angle * (grows[:, None] * waves + rise[:, None] * slopes) * kept / SECONDS
    return where, rate


def ask_joint(
    law: Law, values: list[float], angle: Array, rate: Array, setting: Setting = SETTING, seconds: float = SECONDS
) -> Answer:
    """Return what a law at a joint answers along motions that take so many seconds, shapes [M, T, 3]."""
    motions, samples = angle.shape[:2]
    torque: wp.array = wp.full((motions, samples), value=wp.vec3d(np.nan), dtype=wp.vec3d, device="cpu")
    stiffness, damping = (wp.full((motions, samples), value=np.nan, dtype=wp.float64, device="cpu") for _ in range(2))
    wp.launch(
        joint_law_kernel(law.law, law.memory), motions,
        [wp.array(angle, dtype=wp.vec3d, device="cpu"), wp.array(rate, dtype=wp.vec3d, device="cpu"), _padded(values),
         setting.stiffness, seconds / (samples - 1), torque, stiffness, damping], device="cpu",
    )  # fmt: skip
    return Answer(torque.numpy(), stiffness.numpy(), damping.numpy())


def ask_link(
    law: Law, values: list[float], velocity: Array, setting: Setting = SETTING, seconds: float = SECONDS
) -> Array:
    """Return the force [N] of a law at a link at every velocity [m/s], shapes [M, T, 3]."""
    force: wp.array = wp.full(velocity.shape[:2], value=wp.vec3d(np.nan), dtype=wp.vec3d, device="cpu")
    wp.launch(
        link_law_kernel(law.law), len(velocity),
        [wp.array(velocity, dtype=wp.vec3d, device="cpu"), _padded(values), setting.area,
         seconds / (velocity.shape[1] - 1), force],
        device="cpu",
    )  # fmt: skip
    found: Array = force.numpy()
    return found


def effort_along(
    law: Law, values: list[float], where: Array, rate: Array, slower: float = 1.0, stronger: float = 1.0
) -> Array:
    """Return the torque of a joint, damper's included, or the force at a link along one way, shapes [T, 3].

    A link goes the same way, at its own speed. With ``slower`` and ``stronger`` the way and the joint's spring are told
    in units of that many seconds and joules, as ``values`` then are.
    """
    setting = replace(SETTING, torque=SETTING.torque * stronger)  # and so the joint's stiffness
    if law.kind == "link":
        speed = rate * SETTING.speed / np.abs(rate).max() / slower
        return ask_link(law, values, speed[None], setting, SECONDS * slower)[0]
    answer = ask_joint(law, values, where[None], rate[None] / slower, setting, SECONDS * slower)
    effort: Array = answer.torque[0] - answer.damping[0][:, None] * rate / slower
    return effort


def _padded(values: list[float]) -> wp.array:
    return wp.array([*values, *[0.0] * (PARAMETERS - len(values))], dtype=wp.float64, device="cpu")
