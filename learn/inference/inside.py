"""Coordinates in which no particle leaves its box.

A parameter that may be negative or zero (a share, an angle, an exponent) is sampled as w, with value

    x = low + (high - low) / (1 + exp(-w)):

whatever w is, x is inside its box. The density of w is that of x times dx/dw, so that the density of x is unchanged.
Positive parameters are sampled as logarithms, start states and noise as they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ..systems.system import Parameter, free_of, values_of
from .fit import Modes

#: Nearest share of the box to an end at which particles start, since a mode at the very end is at infinity in w: the
#: parameter's standard deviation where that is less than the first, and no less than the second.
EDGE, SHARPEST = 0.01, 1e-6
#: Least precision of w. A density that is flat over the box has 3 / pi^2 = 0.30.
FLAT = 0.3
#: Nearest share of the box to an end that is told from it, in double precision.
FINEST = 1e-12


class Inside:
    """Transforms vectors theta of a target into coordinates w, entry by entry, and back.

    Args:
        parameters: The first n entries of theta; the others are their own coordinates.
        size: Length D of theta.
        device: Where vectors are.

    Attributes:
        bounded: Which entries have a box that they cannot leave, shape [D].
    """

    def __init__(self, parameters: Sequence[Parameter], size: int, device: torch.device | str = "cpu") -> None:
        more = size - len(parameters)
        linear = [p.scale == "linear" for p in parameters] + [False] * more
        self.bounded = torch.tensor(linear, device=device)
        self.low = torch.tensor([p.low for p in parameters] + [0.0] * more, dtype=torch.float64, device=device)
        high = torch.tensor([p.high for p in parameters] + [1.0] * more, dtype=torch.float64, device=device)
        self.width = high - self.low

    def theta(self, w: torch.Tensor) -> torch.Tensor:
        """Return vectors theta of coordinates w, shapes [..., D]."""
        return torch.where(self.bounded, self.low + self.width * torch.sigmoid(w), w)

    def w(self, theta: torch.Tensor, edge: torch.Tensor | None = None) -> torch.Tensor:
        """Return coordinates w of vectors theta, no nearer to an end of a box than shares ``edge`` of it, [..., D]."""
        edge = torch.full_like(theta, FINEST) if edge is None else edge
        share = torch.minimum(torch.maximum((theta - self.low) / self.width, edge), 1.0 - edge)
        return torch.where(self.bounded, torch.logit(share), theta)

    def slope(self, w: torch.Tensor) -> torch.Tensor:
        """Return d theta / d w, shape [..., D]."""
        share = torch.sigmoid(w)
        return torch.where(self.bounded, self.width * share * (1.0 - share), 1.0)

    def log_volume(self, w: torch.Tensor) -> torch.Tensor:
        """Return the logarithm of d theta / d w up to a constant, shape [...]."""
        inside = torch.nn.functional.logsigmoid(w) + torch.nn.functional.logsigmoid(-w)
        return torch.where(self.bounded, inside, 0.0).sum(-1)

    def gradient(self, w: torch.Tensor, by_theta: torch.Tensor) -> torch.Tensor:
        """Return the gradient of the density of w from that of theta's, shapes [..., D]."""
        return by_theta * self.slope(w) + torch.where(self.bounded, 1.0 - 2.0 * torch.sigmoid(w), 0.0)

    def modes(self, modes: Modes) -> Modes:
        """Return modes in coordinates w, none nearer to an end of a box than `EDGE` or its own standard deviation."""
        if not bool(self.bounded.any()):
            return modes
        spread = modes.precision.diagonal(dim1=-2, dim2=-1).clamp(min=1e-12).rsqrt()
        w = self.w(modes.theta, (spread / self.width).clamp(SHARPEST, EDGE))
        slope = self.slope(w)
        flat = torch.diag(torch.where(self.bounded, FLAT, 0.0))
        precision = slope[:, :, None] * modes.precision * slope[:, None] + flat
        return Modes(w, modes.log_posterior + self.log_volume(w), precision)


def coordinates_of(parameters: Sequence[Parameter], values: torch.Tensor) -> torch.Tensor:
    """Return the coordinates in which parameters are sampled from values in SI units, shapes [..., n]."""
    return Inside(parameters, len(parameters), values.device).w(free_of(parameters, values))


def values_at(parameters: Sequence[Parameter], w: torch.Tensor) -> torch.Tensor:
    """Return values in SI units from the coordinates in which parameters are sampled, shapes [..., n]."""
    return values_of(parameters, Inside(parameters, len(parameters), w.device).theta(w))
