"""Which system a case describes."""

from __future__ import annotations

from ...sim.base.errors import InputError
from ..cases.case import BranchCase, JointCase
from .acting import ActingSet, joint_settings
from .branch import BranchSystem, Unknowns
from .joints import JointSystem
from .mechanism import MechanismSystem
from .system import bounded


def system_of(
    case: BranchCase | JointCase, unknowns: Unknowns | None = None
) -> BranchSystem | JointSystem | MechanismSystem:
    """Return the system that a case describes.

    Raises:
        InputError: ``unknowns`` does not fit: what is unknown of joints is for their ``meta.yaml`` to say.
    """
    if isinstance(case, BranchCase):
        return BranchSystem(case, unknowns)
    system: JointSystem | MechanismSystem = JointSystem(case) if case.mjcf is None else MechanismSystem(case)
    own = unknowns or Unknowns()
    if (own.joints, own.infer, own.shared) != (Unknowns.joints, Unknowns.infer, Unknowns.shared):
        found = "--joints, --infer or --shared with a case of joints"
        raise InputError(case.folder / "meta.yaml", "format", found, "null or mechanism.unknown in meta.yaml")
    settings = joint_settings(case, [system.carried[j.name] for j in system.joints]) if own.effects else []
    system.acting = ActingSet(own.effects, "joint", settings, case.name)
    system.parameters = bounded([*system.parameters, *system.acting.parameters], own.box)
    return system
