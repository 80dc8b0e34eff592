"""Which MJCF features a `Tree` can express, which are refused, and which are left out where the user allows it.

`mjSpec` is MuJoCo's own description of a file that it has read and not yet compiled: default classes are resolved and
replicated bodies made, so a check need not know the language.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..base.errors import InputError
from .mjcf_source import Source
from .omissions import Omissions, Place, touching

_TENDON_PHYSICS = ("stiffness", "damping", "frictionloss", "armature", "range")
#: MuJoCo's mjtJoint.
FREE, BALL = 0, 1
#: Gives the place of a "joint" or "body" by its number in a compiled model, or of a section by its name.
Where = Callable[[str, int], Place]


def line_of(item: Any) -> int:
    """Line of the text from which MuJoCo made a part of its `mjSpec`, from 1; its body's if it does not know."""
    return int(re.findall(r"\d+", item.info or item.parent.info)[-1])


def check_source(source: Source, spec: Any, omissions: Omissions) -> None:
    """Check what does not reach the compiler, or not as it is written: ties, tendons, actuators, ``springdamper``.

    Raises:
        InputError: ``springdamper``, or a plane in a body.
    """
    for joint in spec.joints:
        if np.any(joint.springdamper):
            raise source.element(line_of(joint)).error("springdamper", "stiffness and damping")
    for geom in _of_bodies(spec):
        if geom.type.name == "mjGEOM_PLANE":
            raise source.element(line_of(geom)).error("a plane in a body", "planes in <worldbody> only")
    for constraint in spec.equalities:
        if constraint.active:
            at = source.element(line_of(constraint))
            what = f"an equality <{at.tag}> (a closed loop or coupling)"
            omissions.found("equality", (at.file, at.place), what, "equalities")
    for tendon in spec.tendons:
        for key in _TENDON_PHYSICS:
            if np.any(getattr(tendon, key)):
                at = source.element(line_of(tendon))
                omissions.found("tendons", (at.file, at.place), f"a tendon with {key}", "tendons")
                break
    for at in source.section("actuator"):
        if at.tag == "motor":
            omissions.noted("motors, which are at rest")
        else:
            omissions.found("actuators", (at.file, at.place), "an actuator", "actuators")
    omissions.noted("keyframes", len(source.section("keyframe")))


def check_model(model: Any, where: Where, omissions: Omissions) -> None:
    """Check joints, weights and the air of a compiled model.

    Args:
        model: MuJoCo's compiled model.
        where: Gives the place of a "joint" or "body" by its number in the model.
        omissions: Takes what has to be left out.

    Raises:
        InputError: A spring or damper that is negative or no straight line; a negative density or viscosity.
    """
    for joint in range(model.njnt):
        _check_values(model, joint, where)
        _check_joint(model, joint, where, omissions)
    for body in np.flatnonzero(model.body_gravcomp).tolist():
        what = f"gravcomp='{model.body_gravcomp[body]:g}'"
        omissions.found("gravcomp", where("body", body), what, "gravity compensation")
    for key in ("density", "viscosity"):
        value = float(getattr(model.opt, key))
        if value < 0:
            raise InputError(*where("option", 0), f"{key}='{value:g}'", "zero or more")
        if value > 0:
            omissions.found("fluid", where("option", 0), f"{key}='{value:g}'", f"fluid {key}")


def _check_values(model: Any, joint: int, where: Where) -> None:
    """Raise `InputError` for a joint's number that is negative or has terms beyond the linear one."""
    dof = model.jnt_dofadr[joint]
    for array, key, at in (
        ("jnt_stiffness", "stiffness", joint),
        ("dof_damping", "damping", dof),
        ("dof_armature", "armature", dof),
        ("dof_frictionloss", "frictionloss", dof),
    ):
        further = getattr(model, array + "poly", None)  # MuJoCo 4.0 has polynomials where 3 has numbers
        values = np.append(getattr(model, array)[at], [] if further is None else further[at])
        if values[0] < 0 or values[1:].any():
            found = f"{key}='{' '.join(f'{v:g}' for v in np.trim_zeros(values, 'b'))}'"
            raise InputError(*where("joint", joint), found, "one number, zero or more")
    if np.any(getattr(model, "jnt_springyield", np.zeros(model.njnt))[joint]):
        raise InputError(*where("joint", joint), "springyield", "springs that do not yield")


def _check_joint(model: Any, joint: int, where: Where, omissions: Omissions) -> None:
    """Note a joint's end stops, and friction where it is not that of one axis."""
    kind, dof = int(model.jnt_type[joint]), model.jnt_dofadr[joint]
    if kind == FREE and "free" in omissions.ignore:
        omissions.noted("free joints")
        return
    if model.jnt_limited[joint]:
        omissions.found("limits", where("joint", joint), "a joint limit", "joint limits")
    if model.dof_frictionloss[dof] > 0 and kind in (FREE, BALL):
        omissions.found("friction", where("joint", joint), "frictionloss of several axes", "joint friction")
    elif model.dof_frictionloss[dof] > 0 and "friction" in omissions.ignore:
        omissions.noted("joint friction")


def check_contacts(
    model: Any, bodies: Sequence[tuple[int, int]], world: tuple[int, int], excluded: set[tuple[int, int]],
    pairs: int, where: Where, omissions: Omissions,
) -> None:  # fmt: skip
    """Note bodies that could touch each other or the world's geoms.

    Args:
        model: MuJoCo's compiled model.
        bodies: Bodies and their parents, parents first.
        world: contype and conaffinity of the world's geoms, or-ed.
        excluded: Pairs of bodies that do not collide, the smaller number first.
        pairs: Number of pairs of geoms that collide by name.
        where: As in `check_model`.
        omissions: Takes what has to be left out.
    """
    if disabled(model, "CONTACT"):
        return
    number = {0: 0} | {body: k + 1 for k, (body, _) in enumerate(bodies)}
    masks = np.zeros((len(number), 2), np.int64)
    masks[0] = world
    own = np.array([number[body] for body in model.geom_bodyid], np.int64)
    inner = own > 0
    for column, values in enumerate((model.geom_contype, model.geom_conaffinity)):
        np.bitwise_or.at(masks[:, column], own[inner], values[inner].astype(np.int64))
    parent = [0, *(number[above] for _, above in bodies)]
    moves = [False, *(model.body_jntnum[body] > 0 for body, _ in bodies)]
    renumbered = {tuple(sorted((number[a], number[b]))) for a, b in excluded}
    found = touching(parent, moves, masks, renumbered)  # type: ignore[arg-type]
    if found:
        first, second = found[0]
        name = model.body(bodies[first - 1][0]).name or f"number {first}" if first else ""
        other = f"body '{name}'" if first else "the world's geoms, such as a floor"
        what = f"a body that can touch {other}"
        omissions.found("contacts", where("body", bodies[second - 1][0]), what, "pairs that could touch", len(found))
    elif pairs:
        omissions.found("contacts", where("contact", 0), "a contact <pair>", "contact pairs", pairs)


def _of_bodies(spec: Any) -> list[Any]:
    """Geoms that belong to a body other than the world."""
    return [geom for geom in spec.geoms if geom.parent != spec.worldbody]


def keep_bodies(spec: Any) -> None:
    """Take out of an `mjSpec` what neither moves bodies nor gives them mass.

    Fixed bodies stay apart and every geom of a body stays, whatever the file's compiler settings say.
    """
    bodies = _of_bodies(spec)
    used = {name for geom in bodies for name in (geom.meshname, geom.hfieldname)}
    world = [geom for geom in spec.geoms if geom.parent == spec.worldbody]
    unused = [asset for asset in (*spec.meshes, *spec.hfields) if asset.name not in used]
    for item in (*spec.tendons, *spec.equalities, *world, *unused):
        spec.delete(item)
    spec.compiler.fusestatic = spec.compiler.discardvisual = False


def world_masks(spec: Any) -> tuple[int, int]:
    """Return contype and conaffinity of the world's geoms, or-ed; to be asked before `keep_bodies`."""
    world = [geom for geom in spec.geoms if geom.parent == spec.worldbody]
    return flags([geom.contype for geom in world]), flags([geom.conaffinity for geom in world])


def flags(values: Any) -> int:
    """Return bit masks or-ed together."""
    return int(np.bitwise_or.reduce(np.asarray(values, np.int64), initial=0))


def disabled(model: Any, flag: str) -> bool:
    """Whether the file disables one of MuJoCo's flags: CONTACT, DAMPER, GRAVITY, SPRING."""
    import mujoco

    return bool(model.opt.disableflags & getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))
