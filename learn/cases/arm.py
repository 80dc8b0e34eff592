"""Recordings of a free arm with a known mechanism: a case of joints whose ``meta.yaml`` names an arm.

    format: joint-gap-case/1
    mechanism: {arm: jaco2, weight: out}
    input:
      - {joint: shoulder, column: tau1_Nm, scale: 1.0, hold: linear}
    commands:
      - {joint: shoulder, column: dq_cmd1_rad_s, scale: 1.0}
    outputs:
      - {joint: shoulder, quantity: position, column: q1_rad, scale: 1.0}
    trajectories:
      - {file: run_1.csv, t_start_s: 0.0}

Every joint of the arm needs a position. Torques and commands are of all joints or of none, and one of the two there is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...sim.arms.arm import Arm
from ...sim.arms.registry import ARMS
from ...sim.base.errors import InputError
from ...sim.base.strict_yaml import YamlFile, nearest
from ...sim.base.types import Array
from .case import check_trajectories, joint_trajectory, meta_path
from .schema import CommandMeta, InputMeta, JointMeta, OutputMeta, read_meta


@dataclass(frozen=True)
class ArmTrajectory:
    """One recording of an arm, T rows of D joints.

    Attributes:
        file: Name of its file in the case folder.
        t: Time since its first row, uniform [s], [T].
        position: Joint positions, without jumps of whole turns [rad], [T, D].
        torque: Joint torques [N m], [T, D]; None where there are none.
        command: Commanded speeds, the mean since the row before [rad/s], [T, D]; None where there are none.
    """

    file: str
    t: Array
    position: Array
    torque: Array | None
    command: Array | None


@dataclass(frozen=True)
class ArmCase:
    """An arm that moves freely.

    Attributes:
        name: Name of the case.
        folder: Where it was loaded from.
        arm: The arm, as it is simulated.
        arm_name: Its name in `sim.arms.registry.ARMS`.
        weight_in: Whether torques hold the arm's own weight.
        dt: Sampling step [s].
        trajectories: Recordings.
    """

    name: str
    folder: Path
    arm: Arm
    arm_name: str
    weight_in: bool
    dt: float
    trajectories: tuple[ArmTrajectory, ...]

    @property
    def joints(self) -> list[str]:
        """Names of the joints, those of the links that they move, base first."""
        return self.arm.tree.link_name


def is_arm_case(folder: str | Path) -> bool:
    """Return whether a folder's ``meta.yaml`` names an arm; a faulty one does not: who loads it says what is wrong."""
    try:
        content = YamlFile(meta_path(Path(folder)), "").content
    except InputError:
        return False
    mechanism = content.get("mechanism")
    return isinstance(mechanism, dict) and "arm" in mechanism


def load_arm_case(folder: str | Path) -> ArmCase:
    """Load the recordings of an arm.

    Raises:
        InputError: ``meta.yaml`` or a CSV file breaks the format, names an unknown arm or joint, or a position is
            missing; torques or commands are of some joints only, or there are neither.
    """
    place = Path(folder)
    meta, file = read_meta(meta_path(place))
    if not isinstance(meta, JointMeta) or meta.mechanism.arm is None:
        raise file.error(["mechanism"], "no arm", "mechanism: {arm: NAME, weight: in or out}")
    check_trajectories(meta, file)
    arm = ARMS.of(meta.mechanism.arm, str(file.path), "mechanism arm")
    _check(meta, file, arm.tree.link_name)
    loaded = [_load(place, meta, i, arm) for i in range(len(meta.trajectories))]
    steps = [step for _, step in loaded]
    for item, step in zip(meta.trajectories, steps, strict=True):
        if abs(step - steps[0]) > 1e-3 * steps[0]:
            found, allowed = f"a row every {step:.6g} s", f"{steps[0]:.6g} s as in the others, by resample_hz"
            raise InputError(place / item.file, "", found, allowed)
    return ArmCase(meta.name or place.resolve().name, place, arm, meta.mechanism.arm, meta.mechanism.weight == "in",
                   steps[0], tuple(trajectory for trajectory, _ in loaded))  # fmt: skip


def _check(meta: JointMeta, file: YamlFile, joints: list[str]) -> None:
    """Check that every joint has its position, and a torque and a command where any joint has one."""
    for key, where in (("fit", meta.fit), ("filter_hz", meta.filter_hz), ("split", meta.split)):
        if where is not None:
            raise file.error([key], "this key beside an arm", "none: recordings are left out one after the other")
    if meta.input is None and meta.commands is None:
        raise file.error(["input"], "neither torques nor commands", "input, commands, or both, of every joint")
    listed: list[tuple[str, Sequence[InputMeta | CommandMeta | OutputMeta] | None]] = [
        ("input", meta.input), ("commands", meta.commands), ("outputs", meta.outputs),
    ]  # fmt: skip
    for key, items in listed:
        if items is None:
            continue
        named = [item.joint for item in items if getattr(item, "quantity", "position") == "position"]
        for i, item in enumerate(items):
            if item.joint not in joints:
                raise file.error([key, i, "joint"], repr(item.joint), nearest(item.joint, joints))
            if item.scale == 0:
                raise file.error([key, i, "scale"], "0", "a number other than zero")
        wrong = [j for j in joints if named.count(j) != 1]
        if wrong:
            what = "position" if key == "outputs" else "entry"
            raise file.error([key], f"{named.count(wrong[0])} entries of {wrong[0]}", f"one {what} of every joint")


def _load(folder: Path, meta: JointMeta, index: int, arm: Arm) -> tuple[ArmTrajectory, float]:
    """Return a recording and its step [s]; commands are read as further inputs."""
    torques, commands, joints = meta.input or [], meta.commands or [], arm.tree.link_name
    given = [InputMeta(joint=c.joint, column=c.column, scale=c.scale, hold="linear") for c in commands]
    plain = meta.model_copy(update={"input": [*torques, *given]})
    read, step = joint_trajectory(folder, plain, meta.trajectories[index])
    places = {o.joint: i for i, o in enumerate(meta.outputs) if o.quantity == "position"}
    efforts = {item.joint: i for i, item in enumerate(torques)}
    asked = {item.joint: len(torques) + i for i, item in enumerate(commands)}

    def of(where: dict[str, int], values: Array) -> Array | None:
        """Return the columns of the arm's joints in its order, [T, n], None where none were recorded."""
        return values[:, [where[name] for name in joints]] if where else None

    position = np.unwrap(read.output[:, [places[name] for name in joints]], axis=0)
    return ArmTrajectory(read.file, read.t, position, of(efforts, read.effort), of(asked, read.effort)), step
