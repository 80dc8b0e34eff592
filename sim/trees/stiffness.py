"""Spring and damper of every joint of a tree: two models of the thesis (section 4.3.2), and the load wood carries.

Rudimentary: K_p = max(lower, upper decay^level), Gaussian noise on it. Beam: K_p = E pi r^4 / (2 l) (equation 4.2).
Both take K_d = K_p / 10 unless told otherwise; `sim.wood.posterior` gives the beam what was inferred.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from ..base.errors import InputError
from ..base.rotation import quat_matrix, quat_rotate
from ..base.types import Array
from .pose import generations, rest_pose
from .tree import Joint, Tree

DAMPING_TIME = 0.1
"""K_d / K_p [s]."""

YOUNG = 3e9
"""Young's modulus of green wood [Pa] (thesis, table B.2)."""

StiffnessModel = Literal["rudimentary", "beam"]


def apply_stiffness(tree: Tree, model: StiffnessModel, rng: np.random.Generator) -> Tree:
    """Return the tree with the springs of a model by name, at its defaults; ``rng`` feeds the rudimentary one's noise.

    Raises:
        InputError: No such model.
    """
    if model not in ("rudimentary", "beam"):
        raise InputError(tree.name, "stiffness", repr(model), "rudimentary, beam")
    return beam(tree) if model == "beam" else rudimentary(tree, rng=rng)


def rudimentary(
    tree: Tree,
    *,
    upper: float | None = None,
    lower: float = 5.0,
    decay: float = 1.0 / 3.0,
    sigma: float = 1.0,
    rng: np.random.Generator | int = 0,
) -> Tree:
    """Return the tree with stiffness that falls exponentially with the branching level.

    K_p = max(lower, upper decay^level + sigma N(0, 1)), each joint with its own draw. The defaults give 120, 40, 13 and
    5 N m/rad at levels 0 to 3 of trees up to a few kilograms.

    Args:
        tree: The tree; fixed and prismatic joints keep their values.
        upper: Stiffness at level 0 [N m/rad]. None for 120, or as much as lets every joint, without its noise, be
            twice as stiff as the weight it carries is toppling (`toppling_stiffness`): a heavier tree would fall over.
        lower: Least stiffness, also after the noise [N m/rad].
        decay: Factor from one level to the next, 0 to 1.
        sigma: Standard deviation of the noise [N m/rad] (thesis, section 4.3.3: 1.0).
        rng: Source of the noise.

    Raises:
        InputError: A bound is not positive, ``lower`` above ``upper``, ``decay`` or ``sigma`` out of range.
    """
    if upper is None:
        needed = np.where(_turns(tree), toppling_stiffness(tree), 0.0) / decay**tree.level if decay > 0 else [0.0]
        upper = max(120.0, lower, 2.0 * float(np.max(needed)))
    _require(tree, "lower", lower, 0.0 < lower <= upper, f"above 0, at most upper = {upper:g}")
    _require(tree, "upper", upper, math.isfinite(upper), "a finite number")
    _require(tree, "decay", decay, 0.0 < decay <= 1.0, "above 0, at most 1")
    _require(tree, "sigma", sigma, 0.0 <= sigma < math.inf, "zero or more")
    noise = sigma * np.random.default_rng(rng).standard_normal(tree.num_links)
    return _with_springs(tree, np.maximum(upper * decay**tree.level + noise, lower))


def beam(tree: Tree, young: float | Array = YOUNG, relaxation: float | Array = DAMPING_TIME) -> Tree:
    """Return the tree with springs and dampers of bending beams, K = E pi r^4 / (2 l) (equation 4.2) and D = K tau.

    r and l are those of `beam_size`. Fixed and prismatic joints keep their values.

    Args:
        tree: The tree.
        young: Young's modulus E [Pa], one or one a link, shape [L].
        relaxation: Relaxation time tau [s], one or one a link, shape [L].

    Raises:
        InputError: ``young`` or ``relaxation`` is not positive; names a turning link that has no capsule of positive
            length.
    """
    for name, value in (("young", young), ("relaxation", relaxation)):
        bad = [v for v in np.atleast_1d(value).tolist() if not 0.0 < v < math.inf]
        _require(tree, name, (bad or [0.0])[0], not bad, "finite numbers above 0")
    radius, length = beam_size(tree)
    for link in np.flatnonzero(_turns(tree) & (length <= 0.0)).tolist():
        _require(tree, f"link {tree.link_name[link]}", 0.0, False, "a capsule of positive length, which a beam needs")
    return _with_springs(tree, young * np.pi * radius**4 / (2.0 * np.where(length > 0.0, length, 1.0)), relaxation)


def beam_size(tree: Tree) -> tuple[Array, Array]:
    """Mean radius and length of every link's first capsule [m], shapes [L]; zero where a link has none."""
    radius, length = np.zeros(tree.num_links), np.zeros(tree.num_links)
    first = {int(link): shape for shape, link in reversed(list(enumerate(tree.shape_link)))}
    for link, shape in first.items():
        radius[link] = tree.shape_radius[shape].mean()
        length[link] = np.linalg.norm(tree.shape_end[shape] - tree.shape_start[shape])
    return radius, length


def _require(tree: Tree, place: str, value: float, ok: bool, allowed: str) -> None:
    if not ok:
        raise InputError(tree.name, place, f"{value:g}", allowed)


def _turns(tree: Tree) -> np.ndarray:
    return np.isin(tree.joint, [Joint.REVOLUTE, Joint.SPHERICAL])


def _with_springs(tree: Tree, stiffness: Array, relaxation: float | Array = DAMPING_TIME) -> Tree:
    turns = _turns(tree)
    return tree.with_(
        stiffness=np.where(turns, stiffness, tree.stiffness),
        damping=np.where(turns, relaxation * stiffness, tree.damping),
    )


def hold_rest_pose(tree: Tree, gravity: float = 9.81) -> Tree:
    """Return the tree with the preload that makes all joints at zero its equilibrium under gravity along -z.

    A living branch has grown into its shape with its weight on it. The preload balances, about each joint, the weight
    of everything it carries, and the torque or force of a spring that is not relaxed at joint zero.

    Args:
        tree: The tree.
        gravity: Acceleration of gravity [m/s^2].
    """
    mass, moment = _carried(tree)
    down = quat_rotate(rest_pose(tree)[1] * [1.0, -1.0, -1.0, -1.0], np.array([0.0, 0.0, -1.0]))
    weight = gravity * down
    torque, force = np.cross(moment, weight), mass[:, None] * weight
    return tree.with_(preload=_strained(tree, -(_generalised(tree, torque, force) + _spring_at_zero(tree))))


def toppling_stiffness(tree: Tree, gravity: float = 9.81) -> Array:
    """Stiffness below which the weight each joint carries could topple it [N m/rad], shape [L].

    The weight of all links a joint carries, times the distance of their centre of mass from its anchor at rest.
    """
    return gravity * np.linalg.norm(_carried(tree)[1], axis=1)


def _carried(tree: Tree) -> tuple[Array, Array]:
    """Mass [L] of all that each joint carries, and its first moment about the anchor at joint zero.

    The moment [kg m], shape [L, 3], is in the link's own body frame.
    """
    turn = quat_matrix(tree.rotation)
    mass, moment = tree.mass.copy(), tree.mass[:, None] * tree.com
    for links in reversed(generations(tree.parent)[1:]):
        above = tree.parent[links]
        np.add.at(mass, above, mass[links])
        hanging = mass[links, None] * tree.position[links] + np.einsum("nij,nj->ni", turn[links], moment[links])
        np.add.at(moment, above, hanging)
    return mass, moment - mass[:, None] * tree.anchor


def _generalised(tree: Tree, torque: Array, force: Array) -> Array:
    """Generalised joint forces [L, 3] of torques about the anchors and forces, both [L, 3] in body frames."""
    out = np.where((tree.joint == Joint.SPHERICAL)[:, None], torque, 0.0)
    for joint, load in ((Joint.REVOLUTE, torque), (Joint.PRISMATIC, force)):
        along = np.einsum("ni,ni->n", tree.axis, load)
        out[:, 0] = np.where(tree.joint == joint, along, out[:, 0])
    return out


def _spring_at_zero(tree: Tree) -> Array:
    """Spring forces [L, 3] at joint zero: k q_rest, and K log(q_rest) for spherical joints."""
    out = np.zeros((tree.num_links, 3))
    scalar = np.isin(tree.joint, [Joint.REVOLUTE, Joint.PRISMATIC])
    out[:, 0] = np.where(scalar, tree.stiffness * tree.rest[:, 0], 0.0)
    ball = tree.joint == Joint.SPHERICAL
    out[ball] = tree.stiffness[ball, None] * _relaxed(tree)[ball]
    return out


def _relaxed(tree: Tree) -> Array:
    """Rotation vectors [L, 3] at which the springs of spherical joints are relaxed [rad]."""
    rest = tree.rest * np.where(tree.rest[:, :1] < 0.0, -1.0, 1.0)  # q and -q are one orientation
    sine = np.linalg.norm(rest[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(sine, rest[:, 0])
    vector: Array = rest[:, 1:] * (angle / np.maximum(sine, 1e-300))[:, None]
    return vector


def _strained(tree: Tree, torque: Array) -> Array:
    """Pre-loads [L, 3] that act with joint forces [L, 3] at joint zero, where a ball is turned by phi from its rest.

    A ball's pre-load P acts as J^-T P (`kernels.tree.articulated.held_of`), J the right Jacobian of the rotation
    vector phi:  J^T = 1 + (1 - cos|phi|) / |phi|^2 [phi] + (|phi| - sin|phi|) / |phi|^3 [phi]^2.
    """
    phi = -_relaxed(tree)
    angle = np.maximum(np.linalg.norm(phi, axis=1, keepdims=True), 1e-12)
    first = np.cross(phi / angle, torque)
    second = np.cross(phi / angle, first)
    turned = torque + (1.0 - np.cos(angle)) / angle * first + (1.0 - np.sin(angle) / angle) * second
    return np.where((tree.joint == Joint.SPHERICAL)[:, None], turned, torque)
