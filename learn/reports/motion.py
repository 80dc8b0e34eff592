"""A motion that plays on a report's page: lines drawn over each other, as data inside the page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...sim.base.types import Array

#: Most frames that a page holds, and steps of a line's coordinates across the picture: finer than a pixel.
FRAMES, STEPS = 240, 4000


@dataclass(frozen=True)
class MotionLine:
    """A line that moves: its name, its colour as ``#rrggbb``, and its points at T moments, shape [T, P, 2]."""

    name: str
    colour: str
    points: Array


@dataclass(frozen=True)
class ReportMotion:
    """A motion on a page.

    Attributes:
        title: What moves.
        caption: What is shown and how it was drawn, in a sentence or two.
        t: Moments [s], shape [T].
        lines: At least one, in one unit of length, the second coordinate upwards; the last is drawn on top.
    """

    title: str
    caption: str
    t: Array
    lines: Sequence[MotionLine]

    def __post_init__(self) -> None:
        for line in self.lines:
            if line.points.ndim != 3 or line.points.shape[::2] != (len(self.t), 2):
                raise ValueError(
                    f"motion {self.title!r}, {line.name}: points {line.points.shape} of {len(self.t)} moments"
                )

    @property
    def named(self) -> list[MotionLine]:
        """One line of each name, for the legend."""
        return list({line.name: line for line in self.lines}.values())

    @property
    def data(self) -> str:
        """What the page's script reads, as JSON without ``<``.

        Moments [s], lines in whole steps of the picture, and the frame that is shown first, in which the first line's
        end is farthest from the last one's.
        """
        chosen = np.unique(np.linspace(0, len(self.t) - 1, min(FRAMES, len(self.t))).round().astype(int))
        every = np.concatenate([line.points.reshape(-1, 2) for line in self.lines])
        low, size = every.min(axis=0), every.max(axis=0) - every.min(axis=0)
        step = max(float(size.max()), 1e-300) / STEPS
        lines = [
            {"name": line.name, "colour": line.colour,
             "points": np.round((line.points[chosen] - low) / step).astype(int).reshape(len(chosen), -1).tolist()}
            for line in self.lines
        ]  # fmt: skip
        apart = np.linalg.norm(self.lines[0].points[chosen, -1] - self.lines[-1].points[chosen, -1], axis=1)
        whole = {
            "start": int(apart.argmax()),
            "t": np.round(self.t[chosen] - self.t[0], 4).tolist(),
            "size": np.ceil(size / step).tolist(),
            "lines": lines,
        }
        return json.dumps(whole, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
