"""The Kinova Jaco 2 with six joints and three fingers, in both of its wrists.

Joint frames, limits and masses are facts of Kinova's own description (github.com/Kinovarobotics/kinova-ros, commit
924781d3df: kinova_description/urdf/j2n6s300.xacro, j2s6s300.xacro, kinova_inertial.xacro, kinova_finger_set.xacro).
The capsules were fitted here to the surfaces of its meshes; docs/arm.md says how well.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..base.errors import InputError
from ..base.rotation import axis_angle_quat, quat_multiply, quat_rotate
from ..base.types import Array
from ..trees.inertia import MassProperties, combined
from ..trees.tree import Joint, Tree
from .arm import SERVO_GAIN, Arm

PI = np.pi
LINKS = ("shoulder", "arm", "forearm", "wrist_1", "wrist_2", "hand")
WRISTS = ("curved", "spherical")

Frame = tuple[tuple[float, float, float], tuple[float, float, float]]

# Joint frames in the frame of the link before: origin [m]; roll, pitch, yaw [rad]. All joints turn about local z.
_REACH: list[Frame] = [
    ((0.0, 0.0, 0.15675), (0.0, PI, 0.0)),
    ((0.0, 0.0016, -0.11875), (-PI / 2, 0.0, PI)),
    ((0.0, -0.410, 0.0), (0.0, PI, 0.0)),
    ((0.0, 0.2073, -0.0114), (-PI / 2, 0.0, PI)),
]
_WRIST: dict[str, list[Frame]] = {
    "curved": [((0.0, -0.03703, -0.06414), (PI / 3, 0.0, PI))] * 2,
    "spherical": [((0.0, 0.0, -0.10375), (PI / 2, 0.0, PI)), ((0.0, 0.10375, 0.0), (-PI / 2, 0.0, PI))],
}
_END: Frame = ((0.0, 0.0, -0.16), (PI, 0.0, PI / 2))

# Limits of joints 2 and 3, and of joint 5 of the spherical wrist [degrees]; the others turn without end. Kinova's
# +-360 degrees of those are properties that its URDF does not write.
_LIMITS = {"curved": {1: (47, 313), 2: (19, 341)}, "spherical": {1: (47, 313), 2: (19, 341), 4: (30, 330)}}
_SPEED = (36, 36, 36, 48, 48, 48)  # degrees/s
_TORQUE = (40, 80, 40, 20, 20, 20)  # N m
_FRICTION = 0.01  # N m: the thesis, chapter 4; Kinova's description has none

# Mass [kg], centre of mass [m], and the solid cylinder that the inertia is taken of: axis, height [m], radius [m],
# mass [kg]. Where Kinova's cylinder has another mass than its link (curved wrist, hand), both are taken as they are
# written, so that this arm moves as the URDF does in other simulators.
_Inertial = tuple[float, tuple[float, float, float], int, float, float, float]
_BODY: list[_Inertial] = [
    (0.7477, (0.0, -0.002, -0.0605), 2, 0.14, 0.04, 0.7477),
    (0.99, (0.0, -0.2065, -0.01), 1, 0.35, 0.04, 0.99),
    (0.6763, (0.0, 0.081, -0.0086), 1, 0.15, 0.03, 0.6763),
]
_WRIST_BODY: dict[str, list[_Inertial]] = {
    "curved": [(0.426367, (0.0, -0.037, -0.0642), 2, 0.02, 0.04, 0.1785)] * 2,
    "spherical": [
        (0.463, (0.0, 0.0028848942, -0.0541932613), 2, 0.1, 0.02, 0.463),
        (0.463, (0.0, 0.0497208855, -0.0028562765), 1, 0.1, 0.02, 0.463),
    ],
}
_HAND: _Inertial = (0.99, (0.0, 0.0, -0.06), 2, 0.03, 0.04, 0.727)
_PHALANX: _Inertial = (0.01, (0.022, 0.0, 0.0), 2, 0.03, 0.004, 0.01)

# Fingers: where each turns on the hand, and where its tip turns on it. They are not driven: held at `FINGER_ANGLE`.
_FINGERS: list[Frame] = [
    ((0.00279, 0.03126, -0.11467), (-1.7047873384941834, 0.6476144647144773, 1.67317415161155)),
    ((0.02226, -0.02707, -0.11482), (-1.570796327, 0.649262481663582, -1.38614049188413)),
    ((-0.02226, -0.02707, -0.11482), (-1.570796327, 0.649262481663582, -1.75545216211587)),
]
_TIP = (0.044, -0.003, 0.0)
FINGER_ANGLE = 1.2
"""Angle of the fingers [rad]: "Close" in Kinova's MoveIt configuration. Open, they would span 0.2 m and hook twigs."""

# Capsules: ends of the axis in the body frame and radius [m].
_Capsule = tuple[tuple[float, float, float], tuple[float, float, float], float]
_BASE_CAPSULE: _Capsule = ((0.0, 0.0, 0.041), (0.0, 0.0, 0.157), 0.041)
_SHAPES: list[list[_Capsule]] = [
    [((0.0, 0.0, 0.0), (0.0, 0.0, -0.119), 0.041)],
    [((0.0, 0.009, -0.0215), (0.0, -0.419, -0.0215), 0.032)],
    [((0.0, -0.009, -0.0215), (0.0, 0.207, -0.0114), 0.032)],
]
_WRIST_SHAPES: dict[str, list[list[_Capsule]]] = {
    "curved": [[((0.0, 0.0, 0.0), (0.0, -0.037, -0.064), 0.0315)]] * 2,
    "spherical": [
        [((0.0, 0.004, 0.0), (0.0, 0.02, -0.104), 0.0315)],
        [((0.0, 0.0, -0.02), (0.0, 0.104, -0.004), 0.0315)],
    ],
}
_PALM: _Capsule = ((0.0, 0.0, -0.035), (0.0, 0.0, -0.075), 0.046)
_FINGER_CAPSULE: _Capsule = ((-0.004, -0.008, 0.0), (0.076, -0.008, 0.0), 0.0115)

# "Home" of Kinova's MoveIt configuration of the curved wrist; for the spherical one, which has none there, the joint
# positions that put the hand at the same place and orientation.
_HOME = {
    "curved": (4.8046852, 2.92482, 1.002, 4.2031852, 1.4458, 1.3233),
    "spherical": (4.95084, 2.81687, 0.75149, 4.64141, 4.50657, 5.01627),
}


def jaco2(wrist: Literal["curved", "spherical"] = "curved") -> Arm:
    """Return the Jaco 2 with six joints, its hand of three still fingers included.

    Joint torques act on the links alone: the description gives no rotor inertia to reflect through its gear (ratio
    160), so the armature is zero. The speeds of the arm are small and its servo stiff, so little depends on it.

    Args:
        wrist: ``curved`` (60 degree wrist, Kinova's j2n6s300) or ``spherical`` (j2s6s300).

    Returns:
        Links, capsules, joint limits [rad], speeds [rad/s] and torques [N m], and the servo's gain [N m s/rad].

    Raises:
        InputError: Another wrist.
    """
    if wrist not in WRISTS:
        raise InputError("jaco2", "wrist", repr(wrist), " or ".join(WRISTS))
    bounds = np.array([_LIMITS[wrist].get(i, (-np.inf, np.inf)) for i in range(6)])
    return Arm(
        name=f"jaco2_{wrist}",
        tree=_tree(wrist),
        lower=np.deg2rad(bounds[:, 0]),
        upper=np.deg2rad(bounds[:, 1]),
        velocity_limit=np.deg2rad(_SPEED),
        torque_limit=np.array(_TORQUE),
        gain=np.full(6, SERVO_GAIN),
        friction=np.full(6, _FRICTION),
        end_link=5,
        end_position=np.array(_END[0]),
        end_rotation=_quaternion(_END),
        home=np.array(_HOME[wrist]),
        base_start=np.array([_BASE_CAPSULE[0]]),
        base_end=np.array([_BASE_CAPSULE[1]]),
        base_radius=np.array([_BASE_CAPSULE[2]]),
    )


def _tree(wrist: str) -> Tree:
    frames = _REACH + _WRIST[wrist]
    bodies = [_mass(b) for b in _BODY + _WRIST_BODY[wrist]] + [_hand()]
    capsules = [(i, *c) for i, own in enumerate([*_SHAPES, *_WRIST_SHAPES[wrist], _hand_shapes()]) for c in own]
    link, start, end, radius = zip(*capsules, strict=True)
    return Tree(
        name=f"jaco2_{wrist}",
        link_name=list(LINKS),
        parent=np.arange(-1, 5),
        joint=np.full(6, Joint.REVOLUTE),
        position=np.array([f[0] for f in frames]),
        rotation=np.array([_quaternion(f) for f in frames]),
        mass=np.array([b.mass for b in bodies]),
        com=np.array([b.com for b in bodies]),
        inertia=np.array([b.inertia for b in bodies]),
        stiffness=np.zeros(6),
        damping=np.zeros(6),
        shape_link=np.array(link),
        shape_start=np.array(start),
        shape_end=np.array(end),
        shape_radius=np.repeat(np.array(radius)[:, None], 2, axis=1),
    )


def _quaternion(frame: Frame) -> Array:
    """Orientation w, x, y, z of a frame: roll, pitch, yaw about fixed x, y, z."""
    roll, pitch, yaw = (axis_angle_quat(e, np.array(a)) for e, a in zip(np.eye(3), frame[1], strict=True))
    return quat_multiply(quat_multiply(yaw, pitch), roll)


def _mass(inertial: _Inertial) -> MassProperties:
    """Mass properties of a link: I = m (3 r^2 + h^2)/12 across its cylinder and m r^2/2 along it."""
    mass, com, axis, height, radius, weight = inertial
    across, along = weight * (3 * radius**2 + height**2) / 12, weight * radius**2 / 2
    return MassProperties(mass, np.array(com), np.diag([along if k == axis else across for k in range(3)]))


def _finger_poses() -> list[tuple[Array, Array]]:
    """Frames of the fingers in the hand's frame, turned to `FINGER_ANGLE`."""
    turn = axis_angle_quat(np.array([0.0, 0.0, 1.0]), np.array(FINGER_ANGLE))
    return [(np.array(f[0]), quat_multiply(_quaternion(f), turn)) for f in _FINGERS]


def _hand() -> MassProperties:
    """Hand and fingers as one body."""
    tip = MassProperties(_PHALANX[0], np.array(_TIP) + _PHALANX[1], _mass(_PHALANX).inertia)
    return combined([_mass(_HAND)] + [part.placed(at) for at in _finger_poses() for part in (_mass(_PHALANX), tip)])


def _hand_shapes() -> list[_Capsule]:
    def placed(at: tuple[Array, Array], point: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return a finger's point [m] in the hand's frame; the finger's pose is its place and its turn."""
        x, y, z = at[0] + quat_rotate(at[1], np.array(point))
        return float(x), float(y), float(z)

    start, end, radius = _FINGER_CAPSULE
    return [_PALM, *((placed(at, start), placed(at, end), radius) for at in _finger_poses())]
