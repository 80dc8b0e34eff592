"""Priors over vectors of free coordinates, the logarithms of positive parameters: differentiable modules that add up.

`Product` multiplies densities of one vector, `Blocks` those of its consecutive parts.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ..systems.system import Parameter, box_of, tails_of


class Prior(torch.nn.Module):
    """A log density, up to a constant, of vectors [..., n]."""

    def forward(self, theta: torch.Tensor) -> torch.Tensor:
        """Return the log density, shape [...]."""
        raise TypeError(f"{type(self).__name__} defines no density")


class SmoothBox(Prior):
    """Flat inside a box, with Gaussian tails of width ``sigma`` outside it.

    log p = -d^2 / (2 sigma^2), d the Euclidean distance to the box. Of the two published forms this is that of
    GPyTorch's code (normal tails); thesis eq. 3.13 prints -d^2 / sqrt(2 sigma^2). Neither stops a negative stiffness:
    on logarithms parameters stay positive whatever the box.

    Args:
        low: Lower ends, shape [n].
        high: Upper ends, shape [n].
        sigma: Width of the tails, of all entries or of each, shape [n]; in units of the logarithm where that is taken.
    """

    low: torch.Tensor
    high: torch.Tensor
    sigma: torch.Tensor

    def __init__(self, low: torch.Tensor, high: torch.Tensor, sigma: float | torch.Tensor = 0.1) -> None:
        super().__init__()
        self.register_buffer("low", low)
        self.register_buffer("high", high)
        self.register_buffer("sigma", torch.as_tensor(sigma, dtype=low.dtype).expand_as(low).clone())

    def forward(self, theta: torch.Tensor) -> torch.Tensor:
        """Return the log density, shape [...]."""
        distance = torch.clamp(self.low - theta, min=0.0) + torch.clamp(theta - self.high, min=0.0)
        return -0.5 * ((distance / self.sigma) ** 2).sum(-1)


def box_prior(parameters: Sequence[Parameter]) -> SmoothBox:
    """Return the smooth box of parameters, with the tails that each one's scale asks for."""
    return SmoothBox(*box_of(parameters), tails_of(parameters))


class Normal(Prior):
    """Independent normal densities; on logarithms of parameters, log-normal ones.

    Args:
        mean: Means, shape [n].
        sigma: Standard deviations, shape [n].
    """

    mean: torch.Tensor
    sigma: torch.Tensor

    def __init__(self, mean: torch.Tensor, sigma: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean)
        self.register_buffer("sigma", sigma)

    def forward(self, theta: torch.Tensor) -> torch.Tensor:
        """Return the log density, shape [...]."""
        return -(((theta - self.mean) / self.sigma) ** 2).sum(-1) / 2.0


class Product(Prior):
    """The product of densities over one and the same vector; of none, the flat one."""

    def __init__(self, priors: Sequence[Prior]) -> None:
        super().__init__()
        self.priors = torch.nn.ModuleList(priors)

    def forward(self, theta: torch.Tensor) -> torch.Tensor:
        """Return the log density, shape [...]."""
        return sum((p(theta) for p in self.priors), theta.new_zeros(theta.shape[:-1]))


class Blocks(Prior):
    """Independent priors over consecutive parts of a vector."""

    def __init__(self, parts: Sequence[tuple[int, Prior]]) -> None:
        """Take (length, prior) of every part."""
        super().__init__()
        self.sizes = [n for n, _ in parts]
        self.priors = torch.nn.ModuleList([p for _, p in parts])

    def forward(self, theta: torch.Tensor) -> torch.Tensor:
        """Return the log density, shape [...]."""
        pieces = torch.split(theta, self.sizes, dim=-1)
        return torch.stack([p(x) for p, x in zip(self.priors, pieces, strict=True)]).sum(0)
