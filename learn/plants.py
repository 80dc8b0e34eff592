"""Which plant a case describes."""

from __future__ import annotations

from ..sim.errors import InputError
from .acting import ActingSet, joint_settings
from .case import BranchCase, JointCase
from .plant import bounded
from .plant_branch import BranchPlant, Unknowns
from .plant_joints import JointPlant
from .plant_mechanism import MechanismPlant


def plant_of(
    case: BranchCase | JointCase, unknowns: Unknowns | None = None
) -> BranchPlant | JointPlant | MechanismPlant:
    """Return the plant that a case describes.

    Raises:
        InputError: ``unknowns`` does not fit: what is unknown of joints is for their ``meta.yaml`` to say.
    """
    if isinstance(case, BranchCase):
        return BranchPlant(case, unknowns)
    plant: JointPlant | MechanismPlant = JointPlant(case) if case.mjcf is None else MechanismPlant(case)
    own = unknowns or Unknowns()
    if (own.joints, own.infer, own.shared) != (Unknowns.joints, Unknowns.infer, Unknowns.shared):
        found = "--joints, --infer or --shared with a case of joints"
        raise InputError(case.folder / "meta.yaml", "format", found, "null or mechanism.unknown in meta.yaml")
    carried = [float(plant.tree.inertia[j.link].trace() / 3 if j.type == "revolute" else plant.tree.mass[j.link])
               for j in plant.joints]  # fmt: skip
    settings = joint_settings(case, carried) if own.effects else []
    plant.acting = ActingSet(own.effects, "joint", settings, case.name)
    plant.parameters = bounded([*plant.parameters, *plant.acting.parameters], own.box)
    return plant
