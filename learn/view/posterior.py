"""A posterior on the page: the motions of branches drawn from it, as a cloud about the measured one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...sim.base.types import Array
from ...sim.trees.measured import measured_tree
from ...sim.view.grove import Grove, grove_of
from ...sim.view.legend import swatch
from ...sim.view.player import Player
from ...sim.view.wood import Wood
from ..cases.case import BranchCase
from ..replay.bend import bent
from .case import MEASURED, thick
from .replayed import Drawn, cloud, nominal_springs

if TYPE_CHECKING:
    from ...sim.view.page import Page

MEMBERS = 24
_CLOUD = np.array([0.86, 0.52, 0.16])


class PosteriorScene:
    """Members of a posterior under the recorded forces.

    Attributes:
        seconds: Length of the longest recording [s].
        moved: Displacement of the grasp point for every member [m], shape [P, R, T, 3].
    """

    def __init__(self, page: Page, case: BranchCase, drawn: Drawn, source: Path) -> None:
        self.page, self.case = page, case
        self.seconds = max(float(t.t[-1]) for t in case.trajectories)
        self.moved = cloud(case, drawn, source)
        self._stiffness = _springs(case, drawn)
        tree = thick(measured_tree(case, self._stiffness, np.zeros(case.num_segments)))
        count = len(self.moved)
        self._one: Grove = grove_of([tree])
        self._many: Grove = grove_of([tree] * count)
        page.title(f"{count} draws of {case.name}")
        page.note(f"{swatch(MEASURED)} measured, {swatch(_CLOUD)} drawn from the posterior")
        page.note("Only the held point is measured: each shape is the least bending that takes it there.")
        self._put(page, count)
        names = tuple(f"{i + 1}: {t.file}" for i, t in enumerate(case.trajectories))
        self._chosen = page.server.gui.add_dropdown("recording", names, initial_value=names[0])
        self._names, self._shown = names, -1
        self._factor = page.server.gui.add_slider("spread ×", 1.0, 30.0, 1.0, 1.0)
        self._player = Player(page, self.seconds)
        self._said = page.server.gui.add_text("now", "", disabled=True)
        self._draw(0.0)

    def _put(self, page: Page, count: int) -> None:
        rest = bent(self.case, self.case.grasp, np.zeros((1, 3)), self._stiffness)
        ends, scene = self._one.ends(*rest), page.server.scene
        reach = min(float(np.abs(self.moved).max()), float(self.case.length.sum()))
        points = np.concatenate(ends)
        page.ground(points.min(axis=0) - 0.5 * reach, points.max(axis=0) + 0.5 * reach)
        page.post("/post", ends[0][0], 0.015 * float(self.case.length.sum()))
        self._measured = Wood(scene, "/measured", ends, 0.5 * self._one.radius, np.tile(MEASURED, (len(ends[0]), 1)))
        many = tuple(np.tile(end, (count, 1)) for end in ends)
        self._cloud = Wood(scene, "/cloud", (many[0], many[1]), self._many.radius,
                           np.tile(_CLOUD, (len(many[0]), 1)), opacity=0.25)  # fmt: skip

    def tick(self, seconds: float) -> None:
        """Draw the recording that is chosen as it was, and would be, at the player's time."""
        self._draw(self._player.tick(seconds))

    def _draw(self, time: float) -> None:
        recording = self._names.index(self._chosen.value)
        t = self.case.trajectories[recording]
        if recording != self._shown:
            self._shown = recording
            self._measured_at = bent(self.case, t.grasp, t.displacement, self._stiffness)
        k = int(np.clip(round(time / self.case.dt), 0, len(t.t) - 1))
        now, mean = self.moved[:, recording, k], self.moved[:, recording, k].mean(axis=0)
        drawn = mean + float(self._factor.value) * (now - mean)
        self._cloud.move(*self._many.ends(*bent(self.case, t.grasp, drawn, self._stiffness)))
        self._measured.move(*self._one.ends(*(part[k : k + 1] for part in self._measured_at)))
        spread = float(np.linalg.norm(now - mean, axis=1).max())
        self._said.value = f"spread {100 * spread:.2g} cm"


def _springs(case: BranchCase, drawn: Drawn) -> Array:
    """Return the mean springs of the members, typical ones where none are among their parameters."""
    own = nominal_springs(case)
    for i, name in enumerate(case.segment_name):
        for label in (f"stiffness {name}", "stiffness"):
            if label in drawn.names:
                own[i] = float(drawn.values[:, drawn.names.index(label)].mean())
                break
    return own
