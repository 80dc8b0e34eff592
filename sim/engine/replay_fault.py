"""A frozen world stepped again from its first kept state, to see how its fault arose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from .last_states import Fault
from .model import Model
from .simulator import Simulator

#: What a step computes, in its order, and what it is called; the middle ones go from the tips inward.
_OUTWARD = {
    "pose": "pose", "relative": "joint velocity", "spin": "angular velocity",
    "alpha0": "velocity product of the angular acceleration", "accel0": "velocity product of the acceleration",
}  # fmt: skip
_INWARD = {
    "A": "articulated inertia", "B": "articulated first moment", "M": "articulated mass", "n": "moment that is carried",
    "f": "force that is carried", "D": "inverse of the inertia at the joint", "U": "response to the parent's motion",
    "u": "acceleration that the joint's own torque gives",
}  # fmt: skip
_LAST = {"alpha": "angular acceleration", "accel": "acceleration of the joint point"}


@dataclass(frozen=True)
class Moment:
    """A world before one step.

    Attributes:
        time: Since the start [s].
        link: Link whose joint is the fastest.
        speed: Of that joint [rad/s or m/s].
        energy: Kinetic and all [J].
        astray: Greatest difference of what the step before came to from the state that was kept, 0 for the same bits.
    """

    time: float
    link: str
    speed: float
    energy: tuple[float, float]
    astray: float


@dataclass(frozen=True)
class Replay:
    """How a fault arose.

    Attributes:
        moments: The world before every step.
        tick: Substeps until the fault, None where the replay came to none.
        link: Link whose joint was lost.
        quantity: What is no longer finite first, empty where the joint was only too fast.
        place: Link of that quantity.
        max_speed: Speed that a joint may have [rad/s or m/s].
    """

    moments: list[Moment]
    tick: int | None
    link: str
    quantity: str
    place: str
    max_speed: float


def replay(fault: Fault) -> Replay:
    """Step a world again from its first kept state until it is frozen.

    Every step begins at the state that was kept: what came from outside between two steps (a load, new velocities)
    shows as a difference and is taken over. Memories of effects begin empty.
    """
    sim = _simulator(fault)
    moments = []
    for k in range(len(fault.tick)):
        moments.append(_moment(sim, fault, k))
        sim.step()
        found = sim.state.faults()
        if found:
            _, link, tick = found[0]
            quantity, place = _first_lost(sim)
            # the replay's clock begins at the first state
            return Replay(moments, int(fault.tick[0]) + tick, link, quantity, place, sim.max_speed)
    return Replay(moments, None, "", "", "", sim.max_speed)


def _simulator(fault: Fault) -> Simulator:
    a = fault.arrays
    effects = sorted({key.split(" ")[1] for key in a if key.startswith("effect ")})
    model = Model(fault.tree, gravity=a["gravity"], device="cpu", precision=int(a["precision"]), width=1)
    sim = Simulator(
        model, dt=float(a["dt"]), substeps=int(a["substeps"]), threads=1, max_speed=float(a["max_speed"]),
        effects=effects,
    )  # fmt: skip
    for name, effect in sim.effects.items():
        for parameter, values in effect.items():
            given = torch.as_tensor(a[f"effect {name} {parameter}"])
            values[0] = given[: values.shape[1]] if values.dim() == 2 else given
    for name, array in model.arrays.items():
        _put(model, array, a[f"array {name}"])
    _put(model, sim._damping, a["damping in effect"])
    _put(model, sim._limit, a["limit"])
    return sim


def _put(model: Model, array: Any, values: Any) -> None:
    array.torch[0, 0, torch.as_tensor(model.link_place)] = torch.as_tensor(values, dtype=array.torch.dtype)


def _moment(sim: Simulator, fault: Fault, k: int) -> Moment:
    """Look at the kept state k, and at how far the step before it came from there."""
    place, fields = sim.model.link_place, (sim.state.coordinate, sim.state.velocity)
    kept = (fault.coordinate[k], fault.velocity[k])
    apart = 0.0
    if k:
        apart = max(float(np.abs(f.torch[0, 0].numpy()[place] - w).max()) for f, w in zip(fields, kept, strict=True))
    for field, values in zip(fields, kept, strict=True):
        _put(sim.model, field, values)
    speed = np.linalg.norm(fault.velocity[k], axis=1)
    fastest = int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
    energy = sim.energy()[0][0]
    time = int(fault.tick[k]) * sim.dt / sim.substeps
    name = fault.tree.link_name[fastest]
    return Moment(time, name, float(speed[fastest]), (float(energy[0]), float(energy.sum())), apart)


def _first_lost(sim: Simulator) -> tuple[str, str]:
    """Return what the last step computed first that is not finite, and of which link."""
    m, fields = sim.model, sim._launcher._fields
    places = range(1, m.places + 1)
    for names, order in ((_OUTWARD, places), (_INWARD, reversed(places)), (_LAST, places)):
        for place in order:
            for name, words in names.items():
                if not bool(torch.isfinite(fields[name].torch[0, 0, place]).all()):
                    return words, m.link_name(0, place)
    return "", ""
