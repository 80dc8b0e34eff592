"""Joints and chains that are probed: how they are drawn, driven and stated in a case's ``meta.yaml``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .rig import Array, Chain, Drive, Motion, move

Random = np.random.Generator

#: Sampling rates of real encoders and drives [Hz].
RATES = (50.0, 100.0, 200.0, 500.0, 1000.0)
#: Samples per recording of replays, and of torque fits, which keep one in ten.
SAMPLES, TORQUES = 400, 800
#: Largest product of step and fastest rate while strengths are tried, and for the recording.
COARSE, FINE = 0.3, 0.1
#: Recordings.
RUNS = 3
#: Kinds of rigs: what moves, and how it is fitted where the case says so.
RIGS = ("spring", "sprung", "links", "swing", "axis", "arm")


@dataclass(frozen=True)
class Rig:
    """A chain with its probes.

    Attributes:
        kind: One of `RIGS`.
        chain: What moves.
        rate: Sampling rate [Hz].
        samples: Per recording.
        start: Angles at the first sample [rad], shape [R, n].
        tones: Amplitude, frequency [Hz] and phase of the probes, shape [3, R, n, tones].
        control: Gains of angle and rate that track the probes, shape [2, n]; None where the probes are efforts [N m].
        free: What the case leaves to be learnt: names of chain arrays.
    """

    kind: str
    chain: Chain
    rate: float
    samples: int
    start: Array
    tones: Array
    control: Array | None
    free: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Length of a recording [s]."""
        return (self.samples - 1) / self.rate

    @property
    def steps(self) -> tuple[int, int]:
        """Steps a sample, while strengths are tried and for the recording: 200 and 500 a period of the fastest tone.

        More where a controller, whose dampers are explicit here, acts on links so light that a step would be unstable.
        """
        gains = np.zeros((2, self.chain.count)) if self.control is None else self.control
        swift = self.chain.fastest(*gains) / self.rate
        least = (5, 12) if self.replayed else (2, 6)
        return max(least[0], int(np.ceil(swift / COARSE))), max(least[1], int(np.ceil(swift / FINE)))

    @property
    def replayed(self) -> bool:
        """Whether its motion shows what is hidden, rather than its efforts."""
        return self.kind in ("spring", "links", "swing")

    def drive(self, copies: int) -> Drive:
        """Return what drives ``copies`` of all recordings, run after run."""
        size, frequency, phase = (np.tile(x, (copies, 1, 1)) for x in self.tones)

        def wanted(time: float) -> Array:
            """Return the sum of the tones at a time [s], [R, n]: efforts, or the angles to be tracked."""
            out: Array = (size * np.sin(2 * np.pi * frequency * time + phase)).sum(2)
            return out

        def tracked(time: float, q: Array, v: Array) -> Array:
            """Return the controller's efforts P (wanted - q) - D v + bias(q), [R, n]."""
            assert self.control is not None
            _, bias = self.chain.equations(q, 0.0 * v)
            return self.control[0] * (wanted(time) - q) - self.control[1] * v + bias

        return tracked if self.control is not None else lambda time, q, v: wanted(time)

    def move(self, laws: list[Any], *, copies: int = 1, fine: int, chain: Chain | None = None) -> Motion:
        """Integrate ``copies`` of the recordings with ``fine`` steps a sample; keep the samples alone."""
        start = np.tile(self.start, (copies, 1))
        step = 1.0 / (self.rate * fine)
        return move(chain or self.chain, start, np.zeros_like(start), self.drive(copies), laws,
                    seconds=self.seconds, step=step, every=fine)  # fmt: skip

    def mechanism(self) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the keys of ``meta.yaml`` that describe what moves, and the files beside it."""
        c = self.chain
        if c.count > 1:
            return {"mechanism": {"mjcf": "chain.xml", "unknown": list(self.free)}}, {"chain.xml": self.mjcf()}
        joint: dict[str, Any] = {"name": "joint0", "type": "revolute", "inertia": None, "damping": None}
        joint["stiffness"] = None if c.stiffness[0] else 0.0
        if self.replayed:
            joint["inertia"] = float(c.coupling[0, 0] + c.armature[0])
        if c.weight[0]:
            joint["gravity_torque"] = {"amplitude": None, "zero_angle": 0.0}
        return {"mechanism": {"joints": [joint]}}, {}

    def mjcf(self) -> str:
        """Return the chain in the x-z plane as MJCF, with what is to be learnt put off by a third."""
        c, off = self.chain, {name: 1.35 for name in self.free}
        body = close = ""
        for i in range(c.count):
            spring = f'stiffness="{c.stiffness[i] * off.get("stiffness", 1.0):.9g}"' if c.stiffness[i] else ""
            moment = c.central[i] * off.get("inertia", 1.0)
            at = "0 0 0" if i == 0 else f"0 0 {-c.length[i - 1]:.9g}"
            body += (
                f'<body pos="{at}"><joint name="joint{i}" axis="0 -1 0" armature="{c.armature[i]:.9g}" '
                f'damping="{c.damping[i] * off.get("damping", 1.0):.9g}" {spring}/>'
                f'<inertial pos="0 0 {-c.reach[i] * off.get("com", 1.0):.9g}" mass="{c.mass[i]:.9g}" '
                f'diaginertia="{moment:.9g} {moment:.9g} {0.5 * moment:.9g}"/>'
            )
            close += "</body>"
        return (f'<mujoco><compiler angle="radian"/><option gravity="0 0 {-c.gravity:.9g}"/>'
                f"<worldbody>{body}{close}</worldbody></mujoco>")  # fmt: skip


def draw_rig(kind: str, rng: Random) -> Rig:
    """Draw a rig of a kind."""
    rate = float(rng.choice(RATES))
    samples = SAMPLES if kind in ("spring", "links", "swing") else TORQUES
    if kind in ("spring", "sprung", "links"):
        return _sprung(kind, rng, rate, samples)
    return _swing(rng, rate, samples) if kind == "swing" else _tracked(kind, rng, rate, samples)


def _single(inertia: float, stiffness: float, damping: float, weight: float = 0.0) -> Chain:
    """Return one link whose inertia about its joint and whose gravity torque are given."""
    mass, reach = max(weight / (9.81 * 0.1), 1e-6), 0.1 if weight else 0.0
    numbers = (mass, reach, 0.0, inertia - mass * reach**2, 0.0, stiffness, damping)
    m, r, length, central, armature, k, d = (np.array([x]) for x in numbers)
    return Chain(m, r, length, central, armature, k, d, gravity=9.81 if weight else 0.0)


def _links(rng: Random, count: int, gravity: float) -> Chain:
    """Return links of rods with a mass at their ends."""
    length = rng.uniform(0.2, 0.45, count)
    mass = rng.uniform(0.4, 1.5, count) * 0.75 ** np.arange(count)
    reach = length * rng.uniform(0.4, 0.65, count)
    central = mass * length**2 * rng.uniform(0.07, 0.12, count)
    return Chain(mass, reach, length, central, 0.2 * central, np.zeros(count), np.zeros(count), gravity)


def _sprung(kind: str, rng: Random, rate: float, samples: int) -> Rig:
    """Draw a joint or two on springs, shaken by tones about their frequency with amplitudes of 1 : 2 : 3."""
    frequency = rate / rng.uniform(35.0, 60.0) if kind != "sprung" else rate / rng.uniform(120.0, 200.0)
    if kind == "links":
        chain = _links(rng, 2, 0.0)
        inertia = 1.0 / np.diagonal(np.linalg.inv(chain.equations(np.zeros((1, 2)), np.zeros((1, 2)))[0][0]))
    else:
        inertia = np.exp(rng.uniform(np.log(1e-3), np.log(0.5), 1))
        chain = _single(float(inertia[0]), 1.0, 1.0)
    own = 2 * np.pi * frequency * rng.uniform(0.7, 1.4, chain.count)
    stiffness, damping = inertia * own**2, 2.0 * rng.uniform(0.04, 0.15, chain.count) * inertia * own
    chain = replace(chain, stiffness=stiffness, damping=damping)
    count = 6
    tones = frequency * np.exp(rng.uniform(np.log(0.15), np.log(1.8), (RUNS, chain.count, count)))
    reach = rng.uniform(0.1, 0.6)
    size = reach * stiffness[:, None] * rng.uniform(0.2, 0.5, (RUNS, chain.count, count))
    size *= np.array([0.35, 0.7, 1.0])[:, None, None]
    phase = rng.uniform(0, 2 * np.pi, tones.shape)
    free = ("damping", "stiffness") if chain.count > 1 else ()
    return Rig(kind, chain, rate, samples, np.zeros((RUNS, chain.count)), np.stack([size, tones, phase]), None, free)


def _swing(rng: Random, rate: float, samples: int) -> Rig:
    """Draw a pendulum that is let go."""
    own, inertia = 2 * np.pi * rate / rng.uniform(35.0, 60.0), float(np.exp(rng.uniform(np.log(0.01), np.log(1.0))))
    chain = _single(inertia, 0.0, 2.0 * rng.uniform(0.003, 0.02) * inertia * own, inertia * own**2)
    start = rng.uniform(0.5, 1.5) * np.array([1.0, 0.6, -0.35])[:, None]
    return Rig("swing", chain, rate, samples, start, np.zeros((3, RUNS, 1, 1)), None, ())


def _tracked(kind: str, rng: Random, rate: float, samples: int) -> Rig:
    """Draw an axis, or an arm that hangs, on a controller that tracks sums of sines."""
    slow = min(rate / rng.uniform(150.0, 250.0), 3.0)
    if kind == "axis":
        chain = _single(float(np.exp(rng.uniform(np.log(1e-3), np.log(1.0)))), 0.0, 1.0)
        free: tuple[str, ...] = ()
    else:
        chain = _links(rng, 2 if rng.random() < 0.75 else 3, 9.81)
        free = ("damping", "preload", "com", "inertia")
    inertia = chain.inertia(np.zeros((1, chain.count)))[0]
    chain = replace(chain, damping=rng.uniform(0.1, 0.5, chain.count) * inertia * 2 * np.pi * slow)
    tones = slow * rng.uniform(0.2, 1.0, (RUNS, chain.count, 5))
    size = rng.uniform(0.1, 0.5, tones.shape) * (1.5 if kind == "axis" else 0.9)
    fast = 2 * np.pi * 2.5 * slow
    control = np.stack([inertia * fast**2, 1.6 * inertia * fast])
    phase = rng.uniform(0, 2 * np.pi, tones.shape)
    start = (size * np.sin(phase)).sum(2)
    return Rig(kind, chain, rate, samples, start, np.stack([size, tones, phase]), control, free)
