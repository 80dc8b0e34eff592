"""Trees to Newton models and back. Frames and joint coordinates: see `layout`.

Springs are ``Model.joint_stiffness``, ``joint_damping`` (one per degree of freedom) and ``joint_rest_q`` (laid out as
``joint_q``), which Newton's MuJoCo solver reads. Drives (``joint_target_ke`` ...) are control and are left alone.
Newton has no place for pre-load, branching order and the two radii of a capsule; they travel as the custom attributes
``model.bough.preload``, ``model.bough.level`` and ``model.bough.radius``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import newton
import numpy as np
import warp as wp

from ..base.errors import InputError
from ..base.rotation import quat_rotate, z_to
from ..base.types import Array, IntArray
from ..trees.pose import rest_pose
from ..trees.tree import Joint, Tree
from .layout import SOURCE, WorldLayout, host, read_layout, turned, unit, wxyz, xyzw


def to_newton(
    trees: Sequence[Tree], gravity: Sequence[float] = (0.0, 0.0, -9.81), device: str | None = None
) -> newton.Model:
    """Make a Newton model with one world per tree, z up.

    Bodies, joints and joint coordinates come in the trees' link order; joints start at zero. Bodies are labelled
    ``<tree>/<link>``. Capsules carry no mass of their own; one with two radii is drawn with their mean.

    Args:
        trees: Trees, one per world.
        gravity: Acceleration of gravity of all worlds [m/s^2].
        device: Warp device of the model; None for Warp's default.

    Raises:
        InputError: A tree is no valid mechanism.
    """
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    _register_attributes(builder)
    for tree in trees:
        builder.begin_world(gravity=wp.vec3(*gravity))
        _add_tree(builder, tree.validate())
        builder.end_world()
    # Newton's inertia check widens inertias at the triangle inequality in float32; `validate` has checked them.
    return builder.finalize(device=device, skip_validation_inertia=True)


def _register_attributes(builder: newton.ModelBuilder) -> None:
    joint, shape = newton.Model.AttributeFrequency.JOINT, newton.Model.AttributeFrequency.SHAPE
    for name, frequency, dtype in (("preload", joint, wp.vec3), ("level", joint, wp.int32), ("radius", shape, wp.vec2)):
        builder.add_custom_attribute(
            newton.ModelBuilder.CustomAttribute(name=name, frequency=frequency, dtype=dtype, namespace="bough")
        )


def _add_tree(builder: newton.ModelBuilder, tree: Tree) -> None:
    first = builder.body_count
    pos, quat = rest_pose(tree)
    for i, name in enumerate(tree.link_name):
        builder.add_link(
            xform=_transform(pos[i], quat[i]),
            com=wp.vec3(*tree.com[i]),
            inertia=wp.mat33(*tree.inertia[i].ravel()),
            mass=float(tree.mass[i]),
            label=f"{tree.name}/{name.replace('/', '_')}",
            lock_inertia=True,
        )
    builder.add_articulation([_add_joint(builder, tree, i, first) for i in range(tree.num_links)], label=tree.name)
    config = newton.ModelBuilder.ShapeConfig(density=0.0)
    for link, start, end, radius in zip(
        tree.shape_link, tree.shape_start, tree.shape_end, tree.shape_radius, strict=True
    ):
        half = (end - start) / 2
        length = float(np.linalg.norm(half))
        turn = z_to(half / length) if length > 0 else np.array([1.0, 0.0, 0.0, 0.0])
        builder.add_shape_capsule(
            first + int(link),
            xform=_transform((start + end) / 2, turn),
            radius=float(np.mean(radius)),
            half_height=length,
            cfg=config,
            custom_attributes={"bough:radius": wp.vec2(*radius)},
        )


def _add_joint(builder: newton.ModelBuilder, tree: Tree, i: int, first: int) -> int:
    """Add the joint of link i, whose body is number first + i; return its index."""
    parent = first + int(tree.parent[i]) if tree.parent[i] >= 0 else -1
    place: dict[str, Any] = {
        "parent_xform": _transform(tree.position[i] + quat_rotate(tree.rotation[i], tree.anchor[i]), tree.rotation[i]),
        "child_xform": _transform(tree.anchor[i], np.array([1.0, 0.0, 0.0, 0.0])),
        "label": f"{tree.name}/{tree.link_name[i]}_joint",
        "custom_attributes": {"bough:preload": wp.vec3(*tree.preload[i]), "bough:level": int(tree.level[i])},
    }
    if tree.joint[i] == Joint.FIXED:
        return builder.add_joint_fixed(parent, first + i, **place)
    passive: dict[str, Any] = {key: float(getattr(tree, key)[i]) for key in ("stiffness", "damping", "armature")}
    if tree.joint[i] == Joint.SPHERICAL:
        joint = builder.add_joint_ball(parent, first + i, **place, **passive)
        start = builder.joint_q_start[joint]
        builder.joint_rest_q[start : start + 4] = [float(x) for x in xyzw(tree.rest[i])]
        return joint
    add = builder.add_joint_revolute if tree.joint[i] == Joint.REVOLUTE else builder.add_joint_prismatic
    return add(parent, first + i, axis=wp.vec3(*tree.axis[i]), rest_q=float(tree.rest[i, 0]), **place, **passive)


def from_newton(model: newton.Model) -> list[Tree]:
    """Describe a Newton model as one tree per world, links in the order of Newton's joints.

    Fixed, revolute, ball and prismatic joints with their passive springs and dampers are taken over; drives, limits,
    friction and every shape that is not a capsule are not. A model built without worlds gives one tree.

    Raises:
        InputError: Another kind of joint (free, D6, ...), a closed loop, a body without a joint, a ball joint with
            different springs about its axes.
    """
    return [_read_tree(model, world, number) for number, world in enumerate(read_layout(model))]


def _read_tree(model: newton.Model, world: WorldLayout, number: int) -> Tree:
    return Tree(
        name=_tree_name(model, world, number),
        link_name=_link_names([model.body_label[b] for b in world.body]),
        parent=world.parent,
        joint=world.kind,
        position=world.position,
        rotation=world.rotation,
        mass=host(model, "body_mass")[world.body],
        com=host(model, "body_com")[world.body],
        inertia=host(model, "body_inertia")[world.body],
        anchor=world.anchor,
        axis=_axes(model, world),
        rest=_rest(model, world),
        stiffness=_isotropic(model, world, "stiffness"),
        damping=_isotropic(model, world, "damping"),
        armature=_isotropic(model, world, "armature"),
        **_custom(model, world.joint),
        **_capsules(model, world),
    ).validate(SOURCE)


def _axes(model: newton.Model, world: WorldLayout) -> Array:
    axis = np.tile([0.0, 0.0, 1.0], (len(world.joint), 1))
    scalar = np.isin(world.kind, (Joint.REVOLUTE, Joint.PRISMATIC))
    if scalar.any():
        own = host(model, "joint_axis")[world.qd_start[scalar]].astype(np.float64)
        axis[scalar] = unit(quat_rotate(world.turn[scalar], own))
    return axis


def _isotropic(model: newton.Model, world: WorldLayout, key: str) -> Array:
    """Stiffness, damping or armature of each link, the same about all axes of a ball joint."""
    source, out = host(model, f"joint_{key}"), np.zeros(len(world.joint))
    for i in np.flatnonzero(world.kind != Joint.FIXED):
        own = source[world.qd_start[i] :][: Joint(world.kind[i]).dofs]
        if np.ptp(own) > 1e-6 * np.abs(own).max():
            place = f"joint {model.joint_label[world.joint[i]]}"
            raise InputError(SOURCE, place, f"{key} {own}", "one value for all axes of a ball joint")
        out[i] = own[0]
    return out


def _rest(model: newton.Model, world: WorldLayout) -> Array:
    """Rest coordinate of scalar joints in the first column, rest orientation of spherical ones in the body frame."""
    source, rest = host(model, "joint_rest_q").astype(np.float64), np.zeros((len(world.joint), 4))
    for i in np.flatnonzero(world.kind != Joint.FIXED):
        own = source[world.q_start[i] :]
        if world.kind[i] == Joint.SPHERICAL:
            rest[i] = turned(world.turn[i], unit(wxyz(own[:4])))
        else:
            rest[i, 0] = own[0]
    return rest


def _custom(model: newton.Model, joints: IntArray) -> dict[str, Any]:
    space = getattr(model, "bough", None)
    return {} if space is None else {key: getattr(space, key).numpy()[joints] for key in ("preload", "level")}


def _capsules(model: newton.Model, world: WorldLayout) -> dict[str, Any]:
    if model.shape_count == 0:
        return {}
    link = {int(b): i for i, b in enumerate(world.body)}
    bodies = host(model, "shape_body")
    chosen = np.flatnonzero((host(model, "shape_type") == int(newton.GeoType.CAPSULE)) & np.isin(bodies, world.body))
    place, scale = (host(model, key)[chosen].astype(np.float64) for key in ("shape_transform", "shape_scale"))
    reach = quat_rotate(unit(wxyz(place[:, 3:])), np.array([0.0, 0.0, 1.0])) * scale[:, 1:2]
    space = getattr(model, "bough", None)
    return {
        "shape_link": np.array([link[int(b)] for b in bodies[chosen]], dtype=np.int64),
        "shape_start": place[:, :3] - reach,
        "shape_end": place[:, :3] + reach,
        "shape_radius": np.repeat(scale[:, :1], 2, axis=1) if space is None else space.radius.numpy()[chosen],
    }


def _tree_name(model: newton.Model, world: WorldLayout, number: int) -> str:
    articulation = int(host(model, "joint_articulation")[world.joint[0]])
    return (model.articulation_label[articulation] if articulation >= 0 else "") or f"world_{number}"


def _link_names(labels: list[str]) -> list[str]:
    """Last parts of the labels, which Newton's importers make into paths; whole labels where those are not unique."""
    short = [label.rsplit("/", 1)[-1] for label in labels]
    return short if len(set(short)) == len(short) else labels


def _transform(position: Array, rotation: Array) -> wp.transform:
    return wp.transform(wp.vec3(*position), wp.quat(*xyzw(rotation)))
