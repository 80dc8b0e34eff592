"""Import of a MuJoCo model in memory, compiled or not, by the checks and the code that read MJCF files."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import InputError
from ..base.mujoco_log import without_log
from ..base.types import Array
from .import_mjcf import Mechanism, Written, describe
from .mjcf_features import check_contacts, check_model, flags
from .omissions import Omissions, Place

#: MuJoCo's mjtGain, mjtBias and mjtDyn of a motor: a constant gain, no bias, no state.
_MOTOR = (0, 0, 0)
_TENDON = ("stiffness", "damping", "frictionloss", "armature")


def from_mujoco(model: Any, ignore: Sequence[str] = ()) -> Mechanism:
    """Return the mechanism of a model that MuJoCo has in memory.

    It is what `bough.load_mechanism` makes of the model's file, to MuJoCo's rounding: the compiler keeps axes and
    orientations at length one. Bodies that MuJoCo fused on compiling (``fusestatic``) are one link.

    Args:
        model: ``mujoco.MjModel``, or ``mujoco.MjSpec``, which is compiled; neither is changed.
        ignore: Words of `bough.sim.formats.omissions` ("limits", "contacts", "actuators" ... or "all") for what may be
            left out of what a `Tree` does not have; `Mechanism.ignored` lists what was.

    Returns:
        Tree, gravity, start and what was left out; `Mechanism.simulator` makes a simulator of it, and
        ``bough.Model(mechanism.tree, gravity=mechanism.gravity)`` a model.

    Raises:
        InputError: Another kind of object, a model that does not compile or without bodies, or what the checks of
            `load_mjcf` refuse; joints and bodies are named.
    """
    model = _compiled(model)
    name = _name(model)
    if model.nbody < 2:
        raise InputError(name, "", "no bodies", "at least one body")
    omissions, where = Omissions(ignore), _places(model, name)
    bodies = [(body, int(model.body_parentid[body])) for body in range(1, model.nbody)]
    _check_ties(model, where, omissions)
    _check_actuators(model, where, omissions)
    omissions.noted("keyframes", model.nkey)
    check_model(model, where, omissions)
    own = model.geom_bodyid == 0
    world = flags(model.geom_contype[own]), flags(model.geom_conaffinity[own])
    excluded = {(int(pair) >> 16, int(pair) & 0xFFFF) for pair in model.exclude_signature}
    check_contacts(model, bodies, world, excluded, model.npair, where, omissions)
    mechanism = describe(model, bodies, name, omissions, where, Written())
    tree = mechanism.tree.with_(preload=_preload(model, mechanism.tree.num_links))
    return replace(mechanism, tree=tree.validate(name))


def _preload(model: Any, count: int) -> Array:
    """Pre-loads [N m or N], shape [count, 3], which bough's own export keeps in ``<custom>``."""
    named = [i for i in range(model.nnumeric) if model.numeric(i).name == "bough_preload"]
    return np.array(model.numeric(named[0]).data).reshape(count, 3) if named else np.zeros((count, 3))


def load_mjb(path: str | Path, ignore: Sequence[str] = ()) -> Mechanism:
    """Read a model that MuJoCo has compiled and saved in its binary format.

    Raises:
        InputError: The file cannot be read by this version of MuJoCo, or what `from_mujoco` refuses.
    """
    import mujoco

    try:
        with without_log():
            model = mujoco.MjModel.from_binary_path(str(path))
    except (ValueError, RuntimeError, mujoco.FatalError) as e:
        reason = " ".join(str(e).split())
        raise InputError(path, "", reason, f"a model saved by MuJoCo {mujoco.__version__}") from None
    return from_mujoco(model, ignore)


def _compiled(model: Any) -> Any:
    """Return the compiled model.

    Raises:
        InputError: It is neither MjModel nor MjSpec, or does not compile, or has flexible bodies or plugins.
    """
    import mujoco

    if isinstance(model, mujoco.MjSpec):
        try:
            with without_log(), warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of a simulation, which this is not
                model = model.copy().compile()
        except (ValueError, RuntimeError, mujoco.FatalError) as e:
            raise InputError("MjSpec", "", " ".join(str(e).split()), "a model that MuJoCo compiles") from None
    if not isinstance(model, mujoco.MjModel):
        raise InputError("from_mujoco", "model", type(model).__name__, "mujoco.MjModel or mujoco.MjSpec")
    for count, found, allowed in (("nflex", "a flexible body", "rigid bodies"), ("nplugin", "a plugin", "none")):
        if getattr(model, count):
            raise InputError(_name(model), "", found, allowed)
    return model


def _name(model: Any) -> str:
    """Name of a compiled model."""
    return bytes(model.names).split(b"\0", 1)[0].decode() or "mujoco"


def _places(model: Any, name: str) -> Any:
    """Return what names joints, bodies and sections, for messages."""

    def where(kind: str, number: int) -> Place:
        """Return the model's name, and kind and name of an object, or its number if it has none."""
        if kind not in ("joint", "body", "equality", "tendon", "actuator"):
            return name, kind
        own = getattr(model, kind)(number).name
        return name, f"{kind} '{own}'" if own else f"{kind} number {number}"

    return where


def _check_ties(model: Any, where: Any, omissions: Omissions) -> None:
    """Note equalities that are active, and tendons with a force."""
    for number in np.flatnonzero(model.eq_active0).tolist():
        what = "an equality (a closed loop or coupling)"
        omissions.found("equality", where("equality", number), what, "equalities")
    limited = np.asarray(model.tendon_limited, bool)
    for number in range(model.ntendon):
        values = {key: getattr(model, f"tendon_{key}")[number] for key in _TENDON}
        forces = [key for key, value in values.items() if np.any(value)] + ["range"] * bool(limited[number])
        if forces:
            omissions.found("tendons", where("tendon", number), f"a tendon with {forces[0]}", "tendons")


def _check_actuators(model: Any, where: Any, omissions: Omissions) -> None:
    """Note actuators; motors exert nothing at zero control."""
    for number in range(model.nu):
        kinds = (model.actuator_gaintype[number], model.actuator_biastype[number], model.actuator_dyntype[number])
        if tuple(int(kind) for kind in kinds) == _MOTOR:
            omissions.noted("motors, which are at rest")
        else:
            omissions.found("actuators", where("actuator", number), "an actuator", "actuators")
