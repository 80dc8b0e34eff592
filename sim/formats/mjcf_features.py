"""Which MJCF features a `Tree` can express, which are left out with a word, and which are refused."""

from __future__ import annotations

from .mjcf_document import Document
from .xml_tree import Element

_POSE = "pos quat euler axisangle xyaxes zaxis"
_ALLOWED = {
    "body": f"name childclass mocap fuse gravcomp simple sleep user {_POSE}",
    "frame": f"name childclass {_POSE}",
    "inertial": f"mass diaginertia fullinertia {_POSE}",
    "joint": "name class type group pos axis springdamper limited actuatorfrclimited actuatorfrcrange actuatorgravcomp "
    "solreflimit solimplimit solreffriction solimpfriction stiffness range margin ref springref springyield armature "
    "damping frictionloss user",
    "geom": "name class type contype conaffinity condim group priority size material friction mass density "
    "shellinertia solmix solref solimp margin gap adhesion surfacevel fromto hfield mesh fitscale rgba fluidshape "
    f"fluidcoef castshadow user {_POSE}",
}
_BODY_CHILDREN = "body frame inertial joint freejoint geom site camera light"
_TENDON_PHYSICS = ("stiffness", "damping", "frictionloss", "armature", "range")


def check_attributes(element: Element) -> None:
    """Refuse unknown attributes and unknown children of body, frame, joint, geom and inertial elements.

    Raises:
        InputError: There is one.
    """
    element.check_attributes(_ALLOWED[element.tag])
    if element.tag in ("body", "frame"):
        for child in element.children:
            _check_child(child)
        if element.number("gravcomp", 0.0) != 0:
            raise element.error(f"gravcomp='{element.attrib['gravcomp']}'", "bodies under full gravity")
    elif element.children:
        raise element.children[0].error(f"a <{element.children[0].tag}> in a <{element.tag}>", "nothing inside it")


def _check_child(child: Element) -> None:
    if child.tag not in _BODY_CHILDREN.split():
        raise child.error(f"an unsupported element <{child.tag}>", ", ".join(_BODY_CHILDREN.split()))
    if child.tag == "freejoint":
        raise child.error("an unsupported free joint", "hinge, slide and ball joints")


def check_joint(joint: Element) -> None:
    """Refuse joints whose passive force is no linear spring and damper (class defaults already resolved).

    Raises:
        InputError: A free joint, a negative or nonlinear spring or damper, a yielding spring, ``springdamper``.
    """
    if joint.attrib.get("type") == "free":
        raise joint.error("an unsupported free joint", "hinge, slide and ball joints")
    for key in ("stiffness", "damping"):
        values = joint.vector(key, 3, [0.0], at_least=1)
        if values[0] < 0 or (values[1:] != 0).any():
            raise joint.error(f"{key}='{joint.attrib[key]}'", "one number, zero or more")
    if any(joint.vector("springdamper", 2, [0.0, 0.0]) != 0):
        raise joint.error("springdamper", "stiffness and damping")
    if any(joint.vector("springyield", 3, [0.0], at_least=1) != 0):
        raise joint.error("springyield", "springs that do not yield")


def refuse_unsupported(document: Document) -> None:
    """Refuse features outside the bodies that change the motion and that a tree of joints cannot express.

    Raises:
        InputError: A closed loop or coupling (active equality), a tendon with a force, a flexible body.
    """
    for child in document.sections("worldbody"):
        _check_child(child)
        if child.tag in ("joint", "inertial"):
            raise child.error(f"a <{child.tag}> of the world", "joints and inertias inside a <body>")
    for constraint in document.sections("equality"):
        if constraint.attrib.get("active", "true") != "false":
            raise constraint.error(f"an equality <{constraint.tag}> (a closed loop or coupling)", "a tree of joints")
    for flexible in document.sections("deformable"):
        if flexible.tag == "flex":
            raise flexible.error("a flexible body", "rigid bodies")
    for tendon in document.sections("tendon"):
        _check_tendon(document.resolved(tendon, "main", "tendon"))


def _check_tendon(tendon: Element) -> None:
    for key in _TENDON_PHYSICS:
        if key in tendon.attrib and tendon.vector(key, 3, at_least=1).any():
            raise tendon.error(f"a tendon with {key}", "tendons without force, or joint springs")


def ignored_features(document: Document, joints: list[Element], geoms: list[Element]) -> list[str]:
    """Short descriptions of what was left out and can change the motion.

    Lights, cameras, sites, materials, sensors and the like change nothing and are not listed.
    """
    counts = {
        "joint limits": sum(_is_limited(document, joint) for joint in joints),
        "joint friction": sum(joint.positive("frictionloss", 0.0) > 0 for joint in joints),
        "actuators": len(list(document.sections("actuator"))),
        "keyframes": len(list(document.sections("keyframe"))),
    }
    out = [f"{name} ({count})" for name, count in counts.items() if count]
    collide = [g for g in geoms if g.number("contype", 1) or g.number("conaffinity", 1)]
    if collide and document.flag("contact"):
        out.append(f"contacts ({len(collide)} geoms)")
    for option in document.root.find_all("option"):
        out += [f"fluid {key}" for key in ("density", "viscosity") if option.positive(key, 0.0) > 0]
    return out


def _is_limited(document: Document, joint: Element) -> bool:
    limited = joint.keyword("limited", "auto", ("auto", "true", "false"))
    if limited == "auto":
        auto = document.compiler.keyword("autolimits", "true", ("true", "false")) == "true"
        return auto and bool(joint.vector("range", 2, [0.0, 0.0]).any())
    return limited == "true"
