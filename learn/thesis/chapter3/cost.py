"""What an iteration costs against the number of particles, trajectories and segments (figure beside table A.1)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...inference.target import Target
from .bench import Bench
from .prior import Advance

TIMES = (0.5, 1, 2, 4)
"""Multiples of the number of particles."""
TRAJECTORIES = (2, 5, 10, 20)
SEGMENTS = (1, 2, 3, 4)
REPEATS = 5


@dataclass(frozen=True)
class Cost:
    """Cost of one iteration.

    Attributes:
        size: Number of particles, trajectories or segments.
        seconds: Wall time of one gradient of all particles, median of five [s].
        rollouts: Worlds simulated for it.
    """

    size: int
    seconds: float
    rollouts: int


def linear_fit(costs: Sequence[Cost]) -> tuple[float, float]:
    """Return slope [s] and R^2 of a straight line through seconds over size."""
    size, seconds = np.array([c.size for c in costs], float), np.array([c.seconds for c in costs])
    line = np.polyfit(size, seconds, 1)
    left = np.sum((seconds - np.polyval(line, size)) ** 2)
    return float(line[0]), float(1.0 - left / np.sum((seconds - seconds.mean()) ** 2))


def exponent(costs: Sequence[Cost]) -> float:
    """Return the power of size that seconds grow with, by a straight line through logarithms."""
    return float(np.polyfit(np.log([c.size for c in costs]), np.log([c.seconds for c in costs]), 1)[0])


def _measure(bench: Bench, target: Target, size: int, particles: int, seed: int) -> Cost:
    theta = bench.uniform(particles, seed)
    target.evaluate(theta)
    before, times = target.world_steps, []
    for _ in range(REPEATS):
        began = time.perf_counter()
        target.evaluate(theta)
        times.append(time.perf_counter() - began)
    steps = len(target.recordings[0].t) * target.rollout(1).substeps
    return Cost(size, float(np.median(times)), (target.world_steps - before) // (REPEATS * steps))


def measure_costs(folder: Path, bench: Bench, *, particles: int, seed: int, advance: Advance) -> dict[str, list[Cost]]:
    """Measure iterations over particles, trajectories and segments, the other two at the thesis's values."""
    recordings = [*bench.train, *bench.unseen]
    out: dict[str, list[Cost]] = {"particles": [], "trajectories": [], "segments": []}
    for count in (round(k * particles) for k in TIMES):
        out["particles"].append(_measure(bench, bench.target(), count, count, seed))
        advance()
    for count in TRAJECTORIES:
        used = [recordings[i % len(recordings)] for i in range(count)]
        out["trajectories"].append(_measure(bench, bench.target(chosen=used), count, particles, seed))
        advance()
    for count in SEGMENTS:
        other = Bench(folder / f"segments_{count}", seed, segments=count, unseen=1)
        out["segments"].append(_measure(other, other.target(), count, particles, seed))
        advance()
    return out


def share_simulating(seconds: float, simulating: float) -> str:
    """Return where the time of a run went, as a sentence's part."""
    return f"{simulating:.1f} s in the simulator, {seconds - simulating:.1f} s in gradients, kernels and steps"
