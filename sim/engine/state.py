"""What changes while the worlds move: joint coordinates and velocities, in place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.tree.layout import layout_of
from ..base import rotation
from ..base.errors import InputError
from ..base.types import Array, IntArray
from ..trees.tree import Joint
from .arrays import LaneArray
from .model import Model


class State:
    """Coordinates and velocities of every joint of every world. Arrays are written in place and never move.

    Attributes:
        coordinate: Joint coordinates from the spring's rest: quaternions w, x, y, z of spherical joints; x holds the
            coordinate [rad or m] of the others. `LaneArray` [groups, places + 1] of 4.
        velocity: Angular velocity in the link frame [rad/s], or the rate in x. `LaneArray` of 3.
        alive: 1 where a world moves, -1 where the guard froze it. `LaneArray` of 1, one place.
        fault_link, fault_tick: Place and tick of each slot's first fault, 0 and -1 where there is none, torch [slots].
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.coordinate: LaneArray = model.field("Quat")
        self.velocity: LaneArray = model.field("Vec")
        self.alive: LaneArray = model.field("Real", places=1)
        slots = model.groups * model.width
        self._tick = wp.zeros(model.groups, dtype=int, device=model.device)
        self._fault_link = wp.zeros(slots, dtype=int, device=model.device)
        self._fault_tick = wp.full(slots, -1, dtype=int, device=model.device)
        self.fault_link: torch.Tensor = wp.to_torch(self._fault_link)
        self.fault_tick: torch.Tensor = wp.to_torch(self._fault_tick)
        self.kernel = self._struct()
        self.coordinate.torch[..., 0] = 1.0
        self.alive.torch.fill_(1.0)

    def _struct(self) -> object:
        kernel = layout_of(self.model.width, self.model.precision).State()
        kernel.coordinate, kernel.velocity = self.coordinate.kernel, self.velocity.kernel
        kernel.alive = self.alive.column()
        kernel.tick, kernel.lanes = self._tick, self.model.width
        kernel.fault_link, kernel.fault_tick = self._fault_link, self._fault_tick
        return kernel

    @property
    def nbytes(self) -> int:
        """Bytes of all device arrays of the state."""
        return sum(a.nbytes for a in (self.coordinate, self.velocity, self.alive)) + 4 * (
            self._tick.size + 2 * self._fault_link.size
        )

    def set_qpos(self, qpos: Array | Sequence[Array]) -> None:
        """Set all coordinates from ``qpos`` in MuJoCo's order: one for all worlds, or one a world.

        Raises:
            InputError: A ``qpos`` does not fit its tree.
        """
        values = self.model.coordinates_from_qpos(_rows("qpos", qpos, self.model.num_worlds))
        self.coordinate.assign(self.model.scatter(values, [1.0, 0.0, 0.0, 0.0]))

    def qpos(self) -> list[Array]:
        """Return one ``qpos`` a world, in MuJoCo's order."""
        return self.model.qpos_from_coordinates(self.model.gather(self.coordinate.numpy()))

    def set_qvel(self, qvel: Array | Sequence[Array]) -> None:
        """Set all velocities from ``qvel`` in MuJoCo's order (three numbers a ball joint, in the body frame).

        Raises:
            InputError: A ``qvel`` has the wrong length.
        """
        rows = _rows("qvel", qvel, self.model.num_worlds)
        values = np.concatenate([_by_link(t.joint, v, t.name) for t, v in zip(self.model.trees, rows, strict=True)])
        self.velocity.assign(self.model.scatter(self._turned(values, inverse=True), [0.0, 0.0, 0.0]))

    def qvel(self) -> list[Array]:
        """Return one ``qvel`` a world, in MuJoCo's order."""
        values = self._turned(self.model.gather(self.velocity.numpy()), inverse=False)
        cuts = self.model.first_link
        keep = [np.arange(3)[None, :] < _dofs(t.joint)[:, None] for t in self.model.trees]
        return [values[a:b][k] for a, b, k in zip(cuts, cuts[1:], keep, strict=False)]

    def _turned(self, values: Array, *, inverse: bool) -> Array:
        links = self.model.links
        frame = rotation.quat_conjugate(links.frame) if inverse else links.frame
        return np.where((links.kind == Joint.SPHERICAL)[:, None], rotation.quat_rotate(frame, values), values)

    def faults(self) -> list[tuple[int, str, int]]:
        """Return (world, link name, tick) of every frozen world."""
        link, tick = self.fault_link.cpu().numpy(), self.fault_tick.cpu().numpy()
        out = []
        for world in np.flatnonzero(tick[self.model.world_slot] >= 0):
            slot = self.model.world_slot[world]
            out.append((int(world), self.model.link_name(int(world), int(link[slot])), int(tick[slot])))
        return out


def _rows(name: str, values: Any, worlds: int) -> list[Array]:
    """Return one row a world: ``values`` row by row, or the same for all where it is a single row."""
    single = len(values) == 0 or np.ndim(values[0]) == 0
    rows = [values] * worlds if single else list(values)
    if len(rows) != worlds:
        raise InputError("state", name, f"{len(rows)} rows", f"{worlds}, one a world")
    return [np.asarray(row, np.float64) for row in rows]


def _dofs(joint: IntArray) -> IntArray:
    return np.array([Joint(j).dofs for j in joint])


def _by_link(joint: IntArray, qvel: Array, name: str) -> Array:
    dofs = _dofs(joint)
    if qvel.shape != (dofs.sum(),):
        raise InputError(name, "qvel", f"{qvel.size} numbers", f"{dofs.sum()}")
    out = np.zeros((len(joint), 3))
    out[np.arange(3)[None, :] < dofs[:, None]] = qvel
    return out
