"""Systems that parameters can be written into: a tree and its unknowns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import torch

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ...sim.engine.model import Model
from ...sim.trees.tree import Tree

#: Steps of replayed joints: largest phase that a spring's oscillation turns by in one [rad], of which a fit leaves
#: 4e-5 of the motion, and shortest step as a share of the sampling interval.
TURN, FINEST = 0.03, 0.1


def longest_step(dt: float) -> float:
    """Return the longest step [s] of joints sampled every ``dt`` [s]: a tenth of that, and a millisecond at least.

    What moves slower is sampled slower. Friction and hysteresis are of first order in the step: with a fifth of ``dt``
    a slow play of friction was off by 6 % of its bend.
    """
    return max(1e-3, 0.1 * dt)


@dataclass(frozen=True)
class Parameter:
    """One unknown. Inference works on a free coordinate: the logarithm of a positive one, else the value itself.

    Attributes:
        name: Such as ``stiffness child``.
        unit: SI unit.
        low, high: Box that the prior is flat in.
        typical: Where a search may begin; None takes the middle of the box.
        scale: ``log`` (positive by construction) or ``linear``.
    """

    name: str
    unit: str
    low: float
    high: float
    typical: float | None = None
    scale: Literal["log", "linear"] = "log"

    def free(self, value: float) -> float:
        """Return the free coordinate of a value."""
        return math.log(value) if self.scale == "log" else value

    @property
    def start(self) -> float:
        """Free coordinate where a search may begin."""
        return 0.5 * (self.free(self.low) + self.free(self.high)) if self.typical is None else self.free(self.typical)


class Write(Protocol):
    """Writes a component of a field into the worlds of all sets: (field, place or places, component, values)."""

    def __call__(self, field: str, place: int | list[int], component: int, values: torch.Tensor) -> None:
        """Write values [sets] at a place, [sets, places] at several."""


class System(Protocol):
    """A mechanism with unknowns.

    Attributes:
        tree: The mechanism, at nominal values.
        gravity: Acceleration of free fall [m/s^2], shape [3].
        parameters: The unknowns, in the order of the inference's vectors.
        substep: Longest step that integrates it well [s].
    """

    tree: Tree
    gravity: Array
    parameters: tuple[Parameter, ...]
    substep: float

    def write(self, values: torch.Tensor, model: Model, write: Write) -> None:
        """Write parameter values [sets, n] into the worlds."""


def box_of(parameters: Sequence[Parameter]) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the box's ends in free coordinates, float64, shapes [n]."""
    ends = torch.tensor([[p.free(p.low), p.free(p.high)] for p in parameters], dtype=torch.float64)
    return ends[:, 0], ends[:, 1]


def tails_of(parameters: Sequence[Parameter]) -> torch.Tensor:
    """Return how far the prior reaches beyond the box, in free coordinates, float64, shape [n].

    A tenth of an e-fold, or a twentieth of the box of a parameter without logarithm: a number such as an exponent
    between one and two means nothing far outside.
    """
    tails = [0.1 if p.scale == "log" else 0.05 * (p.high - p.low) for p in parameters]
    return torch.tensor(tails, dtype=torch.float64)


def least_precision(parameters: Sequence[Parameter]) -> torch.Tensor:
    """Return the precision of free coordinates that no data show, float64, shape [n].

    That of one e-fold, or of a flat box for a parameter without logarithm: no particle is drawn farther away.
    """
    least = [1.0 if p.scale == "log" else 12.0 / (p.high - p.low) ** 2 for p in parameters]
    return torch.tensor(least, dtype=torch.float64)


def values_of(parameters: Sequence[Parameter], free: torch.Tensor) -> torch.Tensor:
    """Return values in SI units from free coordinates, shapes [..., n]."""
    log = torch.tensor([p.scale == "log" for p in parameters], device=free.device)
    return torch.where(log, torch.where(log, free, 0.0).exp(), free)


def free_of(parameters: Sequence[Parameter], values: torch.Tensor) -> torch.Tensor:
    """Return free coordinates from values in SI units, shapes [..., n]."""
    log = torch.tensor([p.scale == "log" for p in parameters], device=values.device)
    return torch.where(log, torch.where(log, values, 1.0).log(), values)


#: Bounds beyond it, or below its inverse, leave single precision on the way through the simulator.
LARGEST = 1e15


def bounded(parameters: Sequence[Parameter], box: Sequence[str]) -> tuple[Parameter, ...]:
    """Return the parameters with bounds that a user gives as ``NAME=LOW:HIGH``.

    NAME is a parameter's, or the first word of the names of several (``stiffness``).

    Raises:
        InputError: An entry is no bound, has its ends swapped, names nothing, or lets a positive parameter vanish.
    """
    bounds = dict(given := [_bound(text) for text in box])
    for name in bounds:
        if [n for n, _ in given].count(name) > 1:
            raise InputError("--box", name, "bounds twice", "one pair of bounds for a name")
    known = [p.name for p in parameters] + [p.name.split(" ")[0] for p in parameters]
    for name in bounds:
        if name not in known:
            raise InputError("--box", name, "no unknown of that name", ", ".join(sorted(set(known))))
    return tuple(_within(p, bounds.get(p.name, bounds.get(p.name.split(" ")[0]))) for p in parameters)


def _bound(text: str) -> tuple[str, tuple[float, float]]:
    name, _, ends = text.partition("=")
    first, _, second = ends.partition(":")
    try:
        low, high = float(first), float(second)
    except ValueError:
        raise InputError("--box", text, "no bounds", "NAME=LOW:HIGH, such as stiffness=5:200") from None
    if not -math.inf < low < high < math.inf:
        raise InputError("--box", text, "ends that are not in order", "LOW below HIGH, both finite")
    return name.strip(), (low, high)


def _within(p: Parameter, ends: tuple[float, float] | None) -> Parameter:
    if ends is None:
        return p
    if p.scale == "log" and ends[0] <= 0.0:
        raise InputError("--box", p.name, f"a lower end of {ends[0]:g}", "above 0: it is positive")
    if max(map(abs, ends)) > LARGEST or (p.scale == "log" and ends[0] < 1.0 / LARGEST):
        found = f"{ends[0]:g} to {ends[1]:g}"
        raise InputError(
            "--box", p.name, found, f"numbers between {1.0 / LARGEST:g} and {LARGEST:g}, in single precision"
        )
    inside = p.typical is not None and ends[0] < p.typical < ends[1]
    return replace(p, low=ends[0], high=ends[1], typical=p.typical if inside else None)
