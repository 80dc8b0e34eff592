"""A recorded simulation on the page: worlds side by side, with play, pause and scrub."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..base.archive import read_arrays
from ..base.errors import InputError
from ..base.types import Array
from ..engine.trajectory import CAPSULES
from ..formats.export_mesh import level_color
from .grove import Grove, side_by_side
from .page import Page
from .player import Player
from .wood import Wood

FILE = "trajectory.npz"
_NEEDED = ("time", "body_name", "body_pos", "body_quat", *CAPSULES)
_WORLDS = 256
"""Worlds that are shown; the first ones of more."""


class Recorded:
    """The worlds of a ``trajectory.npz``.

    Attributes:
        seconds: Length of the motion [s].
    """

    def __init__(self, page: Page, file: Path) -> None:
        """Read the file and put its worlds on the page.

        Raises:
            InputError: The file cannot be read, or does not say what the bodies look like.
        """
        data = read(file)
        self._time: Array = data["time"]
        self._pos, self._quat = (np.asarray(data[k][:, :_WORLDS], np.float64) for k in ("body_pos", "body_quat"))
        self._grove = _grove(data, self._pos.shape[1])
        self._grove = self._grove.moved(side_by_side(self._grove, self._pos[0], self._quat[0]))
        self.seconds = float(self._time[-1])
        ends = self._grove.ends(self._pos[0], self._quat[0])
        page.title(f"{_count(self._pos.shape[1], 'world')} of {_count(len(data['body_name']), 'body', 'bodies')}")
        page.ground(*_box(self._grove, self._pos, self._quat))
        self._wood = Wood(page.server.scene, "/wood", ends, self._grove.radius, self._grove.color)
        if data["body_pos"].shape[1] > _WORLDS:
            page.note(f"The first {_WORLDS} of {data['body_pos'].shape[1]} worlds are shown.")
        page.shadows(len(self._grove.world))
        self._player = Player(page, self.seconds)

    def tick(self, seconds: float) -> None:
        """Draw the worlds as they were at the player's time, between two records as a mean of both."""
        self._wood.move(*self.ends(self._player.tick(seconds)))

    def ends(self, time: float) -> tuple[Array, Array]:
        """Return the ends of all capsules at a time [s], [C, 3] each in m."""
        k = int(np.clip(np.searchsorted(self._time, time, side="right") - 1, 0, len(self._time) - 1))
        after = min(k + 1, len(self._time) - 1)
        span = float(self._time[after] - self._time[k])
        share = float(np.clip((time - self._time[k]) / span, 0.0, 1.0)) if span > 0.0 else 0.0
        one, other = (self._grove.ends(self._pos[n], self._quat[n]) for n in (k, after))
        return (1.0 - share) * one[0] + share * other[0], (1.0 - share) * one[1] + share * other[1]


def read(file: Path) -> dict[str, Any]:
    """Return the arrays of a ``trajectory.npz``.

    Raises:
        InputError: It cannot be read, is of joints measured directly, or lacks what a picture needs.
    """
    data = read_arrays(file, "what bough simulate writes")
    if "channel" in data:
        raise InputError(file, "", "joints measured directly, which have no shape", "a simulation of a tree or branch")
    missing = [name for name in _NEEDED if name not in data]
    if missing:
        raise InputError(file, missing[0], "nothing", "what bough simulate writes now; simulate again")
    return data


def _grove(data: dict[str, Any], worlds: int) -> Grove:
    body, start, end, radius, level = (data[name] for name in CAPSULES)
    return Grove(
        np.repeat(np.arange(worlds), len(body)), np.tile(body, worlds), np.tile(start, (worlds, 1)),
        np.tile(end, (worlds, 1)), np.tile(radius, (worlds, 1)), np.tile(level_color(level), (worlds, 1)),
        np.zeros((worlds, 3)),
    )  # fmt: skip


def _box(grove: Grove, pos: Array, quat: Array) -> tuple[Array, Array]:
    """Return corners of the box that holds the worlds in some thirty moments."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for k in range(0, len(pos), max(1, len(pos) // 30)):
        for ends in grove.ends(pos[k], quat[k]):
            seen = ends[np.isfinite(ends).all(axis=1)]
            low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
    return low, high


def _count(n: int, one: str, many: str = "") -> str:
    return f"{n} {one if n == 1 else many or one + 's'}"
