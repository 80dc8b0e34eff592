"""Arrays of reals for many worlds, owned by Warp and seen by torch and NumPy without a copy."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.tree.layout import layout_of
from ..base.types import Array, IntArray

COMPONENTS = {"Real": 1, "Vec": 3, "Quat": 4, "Sym": 6, "Mat": 9}


def link_major(device: Any) -> bool:
    """Return whether memory lies link by link (GPU: neighbouring threads are neighbouring worlds) or world by world."""
    return bool(device.is_cuda)


def integer_array(values: IntArray, device: Any) -> wp.array:
    """Return ``values`` [groups] or [groups, places] as a Warp array of int32, in the device's memory order."""
    flipped = link_major(device) and values.ndim == 2
    host = np.ascontiguousarray(values.T if flipped else values, dtype=np.int32)
    array: wp.array = wp.array(host, dtype=int, device=device)
    return array.transpose() if flipped else array


class LaneArray:
    """One field of every link of every world.

    Memory is [group, place, component, lane] on a CPU (worlds of a group side by side in vector registers) and
    [place, group, component, lane] on a GPU (neighbouring threads touch neighbouring memory), unless ``by_link`` says
    otherwise. Kernels index both as [group, place].

    Attributes:
        kernel: The Warp array of structs that kernels take, shape [groups, places].
        torch: View [groups, lanes, places, components] on the same memory; its pointer never changes.
    """

    def __init__(
        self, kind: str, groups: int, places: int, *, width: int = 1, precision: int = 32, device: Any = None,
        by_link: bool | None = None,
    ) -> None:  # fmt: skip
        self.device = wp.get_device(device)
        self.width, self.components = width, COMPONENTS[kind]
        scalar = wp.float64 if precision == 64 else wp.float32
        self._link_major = link_major(self.device) if by_link is None else by_link
        shape = (places, groups) if self._link_major else (groups, places)
        self._memory = wp.zeros((*shape, self.components, width), dtype=scalar, device=self.device)
        struct = getattr(layout_of(width, precision), kind)
        view: Any = wp.array(ptr=self._memory.ptr, shape=shape, dtype=struct, device=self.device)
        self.kernel: Any = view.transpose() if self._link_major else view
        self.kernel._memory = self._memory  # a view by pointer does not keep what it points to
        seen = wp.to_torch(self._memory)
        self.torch: torch.Tensor = seen.permute(1, 3, 0, 2) if self._link_major else seen.permute(0, 3, 1, 2)

    def column(self) -> wp.array:
        """Return the kernel view [groups] of an array of one place."""
        view: Any = wp.array(
            ptr=self._memory.ptr, shape=self.kernel.shape[0], dtype=self.kernel.dtype, device=self.device
        )
        view._memory = self._memory
        return view

    def entries(self) -> wp.array:
        """Return the view [groups, places, components, lanes] of the scalars themselves."""
        return self._memory.transpose((1, 0, 2, 3)) if self._link_major else self._memory

    @property
    def nbytes(self) -> int:
        """Size of the memory in bytes."""
        return int(self._memory.size) * wp.types.type_size_in_bytes(self._memory.dtype)

    def numpy(self) -> Array:
        """Return a host copy, shape [slots, places, components], float64."""
        t = self.torch.detach().cpu().to(torch.float64).numpy()
        return t.reshape(-1, *t.shape[2:]).copy()

    def assign(self, values: Array) -> None:
        """Write host values of shape [slots, places, components]."""
        host = torch.from_numpy(np.ascontiguousarray(values)).reshape(self.torch.shape)
        self.torch.copy_(host.to(self.torch.dtype))
