"""How a stereo depth camera measures: noise, steps and holes, with the numbers of an Intel RealSense D405."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from ..base.errors import InputError

D405_WIDTH, D405_HEIGHT = 848, 480
"""Picture of the D405 [pixels], at the mode for which its range begins at 7 cm."""

_FIELD = 87.0  # degrees, across


@dataclass(frozen=True)
class StereoDepth:
    """Depth from the disparity of two imagers; the defaults are those of an Intel RealSense D405 at 848 x 480.

    From Intel's data sheet of the D400 series and DigiKey's notes on the D405: imagers 18 mm apart, a field of view of
    87 degrees, depth from 70 mm on at this mode, an ideal range of 7 to 50 cm. From Intel's white papers on these
    cameras (Grunnet-Jepsen, Sweetser and Woodfill, Tuning depth cameras for best performance; Grunnet-Jepsen et al.,
    Subpixel linearity improvement): the deviation of the depth is z^2 dd / (f b), disparities come in steps of 1/32
    pixel, and lower resolutions should be had by decimating. The disparity's noise of 0.08 pixels on a well
    textured surface is these papers' order, not a figure for the D405; at 0.5 m it makes 2.5 mm, a fourth of the
    2 % that the data sheet allows. How far a match reaches, and how steep a surface may be, is set by hand.

    Attributes:
        focal: Focal length of the imagers [pixels].
        baseline: Distance of the imagers [m].
        noise: Standard deviation of the disparity [pixels].
        step: Step of the disparity [pixels], 0 for none.
        unit: Step of the depth [m], 0 for none.
        nearest, farthest: Range of depths that are reported [m].
        reach: Pixels on each side of one that a match is made over, of the picture that is traced.
        agree: Share of these with the pixel's own disparity: below the first number there is never a depth, above the
            second always, in between by chance.
        graze: Cosine of incidence, likewise.
    """

    focal: float = D405_WIDTH / 2 / math.tan(math.radians(_FIELD / 2))
    baseline: float = 0.018
    noise: float = 0.08
    step: float = 1 / 32
    unit: float = 1e-4
    nearest: float = 0.07
    farthest: float = 2.0
    reach: int = 1
    agree: tuple[float, float] = (0.25, 0.6)
    graze: tuple[float, float] = (0.1, 0.35)

    def __post_init__(self) -> None:
        for name in ("focal", "baseline", "nearest"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError("depth", name, f"{getattr(self, name)}", "a number above zero")
        for name in ("noise", "step", "unit", "reach"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError("depth", name, f"{getattr(self, name)}", "zero or more")
        if not self.nearest < self.farthest < math.inf:
            raise InputError("depth", "farthest", f"{self.farthest}", "a number above nearest")

    @staticmethod
    def perfect() -> StereoDepth:
        """Return depth as it is, without noise, steps or holes, up to 1 km."""
        return StereoDepth(noise=0.0, step=0.0, unit=0.0, nearest=1e-6, farthest=1e3, reach=0, agree=(-2.0, -1.0),
                           graze=(-2.0, -1.0))  # fmt: skip

    def deviation(self, depth: float) -> float:
        """Return the standard deviation of a depth [m] from the noise of the disparity, z^2 dd / (f b) [m]."""
        return depth**2 * self.noise / (self.focal * self.baseline)

    @property
    def kernel(self) -> Any:
        """The same as the kernels take it."""
        import warp as wp  # here, so that what knows a camera's numbers alone starts fast

        from ...kernels.points import camera as kernels

        out = kernels.Stereo()
        for field in fields(self):
            value = getattr(self, field.name)
            setattr(out, field.name, wp.vec2(*value) if isinstance(value, tuple) else value)
        return out
