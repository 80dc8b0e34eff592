"""A branch on a compliant trunk: three slides and one more ball joint, below the base."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
import torch

from ...sim.engine.model import Model
from ...sim.trees.stiffness import hold_rest_pose
from ...sim.trees.tree import Joint, Tree
from .acting import FIELD, TRUNK_BENDS, ActingSet
from .system import Write

#: Armature of a pivot or slide without compliance [kg m^2 or kg]: it moves by 1e-9 where a branch moves by one.
LOCKED = 1e9
#: Links below a branch on a pivot: a slide along each level axis and the vertical, and the pivot.
BELOW = ("slide x", "slide y", "slide z", "pivot")
SLIDES = len(BELOW) - 1


def on_pivot(tree: Tree, below: float, gravity: float) -> Tree:
    """Return a branch on slides along x, y and z and a ball joint ``below`` its base [m] that hold the given pose.

    These links have no mass; their joints are locked until a compliance is written, and an inertia with the pivot's
    (`write_pivot`).
    """
    n, pivot = len(BELOW), np.array([0.0, 0.0, below])
    rows: dict[str, object] = {"joint": [Joint.PRISMATIC] * SLIDES + [Joint.SPHERICAL], "rotation": [1.0, 0, 0, 0],
                               "armature": LOCKED, "rest": [[0.0, 0, 0, 0]] * SLIDES + [[1.0, 0, 0, 0]],
                               "axis": [*np.eye(SLIDES), [0.0, 0, 1.0]]}  # fmt: skip
    changes: dict[str, object] = {"link_name": [*BELOW, *tree.link_name],
                                  "parent": np.r_[np.arange(n) - 1, tree.parent + n],
                                  "shape_link": tree.shape_link + n}  # fmt: skip
    for item in fields(tree):
        value = getattr(tree, item.name)
        if item.name in changes or item.name.startswith("shape_") or not isinstance(value, np.ndarray):
            continue
        own = np.asarray(rows.get(item.name, 0), dtype=value.dtype)
        changes[item.name] = np.concatenate([np.broadcast_to(own, (n, *value.shape[1:])), value])
    position = np.array(changes["position"])
    position[0], position[n] = tree.position[0] - pivot, pivot
    changes["position"] = position
    return hold_rest_pose(tree.with_(**changes).validate(), gravity)


def write_pivot(acting: ActingSet, columns: torch.Tensor, least: float, model: Model, write: Write) -> None:
    """Write springs, dampers and inertia or locks of pivot and slides; ``least`` is their least relaxation time [s].

    A trunk that is stiffer in one plane obeys the law of such a joint (`TRUNK_BENDS`).
    """
    given = {
        p.name: acting.value("base_compliance", p.name, columns) for p in acting.laws["base_compliance"].parameters
    }
    places = [int(model.link_place[i]) for i in range(len(BELOW))]
    free = write_spring(given["compliance_radpNm"], given["relaxation_s"].clamp(min=least), places[-1:], write)
    write_spring(given["slide_mpN"], given["slide_relaxation_s"].clamp(min=least), places[:-1], write)
    inertia = given["inertia_kgm2"]
    for c, own in enumerate((inertia, inertia, inertia * given["twist"])):  # about level axes and the trunk's own
        write("inertia", places[-1], c, torch.where(free, own, 0.0).to(own.dtype))
    for name in ("relative", "axis_rad"):
        row = acting.place(TRUNK_BENDS, name) * (model.places + 1)
        write(FIELD, row + places[-1], 0, given[name])


def write_spring(
    compliance: torch.Tensor, relaxation: torch.Tensor, places: Sequence[int], write: Write
) -> torch.Tensor:
    """Write spring and damper of joints, of a compliance [sets], and lock those without; return which are free."""
    free = compliance > 0.0
    spring = torch.where(free, 1.0 / torch.where(free, compliance, 1.0), 0.0)
    for place in places:
        write("stiffness", place, 0, spring)
        write("damping", place, 0, spring * relaxation)
        write("armature", place, 0, torch.where(free, 0.0, LOCKED).to(spring.dtype))
    return free
