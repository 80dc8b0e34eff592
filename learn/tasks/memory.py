"""All that a simulator with an arm carries from one step to the next, kept and put back on the device."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
import warp as wp

from ...sim.arms.simulator import ArmSimulator


def simulator_tensors(sim: ArmSimulator) -> dict[str, torch.Tensor]:
    """Return views by name: what is copied from them and later back into them puts the simulator back to the bit."""
    state = sim.state
    out = {
        "coordinate": state.coordinate.torch, "velocity": state.velocity.torch, "alive": state.alive.torch,
        "fault link": state.fault_link, "fault tick": state.fault_tick, "tick": wp.to_torch(state._tick),
        "start q": sim.start_q, "capsule start": raw(sim.capsules.start), "capsule end": raw(sim.capsules.end),
    }  # fmt: skip
    _, arm, work = sim._arm.kernel
    for label, struct in (("arm", arm), ("work", work)):
        out |= {f"{label} {name}": raw(getattr(struct, name)) for name in struct._cls.vars}
    out |= {f"effect {name}": tensor for name, tensor in sim.effects.tensors().items()}
    return out | {f"touch {name}": raw(array) for name, array in sim._touch.warp.items()}


def raw(array: Any) -> torch.Tensor:
    """Return the bytes of a contiguous Warp array of any type, uint8 [bytes], without a copy."""
    size = array.size * wp.types.type_size_in_bytes(array.dtype)
    view: Any = wp.array(ptr=array.ptr, shape=(size,), dtype=wp.uint8, device=array.device)
    tensor: torch.Tensor = wp.to_torch(view)
    tensor._owner = array  # type: ignore[attr-defined]  # a view by pointer does not keep what it points to
    return tensor


def copies(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Return copies on the same device."""
    return {name: tensor.clone() for name, tensor in tensors.items()}


def put_back(tensors: dict[str, torch.Tensor], snapshot: dict[str, torch.Tensor]) -> None:
    """Copy a snapshot into the tensors that it was taken from.

    Raises:
        ValueError: Names or shapes differ.
    """
    if set(tensors) != set(snapshot):
        raise ValueError(f"a snapshot of another task: {sorted(set(tensors) ^ set(snapshot))}")
    for name, tensor in tensors.items():
        if tensor.shape != snapshot[name].shape:
            raise ValueError(f"{name}: shape {tuple(snapshot[name].shape)}, not {tuple(tensor.shape)}")
    for name, tensor in tensors.items():
        tensor.copy_(snapshot[name])


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
        _copy_all(self._kept, self._now)
        sense()
        wp.copy(self._final, self._seen)
        _copy_all(self._now, self._kept)


def _copy_all(to: Sequence[Any], source: Sequence[Any]) -> None:
    for one, other in zip(to, source, strict=True):
        wp.copy(one, other)
