"""What is known of a branch before anything is measured: a case's ``meta.yaml`` without recordings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from ...sim.base.errors import InputError
from ...sim.base.strict_yaml import NotNegative, Strict, YamlFile, validated
from ...sim.base.types import Array
from ...sim.trees.measured import MeasuredBranch
from ..cases.schema import BRANCH_FORMAT, GraspMeta, SegmentMeta, Vector
from ..gap.next_probe import push_axes
from ..systems.branch import BranchSystem

_BENDS = 12


class _Structure(Strict):
    """``meta.yaml`` without recordings, in the arm's base frame."""

    format: Literal["branch-gap-case/1"]
    name: str | None = None
    gravity_mps2: float = Field(ge=0, le=30)
    planar: Literal[False] = False
    density_kgpm3: float = Field(ge=50, le=2500)
    base_position_m: Vector
    trunk_pivot_below_base_m: NotNegative | None = None
    segments: list[SegmentMeta] = Field(min_length=1)
    grasp: GraspMeta


@dataclass(frozen=True)
class Structure:
    """A branch before it is measured.

    Attributes:
        meta: Keys of ``meta.yaml`` but those of recordings.
        branch: Its geometry, the world being the arm's base frame.
        axes: Directions of pushes: across the held segment in its own plane, across that plane, along it, [3, 3].
    """

    meta: dict[str, Any]
    branch: MeasuredBranch
    axes: Array

    @property
    def grasp(self) -> Array:
        """The grasp point at rest, base frame [m], [3]."""
        return self.branch.lower_end[self.branch.grasp_segment] + self.branch.grasp_distance * self.axes[2]

    @property
    def length(self) -> float:
        """From the base to the grasp point along the branch [m]."""
        below = self.branch.length[: self.branch.grasp_segment]
        return float(below.sum()) + self.branch.grasp_distance

    def bent(self, force: Array, scale: float) -> tuple[Array, Array]:
        """Return where a force moves the grasp point to [m], [3], and how that gives way to more of it [m/N], [3, 3].

        With r from a joint to the grasp point a force f turns the joint by (r x f) / K and moves the point by
        (r x f) / K x r, in the pose to which it has bent. K are typical springs (`BranchSystem.TYPICAL_YOUNG`) times
        ``scale``; bending is found by repeated steps, half of each taken.

        Args:
            force: At the grasp point, base frame [N], [3].
            scale: Of all springs.
        """
        held = self.branch.grasp_segment + 1
        bending = np.pi * self.branch.radius.mean(1) ** 4 / (2 * self.branch.length)
        springs = scale * BranchSystem.TYPICAL_YOUNG * bending
        steps = self.branch.axis[:held] * self.branch.length[:held, None]
        steps[-1] = self.branch.grasp_distance * self.branch.axis[held - 1]
        turned = np.zeros((held, 3))
        for _ in range(_BENDS):
            arms = np.cumsum(_turned(turned, steps)[::-1], axis=0)[::-1]
            turned = 0.5 * (turned + np.cross(arms, force) / springs[:held, None])
        by_unit = np.cross(arms[:, None], np.eye(3))  # [R, force, 3]
        moved = np.cross(by_unit, arms[:, None]) / springs[:held, None, None]
        return self.branch.base_position + arms[0] - self.grasp, moved.sum(axis=0).T


def read_structure(path: Path) -> Structure:
    """Read the file of a branch.

    Raises:
        InputError: It is none, or states what cannot be.
    """
    file = YamlFile(path, BRANCH_FORMAT)
    meta = validated(file, _Structure)
    names = [s.name for s in meta.segments]
    if len(set(names)) < len(names):
        raise file.error(["segments"], "a name twice", "unique names")
    if meta.grasp.segment not in names:
        raise file.error(["grasp", "segment"], repr(meta.grasp.segment), f"one of {', '.join(names)}")
    at = names.index(meta.grasp.segment)
    if meta.grasp.distance_from_lower_end_m > meta.segments[at].length_m:
        found = f"{meta.grasp.distance_from_lower_end_m:g}"
        raise file.error(["grasp", "distance_from_lower_end_m"], found, f"0 to {meta.segments[at].length_m:g}")
    return _structure(meta, names, at)


def _structure(meta: _Structure, names: list[str], at: int) -> Structure:
    segments = meta.segments
    branch = MeasuredBranch(
        name=meta.name or "branch", segment_name=tuple(names), length=np.array([s.length_m for s in segments]),
        radius=np.array([[s.radius_base_m, s.radius_tip_m] for s in segments]),
        elevation=np.radians([s.elevation_deg for s in segments]),
        azimuth=np.radians([s.azimuth_deg for s in segments]), mass=np.array([s.mass_kg for s in segments]),
        base_position=np.array(meta.base_position_m), gravity=meta.gravity_mps2, grasp_segment=at,
        grasp_distance=meta.grasp.distance_from_lower_end_m,
    )  # fmt: skip
    known = {key: value for key, value in meta.model_dump().items() if value is not None}
    return Structure(known, branch, push_axes(branch))


def _turned(turned: Array, steps: Array) -> Array:
    """Return segments [R, 3] after joints turned by rotation vectors [rad], [R, 3], each turning all beyond it."""
    whole, out = Rotation.identity(), []
    for turn, step in zip(turned, steps, strict=True):
        whole = Rotation.from_rotvec(turn) * whole
        out.append(whole.apply(step))
    return np.array(out)


def within_reach(structure: Structure, reach: float) -> None:
    """Raise `InputError` where an arm on a table could not pull so far [m] about the grasp point."""
    low = float(structure.grasp[2]) - reach
    if low < 0.0:
        found = f"a grasp point {structure.grasp[2]:.2f} m above the arm's base, pulled by {reach:.2f} m"
        raise InputError("probe", "--branch", found, "a way that stays above the table")
