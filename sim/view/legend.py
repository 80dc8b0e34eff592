"""What colours mean: a scale from no misfit to the largest, and swatches, as HTML and as numbers."""

from __future__ import annotations

import numpy as np

from ..base.types import Array

_SCALE = np.array([[0.20, 0.52, 0.36], [0.94, 0.80, 0.27], [0.80, 0.18, 0.14]])
"""Green, yellow, red: sRGB of no misfit, half and all of it."""


def color_of(share: Array) -> Array:
    """Return the colours of shares 0..1 of the largest misfit, sRGB [N, 3]."""
    at = np.clip(np.nan_to_num(share, nan=1.0), 0.0, 1.0) * (len(_SCALE) - 1)
    return np.column_stack([np.interp(at, np.arange(len(_SCALE)), column) for column in _SCALE.T])


def css(color: Array) -> str:
    """Return a colour as CSS writes it."""
    return "#" + "".join(f"{round(255 * c):02x}" for c in np.clip(color, 0.0, 1.0))


def color_scale(low: str, high: str) -> str:
    """Return a bar of the scale between two labels."""
    stops = ", ".join(css(color) for color in _SCALE)
    bar = f"display:inline-block;width:6em;height:.7em;border-radius:2px;background:linear-gradient(90deg,{stops})"
    return f'{low} <span style="{bar}"></span> {high}'


def swatch(color: Array) -> str:
    """Return a square of a colour."""
    look = "display:inline-block;width:.8em;height:.8em;border-radius:2px;vertical-align:-.05em"
    return f'<span style="{look};background:{css(color)}"></span>'
