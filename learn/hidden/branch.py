"""A branch as it is given to the hidden simulator: geometry, springs and dampers of R segments, base first."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

#: Base of the branch above the pivot of a trunk that gives way [m]; it stands in every case's ``meta.yaml``.
TRUNK_PIVOT = 1.0


@dataclass
class Branch:
    """Geometry and springs of R segments, base first; SI units, angles in degrees.

    A segment may be an arc over its chord, which ``length`` and the angles are of, and no frustum: ``bend`` is the turn
    of its axis from its lower end to its upper one, about two axes across it [rad], [R, 2]; ``swell`` are factors of
    its radius at points that divide it evenly, [R, any number]. Empty: straight frusta.
    """

    length: list[float]
    radius_base: list[float]
    radius_tip: list[float]
    elevation: list[float]
    azimuth: list[float]
    stiffness: list[float]
    damping: list[float]
    density: float
    grasp_distance: float
    gravity: float = 9.81
    names: list[str] = field(default_factory=list)
    bend: list[list[float]] = field(default_factory=list)
    swell: list[list[float]] = field(default_factory=list)

    def axes(self) -> Array:
        """Return the unit axes of the segments in the rest pose, shape [R, 3]."""
        el, az = np.radians(self.elevation), np.radians(self.azimuth)
        return np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=1)

    def joints(self) -> Array:
        """Lower ends of the segments in the rest pose, base at the origin [m], shape [R, 3]."""
        steps = self.axes() * np.array(self.length)[:, None]
        return np.cumsum(steps, axis=0) - steps

    def grasp(self) -> Array:
        """Grasp point in the rest pose [m], shape [3]; it lies on the last segment's chord."""
        return self.joints()[-1] + self.axes()[-1] * self.grasp_distance

    def links(self, segment: int, count: int) -> tuple[Array, Array]:
        """Cut a segment into links: their steps from end to end [m], shape [count, 3], and end radii, [count + 1]."""
        radii = np.linspace(self.radius_base[segment], self.radius_tip[segment], count + 1)
        if self.swell:
            factors = self.swell[segment]
            radii = radii * np.interp(np.linspace(0, 1, count + 1), np.linspace(0, 1, len(factors)), factors)
        steps = np.tile(self.axes()[segment] / count, (count, 1))
        if self.bend:
            frame = across(self.axes()[segment])
            turns = ((np.arange(count) + 0.5) / count - 0.5)[:, None] * np.array(self.bend[segment])
            steps = Rotation.from_rotvec(turns @ frame[:2]).apply(self.axes()[segment]) / count
            chord = steps.sum(axis=0)  # an arc that is even about its middle: along the chord, and shorter than one
            steps = steps / np.linalg.norm(chord)
        return self.length[segment] * steps, radii

    def mass(self) -> Array:
        """Masses of the frusta [kg], shape [R]."""
        return frustum_mass(np.array(self.length), self.radius_base, self.radius_tip, self.density)


def across(axis: Array) -> Array:
    """Rows: a horizontal axis across the segment, the one across both, the segment's own."""
    side = unit(np.cross([0.0, 0.0, 1.0], axis)) if abs(axis[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    return np.array([side, np.cross(axis, side), axis])


def frustum_mass(length: Any, a: ArrayLike, b: ArrayLike, density: float) -> Any:
    """Mass of a solid frustum [kg] of this length and end radii [m]."""
    a, b = np.asarray(a), np.asarray(b)
    return density * np.pi * length * (a * a + a * b + b * b) / 3


def random_branch(rng: np.random.Generator, segments: int = 3, gravity: float = 9.81) -> Branch:
    """Draw a branch in the range of the practice cases: sizes and springs fall from segment to segment."""
    shrink = np.arange(segments)
    length = rng.uniform(0.52, 0.66) * rng.uniform(0.7, 0.85) ** shrink * rng.uniform(0.95, 1.05, segments)
    base = rng.uniform(0.0165, 0.0195) * rng.uniform(0.68, 0.76) ** shrink
    stiffness = rng.uniform(60, 130) * rng.uniform(0.32, 0.48) ** shrink * rng.uniform(0.9, 1.1, segments)
    drawn = [unit([np.cos(a := np.radians(rng.uniform(15, 45))), 0.0, np.sin(a)])]
    for _ in shrink[1:]:
        drawn.append(_forked(drawn[-1], np.radians(rng.uniform(17, 47)), rng))
    axes = np.array(drawn)
    names = ["grandparent", "parent", "child"]
    return Branch(
        length=length.tolist(),
        radius_base=base.tolist(),
        radius_tip=(base * rng.uniform(0.85, 1.0, segments)).tolist(),
        elevation=np.degrees(np.arcsin(axes[:, 2])).tolist(),
        azimuth=np.degrees(np.arctan2(axes[:, 1], axes[:, 0])).tolist(),
        stiffness=stiffness.tolist(),
        damping=(stiffness / rng.uniform(50, 100, segments)).tolist(),
        density=float(rng.uniform(750, 920)),
        grasp_distance=float(length[-1] * rng.uniform(0.75, 0.92)),
        gravity=gravity,
        names=names[3 - segments :] if segments <= 3 else [f"segment_{i + 1}" for i in range(segments)],
    )


def unit(v: ArrayLike) -> Array:
    """Return a vector's direction."""
    array: Array = np.asarray(v, dtype=float)
    return np.asarray(array / np.linalg.norm(array))


def _forked(axis: Array, angle: float, rng: np.random.Generator) -> Array:
    """Turn an axis by ``angle`` towards a random side; draw again until it neither dives nor stands on end."""
    while True:
        side = unit(np.cross(axis, rng.normal(size=3)))
        new = np.cos(angle) * axis + np.sin(angle) * side
        if 0.0 < new[2] < 0.9 and new[0] > 0.2:
            return unit(new)
