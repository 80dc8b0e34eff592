"""The mechanism of a joint case: what is known, what drives it and what is measured."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..sim.errors import InputError
from ..sim.files import read_text
from .case_schema import InputMeta, JointMeta, JointSpecMeta, MetaFile, OutputMeta, nearest


@dataclass(frozen=True)
class GravityTorque:
    """Gravity torque ``-amplitude sin(q - zero_angle)`` of a revolute joint that hangs at ``zero_angle``.

    Attributes:
        amplitude: m g l [N m], or None = infer.
        zero_angle: Hanging angle [rad].
    """

    amplitude: float | None
    zero_angle: float


@dataclass(frozen=True)
class JointSpec:
    """One joint; None = infer.

    Attributes:
        name: Its name.
        type: ``revolute`` (rad, N m, kg m^2) or ``prismatic`` (m, N, kg).
        inertia: Inertia [kg m^2 or kg].
        stiffness: Spring [N m/rad or N/m].
        damping: Damper [N m s/rad or N s/m].
        gravity_torque: Gravity torque, or None where there is none.
    """

    name: str
    type: Literal["revolute", "prismatic"]
    inertia: float | None
    stiffness: float | None
    damping: float | None
    gravity_torque: GravityTorque | None


@dataclass(frozen=True)
class JointInput:
    """The measured generalised force; ``JointTrajectory.input`` is already scaled.

    Attributes:
        joint: Joint it acts on.
        column: Column of the CSV.
        hold: Between samples ``linear`` or constant (``zero_order``).
    """

    joint: str
    column: str
    hold: Literal["linear", "zero_order"]


@dataclass(frozen=True)
class JointOutput:
    """One measured quantity; ``JointTrajectory.output`` is already scaled.

    Attributes:
        joint: Joint it belongs to.
        quantity: ``position``, ``velocity`` or ``acceleration``.
        column: Column of the CSV.
        scale: SI units per unit of the column.
    """

    joint: str
    quantity: Literal["position", "velocity", "acceleration"]
    column: str
    scale: float


@dataclass(frozen=True)
class JointSetup:
    """Mechanism, input and outputs.

    Attributes:
        joints: Joints with their known values; empty where an MJCF file describes the mechanism.
        mjcf: That file, or None.
        input: What drives the mechanism, or None for free motion.
        outputs: What is measured, length C.
    """

    joints: tuple[JointSpec, ...]
    mjcf: Path | None
    input: JointInput | None
    outputs: tuple[JointOutput, ...]


def joint_setup(meta: JointMeta, folder: Path) -> JointSetup:
    """Turn a checked ``meta.yaml`` into the mechanism, its input and its outputs."""
    drive = meta.input
    return JointSetup(
        joints=tuple(_joint(spec) for spec in meta.mechanism.joints or ()),
        mjcf=folder / meta.mechanism.mjcf if meta.mechanism.mjcf else None,
        input=JointInput(drive.joint, drive.column, drive.hold) if drive else None,
        outputs=tuple(JointOutput(o.joint, o.quantity, o.column, float(o.scale)) for o in meta.outputs),
    )


def _joint(spec: JointSpecMeta) -> JointSpec:
    gravity = spec.gravity_torque
    torque = GravityTorque(gravity.amplitude, float(gravity.zero_angle)) if gravity else None
    return JointSpec(spec.name, spec.type, spec.inertia, spec.stiffness, spec.damping, torque)


def check_joint_meta(meta: JointMeta, file: MetaFile, folder: Path) -> None:
    """Check names, scales, rows and the split of a joint case.

    Raises:
        InputError: An input or output names an unknown joint, has a scale of zero; a joint cannot have what it states;
            the inertia is to be inferred where nothing drives the joint; ``rows`` are reversed; the split overlaps or
            names a trajectory that is not there; the MJCF file is missing or no XML.
    """
    names = _mjcf_joints(folder / meta.mechanism.mjcf) if meta.mechanism.mjcf else _names(meta)
    users: list[tuple[list[str | int], InputMeta | OutputMeta]] = [
        (["outputs", i], output) for i, output in enumerate(meta.outputs)
    ]
    if meta.input:
        users.append((["input"], meta.input))
    for here, user in users:
        if names is not None and user.joint not in names:
            raise file.error([*here, "joint"], repr(user.joint), nearest(user.joint, names))
        if user.scale == 0:
            raise file.error([*here, "scale"], "0", "a number other than zero")
    _check_mechanism(meta, file)
    for i, item in enumerate(meta.trajectories):
        if item.rows and item.rows[1] <= item.rows[0]:
            raise file.error(["trajectories", i, "rows"], f"{item.rows}", "[start, stop] with start < stop")
    _check_split(meta, file)


def _names(meta: JointMeta) -> list[str]:
    return [joint.name for joint in meta.mechanism.joints or ()]


def _check_mechanism(meta: JointMeta, file: MetaFile) -> None:
    driven = meta.input.joint if meta.input else None
    for i, joint in enumerate(meta.mechanism.joints or ()):
        here: list[str | int] = ["mechanism", "joints", i]
        if joint.name in _names(meta)[:i]:
            raise file.error([*here, "name"], f"{joint.name} a second time", "unique names")
        if joint.gravity_torque and joint.type == "prismatic":
            raise file.error([*here, "gravity_torque"], "a gravity torque on a prismatic joint", "revolute joints only")
        if joint.inertia is None and joint.name != driven:
            allowed = "a known value, or an input on this joint to infer it from"
            raise file.error([*here, "inertia"], "null on a joint that nothing drives", allowed)


def _mjcf_joints(path: Path) -> list[str] | None:
    """Names of an MJCF file's joints; None where it includes others, which the importer follows."""
    try:
        root = ElementTree.fromstring(read_text(path))
    except ElementTree.ParseError as e:
        line, column = e.position
        raise InputError(path, f"line {line}, column {column + 1}", "text that is not XML", "an MJCF file") from None
    if root.find(".//include") is not None:
        return None
    return [item.get("name", "") for item in root.iter("joint") if item.get("name")]


def _check_split(meta: JointMeta, file: MetaFile) -> None:
    split, count = meta.split, len(meta.trajectories)
    if split is None:
        return
    for part in ("train", "test"):
        for i, number in enumerate(getattr(split, part)):
            if number > count:
                raise file.error(["split", part, i], f"trajectory {number}", f"1 to {count}")
    both = sorted(set(split.train) & set(split.test))
    if both:
        raise file.error(["split"], f"trajectory {both[0]} in train and in test", "each in one of them")
