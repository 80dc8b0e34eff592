"""Masks without weights: what stands in the box is told apart by its colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...sim.base.types import Array
from ...sim.cameras.label import Label
from .calibration import Rig
from .frames import Frame

Labels = NDArray[np.uint8]


def hue_of(colour: Array) -> tuple[Array, Array]:
    """Return hue [degrees] and saturation 0..1 of sRGB colours [..., 3] in 0..1 (HSV: Smith 1978)."""
    high, low = colour.max(axis=-1), colour.min(axis=-1)
    spread = high - low
    safe = np.where(spread > 0, spread, 1.0)
    r, g, b = (colour[..., k] for k in range(3))
    sector = np.where(high == r, (g - b) / safe, np.where(high == g, 2.0 + (b - r) / safe, 4.0 + (r - g) / safe))
    return (60.0 * sector) % 360.0, spread / np.where(high > 0, high, 1.0)


class ByColour:
    """The line has its own hue, leaves are green, and all else with a depth is a branch.

    What is not within the rig's box, and the arm, is left to `learn.cameras.clouds`.
    """

    def __init__(self, rig: Rig) -> None:
        """Take the rig, whose colours count."""
        self._rig = rig
        self._hue = float(hue_of(np.array(rig.line_srgb))[0])

    def label(self, frame: Frame) -> Labels:
        """Return `Label` of each pixel, [H, W]: BACKGROUND, BRANCH, LINE or LEAF."""
        rig = self._rig
        out = np.zeros(frame.depth.shape, np.uint8)
        near = (frame.depth > 0) & (frame.depth <= rig.farthest)
        hue, saturation = hue_of(frame.colour[near] / 255.0)
        kind = np.full(len(hue), Label.BRANCH, np.uint8)
        hued = saturation > rig.saturation
        kind[hued & (hue > rig.leaf_hue[0]) & (hue < rig.leaf_hue[1])] = Label.LEAF
        off = np.abs((hue - self._hue + 180.0) % 360.0 - 180.0)
        kind[hued & (off < rig.line_hue)] = Label.LINE
        out[near] = kind
        return out
