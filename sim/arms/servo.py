"""``model.yaml`` of an arm: what its servos were found to be, for the simulator.

    format: arm-model/1
    name: free motions of 5 April
    arm: jaco2
    joints:
      - {name: shoulder, gain_Nmsprad: 80.0, friction_Nm: 4.7, damping_Nmsprad: 0.0, weight_error: 0.0, delay_s: 0.14}
      - ...

Joints stand base first, by the names of the arm's links. ``weight_error`` is the share of the arm's weight that the
servo does not carry; ``delay_s`` how late a commanded speed is obeyed. A diagnosis may add ``backlash_rad``, which the
simulator's servos do not have, and ``claimed: false``, which says that it claims none of the numbers.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..base.errors import InputError
from ..base.strict_yaml import NotNegative, Positive, Strict, YamlFile, nearest, validated
from .arm import Arm

FORMAT: Literal["arm-model/1"] = "arm-model/1"
#: Numbers of a joint that the simulator's servos have, in the order of `Servo`.
NUMBERS = ("gain_Nmsprad", "friction_Nm", "damping_Nmsprad", "weight_error", "delay_s")
#: Gain, friction, damping, weight error and delay of every joint, base first; empty for the arm's own.
Servo = tuple[tuple[float, float, float, float, float], ...]


class ServoModel(Strict):
    """The servo of one joint: gain, dry friction, damping, share of the weight not carried, delay, backlash."""

    name: str
    gain_Nmsprad: Positive  # noqa: N815
    friction_Nm: NotNegative  # noqa: N815
    damping_Nmsprad: NotNegative  # noqa: N815
    weight_error: Annotated[float, Field(ge=-1, le=1)]
    delay_s: Annotated[float, Field(ge=0, le=1)]
    backlash_rad: NotNegative = 0.0


class ArmFile(Strict):
    """The keys of an arm's ``model.yaml``."""

    format: Literal["arm-model/1"]
    name: str
    arm: str
    joints: Annotated[list[ServoModel], Field(min_length=1)]
    claimed: bool = True

    @property
    def servo(self) -> Servo:
        """What the simulator takes of it."""
        return tuple((j.gain_Nmsprad, j.friction_Nm, j.damping_Nmsprad, j.weight_error, j.delay_s) for j in self.joints)

    @property
    def backlash(self) -> list[str]:
        """Joints with backlash, which the simulator's servos do not have."""
        return [j.name for j in self.joints if j.backlash_rad > 0.0]


def read_arm_file(path: str | Path, arm: Arm, called: str) -> ArmFile:
    """Read the ``model.yaml`` of an arm.

    Args:
        path: The file.
        arm: The arm that is to have these servos.
        called: Its name in the registry of arms.

    Raises:
        InputError: The file is missing or no YAML, has unknown or missing keys or values that cannot be, or is of
            another arm.
    """
    file = YamlFile(Path(path), FORMAT)
    found = file.content.get("format")
    if isinstance(found, str) and found != FORMAT:
        raise file.error(["format"], found, f"{FORMAT}, the model of an arm")
    meta = validated(file, ArmFile)
    if meta.arm != called:
        raise file.error(["arm"], meta.arm, f"{called}, the arm that is simulated")
    names = arm.tree.link_name
    for i, joint in enumerate(meta.joints):
        if joint.name != (names[i] if i < len(names) else None):
            raise file.error(["joints", i, "name"], joint.name, nearest(joint.name, names) + ", base first")
    if len(meta.joints) != len(names):
        raise file.error(["joints"], f"{len(meta.joints)} joints", f"{len(names)}: {', '.join(names)}")
    return meta


def with_servo(arm: Arm, servo: Servo) -> Arm:
    """Return an arm with other servos; one without rows is the arm itself.

    Raises:
        InputError: There is not one row for each joint.
    """
    if not servo:
        return arm
    if len(servo) != arm.num_dofs:
        raise InputError(arm.name, "servo", f"{len(servo)} rows", f"{arm.num_dofs}, one for each joint")
    gain, friction, damping, weight_error, delay = np.array(servo).T
    tree = arm.tree.with_(damping=damping)
    return replace(arm, tree=tree, gain=gain, friction=friction, weight_error=weight_error, delay=delay)
