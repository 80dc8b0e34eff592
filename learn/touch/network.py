"""A network of three layers on the same features: standardised, 64 and 32 units with ReLU, one logit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...sim.base.errors import InputError
from ...sim.base.types import Array, IntArray

UNITS = (64, 32)
#: Passes over the data, rows of a batch, rate and weight decay of Adam.
_EPOCHS, _BATCH, _RATE, _DECAY = 20, 64, 1.0e-3, 1.0e-3
#: Standardised features are cut here, so that a value far from all training data cannot rule the sum.
CUT = 5.0


@dataclass(frozen=True)
class Network:
    """Weights of the three layers and what standardises the features.

    Attributes:
        middle, width: Mean and standard deviation of every feature, [F].
        weight: Of the layers, [64, F], [32, 64], [1, 32].
        bias: [64], [32], [1].
    """

    middle: NDArray[np.float32]
    width: NDArray[np.float32]
    weight: tuple[NDArray[np.float32], ...]
    bias: tuple[NDArray[np.float32], ...]

    def check(self, source: str, features: int) -> None:
        """Raise `InputError` where shapes do not fit together or a number is not finite."""
        sizes = (features, *UNITS, 1)
        good = all(w.shape == (b, a) for w, a, b in zip(self.weight, sizes[:-1], sizes[1:], strict=True))
        good = good and all(b.shape == (n,) for b, n in zip(self.bias, sizes[1:], strict=True))
        good = good and self.middle.shape == self.width.shape == (features,) and bool((self.width > 0).all())
        if not (good and all(np.isfinite(a).all() for a in (self.middle, *self.weight, *self.bias))):
            raise InputError(source, "network", "layers that do not fit", "a model that bough touch train wrote")

    def module(self, device: str) -> torch.nn.Module:
        """Return it as a torch module [N, F] -> [N], without gradients."""
        middle, width = (torch.from_numpy(np.ascontiguousarray(a)) for a in (self.middle, self.width))
        layers = _layers(len(self.middle))
        linear = [layer for layer in layers if isinstance(layer, torch.nn.Linear)]
        for layer, w, b in zip(linear, self.weight, self.bias, strict=True):
            layer.weight.data.copy_(torch.from_numpy(w))
            layer.bias.data.copy_(torch.from_numpy(b))
        return _Standardised(middle, width, layers).to(device).requires_grad_(False)

    def probability(self, x: Array) -> Array:
        """Return the probability of contact of rows [N, F], [N]."""
        with torch.no_grad():
            return self.module("cpu")(torch.from_numpy(x.astype(np.float32))).numpy().astype(np.float64)


class _Standardised(torch.nn.Module):
    middle: torch.Tensor
    width: torch.Tensor

    def __init__(self, middle: torch.Tensor, width: torch.Tensor, layers: torch.nn.Sequential) -> None:
        super().__init__()
        self.register_buffer("middle", middle)
        self.register_buffer("width", width)
        self.layers = layers

    def logit(self, x: torch.Tensor) -> torch.Tensor:
        """Return the log odds of contact of rows [N, F], [N]; inputs are standardised and cut at `CUT` deviations."""
        out: torch.Tensor = self.layers(((x - self.middle) / self.width).clamp(-CUT, CUT))[:, 0]
        return out

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the probability of contact of rows [N, F], [N]."""
        return torch.sigmoid(self.logit(x))


def _layers(features: int) -> torch.nn.Sequential:
    a, b = UNITS
    return torch.nn.Sequential(
        torch.nn.Linear(features, a), torch.nn.ReLU(), torch.nn.Linear(a, b), torch.nn.ReLU(), torch.nn.Linear(b, 1)
    )


def train_network(x: Array, contact: IntArray, seed: int = 0) -> Network:
    """Train on features [N, F] and labels 0 and 1 [N] with Adam; both labels count the same in sum."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        middle, width = x.mean(0).astype(np.float32), np.maximum(x.std(0), 1.0e-6).astype(np.float32)
        net = _Standardised(torch.from_numpy(middle), torch.from_numpy(width), _layers(x.shape[1]))
        given, wanted = torch.from_numpy(x.astype(np.float32)), torch.from_numpy(contact.astype(np.float32))
        share = max(float(wanted.mean()), 1.0e-6)
        loss = torch.nn.BCEWithLogitsLoss(pos_weight=torch.tensor((1.0 - share) / share))
        adam = torch.optim.AdamW(net.parameters(), lr=_RATE, weight_decay=_DECAY)
        for _ in range(_EPOCHS):
            for rows in torch.randperm(len(given)).split(_BATCH):
                adam.zero_grad()
                loss(net.logit(given[rows]), wanted[rows]).backward()
                adam.step()
    parts = [layer for layer in net.layers if isinstance(layer, torch.nn.Linear)]
    return Network(
        middle, width,
        tuple(p.weight.detach().numpy().copy() for p in parts), tuple(p.bias.detach().numpy().copy() for p in parts),
    )  # fmt: skip
