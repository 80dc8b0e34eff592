"""Simulations that a fit asks for again: a step was rejected, or what was tried is where the next step begins."""

from __future__ import annotations

from collections.abc import Callable

import torch

#: Simulates rows of values [S, n] from start states [S, R, J, 2], each on its own: [S, R, T, C].
Simulate = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]


class Remembered:
    """Simulates rows, and takes over to the bit those that one of the last two calls had.

    A third of the rows of a fit's derivatives come again after a rejected step, and every accepted step was simulated
    when it was tried.
    """

    def __init__(self, simulate: Simulate) -> None:
        self._simulate = simulate
        self._calls: list[tuple[list[bytes], torch.Tensor]] = []

    def __call__(self, values: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
        """Return what ``simulate`` returns."""
        rows = torch.cat([values, start.flatten(1).to(values)], 1).cpu().numpy()
        keys = [row.tobytes() for row in rows]
        known = {key: (call, s) for call, (own, _) in enumerate(self._calls) for s, key in enumerate(own)}
        new = torch.tensor([key not in known for key in keys], device=values.device)
        out = self._simulate(values[new], start[new]) if bool(new.any()) else None
        if not bool(new.all()):
            out = self._joined(keys, known, new, out)
        assert out is not None
        self._calls = [*self._calls[-1:], (keys, out)]
        return out

    def _joined(
        self, keys: list[bytes], known: dict[bytes, tuple[int, int]], new: torch.Tensor, fresh: torch.Tensor | None
    ) -> torch.Tensor:
        last = self._calls[-1][1]
        out = last.new_empty(len(keys), *last.shape[1:])
        if fresh is not None:
            out[new] = fresh
        for call, (_, rows) in enumerate(self._calls):
            pairs = [(s, known[key][1]) for s, key in enumerate(keys) if key in known and known[key][0] == call]
            if pairs:
                to, at = (list(x) for x in zip(*pairs, strict=True))
                out[to] = rows[at]
        return out
