"""A film of an episode that an arm has run: the arm from its measured joints, the rest as a twin has told it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from ...sim.arms.arm import Arm
from ...sim.arms.arrays import arm_capsules
from ...sim.base.types import Array
from ...sim.formats.export_mesh import level_color
from ...sim.pictures.tracer import Solids
from ..robot.client import State
from ..tasks.picture import ARM, BALL, LINE, TARGET, UP, across, developed
from .truth import Facts


@dataclass
class Footage:
    """What a film is made of, collected while an episode runs.

    Attributes:
        arm: The arm.
        every: Least time between two pictures [s].
        moments: Joint positions [rad] and what was true, or None, at every picture.
    """

    arm: Arm
    every: float
    moments: list[tuple[Array, Facts | None]] = field(default_factory=list)
    _due: float = -np.inf

    def take(self, state: State, facts: Facts | None) -> None:
        """Take a state that was answered, where a picture is due."""
        if state.time >= self._due - 1e-3:
            self._due = max(self._due, state.time) + self.every if self.moments else state.time + self.every
            self.moments.append((state.q, facts))

    def frames(self, target: Array | None, within: float) -> Iterator[PIL.Image.Image]:
        """Yield the pictures.

        Args:
            target: Where the hand was to go [m], None for nowhere.
            within: Distance from it that is success [m].
        """
        for q, facts in self.moments:
            yield PIL.Image.fromarray(picture(self.arm, q, facts or {}, target, within))


def picture(arm: Arm, q: Array, facts: Facts, target: Array | None, within: float) -> NDArray[np.uint8]:
    """Return a picture of an arm at joint positions [rad], [D], among what is known of its scene."""
    start, end = arm_capsules(arm, q)
    radius = np.concatenate([arm.base_radius, arm.tree.shape_radius.mean(axis=1)])
    parts = [_capsules(start, end, radius, np.tile(ARM, (len(radius), 1))), *_scene(facts)]
    middle = _middle(facts, target, end[-1])
    if target is not None:
        ball = (target[None], target[None] + UP, np.full(1, BALL * within), np.array([TARGET]))
        parts.append(_capsules(*ball))
    root = np.asarray(facts.get("root", [0.0, -0.6, 0.0]), np.float64)
    return developed(root, parts, across(middle, root))


def _scene(facts: Facts) -> list[Solids]:
    out = []
    if "start" in facts:
        wood = slice(int(facts["arm"]), None)
        start, end, radius = (np.asarray(facts[name][wood], np.float64) for name in ("start", "end", "radius"))
        used = radius > 0.0
        colour = level_color(facts["level"][wood].astype(int))
        out.append(_capsules(start[used], end[used], radius[used], colour[used]))
    if "line" in facts:
        ends = np.asarray(facts["line"][[0, -1]], np.float64)
        out.append(_capsules(ends[:1], ends[1:], np.full(1, float(facts["line_radius"])), np.array([LINE])))
    return out


def _middle(facts: Facts, target: Array | None, hand: Array) -> Array:
    """Return what a film looks at: between the arm's base and what it is about [m], [3]."""
    if "line" in facts:
        return np.asarray(0.6 * facts["line"].mean(axis=0) + [0.0, 0.0, 0.16])
    return np.asarray(0.6 * (hand if target is None else target) + [0.0, 0.0, 0.12])


def _capsules(start: Array, end: Array, radius: Array, colour: Array) -> Solids:
    return Solids.cones(start, end, np.repeat(radius[:, None], 2, axis=1), colour)
