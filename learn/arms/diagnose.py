"""The diagnosis of an arm: all channels searched, one verdict, and the servos of its ``model.yaml``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from ...sim.arms.servo import FORMAT, ArmFile, ServoModel
from ...sim.base.errors import InputError
from ..cases.arm import ArmCase
from .channels import LEAST_BLOCK, LEAST_BLOCKS, Kind, Rows, rows_of
from .effects import NAMES, PARAMETERS
from .search import Channel, Named, Search

#: Names that an arm's diagnosis knows.
KNOWN = tuple(PARAMETERS)


@dataclass(frozen=True)
class ArmDiagnosis:
    """What came out.

    Attributes:
        case: The recordings.
        rows: Their rows.
        verdict: ``effects`` where a channel has a claimed name, ``unknown`` where something is left that no name
            explains or the recordings are too short, else ``none``.
        channels: Torques and speeds of all joints; empty where the recordings are too short.
        unusable: Why there is no verdict, empty where there is one.
    """

    case: ArmCase
    rows: Rows
    verdict: Literal["none", "effects", "unknown"]
    channels: tuple[Channel, ...]
    unusable: str = ""

    @property
    def claimed(self) -> list[tuple[Channel, Named]]:
        """Effects that are claimed, with their channels."""
        return [(c, n) for c in self.channels if c.claimed for n in c.named]

    def named(self, joint: int, kind: Kind, name: str) -> Named | None:
        """Return a claimed effect of a joint, None where it has not that one."""
        found = (n for c, n in self.claimed if (c.joint, c.kind, n.name) == (joint, kind, name))
        return next(found, None)

    def model(self) -> ArmFile:
        """Return the servos as the simulator takes them: claimed effects, else the arm's own numbers."""
        joints = [self._servo(j, name) for j, name in enumerate(self.case.joints)]
        return ArmFile(format=FORMAT, name=self.case.name, arm=self.case.arm_name, joints=joints)

    def _servo(self, joint: int, name: str) -> ServoModel:
        arm = self.case.arm

        def value(kind: Kind, effect: str) -> float:
            """Return the value of the joint's effect as one channel has it, 0 where it is not claimed."""
            found = self.named(joint, kind, effect)
            return 0.0 if found is None else found.value

        def surest(effect: str) -> float:
            """Return what the channel says that knows it best: a torque's noise may hide what a speed shows."""
            both = [n for c, n in self.claimed if (c.joint, n.name) == (joint, effect)]
            return min(both, key=lambda n: n.high - n.low).value if both else 0.0

        rubbing, error = surest("dry_friction"), surest("gravity_comp_error")
        damping = next((c.damping for c in self.channels if (c.joint, c.kind) == (joint, "torque")), (0.0, 0.0, 0.0))
        return ServoModel(
            name=name,
            gain_Nmsprad=value("speed", "servo_gain") or float(arm.gain[joint]),
            friction_Nm=rubbing or float(arm.friction[joint]),
            damping_Nmsprad=damping[0] if damping[1] > 0.0 else float(arm.tree.damping[joint]),
            weight_error=min(1.0, max(-1.0, error)),
            delay_s=value("speed", "time_delay"),
            backlash_rad=value("speed", "backlash"),
        )


def check_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the effects that may be named, all if none are given.

    Raises:
        InputError: The diagnosis of an arm does not know one of them.
    """
    for name in names:
        if name not in KNOWN:
            raise InputError("diagnose", "--effects", name, f"of an arm: {', '.join(KNOWN)}")
    return names or KNOWN


def diagnose_arm(
    case: ArmCase, *, effects: tuple[str, ...] = (), tolerance: float = 0.0055, most: int = 3,
    progress: Callable[[int], None] = lambda done: None,
) -> ArmDiagnosis:  # fmt: skip
    """Search all channels of an arm.

    Args:
        case: The recordings.
        effects: Names that may be taken up; all if none are given.
        tolerance: Share of a channel's rms below which an effect is of no interest.
        most: Effects that a channel is given at most.
        progress: Told of every channel that is done.

    Raises:
        InputError: An effect is not known.
    """
    allowed, rows = check_names(effects), rows_of(case)
    if not len(rows.start) or rows.blocks < LEAST_BLOCKS:
        count = rows.blocks if len(rows.start) else 0
        need = f"{LEAST_BLOCKS}, of {LEAST_BLOCK:g} s each"
        return ArmDiagnosis(case, rows, "unknown", (), f"{count} stretches of motion, where a verdict needs {need}")
    first = case.trajectories[0]
    there: list[tuple[Kind, object]] = [("torque", first.torque), ("speed", first.command)]
    kinds = [kind for kind, values in there if values is not None]
    joints = range(case.arm.num_dofs)
    tried = len(joints) * sum(len([n for n in NAMES[k] if n in allowed]) for k in kinds)
    channels = []
    for kind in kinds:
        for joint in joints:
            channels.append(Search(case, rows, kind, joint, max(1, tried), tolerance, allowed, most).run())
            progress(1)
    return ArmDiagnosis(case, rows, _verdict(channels), tuple(channels))


def _verdict(channels: list[Channel]) -> Literal["none", "effects", "unknown"]:
    if any(c.named and c.claimed for c in channels):
        return "effects"
    return "unknown" if any(c.unnamed > 0.0 or c.named for c in channels) else "none"
