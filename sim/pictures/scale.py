"""What tells a picture's scale: a measuring rod of five painted bands that stands on the ground, with its length."""

from __future__ import annotations

from typing import Any

import numpy as np
import PIL.Image
import PIL.ImageDraw
import PIL.ImageFont

from ..base.types import Array
from .tracer import Image, Solids, View

_BANDS = 5
_PAINT = np.array([[0.80, 0.10, 0.08], [0.95, 0.95, 0.93]])


def round_length(length: float) -> float:
    """Return the longest of 1, 2 and 5 times a power of ten that is no longer than ``length`` [m]."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(k for k in (1.0, 2.0, 5.0) if k * power <= length * (1 + 1e-9)))


def rod(foot: Array, length: float) -> Solids:
    """Return an upright rod from ``foot`` [m], as thick as a thirtieth of its length, in red and white bands.

    The bands' balls reach over their ends; the rod is shorter by them, so that all of it measures ``length``.
    """
    radius = length / 60
    at = np.linspace(radius, length - radius, _BANDS + 1)
    axis = foot + at[:, None] * [0.0, 0.0, 1.0]
    thick = np.full((_BANDS, 2), radius)
    return Solids.cones(axis[:-1], axis[1:], thick, _PAINT[np.arange(_BANDS) % 2])


def caption(image: Image, view: View, foot: Array, length: float, note: str = "") -> Image:
    """Write a rod's length beside its top, and ``note`` into the lower left corner, on a copy of an sRGB picture."""
    height, width = image.shape[:2]
    canvas = PIL.Image.fromarray(image)
    draw = PIL.ImageDraw.Draw(canvas)
    size = max(height // 36, 9)
    column, row = view.pixels(np.array([foot[0], foot[1], foot[2] + length]), width, height)
    look: dict[str, Any] = {"font": PIL.ImageFont.load_default(size), "fill": (20, 20, 20)}
    look |= {"stroke_fill": (255, 255, 255), "stroke_width": max(height // 400, 1)}
    draw.text((column, row - 0.3 * size), f"{length:g} m", anchor="mb", **look)
    draw.text((0.6 * size, height - 0.6 * size), note, anchor="lb", **look)
    return np.asarray(canvas)
