"""Where a camera is and what its pixels see."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from ...kernels.points import camera as kernels
from ..base.errors import InputError
from ..base.types import Array
from .stereo import D405_HEIGHT, D405_WIDTH, StereoDepth


@dataclass(frozen=True)
class Pinhole:
    """A camera without distortion: it looks along its +z, x to the right, y down; pixel centres are whole numbers.

    Attributes:
        width, height: Of its picture [pixels].
        intrinsics: fx, fy, cx, cy [pixels].
        position: In the world [m].
        rotation: Orientation there, unit quaternion w, x, y, z.
    """

    width: int
    height: int
    intrinsics: tuple[float, float, float, float]
    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        numbers = (*self.intrinsics, *self.position, *self.rotation)
        if not all(math.isfinite(x) for x in numbers) or min(self.intrinsics[:2]) <= 0:
            raise InputError("camera", "", f"{numbers}", "finite numbers, focal lengths above zero")
        if not (0 < self.width <= 4096 and 0 < self.height <= 4096):
            raise InputError("camera", "size", f"{self.width} x {self.height}", "1 to 4096 pixels each way")
        if abs(math.hypot(*self.rotation) - 1) > 1e-4:
            raise InputError("camera", "rotation", f"{self.rotation}", "a unit quaternion w, x, y, z")

    @staticmethod
    def d405(position: Array, target: Array, *, decimation: int = 2) -> Pinhole:
        """Return a D405 that looks from a point to another [m], its x level; every ``decimation``-th pixel is kept."""
        width, height = D405_WIDTH // decimation, D405_HEIGHT // decimation
        focal = StereoDepth().focal / decimation
        middle = ((width - 1) / 2, (height - 1) / 2)
        spot = tuple(float(x) for x in position)
        return Pinhole(width, height, (focal, focal, *middle), (spot[0], spot[1], spot[2]),
                       looking(np.asarray(position, float), np.asarray(target, float)))  # fmt: skip

    @property
    def kernel(self) -> Any:
        """The same as the kernels take it."""
        out, (w, x, y, z) = kernels.Eye(), self.rotation
        out.position, out.rotation = wp.vec3(*self.position), wp.quat(x, y, z, w)
        out.focal, out.middle = wp.vec2(*self.intrinsics[:2]), wp.vec2(*self.intrinsics[2:])
        return out


def looking(position: Array, target: Array) -> tuple[float, float, float, float]:
    """Return the orientation w, x, y, z of a camera that looks from a point to another, its x level.

    Raises:
        InputError: The points are one, or one is straight above the other.
    """
    forward = target - position
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-9:
        raise InputError("camera", "target", f"{target}", "a point that is not straight above or below the camera")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    x, y, z, w = Rotation.from_matrix(axes).as_quat()
    return float(w), float(x), float(y), float(z)
