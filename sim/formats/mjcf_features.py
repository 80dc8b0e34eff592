"""Which MJCF features a `Tree` can express, which are left out with a word, and which are refused.

`mjSpec` is MuJoCo's own description of a file that it has read and not yet compiled: default classes are resolved and
replicated bodies made, so a check need not know the language.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ..base.errors import InputError
from .mjcf_source import Source
from .xml_tree import Element

_TENDON_PHYSICS = ("stiffness", "damping", "frictionloss", "armature", "range")
_JOINT_PHYSICS = ("stiffness", "damping", "armature", "frictionloss")


def line_of(item: Any) -> int:
    """Line of the text from which MuJoCo made a part of its `mjSpec`, from 1; its body's if it does not know."""
    return int(re.findall(r"\d+", item.info or item.parent.info)[-1])


def refuse_unsupported(source: Source, spec: Any) -> None:
    """Refuse features that change the motion and that a tree of joints with linear springs cannot express.

    Raises:
        InputError: A free joint, a spring or damper that is negative or no straight line, ``springdamper``, gravity
            compensation, a plane in a body, a closed loop or coupling (active equality), a tendon with a force.
    """
    for joint in spec.joints:
        _check_joint(spec, joint, source.element(line_of(joint)))
    for body in spec.bodies[1:]:
        if body.gravcomp != 0:
            raise source.element(line_of(body)).error(f"gravcomp='{body.gravcomp:g}'", "bodies under full gravity")
    for geom in _of_bodies(spec):
        if geom.type.name == "mjGEOM_PLANE":
            raise source.element(line_of(geom)).error("a plane in a body", "planes in <worldbody> only")
    for constraint in spec.equalities:
        if constraint.active:
            at = source.element(line_of(constraint))
            raise at.error(f"an equality <{at.tag}> (a closed loop or coupling)", "a tree of joints")
    for tendon in spec.tendons:
        for key in _TENDON_PHYSICS:
            if np.any(getattr(tendon, key)):
                at = source.element(line_of(tendon))
                raise at.error(f"a tendon with {key}", "tendons without force, or joint springs")


def _check_joint(spec: Any, joint: Any, at: Element) -> None:
    if joint.type.name == "mjJNT_FREE":
        raise at.error("an unsupported free joint", "hinge, slide and ball joints")
    for key in _JOINT_PHYSICS:
        values = np.atleast_1d(getattr(joint, key))  # MuJoCo 4.0 has polynomials where 3 has numbers
        if values[0] < 0 or values[1:].any():
            raise at.error(
                f"{key}='{' '.join(f'{v:g}' for v in np.trim_zeros(values, 'b'))}'", "one number, zero or more"
            )
    if np.any(joint.springdamper):
        raise at.error("springdamper", "stiffness and damping")
    if np.any(getattr(joint, "springyield", 0.0)):
        raise at.error("springyield", "springs that do not yield")


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


def ignored_features(source: Source, model: Any) -> list[str]:
    """Short descriptions of what was left out and can change the motion.

    Lights, cameras, sites, materials, sensors and the like change nothing and are not listed.
    """
    counts = {
        "joint limits": int(np.sum(model.jnt_limited)),
        "joint friction": int(np.sum(model.dof_frictionloss[model.jnt_dofadr] > 0)),
        "actuators": len(source.section("actuator")),
        "keyframes": len(source.section("keyframe")),
    }
    out = [f"{name} ({count})" for name, count in counts.items() if count]
    collide = int(np.sum((model.geom_contype != 0) | (model.geom_conaffinity != 0)))
    if collide and not disabled(model, "CONTACT"):
        out.append(f"contacts ({collide} geoms)")
    for key in ("density", "viscosity"):
        if getattr(model.opt, key) < 0:
            raise InputError(source.root.file, "<option>", f"{key}='{getattr(model.opt, key):g}'", "zero or more")
        out += [f"fluid {key}"] * (getattr(model.opt, key) > 0)
    return out


def disabled(model: Any, flag: str) -> bool:
    """Whether the file disables one of MuJoCo's flags: CONTACT, DAMPER, GRAVITY, SPRING."""
    import mujoco

    return bool(model.opt.disableflags & getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))
