"""What cameras give and what policies take: frames of colour and depth, clouds of points, and a source of clouds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...sim.base.types import Array


@dataclass(frozen=True)
class Frame:
    """One picture of one camera, depth registered to colour.

    Attributes:
        time: When it was taken, on the clock of `time.monotonic` [s].
        colour: sRGB, uint8 [H, W, 3].
        depth: Distance along the viewing axis [m], float32 [H, W]; 0 where there is none.
        intrinsics: fx, fy, cx, cy [pixels], pixel centres at whole numbers.
        position: Of the camera in the arm's base frame [m], [3].
        rotation: Its orientation there, w, x, y, z, [4]: it looks along its +z, x to the right, y down.
    """

    time: float
    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]
    intrinsics: tuple[float, float, float, float]
    position: Array
    rotation: Array


@dataclass(frozen=True)
class Clouds:
    """Points in the arm's base frame, without any on the arm itself.

    Attributes:
        time: When the oldest frame that they come from was taken, on the clock of `time.monotonic` [s].
        branches: On branches [m], float32 [N, 3].
        line: On the line [m], float32 [M, 3].
    """

    time: float
    branches: NDArray[np.float32]
    line: NDArray[np.float32]


class CloudSource(Protocol):
    """The newest clouds of one or several cameras. No method waits.

    Attributes:
        trouble: Why `latest` has none, in one line; empty while it has some.
    """

    trouble: str

    def latest(self) -> Clouds | None:
        """Return the newest clouds; None before the first, and where they are older than the source's limit."""
        ...

    def tell(self, time: float, q: Array) -> None:
        """Take measured joint positions [rad], [D], at a time of `time.monotonic` [s]: the arm is cut out with them."""
        ...

    def close(self) -> None:
        """Let go of cameras, processes and memory."""
        ...
