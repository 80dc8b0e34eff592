"""Mixtures of normal densities, one component per posterior sample: the predictive kernel density estimate.

At every time step and channel the predictive density is a Gaussian kernel density estimate over the particles'
simulations with Scott's bandwidth h = s P^(-1/5) and the variance v_i of the noise:

    p(y) = 1/P sum_i N(y; x_i, h^2 + v_i).
"""

from __future__ import annotations

import math

import numpy as np
import torch

#: Bisections of the bracket of a quantile: to 2^-40 of its width.
HALVINGS = 40
#: Most partners of each component in the double sum of the CRPS: all pairs (i, i + k) for so many evenly spaced
#: shifts k.
SHIFTS = 64


def scott_bandwidth(x: torch.Tensor) -> torch.Tensor:
    """Scott's bandwidth of samples [P, ...] in one dimension, s P^(-1/5) (Scott 1992)."""
    if len(x) < 2:
        return torch.zeros_like(x[0])
    return x.std(0) * len(x) ** -0.2


class Mixture:
    """Equal mixtures of P normals at many points.

    Args:
        mean: Shape [P, ...].
        deviation: Shape [P, ...], above zero.
    """

    def __init__(self, mean: torch.Tensor, deviation: torch.Tensor) -> None:
        self.mean, self.deviation = mean, deviation

    def cdf(self, y: torch.Tensor) -> torch.Tensor:
        """Return the share of the mixture below y [...]."""
        return torch.special.ndtr((y - self.mean) / self.deviation).mean(0)

    def quantile(self, share: float) -> torch.Tensor:
        """Return the quantile at every point [...], by bisection."""
        low = (self.mean - 10.0 * self.deviation).amin(0)
        high = (self.mean + 10.0 * self.deviation).amax(0)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            below = self.cdf(middle) < share
            low, high = torch.where(below, middle, low), torch.where(below, high, middle)
        return 0.5 * (low + high)

    def log_density(self, y: torch.Tensor) -> torch.Tensor:
        """Return the log density at y [...]."""
        z = (y - self.mean) / self.deviation
        terms = -0.5 * z**2 - self.deviation.log() - 0.5 * math.log(2.0 * math.pi)
        return torch.logsumexp(terms, 0) - math.log(len(self.mean))

    def crps(self, y: torch.Tensor) -> torch.Tensor:
        """Return the continuous ranked probability score at y [...], in y's unit; smaller is better.

        Closed form for mixtures of normals (Grimit et al. 2006): with A(m, s) = 2 s phi(m/s) + m (2 Phi(m/s) - 1),
        mean_i A(y - m_i, s_i) - 1/2 mean_ij A(m_i - m_j, sqrt(s_i^2 + s_j^2)).
        """
        count = len(self.mean)
        error = _spread(y - self.mean, self.deviation).mean(0)
        own = _spread(torch.zeros_like(self.mean), math.sqrt(2.0) * self.deviation).mean(0)
        shifts = np.unique(np.linspace(1, count - 1, min(SHIFTS, count - 1)).round().astype(int)).tolist()
        others = torch.zeros_like(error)
        for k in shifts:
            apart = torch.hypot(self.deviation, self.deviation.roll(k, 0))
            others += _spread(self.mean - self.mean.roll(k, 0), apart).mean(0) / len(shifts)
        return error - 0.5 * (own + (count - 1) * others) / count


def _spread(m: torch.Tensor, s: torch.Tensor) -> torch.Tensor:
    z = m / s
    density = torch.exp(-0.5 * z**2) / math.sqrt(2.0 * math.pi)
    return 2.0 * s * density + m * (2.0 * torch.special.ndtr(z) - 1.0)
