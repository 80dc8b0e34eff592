"""Where cameras are and what belongs to what they see: ``cameras.yaml``.

    format: cameras/1
    cameras:
      - name: left
        position_m: [0.1, 0.6, 0.8]
        rotation: [0.42, 0.85, -0.26, -0.13]
    box_low_m: [-1.0, -1.0, -0.8]
    box_high_m: [1.0, 1.0, 1.4]

Poses are those of the camera's optical frame (it looks along +z, x right, y down) in the arm's base frame, or in that
of the hand with ``mount: hand``; rotations are w, x, y, z.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ...sim.base.errors import InputError
from ...sim.base.rotation import quat_multiply, quat_rotate
from ...sim.base.strict_yaml import NotNegative, Positive, Strict, YamlFile, validated
from ...sim.base.types import Array

Three = Annotated[list[float], Field(min_length=3, max_length=3)]
Four = Annotated[list[float], Field(min_length=4, max_length=4)]
Share = Annotated[float, Field(ge=0, le=1)]


class Mounted(Strict):
    """One camera.

    Attributes:
        name: Its name, or the serial number of a RealSense.
        mount: What its pose is told in.
        position_m: Of its optical frame.
        rotation: w, x, y, z.
        intrinsics_px: fx, fy, cx, cy, where the source does not know them.
        size_px: Width and height, for a twin's camera.
        colour_topic, depth_topic: In a bag.
    """

    name: Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[\w.-]+$")]
    mount: Literal["base", "hand"] = "base"
    position_m: Three
    rotation: Four
    intrinsics_px: Four | None = None
    size_px: Annotated[list[int], Field(min_length=2, max_length=2)] | None = None
    colour_topic: str | None = None
    depth_topic: str | None = None

    def pose(self, hand: tuple[Array, Array] | None) -> tuple[Array, Array] | None:
        """Return position [m] and rotation w, x, y, z in the base frame; None where it takes a hand and there is none.

        Args:
            hand: Position [m] and rotation of the hand.
        """
        position, rotation = np.array(self.position_m), np.array(self.rotation)
        if self.mount == "base":
            return position, rotation
        if hand is None:
            return None
        return hand[0] + quat_rotate(hand[1], position), quat_multiply(hand[1], rotation)


class _File(Strict):
    format: Literal["cameras/1"]
    cameras: Annotated[list[Mounted], Field(min_length=1, max_length=8)]
    box_low_m: Three = Field(default=[-1.2, -1.2, -0.8])
    box_high_m: Three = Field(default=[1.2, 1.2, 1.5])
    farthest_m: Positive = 1.5
    ground_m: float | None = None
    margin_m: NotNegative = 0.025
    grain_m: Positive = 0.01
    line_srgb: Three = Field(default=[0.70, 0.10, 0.08])
    line_hue_deg: Positive = 20.0
    leaf_hue_deg: Annotated[list[float], Field(min_length=2, max_length=2)] = Field(default=[65.0, 170.0])
    saturation: Share = 0.25


@dataclass(frozen=True)
class Rig:
    """Cameras and what counts in their pictures.

    Attributes:
        cameras: The cameras.
        box_low, box_high: Corners of the box in the base frame beyond which nothing counts [m], [3].
        farthest: Depth beyond which nothing counts [m].
        ground: Height of the ground [m], None where there is none in the box; what is no higher than ``margin``, and
            three deviations of the depth, above it does not count.
        margin: Distance from the arm within which a point is the arm's [m], beside three deviations of the depth.
        grain: Edge of the cells that a cloud is thinned to one point in [m].
        line_srgb: Colour of the line, 0..1, for the segmenter by colour; ``line_hue`` is how far its hue may be off
            [degrees].
        leaf_hue: Range of hues that are leaves [degrees].
        saturation: Below it a colour has no hue.
    """

    cameras: tuple[Mounted, ...]
    box_low: Array
    box_high: Array
    farthest: float
    ground: float | None
    margin: float
    grain: float
    line_srgb: tuple[float, float, float]
    line_hue: float
    leaf_hue: tuple[float, float]
    saturation: float


def read_rig(path: Path) -> Rig:
    """Read ``cameras.yaml``.

    Raises:
        InputError: It cannot be read, or says what cannot be.
    """
    file = YamlFile(path, "cameras.yaml")
    said = validated(file, _File)
    names = [camera.name for camera in said.cameras]
    for k, camera in enumerate(said.cameras):
        if abs(math.hypot(*camera.rotation) - 1) > 1e-3:
            raise file.error(("cameras", k, "rotation"), f"{camera.rotation}", "a unit quaternion w, x, y, z")
        if camera.intrinsics_px is not None and min(camera.intrinsics_px[:2]) <= 0:
            raise file.error(("cameras", k, "intrinsics_px"), f"{camera.intrinsics_px}", "focal lengths above zero")
        if names.count(camera.name) > 1:
            raise file.error(("cameras", k, "name"), camera.name, "names that differ")
    if not all(a < b for a, b in zip(said.box_low_m, said.box_high_m, strict=True)):
        raise file.error(("box_high_m",), f"{said.box_high_m}", "numbers above those of box_low_m")
    return rig_of(said)


def rig_of(said: _File) -> Rig:
    """Return what a file says."""
    red, green, blue = said.line_srgb
    return Rig(
        tuple(said.cameras), np.array(said.box_low_m), np.array(said.box_high_m), said.farthest_m, said.ground_m,
        said.margin_m, said.grain_m, (red, green, blue), said.line_hue_deg,
        (said.leaf_hue_deg[0], said.leaf_hue_deg[1]), said.saturation,
    )  # fmt: skip


def plain_rig(cameras: list[Mounted]) -> Rig:
    """Return a rig with everything else as a file has it that says nothing of it."""
    return rig_of(_File(format="cameras/1", cameras=cameras))


def check_names(rig: Rig, path: Path | str, wanted: list[str]) -> None:
    """Raise `InputError` where a rig lacks a camera that is wanted."""
    names = [camera.name for camera in rig.cameras]
    for name in wanted:
        if name not in names:
            raise InputError(path, "cameras", ", ".join(names), f"one that is called {name}")
