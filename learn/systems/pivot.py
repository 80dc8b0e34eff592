"""A branch on a compliant trunk: one more ball joint, below the base."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import torch

from ...sim.engine.model import Model
from ...sim.trees.stiffness import hold_rest_pose
from ...sim.trees.tree import Joint, Tree
from .acting import FIELD, TRUNK_BENDS, ActingSet
from .system import Write

#: Armature of a pivot without compliance [kg m^2]: it turns by 1e-9 rad where a branch turns by one.
LOCKED = 1e9


def on_pivot(tree: Tree, below: float, gravity: float) -> Tree:
    """Return a branch on one more link, a ball joint ``below`` its base [m] that holds the given pose.

    The link has no mass; its joint is locked until a compliance is written, and an inertia with it (`write_pivot`).
    """
    pivot = np.array([0.0, 0.0, below])
    row: dict[str, object] = {"joint": Joint.SPHERICAL, "rotation": [1.0, 0, 0, 0], "armature": LOCKED,
                              "rest": [1.0, 0, 0, 0], "axis": [0.0, 0, 1.0],
                              "position": tree.position[0] - pivot}  # fmt: skip
    changes: dict[str, object] = {"link_name": ["pivot", *tree.link_name], "parent": np.r_[-1, tree.parent + 1],
                                  "shape_link": tree.shape_link + 1, "level": np.r_[0, tree.level]}  # fmt: skip
    for item in fields(tree):
        value = getattr(tree, item.name)
        if item.name in changes or item.name.startswith("shape_") or not isinstance(value, np.ndarray):
            continue
        own = np.asarray(row.get(item.name, np.zeros(value.shape[1:])), dtype=value.dtype)
        changes[item.name] = np.concatenate([own[None], value])
    position = np.array(changes["position"])
    position[1] = pivot
    changes["position"] = position
    return hold_rest_pose(tree.with_(**changes).validate(), gravity)


def write_pivot(acting: ActingSet, columns: torch.Tensor, least: float, model: Model, write: Write) -> None:
    """Write the pivot's spring, damper and inertia or lock; ``least`` is a ball joint's least relaxation time [s].

    A trunk that is stiffer in one plane obeys the law of such a joint (`TRUNK_BENDS`).
    """
    compliance = acting.value("base_compliance", "compliance_radpNm", columns)
    relaxation = acting.value("base_compliance", "relaxation_s", columns)
    inertia = acting.value("base_compliance", "inertia_kgm2", columns)
    twist = acting.value("base_compliance", "twist", columns)
    free = compliance > 0.0
    spring = torch.where(free, 1.0 / torch.where(free, compliance, 1.0), 0.0)
    place = int(model.link_place[0])
    write("stiffness", place, 0, spring)
    write("damping", place, 0, spring * relaxation.clamp(min=least))
    write("armature", place, 0, torch.where(free, 0.0, LOCKED).to(spring.dtype))
    for c, own in enumerate((inertia, inertia, inertia * twist)):  # about the level axes and about the trunk's own
        write("inertia", place, c, torch.where(free, own, 0.0).to(spring.dtype))
    for name in ("relative", "axis_rad"):
        row = acting.place(TRUNK_BENDS, name) * (model.places + 1)
        write(FIELD, row + place, 0, acting.value("base_compliance", name, columns))
