"""What a simulated camera looks at: round cones and leaves, each with a label, above a ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.types import Array
from ..pictures.tracer import Solids
from .label import Label


@dataclass(frozen=True)
class World:
    """Solids with labels, at one time.

    Attributes:
        solids: What there is.
        label: `Label` of each, uint8 [C].
        ground: Height of the ground [m].
    """

    solids: Solids
    label: NDArray[np.uint8]
    ground: float = 0.0

    @staticmethod
    def joined(parts: Sequence[World]) -> World:
        """Return all parts, on the ground of the first."""
        label = np.concatenate([part.label for part in parts])
        return World(Solids.joined([part.solids for part in parts]), label, parts[0].ground)

    @staticmethod
    def capsules(
        start: Array, end: Array, radius: Array, label: NDArray[np.uint8], colour: Array, ground: float = 0.0
    ) -> World:  # fmt: skip
        """Return capsules: ends [C, 3], radii [C] (those of 0 are left out), labels [C], sRGB colours [C, 3]."""
        used = radius > 0.0
        radii = np.repeat(radius[used, None], 2, axis=1)
        return World(Solids.cones(start[used], end[used], radii, colour[used]), label[used].astype(np.uint8), ground)

    @staticmethod
    def leaves(solids: Solids, ground: float = 0.0) -> World:
        """Return what stands before branches, twigs too, as leaves."""
        return World(solids, np.full(len(solids.start), Label.LEAF, np.uint8), ground)

    def cones_first(self) -> World:
        """Return the same, leaves last, as the ray tracer takes them."""
        order = np.argsort(self.solids.leaf(), kind="stable")
        return World(self.solids.cones_first(), self.label[order], self.ground)
