"""The mechanism of a joint case: what is known, what drives it and what is measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.strict_yaml import YamlFile, nearest
from ...sim.formats.import_mjcf import MEASURED, load_mjcf
from ...sim.trees.tree import Joint
from .schema import InputMeta, JointMeta, JointSpecMeta, OutputMeta


@dataclass(frozen=True)
class GravityTorque:
    """Gravity torque ``-amplitude sin(q - zero_angle)`` of a revolute joint that hangs at ``zero_angle``.

    Attributes:
        amplitude: m g l [N m], or None = infer.
        zero_angle: Hanging angle [rad], as the encoder reads it, or None = infer.
    """

    amplitude: float | None
    zero_angle: float | None


@dataclass(frozen=True)
class JointAxis:
    """One joint of a mechanism.

    Attributes:
        name: Its name.
        type: ``revolute`` (rad, N m, kg m^2) or ``prismatic`` (m, N, kg).
        link: Index of the link that it moves, in the system's tree.
    """

    name: str
    type: Literal["revolute", "prismatic"]
    link: int


@dataclass(frozen=True)
class JointSpec(JointAxis):
    """One joint on a fixed frame; None = infer.

    Attributes:
        inertia: Inertia [kg m^2 or kg].
        stiffness: Spring [N m/rad or N/m].
        damping: Damper [N m s/rad or N s/m].
        gravity_torque: Gravity torque, or None where there is none.
    """

    inertia: float | None
    stiffness: float | None
    damping: float | None
    gravity_torque: GravityTorque | None


@dataclass(frozen=True)
class JointInput:
    """One measured generalised force; ``JointTrajectory.effort`` is already scaled.

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
        quantity: ``position``, ``velocity`` or ``acceleration``; ``effort`` for a channel of a torque fit.
        column: Column of the CSV.
        scale: SI units per unit of the column.
    """

    joint: str
    quantity: Literal["position", "velocity", "acceleration", "effort"]
    column: str
    scale: float


@dataclass(frozen=True)
class JointSetup:
    """Mechanism, inputs, outputs and how the model is held against them.

    Attributes:
        joints: Joints in the system's order: `JointSpec` with their known values, or the axes of the MJCF file.
        mjcf: File that describes the mechanism, or None.
        unknown: What of the MJCF file is unknown: a quantity of `UNKNOWN` for every joint, or ``quantity joint``.
        inputs: What drives the mechanism, length I; empty for free motion.
        outputs: What is measured, length C.
        fit: ``replay`` (the motion that the efforts cause) or ``torque`` (the efforts that the motion needs).
        filter_hz: Cut-off of the low-pass filter of torque fits [Hz].
        stated: Whether ``meta.yaml`` says how to fit, by ``fit`` or by the cut-off; else see `learn.replay.choice`.
    """

    joints: tuple[JointAxis, ...]
    mjcf: Path | None
    unknown: tuple[str, ...]
    inputs: tuple[JointInput, ...]
    outputs: tuple[JointOutput, ...]
    fit: Literal["replay", "torque"]
    filter_hz: float
    stated: bool

    @property
    def channels(self) -> tuple[JointOutput, ...]:
        """What the model predicts: the outputs of a replay, the driven joints' efforts in a torque fit."""
        if self.fit == "replay":
            return self.outputs
        return tuple(JointOutput(item.joint, "effort", item.column, 1.0) for item in self.inputs)


#: What may be unknown of a mechanism from an MJCF file; see `learn.systems.mechanism`.
UNKNOWN = ("damping", "stiffness", "armature", "preload", "mass", "com", "inertia", "length")

_TYPES: dict[Joint, Literal["revolute", "prismatic"]] = {Joint.REVOLUTE: "revolute", Joint.PRISMATIC: "prismatic"}

#: Samples a period of the cut-off where ``filter_hz`` is not given.
FILTER_SAMPLES = 20.0


def joint_setup(meta: JointMeta, file: YamlFile, folder: Path, dt: float) -> JointSetup:
    """Turn a checked ``meta.yaml`` into the mechanism, its inputs and outputs; ``dt`` is the sampling step [s].

    Raises:
        InputError: The filter or the kind of fit does not go with what is measured.
    """
    joints = case_joints(meta, folder)
    torque = _fits_torque(meta, file, [j.name for j in joints])
    if meta.filter_hz is not None and not torque:
        raise file.error(["filter_hz"], f"{meta.filter_hz:g} where fit is replay", "this key with fit: torque only")
    holds = [item.hold for item in meta.input or ()]
    if not torque and len(set(holds)) > 1:
        k = next(i for i, hold in enumerate(holds) if hold != holds[0])
        raise file.error(["input", k, "hold"], holds[k], f"{holds[0]} as in the other inputs of a replay")
    filter_hz = 1.0 / (FILTER_SAMPLES * dt) if meta.filter_hz is None else meta.filter_hz
    if filter_hz >= 0.5 / dt:
        raise file.error(["filter_hz"], f"{filter_hz:g}", f"below half the sampling rate, {0.5 / dt:g} Hz")
    return JointSetup(
        joints=joints,
        mjcf=folder / meta.mechanism.mjcf if meta.mechanism.mjcf else None,
        unknown=tuple(meta.mechanism.unknown or ()),
        inputs=tuple(JointInput(i.joint, i.column, i.hold) for i in meta.input or ()),
        outputs=tuple(JointOutput(o.joint, o.quantity, o.column, float(o.scale)) for o in meta.outputs),
        fit="torque" if torque else "replay",
        filter_hz=filter_hz,
        stated=meta.fit is not None or meta.filter_hz is not None,
    )


def _fits_torque(meta: JointMeta, file: YamlFile, joints: list[str]) -> bool:
    """Return whether efforts are fitted: as ``fit`` or a cut-off says, else for an MJCF file, if all is measured."""
    located = [o.joint for o in meta.outputs if o.quantity == "position"]
    driven = [i.joint for i in meta.input or ()]
    missing = [f"{what} of {name}" for what, names in (("position", located), ("input", driven))
               for name in joints if name not in names]  # fmt: skip
    if meta.fit == "torque" and missing:
        raise file.error(["fit"], f"torque without {missing[0]}", "replay, or position and input of every joint")
    likely = meta.mechanism.mjcf is not None or meta.filter_hz is not None
    return meta.fit == "torque" or (meta.fit is None and likely and not missing)


def case_joints(meta: JointMeta, folder: Path) -> tuple[JointAxis, ...]:
    """Return the joints of a case.

    Raises:
        InputError: The MJCF file is refused by `load_mjcf` or has a joint that neither turns about nor slides along an
            axis.
    """
    if meta.mechanism.mjcf is None:
        return tuple(_joint(i, spec) for i, spec in enumerate(meta.mechanism.joints or ()))
    mechanism, axes = load_mjcf(folder / meta.mechanism.mjcf, MEASURED), []
    for link in np.flatnonzero(mechanism.tree.joint != Joint.FIXED).tolist():
        kind = _TYPES.get(Joint(mechanism.tree.joint[link]))
        if kind is None:
            found, allowed = "a ball joint in a measured mechanism", "hinge or slide joints"
            raise InputError(folder / meta.mechanism.mjcf, mechanism.joint_place[link], found, allowed)
        axes.append(JointAxis(mechanism.joint_name[link] or f"joint{link}", kind, link))
    return tuple(axes)


def _joint(link: int, spec: JointSpecMeta) -> JointSpec:
    gravity = spec.gravity_torque
    torque = GravityTorque(gravity.amplitude, gravity.zero_angle) if gravity else None
    return JointSpec(spec.name, spec.type, link, spec.inertia, spec.stiffness, spec.damping, torque)


def check_joint_meta(meta: JointMeta, file: YamlFile, folder: Path) -> None:
    """Check names, scales, rows and the split of a joint case.

    Raises:
        InputError: An input, output or unknown names an unknown joint, a scale is zero, a joint is driven twice; a
            joint cannot have what it states; the inertia is to be inferred where nothing drives the joint; the split
            overlaps or names a trajectory that is not there; the MJCF file cannot be read.
    """
    names = [joint.name for joint in case_joints(meta, folder)]
    users: list[tuple[list[str | int], InputMeta | OutputMeta]] = [
        (["outputs", i], output) for i, output in enumerate(meta.outputs)
    ]
    users += [(["input", i], item) for i, item in enumerate(meta.input or ())]
    for here, user in users:
        if user.joint not in names:
            raise file.error([*here, "joint"], repr(user.joint), nearest(user.joint, names))
        if user.scale == 0:
            raise file.error([*here, "scale"], "0", "a number other than zero")
    driven = [item.joint for item in meta.input or ()]
    for i, name in enumerate(driven):
        if name in driven[:i]:
            raise file.error(["input", i, "joint"], f"{name} a second time", "one input a joint")
    _check_unknown(meta, file, names)
    _check_mechanism(meta, file)
    _check_split(meta, file)


def _check_unknown(meta: JointMeta, file: YamlFile, joints: list[str]) -> None:
    for i, text in enumerate(meta.mechanism.unknown or ()):
        quantity, _, joint = text.partition(" ")
        here: list[str | int] = ["mechanism", "unknown", i]
        if quantity not in UNKNOWN:
            raise file.error(here, repr(text), nearest(quantity, UNKNOWN))
        if joint and joint not in joints:
            raise file.error(here, repr(text), f"{quantity} alone, or with a joint: {nearest(joint, joints)}")


def _check_mechanism(meta: JointMeta, file: YamlFile) -> None:
    driven = [item.joint for item in meta.input or ()]
    names = [joint.name for joint in meta.mechanism.joints or ()]
    for i, joint in enumerate(meta.mechanism.joints or ()):
        here: list[str | int] = ["mechanism", "joints", i]
        if joint.name in names[:i]:
            raise file.error([*here, "name"], f"{joint.name} a second time", "unique names")
        if joint.gravity_torque and joint.type == "prismatic":
            raise file.error([*here, "gravity_torque"], "a gravity torque on a prismatic joint", "revolute joints only")
        if joint.inertia is None and joint.name not in driven:
            allowed = "a known value, or an input on this joint to infer it from"
            raise file.error([*here, "inertia"], "null on a joint that nothing drives", allowed)


def _check_split(meta: JointMeta, file: YamlFile) -> None:
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
