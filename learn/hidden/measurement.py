"""What makes a real measurement harder than a model of one: shapes, callipers, sensors askew, noise with a memory.

Each kind can be had alone, so that what goes wrong can be told from what does not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from .branch import Array, Branch, unit
from .parts import Readings

#: What can be harder: bent segments of uneven radius; measured geometry a little wrong; other probes and rates; noise
#: with a memory; sensors askew; other forms of the laws.
Hard = Literal["shape", "geometry", "probes", "noise", "sensors", "forms"]
HARD: tuple[Hard, ...] = get_args(Hard)

#: Deviations of what a calliper, a scale and a protractor say: shares of length, radius and density; degrees.
LENGTH_ERROR, RADIUS_ERROR, DENSITY_ERROR, ANGLE_ERROR = 0.01, 0.02, 0.03, 0.5
#: Share of the noise's variance that drifts slowly, and the coarsest step of a reading over the noise's deviation.
DRIFT, COARSE = (0.05, 0.25), (0.2, 1.0)


def shaped(branch: Branch, rng: np.random.Generator) -> Branch:
    """Return the branch with segments that are arcs of up to 25 degrees and swell by up to 8 % here and there."""
    count = len(branch.length)
    turn, way = np.radians(rng.uniform(4, 25, count)), rng.uniform(0, 2 * np.pi, count)
    bend = np.stack([turn * np.cos(way), turn * np.sin(way)], axis=1)
    swell = 1 + rng.uniform(-0.08, 0.08, (count, 5))
    return replace(branch, bend=bend.tolist(), swell=swell.tolist())


def measured(branch: Branch, rng: np.random.Generator) -> Branch:
    """Return the branch as somebody measured it who knows of no arcs: straight frusta, each number a little wrong."""
    count = len(branch.length)

    def read(values: list[float], error: float) -> list[float]:
        """Return values with relative errors of deviation ``error``, cut at two deviations."""
        return (np.array(values) * (1 + error * np.clip(rng.normal(size=len(values)), -2, 2))).tolist()

    length = read(branch.length, LENGTH_ERROR)
    (grasp,) = read([branch.grasp_distance], LENGTH_ERROR)
    return replace(
        branch,
        length=length,
        radius_base=read(branch.radius_base, RADIUS_ERROR),
        radius_tip=read(branch.radius_tip, RADIUS_ERROR),
        elevation=(np.array(branch.elevation) + ANGLE_ERROR * rng.normal(size=count)).tolist(),
        azimuth=(np.array(branch.azimuth) + ANGLE_ERROR * rng.normal(size=count)).tolist(),
        density=read([branch.density], DENSITY_ERROR)[0],
        grasp_distance=min(grasp, length[-1]),
        bend=[],
        swell=[],
    )


@dataclass(frozen=True)
class Mounting:
    """Where the sensors sit, against where they are said to sit.

    Attributes:
        offset: Of the tracked point from the grasp point, in the world at rest [m], shape [3].
        tracker: Turn of the tracker's frame, a rotation vector [rad], shape [3].
        cell: Turn of the force sensor's frame [rad], shape [3].
    """

    offset: Array
    tracker: Array
    cell: Array

    def seen(self, readings: Readings) -> Readings:
        """Return what the sensors say as they are mounted."""
        shape = readings.turn.shape
        turn = Rotation.from_quat(readings.turn.reshape(-1, 4)[:, [1, 2, 3, 0]])
        swung = (turn.apply(self.offset) - self.offset).reshape(*shape[:-1], 3)
        speed = np.gradient(swung, readings.time, axis=1)
        tracker, cell = (Rotation.from_rotvec(v).as_matrix() for v in (self.tracker, self.cell))
        return readings.but(  # rows times the frame's matrix: components along its axes
            force=readings.force @ cell,
            moved=(readings.moved + swung) @ tracker,
            velocity=(readings.velocity + speed) @ tracker,
        )


def mounting(rng: np.random.Generator) -> Mounting:
    """Draw sensors askew: the tracked point 2 to 6 mm off, the tracker turned by 1 to 3, the cell by 0.5 to 1.5 deg."""
    offset, tracker, cell = (unit(rng.normal(size=3)) for _ in range(3))
    return Mounting(
        rng.uniform(2e-3, 6e-3) * offset,
        np.radians(rng.uniform(1.0, 3.0)) * tracker,
        np.radians(rng.uniform(0.5, 1.5)) * cell,
    )


@dataclass(frozen=True)
class Noise:
    """Noise of deviation one: a first-order memory, a slow drift, and readings in steps.

    Attributes:
        memory: Correlation from one sample to the next.
        drift: Share of the variance that is slow.
        step: Of a reading, over the deviation.
    """

    memory: float
    drift: float
    step: float

    def draw(self, rng: np.random.Generator, shape: tuple[int, int, int]) -> Array:
        """Draw N recordings of T samples of C channels; shape [N, T, C]."""
        count, samples, channels = shape
        white = rng.normal(size=shape)
        white[:, 0] /= np.sqrt(1 - self.memory**2)  # stationary from the first sample on
        fast = lfilter([np.sqrt(1 - self.memory**2)], [1, -self.memory], white, axis=1)
        waves = np.arange(1, 4)[:, None] * np.linspace(0, 1, samples)  # up to three periods a recording
        phase = rng.uniform(0, 2 * np.pi, (count, channels, 3))
        slow = np.sqrt(2 / 3) * np.sin(2 * np.pi * waves[None, None] + phase[..., None]).sum(axis=2)
        return np.asarray(np.sqrt(1 - self.drift) * fast + np.sqrt(self.drift) * slow.transpose(0, 2, 1))

    def rounded(self, values: Array, sigma: float) -> Array:
        """Return readings in steps, of noise whose deviation is ``sigma``."""
        step = self.step * sigma
        return np.asarray(step * np.round(values / step) if step else values)


def noise(rng: np.random.Generator, rate: float) -> Noise:
    """Draw noise that remembers 5 to 25 ms, at a sampling rate [Hz]."""
    return Noise(
        float(np.exp(-1 / (rate * rng.uniform(0.005, 0.025)))), float(rng.uniform(*DRIFT)), float(rng.uniform(*COARSE))
    )
