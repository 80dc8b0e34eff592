"""Nuisance columns: linear changes of the simulation that no model is asked about, under normal priors.

What a branch's file says of its geometry and of its sensors is a little wrong, and its wood bends. To first order the
simulation changes by a @ columns, a normal with known mean and deviation one. The cost of a model is least over a:
equal, up to a constant, to a normal likelihood whose covariance is that of the noise plus columns^T columns. So a
model is charged for geometry that it needs to be wrong, in deviations squared. The normals are cut off: what nobody
mismeasures so far, and wood that bends backwards, explain no misfit, however much the charge would be worth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import torch

#: Deviations from its mean at which the prior of a measured number is cut off: one of a hundred normals is further off
#: once in 160 cases. Without a limit, a point held 23 deviations off stood in for a branch's relaxation.
FARTHEST = 4.0


@dataclass(frozen=True)
class Nuisances:
    """M nuisance parameters that all models of a case share.

    Attributes:
        columns: Whitened change of the channels by one prior deviation of each, shape [M, R, T C].
        mean: Prior means in deviations, shape [M].
        names: What each is, length M.
        low, high: Least and largest coefficients, shape [M].
    """

    columns: torch.Tensor
    mean: torch.Tensor
    names: tuple[str, ...]
    low: torch.Tensor
    high: torch.Tensor

    @cached_property
    def _gram(self) -> torch.Tensor:
        """Products of the columns in each recording, [R, M, M]."""
        by_recording = self.columns.transpose(0, 1)
        return by_recording @ by_recording.transpose(1, 2)

    def __len__(self) -> int:
        return len(self.columns)

    @property
    def flat(self) -> torch.Tensor:
        """Columns over all samples, shape [M, N]."""
        return self.columns.flatten(1)

    def held(self, found: torch.Tensor) -> torch.Tensor:
        """Return which coefficients [S, M] are at their bounds."""
        return (found <= self.low) | (found >= self.high)

    def unlimited(self) -> Nuisances:
        """Return the same under whole normals."""
        most = torch.full_like(self.mean, math.inf)
        return replace(self, low=-most, high=most)

    def change(self, found: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        """Return the change of the channels by coefficients [S, M] in recordings weighted [S, R], shape [S, N]."""
        whole = (found @ self.flat).view(len(found), *self.columns.shape[1:])
        return (whole * weight[:, :, None]).flatten(1)

    def along(self, rows: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        """Return products of weighted rows [S, P, N] with the columns as weighted by ``weight`` [S, R], [S, P, M]."""
        if bool((weight == 1.0).all()):
            return rows @ self.flat.T
        split = rows.view(*rows.shape[:2], *self.columns.shape[1:]) * weight[:, None, :, None]
        return split.flatten(2) @ self.flat.T

    def precision(self, weight: torch.Tensor, overdispersion: float) -> torch.Tensor:
        """Return the precision of the coefficients given the data and the prior, [S, M, M]."""
        own = torch.einsum("sr,rij->sij", weight**2, self._gram)
        return own + overdispersion * torch.eye(len(self), dtype=own.dtype, device=own.device)


def none_of(like: torch.Tensor) -> Nuisances:
    """Return no nuisances, for measured channels [R, T, C]."""
    nothing = like.new_zeros(0)
    return Nuisances(like.new_zeros(0, len(like), like[0].numel()), nothing, (), nothing, nothing)


def joined(parts: list[Nuisances]) -> Nuisances:
    """Return several sets as one."""
    columns, mean, low, high = (torch.cat([getattr(p, k) for p in parts]) for k in ("columns", "mean", "low", "high"))
    return Nuisances(columns, mean, tuple(n for p in parts for n in p.names), low, high)
