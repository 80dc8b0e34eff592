"""State, loads and parameters of all worlds as plain tensors, [worlds, links, ...] or [worlds, columns].

The kernels' arrays are laid out for the kernels: worlds in vector lanes, links of a world apart. A tensor here is
gathered from them, and what is written is scattered into them, by one launch on the device.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.tree.exchange import exchange_kernels, exchange_types
from ..base.errors import InputError
from ..base.thread_pool import Launches, recorded
from ..base.types import Array, IntArray
from ..trees.tree import Joint
from .arrays import LaneArray, integer_array
from .launcher import Recorded
from .load import Load
from .model import Model
from .state import State


@dataclass(frozen=True)
class Quantity:
    """One name that `WorldTensors` knows.

    Attributes:
        form: How it is laid out and which kernels carry it: "qpos", "dofs", "links" or "points".
        owner: Where its array is: "state", "load" or "model".
        field: The array's name there.
        components: Numbers a link; 1 makes a tensor [worlds, links].
        unit: SI unit.
        text: What it is.
    """

    form: str
    owner: str
    field: str
    components: int
    unit: str
    text: str


#: What can be read and written, by name.
QUANTITIES: Mapping[str, Quantity] = MappingProxyType(
    {
        "qpos": Quantity("qpos", "state", "coordinate", 0, "rad, m, 1", "joint coordinates in MuJoCo's order"),
        "qvel": Quantity("dofs", "state", "velocity", 0, "rad/s, m/s", "joint velocities in MuJoCo's order"),
        "effort": Quantity("dofs", "load", "effort", 0, "N m, N", "applied joint efforts"),
        "force": Quantity("links", "load", "force", 3, "N", "applied force on each link, world axes"),
        "torque": Quantity("links", "load", "torque", 3, "N m", "applied torque on each link, world axes"),
        "point": Quantity("points", "load", "point", 3, "m", "where the force acts, body frame"),
        "stiffness": Quantity("links", "model", "stiffness", 1, "N m/rad, N/m", "springs of the joints"),
        "damping": Quantity("links", "model", "damping", 1, "N m s/rad, N s/m", "dampers of the joints"),
        "armature": Quantity("links", "model", "armature", 1, "kg m^2, kg", "inertia added at the joints"),
        "preload": Quantity("dofs", "model", "preload", 0, "N m, N", "pre-loads of the joints"),
        "mass": Quantity("mass", "model", "mass", 1, "kg", "masses; inertias follow in proportion"),
    }
)


class WorldTensors:
    """Tensors over all worlds of a simulator, read with `get` and written with `set`.

    Names and units are those of `QUANTITIES`. Shapes are [worlds, nq] for ``qpos``, [worlds, nv] for ``qvel``,
    ``effort`` and ``preload``, [worlds, links, 3] for ``force``, ``torque`` and ``point``, and [worlds, links] for the
    others; nq, nv and links are those of the largest tree, columns that a world lacks are zero and never read. Links
    are in the order of each world's tree, columns in MuJoCo's: of a ball joint four in ``qpos`` (w, x, y, z) and three
    in the body frame elsewhere, of a hinge or slide one, of a fixed joint none.

    Forces act from the next `Simulator.step` on, until they are written again. They act at the links' centres of mass
    until ``point`` is written. New parameters act from the next step on, too: `Simulator.refresh` runs before it by
    itself. A mass scales its link's inertia; a link without mass stays without.

    Attributes:
        coordinate_column: First column of each link's joint in ``qpos``, torch int32 [worlds, links]; -1 where a joint
            is fixed or a link is not there.
        dof_column: The same in ``qvel``, ``effort`` and ``preload``.
    """

    def __init__(self, model: Model, state: State, load: Callable[[], Load], changed: Callable[[], None]) -> None:
        """Make the index tables, some 80 bytes a link.

        Args:
            model: The worlds.
            state: Where they are, written in place.
            load: Gives what acts on them, made when it is first asked for.
            changed: Called when a parameter of the model has been written.
        """
        self._model, self._state, self._load, self._changed = model, state, load, changed
        self._device = state.fault_link.device
        m = model
        self._kernels, self._types = exchange_kernels(m.precision), exchange_types(m.precision)
        self._longest = max(t.num_links for t in m.trees)
        self._columns = {"qpos": max(t.num_coordinates for t in m.trees), "dofs": max(t.num_dofs for t in m.trees)}
        self._slots = self._index()
        self._everyone: wp.array = wp.full(m.num_worlds, True, dtype=wp.bool, device=m.device)
        self._every: wp.array = wp.array(np.arange(m.num_worlds, dtype=np.int32), device=m.device)
        self._read: dict[str, tuple[torch.Tensor, Callable[[], None]]] = {}
        self._write: dict[str, Recorded] = {}

    def get(self, name: str) -> torch.Tensor:
        """Gather a quantity of all worlds into its tensor and return it.

        The tensor is the same at every call, so that it can stand in a graph; writing into it changes no world. No
        memory is allocated but at the first call of a name.

        Raises:
            InputError: No such name.
        """
        quantity = _quantity(name)
        if name not in self._read:
            self._read[name] = self._prepare_read(name, quantity)
        tensor, read = self._read[name]
        read()
        return tensor

    def set(self, name: str, values: Any, worlds: torch.Tensor | None = None) -> None:
        """Write a quantity of all worlds, of those that a mask names, or of those with given numbers.

        Args:
            name: What to write.
            values: Shape as `get` returns it, or what broadcasts to it; a row a number with indices. A contiguous
                torch or Warp array of the model's device and precision is read where it lies, others are copied.
            worlds: Mask [worlds], bool; or numbers of worlds [n], int32 (others are copied), each at most once.
                Numbers that are no world's are passed over. None is all.

        Raises:
            InputError: No such name; values or worlds of another shape; a parameter inside a graph capture.
        """
        quantity = _quantity(name)
        index, mask, rows = self._chosen(worlds)
        given = self._given(name, quantity, values, rows)
        if quantity.owner == "model":
            if self._model.device.is_capturing:
                raise InputError("simulator", name, "a parameter written inside a graph", "set it before the capture")
            self._changed()
        if name not in self._write:
            self._write[name] = Recorded(self._recorder(quantity))
        self._write[name](index, mask, given)

    @property
    def coordinate_column(self) -> torch.Tensor:
        """First column of each link's joint in ``qpos``, -1 where there is none, int32 [worlds, links]."""
        return self._start("coordinates")

    @property
    def dof_column(self) -> torch.Tensor:
        """First column of each link's joint in ``qvel``, -1 where there is none, int32 [worlds, links]."""
        return self._start("dofs")

    # ---- tables --------------------------------------------------------------------------------------------------

    def _index(self) -> Any:
        """Return the struct of `kernels.tree.exchange`."""
        m, t = self._model, self._types
        slots = t.Slots()
        slots.slot = wp.array(m.world_slot.astype(np.int32), device=m.device)
        place, kind = self._table(m.link_place), self._table(m.links.kind)
        slots.place, slots.kind = integer_array(place, m.device), integer_array(kind, m.device)
        slots.q_start = integer_array(np.maximum(self._starts("coordinates"), 0), m.device)
        slots.v_start = integer_array(np.maximum(self._starts("dofs"), 0), m.device)
        ball = (m.links.kind == Joint.SPHERICAL)[:, None]
        rest = np.where(ball, np.roll(m.links.rest, -1, axis=1), m.links.rest)
        identity = [0.0, 0.0, 0.0, 1.0]
        slots.frame = self._vectors(np.roll(m.links.frame, -1, axis=1), t.Quat, identity)
        slots.rest = self._vectors(rest, t.Quat, identity)
        slots.anchor = self._vectors(m.links.anchor, t.Vec, [0.0, 0.0, 0.0])
        return slots

    def _table(self, values: Array | IntArray, fill: Any = 0) -> Any:
        """Return per-link values [N, ...] as [worlds, longest, ...], ``fill`` where no link is."""
        m = self._model
        link = np.arange(len(m.link_slot)) - m.first_link[m.links.world]
        out = np.empty((m.num_worlds, self._longest, *np.shape(values)[1:]), np.asarray(values).dtype)
        out[:] = fill
        out[m.links.world, link] = values
        return out

    def _vectors(self, values: Array, kind: Any, fill: list[float]) -> wp.array:
        number = np.float64 if self._model.precision == 64 else np.float32
        array: wp.array = wp.array(self._table(values, fill).astype(number), dtype=kind, device=self._model.device)
        return array

    def _starts(self, size: str) -> IntArray:
        """Return first columns [worlds, longest], -1 where a link has none; ``size`` of `Joint`."""
        counts = self._table(np.array([getattr(Joint(k), size) for k in range(4)])[self._model.links.kind])
        return np.where(counts > 0, np.cumsum(counts, axis=1) - counts, -1)

    def _start(self, size: str) -> torch.Tensor:
        return torch.as_tensor(self._starts(size).astype(np.int32), device=self._device)

    # ---- launches ------------------------------------------------------------------------------------------------

    def _field(self, quantity: Quantity) -> LaneArray:
        """Return the array behind a quantity; a load begins with its points at the centres of mass."""
        m = self._model
        if quantity.owner == "model":
            return m.arrays[quantity.field]
        if quantity.owner == "state":
            return getattr(self._state, quantity.field)
        load = self._load()
        if not load.point.torch.any():
            load.point.assign(m.scatter(m.links.com, [0.0, 0.0, 0.0]))
        return getattr(load, quantity.field)

    def _shape(self, quantity: Quantity, rows: int) -> tuple[int, ...]:
        """Return the shape that the kernels take for so many rows."""
        if quantity.form in self._columns:
            return rows, self._columns[quantity.form]
        return rows, self._longest, quantity.components

    def _prepare_read(self, name: str, quantity: Quantity) -> tuple[torch.Tensor, Callable[[], None]]:
        m = self._model
        out = wp.zeros(self._shape(quantity, m.num_worlds), dtype=self._types.Scalar, device=m.device)
        kernel = getattr(self._kernels, "get_links" if quantity.form == "mass" else f"get_{quantity.form}")
        given = [self._slots, self._field(quantity).entries(), out]
        launch = Launches([recorded(kernel, (m.num_worlds, self._longest), given, m.device)])
        seen: torch.Tensor = wp.to_torch(out)
        return (seen[..., 0] if quantity.components == 1 else seen), launch

    def _recorder(self, quantity: Quantity) -> Callable[..., list[Any]]:
        """Return what records the launch that writes a quantity, for `Recorded`."""
        m, kernel = self._model, getattr(self._kernels, f"set_{quantity.form}")
        after = [self._field(quantity).entries()]
        if quantity.form == "mass":
            number = np.float64 if m.precision == 64 else np.float32
            own: wp.array = wp.array(self._table(m.links.mass).astype(number), device=m.device)
            after = [
                own,
                self._vectors(m.links.inertia, self._types.Vec, [0.0] * 3),
                *after,
                m.arrays["inertia"].entries(),
            ]

        def record(index: wp.array, mask: wp.array, values: wp.array) -> list[Any]:
            """Record the launch that writes ``values`` into the worlds of ``index`` that are masked."""
            inputs = [self._slots, index, mask, values, *after]
            dim = (len(index), self._longest)
            return [recorded(kernel, dim, inputs, m.device)]

        return record

    def _chosen(self, worlds: torch.Tensor | None) -> tuple[wp.array, wp.array, int]:
        """Return indices, mask and number of rows for the worlds that were named."""
        count, device = self._model.num_worlds, self._device
        if worlds is None:
            return self._every, self._everyone, count
        chosen = torch.as_tensor(worlds, device=device)
        if chosen.dtype == torch.bool:
            if chosen.shape != (count,):
                raise InputError("simulator", "worlds", f"a mask of shape {tuple(chosen.shape)}", f"({count},)")
            masked: Any = wp.from_torch(chosen.contiguous(), dtype=wp.bool)
            return self._every, masked, count
        if chosen.ndim != 1 or chosen.is_floating_point():
            found = f"{chosen.dtype} of shape {tuple(chosen.shape)}"
            raise InputError("simulator", "worlds", found, "int [n], bool [worlds]")
        numbers: Any = wp.from_torch(chosen.to(torch.int32).contiguous(), dtype=wp.int32)
        return numbers, self._everyone, len(chosen)

    def _given(self, name: str, quantity: Quantity, values: Any, rows: int) -> wp.array:
        """Return values as the Warp array that the kernels take, without a copy where they are laid out so."""
        seen = wp.to_torch(values) if isinstance(values, wp.array) else values
        dtype = torch.float64 if self._model.precision == 64 else torch.float32
        tensor = torch.as_tensor(seen, dtype=dtype, device=self._device)
        shape = self._shape(quantity, rows)
        plain = shape[:2] if quantity.components == 1 else shape
        try:
            tensor = tensor.expand(plain).reshape(shape).contiguous()
        except RuntimeError:
            found, allowed = f"shape {tuple(tensor.shape)}", f"{plain}, or what broadcasts to it"
            raise InputError("simulator", name, found, allowed) from None
        array: Any = wp.from_torch(tensor, dtype=self._types.Scalar)
        return array


def _quantity(name: str) -> Quantity:
    if name not in QUANTITIES:
        raise InputError("simulator", "tensors", f"'{name}'", ", ".join(QUANTITIES))
    return QUANTITIES[name]
