"""The encoder of PointNet++ in plain torch, to compare kernel mean embeddings with (Qi et al. 2017)."""

from __future__ import annotations

from itertools import pairwise

import torch

_NEIGHBOURS = 32


class PointNet(torch.nn.Module):
    """Two set abstractions and a global one, with the sizes of the classification network and random weights.

    Its time does not depend on the weights. Farthest point sampling is left out (every second and every fourth point
    is a centre instead) and neighbours are the 32 nearest: a lower bound of what the encoder costs.
    """

    def __init__(self) -> None:
        super().__init__()
        self.local = torch.nn.ModuleList([layers(3, 64, 64, 128), layers(131, 128, 128, 256)])
        self.last = layers(259, 256, 512, 1024)

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """Return features of clouds.

        Args:
            points: Clouds [B, N, 3] in m, N at least 64.

        Returns:
            Features [B, 1024].
        """
        features, row = None, torch.arange(len(points), device=points.device)[:, None, None]
        for chain, step in zip(self.local, (2, 4), strict=True):
            centres, index = neighbours(points, step)
            near = points[row, index] - centres[:, :, None]
            near = near if features is None else torch.cat([features[row, index], near], dim=-1)
            points, features = centres, chain(near).amax(2)
        assert features is not None
        found: torch.Tensor = self.last(torch.cat([features, points], dim=-1)).amax(1)
        return found


def neighbours(points: torch.Tensor, step: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return centres [B, N/step, 3], every ``step``-th point, and their nearest points [B, N/step, 32]."""
    centres = points[:, ::step]
    return centres, torch.cdist(centres, points).topk(_NEIGHBOURS, largest=False, sorted=False).indices


def layers(*sizes: int) -> torch.nn.Sequential:
    """Return a chain of linear layers and rectifiers."""
    return torch.nn.Sequential(*[m for a, b in pairwise(sizes) for m in (torch.nn.Linear(a, b), torch.nn.ReLU())])
