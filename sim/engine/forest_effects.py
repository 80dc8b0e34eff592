"""Effects of a forest: terms of the simulator's step, with values of its own in every world."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import warp as wp

from ...kernels.effects.step import FLAGS, KINDS, term_kernels, term_types
from ...kernels.effects.structs import PARAMETERS
from ...kernels.effects.terms import Term, memory_row
from ...kernels.tree.reset import reset_kernels
from ..base.errors import InputError
from ..base.types import Array, IntArray
from ..effects import Effect, EffectParameter, Law, effect_of, effects
from ..trees.outline import outlines
from ..trees.tree import Joint
from . import arrays

if TYPE_CHECKING:
    from .launcher import Launcher
    from .model import Model
    from .state import State

#: `kernels.tree.momentum` FLOATING: a tree on three slides and a ball that nothing holds.
_FLOATING, _FLOATING_LINKS = 2, 4


@dataclass(frozen=True)
class Row:
    """One parameter of one effect in a forest.

    Attributes:
        slot: Which of the terms it belongs to.
        number: Which of the term's parameters it is.
        kind: Of the term, one of `kernels.effects.step.KINDS`.
        spec: What it is.
        per_link: Whether every link (its joint, or its end) has a value of its own.
        at_hinges: Its value at joints that are no ball joints, where it is not the user's to say.
    """

    slot: int
    number: int
    kind: str
    spec: EffectParameter
    per_link: bool
    at_hinges: float | None


def forest_laws() -> dict[str, Law]:
    """Return the laws of all effects that a forest can have, by name, in the order in which they act."""
    laws = {e.name: e.branch or e.joint for e in effects()}
    return {name: law for name, law in laws.items() if law is not None and law.kind in KINDS}


def forest_terms(names: Sequence[str], source: str = "simulator") -> tuple[tuple[Term, ...], tuple[Row, ...]]:
    """Return the kernel terms of some effects and their parameters, without those of what was read off recordings.

    Raises:
        InputError: A name is unknown, given twice, or of an effect that makes sense in a measured case only.
    """
    laws = forest_laws()
    for n, name in enumerate(names):
        if name not in laws:
            known = any(e.name == name for e in effects())
            found = f"'{name}'" + (", an effect of measured cases" if known else "")
            raise InputError(source, "effects", found, f"one of {', '.join(laws)}")
        if name in names[:n]:
            raise InputError(source, "effects", f"'{name}' a second time", "each effect once")
    chosen = [e for e in effects() if e.name in names]
    terms = tuple(
        Term(e.name, law.kind, law.law, slot, law.per_joint or law.kind == "tip_mass", law.memory)
        for slot, (e, law) in enumerate((e, laws[e.name]) for e in chosen)
    )
    rows = [
        Row(term.slot, n, term.kind, spec, term.per_joint, _at_hinges(e, spec) if term.per_joint else None)
        for e, term in zip(chosen, terms, strict=True)
        for n, spec in enumerate(laws[e.name].parameters)
        if not spec.read_off
    ]
    return terms, tuple(rows)


def _at_hinges(effect: Effect, spec: EffectParameter) -> float | None:
    """Return what a law that bends a ball joint about an ``axis_rad`` gets at other joints: see `ForestEffects`."""
    if _for_balls_alone(effect):
        return spec.neutral
    hinge = effect.joint is None or spec.name in (p.name for p in effect.joint.parameters)
    return None if hinge or not _has_axis(effect) else 0.0


def _has_axis(effect: Effect) -> bool:
    return effect.branch is not None and "axis_rad" in (p.name for p in effect.branch.parameters)


def _for_balls_alone(effect: Effect) -> bool:
    return _has_axis(effect) and effect.joint is None


class ForestEffects(Mapping[str, Mapping[str, torch.Tensor]]):
    """The effects of a simulator: ``effects[name][parameter]`` is a torch tensor on the device, to be written in place.

    Laws at joints have a value a world and link (the link that the joint moves), shape [worlds, links], and so has
    `tip_mass` (a mass at the end of the link); others one a world, shape [worlds]. A world with fewer links than
    the largest does not read the last columns. All start at the neutral value, at which an effect is off. What is
    written acts from the next `Simulator.step` on.

    A law that bends a joint about an ``axis_rad`` across its link acts at a hinge or slide as its form for measured
    joints does, about the hinge's own axis, and not at all where it has none. At the joints of a free root (three
    slides and a ball that nothing holds) no law acts.
    """

    def __init__(self, model: Model, launcher: Launcher, names: Sequence[str] = ()) -> None:
        """Allocate values and memories; nothing for no names.

        Raises:
            InputError: What `forest_terms` refuses; a force on links none of which has a capsule; a mass at the tips
                of a tree that nothing holds; a law for ball joints on trees without.
        """
        self.model, self._launcher = model, launcher
        self.terms, self._rows = forest_terms(names)
        self._values: dict[str, Mapping[str, torch.Tensor]] = {}
        self._memories: list[tuple[arrays.LaneArray, arrays.LaneArray]] = []
        if self.terms:
            self._check_trees()
            self._allocate()
            self._fill_outlines()

    def __getitem__(self, name: str) -> Mapping[str, torch.Tensor]:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def _has(self, kind: str) -> bool:
        return any(term.kind == kind for term in self.terms)

    def _check_trees(self) -> None:
        """Refuse trees that a chosen effect cannot act on."""
        blown = [t.name for t in self.terms if t.kind == "link"]
        if blown and not any(len(t.shape_link) for t in self.model.trees):
            raise InputError("simulator", "effects", f"'{blown[0]}', but no link has a capsule", "trees with shapes")
        bent = [t.name for t in self.terms if _for_balls_alone(effect_of(t.name))]
        if bent and not (self.model.links.kind == Joint.SPHERICAL).any():
            raise InputError("simulator", "effects", f"'{bent[0]}', but no ball joint", "trees with ball joints")
        if self._has("tip_mass") and self.model.has_free_trees:
            found = "'tip_mass' on a tree that nothing holds"
            raise InputError("simulator", "effects", found, "trees with a spring, damper or armature at the root")

    # ---- memory --------------------------------------------------------------------------------------------------

    def _allocate(self) -> None:
        """Make the kernels' struct: what is known of the links, the lanes' parameters, memories, working memory."""
        m, stride = self.model, self.model.places + 1
        kinds = {"area": "Real", "crown": "Real", "centre": "Vec", "end": "Vec", "pose": "Quat", "offset": "Vec"}
        self._fields = {name: m.field(kind) for name, kind in kinds.items()}
        self._fields["parameter"] = m.field("Real", places=len(self.terms) * PARAMETERS * stride)
        self._fields["memory"] = m.field("Vec", places=max(1, memory_row(self.terms, len(self.terms)) * stride))
        self._fields |= {name: self._launcher.field("Vec") for name in ("hold", "effort", "wind", "swirl")}
        self._fields["course"] = m.field("Vec", places=1)  # zero: a forest's gusts have a frequency
        types = term_types(m.width, m.precision)
        self.kernel = types.Terms()
        for name, field in self._fields.items():
            setattr(self.kernel, name, field.kernel)
        self.kernel.entry, self.kernel.stride = self._fields["parameter"].entries(), stride
        self.kernel.active = wp.zeros((m.groups, len(self.terms) + len(FLAGS)), dtype=int, device=m.device)
        self._effective = m.field("Real")
        memory = self._fields["memory"]
        self._memories.append((memory, m.field("Vec", places=memory.kernel.shape[1])))
        self._allocate_values(types.Scalar)
        self._allocate_clock()

    def _allocate_values(self, scalar: Any) -> None:
        """Lay out the tensors: a row a parameter, a column a world and link (a GPU's neighbours are worlds)."""
        m, longest = self.model, max(t.num_links for t in self.model.trees)
        self._table = wp.zeros((len(self._rows), m.num_worlds * longest), dtype=scalar, device=m.device)
        self.kernel.value, self.kernel.source = self._table, self._sources(longest)
        rows, device = self._rows, m.device
        for name, numbers in {
            "term": [r.slot for r in rows],
            "kind": [FLAGS.index("crown" if r.spec.name == "crown" else r.kind) for r in rows],
            "target": [r.slot * PARAMETERS + r.number for r in rows],
            "own": [int(r.per_link) for r in rows],
            "balls": [int(r.at_hinges is not None) for r in rows],
        }.items():
            setattr(self.kernel, name, wp.array(numbers, dtype=int, device=device))
        self.kernel.neutral = wp.array([r.spec.neutral for r in rows], dtype=wp.float64, device=device)
        self.kernel.elsewhere = wp.array([r.at_hinges or 0.0 for r in rows], dtype=wp.float64, device=device)
        for row, values in zip(rows, wp.to_torch(self._table), strict=True):
            values.fill_(row.spec.neutral)
        self._values = {t.name: MappingProxyType(self._tensors(t, longest)) for t in self.terms}

    def _tensors(self, term: Term, longest: int) -> dict[str, torch.Tensor]:
        """Return the views [worlds, links] or [worlds] of a term's parameters by name."""
        worlds, out = self.model.num_worlds, {}
        for row, values in zip(self._rows, wp.to_torch(self._table), strict=True):
            if row.slot == term.slot and not row.per_link:
                out[row.spec.name] = values[:worlds]
            elif row.slot == term.slot and arrays.link_major(self.model.device):
                out[row.spec.name] = values.view(longest, worlds).T
            elif row.slot == term.slot:
                out[row.spec.name] = values.view(worlds, longest)
        return out

    def _sources(self, longest: int) -> wp.array:
        """Return the column of every lane's number at every place: of its world at place 0; -1 where there is none."""
        m = self.model
        world, link = m.links.world, np.arange(len(m.link_slot)) - m.first_link[m.links.world]
        by_link = arrays.link_major(m.device)
        column = link * m.num_worlds + world if by_link else world * longest + link
        out = np.full((m.groups * m.width, m.places + 1), -1, np.int64)
        out[m.link_slot, m.link_place] = np.where(self._in_floating_root(), -1, column)
        out[m.world_slot, 0] = np.arange(m.num_worlds)
        lanes = out.reshape(m.groups, m.width, -1).transpose(0, 2, 1)
        host = np.ascontiguousarray(lanes.transpose(1, 0, 2) if by_link else lanes, np.int32)
        array: wp.array = wp.array(host, dtype=int, device=m.device)
        return array.transpose((1, 0, 2)) if by_link else array

    def _in_floating_root(self) -> IntArray:
        """Return whether each link is one of the four that make a free root, shape [N]."""
        m = self.model
        floating = m.freedom[m.link_slot // m.width] == _FLOATING
        return floating & (m.link_place <= _FLOATING_LINKS)

    def _allocate_clock(self) -> None:
        """Give every slot a clock in float64, and every group the lanes that its steps begin at."""
        m = self.model
        clock, start = (
            arrays.LaneArray("Real", m.groups * m.width, 1, precision=64, device=m.device) for _ in range(2)
        )
        self._fields["begin"], self._clock = m.field("Real", places=1), clock
        self.kernel.clock = wp.from_torch(clock.torch.view(-1), dtype=wp.float64)
        self.kernel.begin, self.kernel.begin_entry = self._fields["begin"].column(), self._fields["begin"].entries()
        self._memories.append((clock, start))
        self._slot = torch.as_tensor(m.world_slot, device=clock.torch.device)

    def _fill_outlines(self) -> None:
        """Give every link its area, the area's centre, its end, in link frames, and its share of the crown."""
        m, found = self.model, outlines(self.model.trees)
        every = np.arange(len(found.area))
        self._assign("area", found.area)
        self._assign("centre", m.links.in_link_frame(every, found.centre))
        self._assign("end", m.links.in_link_frame(every, found.end))
        self._assign("crown", found.crown)
        leaf: IntArray = np.asarray(m.scatter(found.crown, [0.0]) > 0.0, dtype=np.int32)
        self.kernel.leaf = wp.array(leaf.reshape(m.groups, m.width, -1).max(1), dtype=int, device=m.device)

    def _assign(self, name: str, values: Array) -> None:
        field = self._fields[name]
        field.assign(self.model.scatter(values, [0.0] * field.components))

    @property
    def nbytes(self) -> int:
        """Bytes of values, memories and what else effects need on the device."""
        if not self.terms:
            return 0
        fields = [*self._fields.values(), self._effective, self._clock, *(start for _, start in self._memories)]
        return sum(f.nbytes for f in fields) + 4 * self.kernel.source.size + 8 * self._table.size

    # ---- what the simulator asks for -----------------------------------------------------------------------------

    @property
    def memory(self) -> arrays.LaneArray:
        """What laws remember: rows of a vector for every link."""
        return self._fields["memory"]

    @property
    def clock(self) -> arrays.LaneArray:
        """Time of every slot since its start [s], float64."""
        return self._clock

    @property
    def time(self) -> torch.Tensor:
        """Time of every world since its start [s], a copy, float64, shape [worlds]."""
        return self._clock.torch[:, 0, 0, 0][self._slot]

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return values, memories and clocks by name, as views: copying back what was copied undoes all between."""
        if not self.terms:
            return {}
        carried = {f"memory {n}": field.torch for n, (field, _) in enumerate(self._memories)}
        return carried | {"values": wp.to_torch(self._table)}

    def step_kernel(self) -> Any:
        """Return the step with these terms."""
        m = self.model
        return term_kernels(m.width, m.precision, self.terms, m.has_free_trees).step

    def prepare_rest(self, rest: State) -> Callable[[], None]:
        """Return what notes the springs' rest pose after the model's geometry has changed."""
        if not self._has("tip_mass"):
            return lambda: None
        m = self.model
        kernel = term_kernels(m.width, m.precision, self.terms, m.has_free_trees).rest
        return self._launcher.prepare(kernel, [m.kernel, rest.kernel, self.kernel], [])

    def bind(self, base: arrays.LaneArray) -> arrays.LaneArray:
        """Take over the joints' own dampers; return those that a step shall use."""
        if not self.terms:
            return base
        self.kernel.damping = base.kernel
        return self._effective if self._has("joint") else base

    def mark_start(self) -> None:
        """Take memories and clocks as those that `reset` returns to."""
        for field, start in self._memories:
            start.torch.copy_(field.torch)

    def reset(self, chosen: Any, slot_world: wp.array) -> None:
        """Put memories, damage and clocks of the chosen worlds back to their start."""
        for field, start in self._memories:
            kernels = reset_kernels(64 if field is self._clock else self.model.precision)
            inputs = [chosen, slot_world, start.entries(), field.entries()]
            wp.launch(kernels.restore, dim=field.kernel.shape, inputs=inputs, device=self.model.device)

    def fill(self, name: str, parameter: str, value: float) -> None:
        """Write one value to all worlds and joints; `tip_mass` to the tips, the links that carry no other."""
        tensor = self[name][parameter]
        if self._kind(name) != "tip_mass":
            tensor.fill_(value)
            return
        for world, tree in enumerate(self.model.trees):
            tips = np.setdiff1d(np.arange(tree.num_links), tree.parent)
            tensor[world, torch.as_tensor(tips, device=tensor.device)] = value

    def _kind(self, name: str) -> str:
        return next(term.kind for term in self.terms if term.name == name)
