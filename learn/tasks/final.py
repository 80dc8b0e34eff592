"""What a policy would have seen had an episode gone on: the observation that belongs to its last reward."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
import warp as wp


class FinalObservation:
    """Senses before episodes are closed and puts back all that sensing changed, so that nothing else changes by it.

    Only copies in device memory; a graph may hold them.

    Args:
        changed: All that sensing may write; the scene and the simulator are only read.
        observation: What the policy sees, [worlds, columns], one of them.

    Attributes:
        observation: The last observations of the episodes that the last step ended, [worlds, columns]; of other worlds
            what they see now.
    """

    def __init__(self, changed: Mapping[str, torch.Tensor], observation: wp.array) -> None:
        self._now: list[Any] = [wp.from_torch(tensor) for tensor in changed.values() if tensor.numel()]
        self._kept: list[Any] = [wp.empty_like(array) for array in self._now]
        self._seen: Any = observation
        self._final: Any = wp.empty_like(self._seen)
        self.observation: torch.Tensor = wp.to_torch(self._final)

    def take(self, sense: Callable[[], None]) -> None:
        """Call what senses; keep the observation and put everything back."""
        for now, kept in zip(self._now, self._kept, strict=True):
            wp.copy(kept, now)
        sense()
        wp.copy(self._final, self._seen)
        for now, kept in zip(self._now, self._kept, strict=True):
            wp.copy(now, kept)
