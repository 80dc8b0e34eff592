"""Which plant a case describes."""

from __future__ import annotations

from ..sim.errors import InputError
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
    plant.parameters = bounded(plant.parameters, own.box)
    return plant
