"""A case on the page: the measured branch and what models make of it, one over the other, with the arm's force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...sim.base.rotation import quat_rotate
from ...sim.base.types import Array
from ...sim.trees.measured import measured_tree
from ...sim.view.grove import Grove, grove_of
from ...sim.view.legend import color_of, color_scale, swatch
from ...sim.view.player import Player
from ...sim.view.wood import Wood
from ..cases.case import BranchCase
from ..replay.bend import bent
from .replayed import Told

if TYPE_CHECKING:
    from ...sim.trees.tree import Tree
    from ...sim.view.page import Page

MEASURED = np.array([0.35, 0.42, 0.52])
_PUSH = (214, 60, 40)


@dataclass
class _Pair:
    """One model beside others: where it stands [m], its branch and the measured one."""

    told: Told
    place: Array
    model: Wood
    measured: Wood


class CaseScene:
    """Recordings of a branch, each model beside the next with the measured branch over it.

    Attributes:
        seconds: Length of the longest recording [s].
    """

    def __init__(self, page: Page, case: BranchCase, tellers: Sequence[Told]) -> None:
        self.page, self.case = page, case
        self.seconds = max(float(t.t[-1]) for t in case.trajectories)
        tree = measured_tree(case, tellers[0].stiffness, np.zeros(case.num_segments))
        self._grove: Grove = grove_of([thick(tree)])
        self._size = float(case.length.sum())
        self._worst = max(1e-6, max(float(np.abs(_misfit(case, t)).max()) for t in tellers))
        page.title(f"Case {case.name}")
        page.note(f"{swatch(MEASURED)} measured, {swatch(_share(_PUSH))} force of the arm")
        page.note("model: " + color_scale("off by 0", f"{100 * self._worst:.2g} cm"))
        page.note("Only the held point is measured: each shape is the least bending that takes it there.")
        self._worlds(page, tellers)
        names = tuple(f"{i + 1}: {t.file}" for i, t in enumerate(case.trajectories))
        self._chosen = page.server.gui.add_dropdown("recording", names, initial_value=names[0])
        self._names, self._shown = names, -1
        page.shadows(len(self._pairs) * case.num_segments)
        self._player = Player(page, self.seconds)
        self._said = page.server.gui.add_text("now", "", disabled=True)
        self._draw(0.0)

    def _worlds(self, page: Page, tellers: Sequence[Told]) -> None:
        rest = bent(self.case, self.case.grasp, np.zeros((1, 3)), tellers[0].stiffness)
        start, end = self._grove.ends(rest[0], rest[1])
        span = np.maximum(np.ptp(np.concatenate([start, end]), axis=0), 0.3 * self._size)
        reach = max(float(np.abs(t.moved).max()) for t in tellers)
        apart = np.array([0.0, 1.0, 0.0]) * (1.1 * span[1] + 2.0 * min(reach, self._size))
        points = np.concatenate([start, end])
        low, high = points.min(axis=0) - min(reach, 0.3), points.max(axis=0) + min(reach, 0.3)
        page.ground(low, high + apart * (len(tellers) - 1))
        self._pairs: list[_Pair] = []
        scene = page.server.scene
        for k, told in enumerate(tellers):
            place = apart * k
            grove, ends = self._grove, (start + place, end + place)
            self._pairs.append(_Pair(
                told, place, Wood(scene, f"/model{k}", ends, grove.radius, grove.color),
                Wood(scene, f"/measured{k}", ends, 1.25 * grove.radius, np.tile(MEASURED, (len(end), 1)), opacity=0.3),
            ))  # fmt: skip
            top = place + np.array([*(0.5 * (start + end).mean(axis=0)[:2] + 0.25 * (start[0] + end[-1])[:2]),
                                    max(start[:, 2].max(), end[:, 2].max()) + 0.28 * self._size])  # fmt: skip
            page.post(f"/post{k}", start[0] + place, 0.015 * self._size)
            scene.add_label(f"/model{k}/name", told.name, position=tuple(top), anchor="bottom-center")
        self._arrows = scene.add_arrows(
            "/force", np.zeros((len(tellers), 2, 3)), _PUSH, shaft_radius=0.008 * self._size,
            head_radius=0.022 * self._size, head_length=0.05 * self._size,
        )  # fmt: skip

    def tick(self, seconds: float) -> None:
        """Draw the recording that is chosen as it was at the player's time."""
        self._draw(self._player.tick(seconds))

    def _draw(self, time: float) -> None:
        recording = self._names.index(self._chosen.value)
        if recording != self._shown:
            self._shown = recording
            self._shapes = [_Shapes(self.case, recording, pair.told) for pair in self._pairs]
        t = self.case.trajectories[recording]
        k = int(np.clip(round(time / self.case.dt), 0, len(t.t) - 1))
        arrows = [self._one(pair, shapes, k) for pair, shapes in zip(self._pairs, self._shapes, strict=True)]
        self._arrows.points = np.array(arrows, np.float32)
        force = 0.0 if t.no_contact[k] else float(np.linalg.norm(t.force[k]))
        off = ", ".join(f"{100 * shapes.off[k]:.2g}" for shapes in self._shapes)
        self._said.value = f"{force:.2g} N, off {off} cm"

    def _one(self, pair: _Pair, shapes: _Shapes, k: int) -> Array:
        """Draw one model and the measured branch over it; return the arrow of the force [2, 3]."""
        grove = self._grove.moved(pair.place[None])
        model, measured = (grove.ends(p[k : k + 1], q[k : k + 1]) for p, q in (shapes.model, shapes.measured))
        pair.model.move(*model)
        pair.measured.move(*measured)
        away = np.linalg.norm(model[1] - measured[1], axis=1)
        pair.model.paint(color_of(away / self._worst))
        return arrow(shapes.held[k] + pair.place, shapes.force[k] * (0.35 * self._size))


class _Shapes:
    """Shapes over a recording, of a model and as measured, and the force as a share of the case's largest."""

    def __init__(self, case: BranchCase, recording: int, told: Told) -> None:
        t = case.trajectories[recording]
        moved = told.moved[recording, : len(t.t)]
        self.model = bent(case, t.grasp, moved, told.stiffness)
        self.measured = bent(case, t.grasp, t.displacement, told.stiffness)
        self.off = np.linalg.norm(moved - t.displacement, axis=1)
        held, point = t.grasp
        position, rotation = self.measured
        self.held = position[:, held] + quat_rotate(rotation[:, held], np.broadcast_to(point, moved.shape))
        most = max(float(np.linalg.norm(u.force[~u.no_contact], axis=1).max(initial=0.0)) for u in case.trajectories)
        self.force = np.where(t.no_contact[:, None], 0.0, t.force) / max(most, 1e-12)


def arrow(tip: Array, along: Array) -> Array:
    """Return an arrow that ends at a point [m], shape [2, 3]; out of sight where it is too short for its head."""
    seen = np.linalg.norm(along) > 1e-2
    return np.stack([tip - along, tip]) if seen else np.array([[0.0, 0.0, -1e4], [0.0, 0.0, -1e4 + 1.0]])


def _misfit(case: BranchCase, told: Told) -> Array:
    """Return how far the grasp point is from where it was measured [m], all recordings in a row."""
    rows = [m[: len(t.t)] - t.displacement for m, t in zip(told.moved, case.trajectories, strict=True)]
    return np.linalg.norm(np.concatenate(rows), axis=1)


def thick(tree: Tree) -> Tree:
    """Return the tree with radii that can be seen: a hundredth of its length at least."""
    least = 0.008 * float(np.linalg.norm(tree.shape_end - tree.shape_start, axis=1).sum())
    return tree.with_(shape_radius=np.maximum(tree.shape_radius, least))


def _share(color: tuple[int, int, int]) -> Array:
    return np.array(color) / 255.0
