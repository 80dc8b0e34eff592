"""The robot arm: Kinova's Jaco 2 against C MuJoCo and Kinova's own DH tables, and arms out of URDF files."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh
from bough.sim.arms.arm import Arm, forward_kinematics
from bough.sim.arms.jaco2 import FINGER_ANGLE, jaco2
from bough.sim.arms.urdf import arm_from_urdf, enclosing_capsule
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_matrix
from bough.sim.formats.export_mesh import shape_ends
from bough.sim.formats.export_mjcf import to_mjcf
from bough.sim.trees.pose import pose
from bough.sim.trees.tree import Joint

WRISTS = ("curved", "spherical")
PI = np.pi
#: Both sides work in float64 from the same decimal text: what is left is round-off of some twenty products.
ROUND_OFF = 1e-11


@pytest.fixture(scope="module", autouse=True)
def _elsewhere(tmp_path_factory):
    """Work in a scratch folder: C MuJoCo appends its warnings to MUJOCO_LOG.TXT in the current one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("log"))
        yield


# ---- Kinova's numbers as a URDF text, which MuJoCo compiles too ------------------------------------------------------

# origin [m], roll pitch yaw [rad], limits [degrees] or None, velocity [degrees/s], torque [N m]
REACH = [
    ("0 0 0.15675", (0, PI, 0), None, 36, 40),
    ("0 0.0016 -0.11875", (-PI / 2, 0, PI), (47, 313), 36, 80),
    ("0 -0.410 0", (0, PI, 0), (19, 341), 36, 40),
    ("0 0.2073 -0.0114", (-PI / 2, 0, PI), None, 48, 20),
]
WRIST_JOINTS = {
    "curved": [("0 -0.03703 -0.06414", (PI / 3, 0, PI), None, 48, 20)] * 2,
    "spherical": [
        ("0 0 -0.10375", (PI / 2, 0, PI), (30, 330), 48, 20),
        ("0 0.10375 0", (-PI / 2, 0, PI), None, 48, 20),
    ],
}
# mass, centre of mass, axis of the cylinder, height, radius, its mass
BODIES = [
    (0.7477, "0 -0.002 -0.0605", "z", 0.14, 0.04, 0.7477),
    (0.99, "0 -0.2065 -0.01", "y", 0.35, 0.04, 0.99),
    (0.6763, "0 0.081 -0.0086", "y", 0.15, 0.03, 0.6763),
]
WRIST_BODIES = {
    "curved": [(0.426367, "0 -0.037 -0.0642", "z", 0.02, 0.04, 0.1785)] * 2,
    "spherical": [
        (0.463, "0 0.0028848942 -0.0541932613", "z", 0.1, 0.02, 0.463),
        (0.463, "0 0.0497208855 -0.0028562765", "y", 0.1, 0.02, 0.463),
    ],
}
HAND = (0.99, "0 0 -0.06", "z", 0.03, 0.04, 0.727)
FINGER = (0.01, "0.022 0 0", "z", 0.03, 0.004, 0.01)
FINGERS = [
    ("0.00279 0.03126 -0.11467", (-1.7047873384941834, 0.6476144647144773, 1.67317415161155)),
    ("0.02226 -0.02707 -0.11482", (-1.570796327, 0.649262481663582, -1.38614049188413)),
    ("-0.02226 -0.02707 -0.11482", (-1.570796327, 0.649262481663582, -1.75545216211587)),
]


def _inertial(mass, com, axis, height, radius, weight):
    across, along = weight * (3 * radius**2 + height**2) / 12, weight * radius**2 / 2
    moments = " ".join(f'i{a}{a}="{along if a == axis else across}"' for a in "xyz")
    zeros = 'ixy="0" ixz="0" iyz="0"'
    return f'<inertial><origin xyz="{com}"/><mass value="{mass}"/><inertia {moments} {zeros}/></inertial>'


def _capsule(start, end, radius):
    """Return a capsule as ROS files write it: a cylinder and two spheres."""
    across, middle = end - start, (start + end) / 2
    pitch, yaw = np.arctan2(np.hypot(*across[:2]), across[2]), np.arctan2(across[1], across[0])
    shapes = [(start, f'<sphere radius="{radius}"/>'), (end, f'<sphere radius="{radius}"/>')]
    shapes += [(middle, f'<cylinder radius="{radius}" length="{np.linalg.norm(across)}"/>')]
    item = '<collision><origin xyz="{} {} {}" rpy="0 {} {}"/><geometry>{}</geometry></collision>'
    return "".join(item.format(*at, pitch, yaw, shape) for at, shape in shapes)


def _joint(parent, child, kind, xyz="0 0 0", rpy=(0, 0, 0), inner=""):
    angles = " ".join(repr(float(a)) for a in rpy)
    return (
        f'<joint name="joint_{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{angles}"/><axis xyz="0 0 1"/>{inner}</joint>'
    )


def jaco_urdf(wrist, arm=None):
    """Write Kinova's URDF; fingers turn from 1.2 rad on. With ``arm``, its capsules are the collision shapes."""
    parts = ['<link name="world"/>', _joint("world", "base", "fixed")]
    boxes = ["" for _ in range(6)]
    for k, link in enumerate(arm.tree.shape_link if arm else ()):
        boxes[link] += _capsule(arm.tree.shape_start[k], arm.tree.shape_end[k], arm.tree.shape_radius[k, 0])
    base = _capsule(arm.base_start[0], arm.base_end[0], arm.base_radius[0]) if arm else ""
    parts.append(f'<link name="base">{_inertial(0.46784, "0 0 0.1255", "z", 0.14, 0.04, 0.46784)}{base}</link>')
    above, bodies = "base", BODIES + WRIST_BODIES[wrist] + [HAND]
    for k, (xyz, rpy, limits, speed, torque) in enumerate(REACH + WRIST_JOINTS[wrist]):
        name = ("shoulder", "arm", "forearm", "wrist_1", "wrist_2", "hand")[k]
        parts.append(f'<link name="{name}">{_inertial(*bodies[k])}{boxes[k]}</link>')
        span = "" if limits is None else 'lower="{!r}" upper="{!r}"'.format(*np.deg2rad(limits).tolist())
        limit = f'<limit effort="{torque}" velocity="{np.deg2rad(speed)}" {span}/><dynamics friction="0.01"/>'
        parts.append(_joint(above, name, "continuous" if limits is None else "revolute", xyz, rpy, limit))
        above = name
    for k, (xyz, rpy) in enumerate(FINGERS):
        parts += [f'<link name="{n}_{k}">{_inertial(*FINGER)}</link>' for n in ("finger", "tip")]
        limit = f'<limit lower="{FINGER_ANGLE}" upper="1.51" effort="2" velocity="1"/>'
        parts.append(_joint("hand", f"finger_{k}", "revolute", xyz, rpy, limit))
        parts.append(_joint(f"finger_{k}", f"tip_{k}", "fixed", "0.044 -0.003 0"))
    parts += ['<link name="end"/>', _joint("hand", "end", "fixed", "0 0 -0.16", (PI, 0, PI / 2))]
    return f'<robot name="jaco2_{wrist}">' + "\n".join(parts) + "</robot>"


@pytest.fixture(scope="module", params=WRISTS)
def case(request):
    """Give an arm of ours and MuJoCo's model of the URDF text with its fingers held."""
    text = jaco_urdf(request.param).replace(
        "</robot>", '<mujoco><compiler fusestatic="false" discardvisual="false"/></mujoco></robot>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    return jaco2(request.param), model, mujoco.MjData(model)


def _set(model, data, q):
    data.qpos[:6], data.qpos[6:] = q, FINGER_ANGLE
    mujoco.mj_forward(model, data)


def _random_q(count=20, seed=0):
    return np.random.default_rng(seed).uniform(-PI, PI, (count, 6))


# ---- the Jaco 2 ------------------------------------------------------------------------------------------------------


def test_forward_kinematics_is_mujocos(case):
    """Compare joint points, link frames and the end-effector's frame at random joint positions, in one batch."""
    arm, model, data = case
    q = _random_q()
    points, turns, (end, end_turn) = forward_kinematics(arm, q)
    assert points.shape == (20, 6, 3) and turns.shape == (20, 6, 4) and end.shape == (20, 3)
    body, tip = [model.body(name).id for name in arm.tree.link_name], model.body("end").id
    for k in range(len(q)):
        _set(model, data, q[k])
        np.testing.assert_allclose(points[k], data.xanchor[:6], atol=ROUND_OFF)
        np.testing.assert_allclose(quat_matrix(turns[k]).reshape(6, 9), data.xmat[body], atol=ROUND_OFF)
        np.testing.assert_allclose(end[k], data.xpos[tip], atol=ROUND_OFF)
        np.testing.assert_allclose(quat_matrix(end_turn[k]).ravel(), data.xmat[tip], atol=ROUND_OFF)


def test_masses_are_kinovas(case):
    """Compare the mass of every link with Kinova's table and with MuJoCo; the hand holds three fingers of 20 g."""
    arm, model, _ = case
    wrist = {"jaco2_curved": 0.426367, "jaco2_spherical": 0.463}[arm.name]
    np.testing.assert_allclose(arm.tree.mass, [0.7477, 0.99, 0.6763, wrist, wrist, 1.05], rtol=1e-12)
    np.testing.assert_allclose(arm.tree.mass.sum() + 0.46784, model.body_mass.sum(), rtol=1e-12)


def test_joint_inertia_and_gravity_torques_are_mujocos(case):
    """Compare the joint-space inertia and the torques of gravity with MuJoCo's at random joint positions.

    The joint-space inertia of the arm with still fingers is the arm's block of MuJoCo's, whose fingers move.
    """
    arm, model, data = case
    own = mujoco.MjModel.from_xml_string(to_mjcf(arm.tree))
    ours, full = mujoco.MjData(own), np.zeros((model.nv, model.nv))
    for q in _random_q():
        _set(model, data, q)
        ours.qpos[:] = q
        mujoco.mj_forward(own, ours)
        np.testing.assert_allclose(ours.qfrc_bias, data.qfrc_bias[:6], atol=1e-9)
        block = np.zeros((6, 6))
        mujoco.mj_fullM(own, block, ours.qM) if hasattr(ours, "qM") else mujoco.mj_fullM(own, ours, block)
        mujoco.mj_fullM(model, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(model, data, full)
        np.testing.assert_allclose(block, full[:6, :6], atol=1e-9)


def test_gravity_on_a_stretched_arm_by_hand():
    """Hold the arm straight out: joint 2 carries sum m g x, with the centres of mass of Kinova's table.

    With joints 1 to 6 at 180, 90, 180, 180, 180, 180 degrees the arm of the spherical wrist lies level, and only the
    lengths along it count. The fingers' centre of mass is taken from the model: 1.05 kg of hand and fingers.
    """
    arm = jaco2("spherical")
    q = np.deg2rad([180.0, 90.0, 180.0, 180.0, 180.0, 180.0])
    points, _, (end, _) = forward_kinematics(arm, q)
    assert abs(end[2] - points[1, 2]) < 0.01  # level but for the offset of 9.8 mm
    across = np.array([0.2065, 0.41 + 0.081, 0.41 + 0.2073 + 0.0541932613, 0.41 + 0.2073 + 0.10375 + 0.0497208855])
    hand = 0.41 + 0.2073 + 2 * 0.10375 - arm.tree.com[5, 2]
    expected = 9.81 * (np.array([0.99, 0.6763, 0.463, 0.463, 1.05]) @ [*across, hand])
    model = mujoco.MjModel.from_xml_string(to_mjcf(arm.tree))
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(abs(data.qfrc_bias[1]), expected, rtol=1e-6)
    assert expected < arm.torque_limit[1]  # it can hold itself


def _dh(theta, d, a, alpha):
    """Classic Denavit-Hartenberg matrix: Rz(theta) Tz(d) Tx(a) Rx(alpha)."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])


def _dh_table(wrist, D4):
    """Rows d, a, alpha, sign, offset of the driver's table; ``D4`` is both lengths of the wrist [m]."""
    D1, D2, D3, e2, D5, D6 = 0.2755, 0.41, 0.2073, 0.0098, D4, 0.16
    if wrist == "curved":
        k = np.sin(PI / 6) / np.sin(PI / 3)
        d, sign = (D1, 0, -e2, -(D3 + k * D4), -k * (D4 + D5), -(k * D5 + D6)), (-1, 1, 1, 1, 1, 1)
        alpha, offset = (PI / 2, PI, PI / 2, PI / 3, PI / 3, PI), (0, -PI / 2, PI / 2, 0, -PI, PI / 2)
    else:
        d, sign = (-D1, 0, -e2, -(D3 + D4), 0, -(D5 + D6)), (1,) * 6
        alpha, offset = (PI / 2, PI, PI / 2, PI / 2, PI / 2, PI), (-PI, PI / 2, PI / 2, 0, 0, -PI / 2)
    return zip(d, (0, D2, 0, 0, 0, 0), alpha, sign, offset, strict=True)


@pytest.mark.parametrize(
    ("wrist", "D4", "tolerance"),
    [
        # The tables' wrist lengths are rounded to 0.1 mm: up to 0.05 mm each, and two of them are added.
        ("curved", 0.0741, 1.2e-4),
        ("spherical", 0.1038, 1.2e-4),
        # The length in the joint frames' own digits. The curved wrist's origin (-0.03703, -0.06414) is its chord
        # sqrt(3) h (sin 30, cos 30), h = 0.04276, rounded to 10 um a coordinate: 1.2 um off, and there are two.
        ("curved", np.sqrt(3) * 0.04276, 2.5e-6),
        ("spherical", 0.10375, 1e-12),
    ],
)
def test_forward_kinematics_is_kinovas_dh_table(wrist, D4, tolerance):
    """Compare the end-effector with the driver's classic DH table, theta = sign q + offset.

    The table ends in the end-effector's frame of the URDF. It starts in the base frame for the curved wrist, and in
    the base frame turned by 180 degrees about x for the spherical one (whose d1 is -D1).
    """
    arm = jaco2(wrist)
    angles = _random_q(40, seed=1)
    _, _, (ends, turns) = forward_kinematics(arm, angles)
    for q, end, turn in zip(angles, ends, turns, strict=True):
        T = np.diag([1.0, 1.0, 1.0, 1.0] if wrist == "curved" else [1.0, -1.0, -1.0, 1.0])
        for angle, (d, a, alpha, sign, offset) in zip(q, _dh_table(wrist, D4), strict=True):
            T = T @ _dh(sign * angle + offset, d, a, alpha)
        np.testing.assert_allclose(end, T[:3, 3], atol=tolerance)
        np.testing.assert_allclose(quat_matrix(turn), T[:3, :3], atol=1e-12)


def test_limits_are_kinovas():
    """Compare limits with the table, in degrees: joints 2 and 3, and 5 of the spherical wrist, are limited."""
    free = (-np.inf, np.inf)
    for wrist, fifth in (("curved", free), ("spherical", (30, 330))):
        arm = jaco2(wrist)
        found = np.rad2deg(np.stack([arm.lower, arm.upper], axis=1))
        np.testing.assert_allclose(found, [free, (47, 313), (19, 341), free, fifth, free])
        np.testing.assert_allclose(np.rad2deg(arm.velocity_limit), [36, 36, 36, 48, 48, 48])
        np.testing.assert_array_equal(arm.torque_limit, [40, 80, 40, 20, 20, 20])
        np.testing.assert_array_equal(arm.gain, np.full(6, 80.0))
        np.testing.assert_array_equal(arm.friction, np.full(6, 0.01))


def test_both_wrists_start_with_the_hand_at_one_place():
    """Find the hand at the same pose at home, to the five digits that the spherical wrist's home is written in."""
    (p, r), (a, b) = (forward_kinematics(jaco2(w), jaco2(w).home)[2] for w in WRISTS)
    np.testing.assert_allclose(p, a, atol=1e-4)
    np.testing.assert_allclose(quat_matrix(r), quat_matrix(b), atol=1e-4)
    assert 0.2 < np.linalg.norm(p) < 0.9 and p[2] > 0.2


def _gap(a, b):
    """Least distance of two capsules (start, end, radius), by 400 points on each axis: to 1 mm for half a metre."""
    s = np.linspace(0.0, 1.0, 400)[:, None]
    x, y = (c[0] + s * (c[1] - c[0]) for c in (a, b))
    return np.linalg.norm(x[:, None] - y[None], axis=2).min() - a[2] - b[2]


@pytest.mark.parametrize("wrist", WRISTS)
def test_capsules_cover_every_link_without_gaps(wrist):
    """Hold a capsule on each link, the hand's four last; neighbours overlap, and at home no others touch."""
    arm = jaco2(wrist)
    start, end = shape_ends(arm.tree, pose(arm.tree, arm.home))
    np.testing.assert_array_equal(arm.tree.shape_link, [0, 1, 2, 3, 4, 5, 5, 5, 5])
    capsules = [(*c, -1) for c in zip(arm.base_start, arm.base_end, arm.base_radius, strict=True)]
    capsules += zip(start, end, arm.tree.shape_radius[:, 0], arm.tree.shape_link, strict=True)
    for k in range(6):
        assert _gap(capsules[k], capsules[k + 1]) < 0  # base, then link after link to the palm
    for finger in capsules[-3:]:
        assert _gap(finger, capsules[6]) < 0
    for a in capsules:
        for b in capsules:
            if b[3] - a[3] >= 2:
                assert _gap(a, b) > 0, (a[3], b[3])


def test_another_wrist_is_refused():
    """Name the wrists that there are."""
    with pytest.raises(InputError, match=r"^jaco2: wrist: found 'bent'; allowed: curved or spherical$"):
        jaco2("bent")


# ---- what an arm must be ---------------------------------------------------------------------------------------------

BAD_ARMS = {
    "shape": ({"gain": np.ones(5)}, "gain: found numbers of shape (5,)"),
    "nan": ({"friction": np.full(6, np.nan)}, "friction"),
    "infinite torque": ({"torque_limit": np.full(6, np.inf)}, "torque_limit"),
    "crossed limits": ({"lower": np.full(6, 9.0), "home": np.full(6, 9.0)}, "lower below an upper"),
    "home outside": ({"home": np.zeros(6)}, "joint of link arm: found home 0 rad"),
    "no speed": ({"velocity_limit": np.zeros(6)}, "velocity limit 0 rad/s"),
    "no torque": ({"torque_limit": np.zeros(6)}, "torque limit 0 N m"),
    "negative gain": ({"gain": -np.ones(6)}, "gain -1"),
    "negative friction": ({"friction": -np.ones(6)}, "friction -1"),
    "end link": ({"end_link": 6}, "end_link: found 6; allowed: 0 to 5"),
    "end rotation": ({"end_rotation": np.ones(4)}, "end_rotation"),
    "base radius": ({"base_radius": np.zeros(1)}, "radius of zero"),
    "base shape": ({"base_start": np.zeros((2, 3))}, "base_start"),
}
BAD_TREES = {
    "branch": ({"parent": [-1, 0, 1, 2, 2, 4]}, "link wrist_2: found parent number 2"),
    "ball": ({"joint": [1, 1, 2, 1, 1, 1]}, "link forearm: found a spherical joint"),
    "weightless": ({"mass": [1, 1, 1, 0, 1, 1]}, "link wrist_1: found no mass"),
    "spring": ({"stiffness": [0, 0, 0, 0, 0, 1]}, "link hand: found a joint spring"),
}


@pytest.mark.parametrize("case", [*BAD_ARMS, *BAD_TREES])
def test_what_is_no_arm_is_refused_in_one_line(case):
    """Refuse an arm with the name of the link or field, what was found and what is allowed."""
    arm = jaco2()
    change, found = BAD_ARMS[case] if case in BAD_ARMS else BAD_TREES[case]
    with pytest.raises(InputError) as e:
        replace(arm, **(change if case in BAD_ARMS else {"tree": arm.tree.with_(**change)}))
    assert "\n" not in str(e.value) and str(e.value).startswith("jaco2_curved: ") and found in str(e.value)


def test_arm_without_capsules_is_refused():
    """Refuse an arm that would pass through everything."""
    arm = jaco2()
    none = {"shape_link": [], "shape_start": np.zeros((0, 3)), "shape_end": np.zeros((0, 3)), "shape_radius": []}
    none["shape_radius"] = np.zeros((0, 2))
    with pytest.raises(InputError, match="no collision shape"):
        replace(arm, tree=arm.tree.with_(**none))


# ---- URDF ------------------------------------------------------------------------------------------------------------


def _write(tmp_path, text, name="arm.urdf"):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("wrist", WRISTS)
def test_urdf_of_the_jaco_gives_the_jaco(tmp_path, wrist):
    """Read Kinova's URDF with our capsules: the same arm to round-off; fingers stay at their limit next to zero."""
    arm = jaco2(wrist)
    read = arm_from_urdf(_write(tmp_path, jaco_urdf(wrist, arm)), "end")
    q = _random_q()
    for ours, theirs in zip(_flat(forward_kinematics(arm, q)), _flat(forward_kinematics(read, q)), strict=True):
        np.testing.assert_allclose(theirs, ours, atol=ROUND_OFF)
    for key in ("lower", "upper", "velocity_limit", "torque_limit", "gain", "friction"):
        np.testing.assert_allclose(getattr(read, key), getattr(arm, key), rtol=1e-12)
    for key in ("mass", "com", "inertia", "shape_link", "shape_start", "shape_end", "shape_radius"):
        np.testing.assert_allclose(getattr(read.tree, key), getattr(arm.tree, key), atol=1e-12, err_msg=key)
    for key in ("base_start", "base_end", "base_radius"):
        np.testing.assert_allclose(getattr(read, key), getattr(arm, key), atol=1e-12)
    np.testing.assert_allclose(read.home, [0, PI, PI, 0, PI if wrist == "spherical" else 0, 0])


def _flat(kinematics):
    """List joint points, link rotations, end-effector position and rotation; rotations as matrices."""
    points, turns, (end, end_turn) = kinematics
    return points, quat_matrix(turns), end, quat_matrix(end_turn)


BODY = '<inertial><mass value="{}"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
BALL = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
LIMIT = '<limit effort="5" velocity="2" lower="-1" upper="1"/>'


def _link(name, mass=1.0, shape=BALL):
    return f'<link name="{name}">{BODY.format(mass)}{shape}</link>'


def _robot(*parts):
    return '<robot name="r">\n' + "\n".join(parts) + "\n</robot>"


def test_fixed_links_become_part_of_their_carrier(tmp_path):
    """Merge by hand: two masses of 1 and 3 kg, 0.4 m apart, on one link; a fixed link of the base; a base frame.

    The joint sits on a fixed column at (0, 0, 1); its link carries a bracket at (0.4, 0, 0), turned by 90 degrees
    about z, whose tool is at (0.1, 0, 0) of the bracket, so at (0.4, 0.1, 0) of the link. About the common centre of
    mass, at 0.3 m, I = 2 + d^2 (1 0.09 + 3 0.01) across x and 2 along it.
    """
    text = _robot(
        _link("base", shape=""), _link("column"), _link("upper"), _link("bracket", 3.0), '<link name="tool"/>',
        _joint("base", "column", "fixed", "0 0 1"),
        _joint("column", "upper", "revolute", inner=LIMIT + '<dynamics damping="0.5" friction="0.2"/>'),
        _joint("upper", "bracket", "fixed", "0.4 0 0", (0, 0, PI / 2)),
        _joint("bracket", "tool", "fixed", "0.1 0 0"),
    )  # fmt: skip
    arm = arm_from_urdf(_write(tmp_path, text))
    assert arm.tree.link_name == ["upper"] and arm.tree.joint[0] == Joint.REVOLUTE
    np.testing.assert_allclose(arm.tree.position, [[0, 0, 1]])
    np.testing.assert_allclose(arm.tree.mass, [4.0])
    np.testing.assert_allclose(arm.tree.com, [[0.3, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(arm.tree.inertia[0], np.diag([2.0, 2.12, 2.12]), atol=1e-14)
    np.testing.assert_allclose(arm.tree.shape_start, [[0, 0, 0], [0.4, 0, 0]], atol=1e-15)
    np.testing.assert_allclose(arm.base_start, [[0, 0, 1]])
    np.testing.assert_allclose(arm.base_radius, [0.1])
    np.testing.assert_allclose(arm.end_position, [0.4, 0.1, 0], atol=1e-15)
    np.testing.assert_allclose(quat_matrix(arm.end_rotation) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose([arm.friction[0], arm.tree.damping[0], arm.home[0]], [0.2, 0.5, 0.0])


def test_end_link_picks_a_chain_and_holds_the_rest(tmp_path):
    """Take either of two chains on one link; the other, a slide that mimics, stays still as part of its carrier."""
    text = _robot(
        *(_link(n) for n in "abcd"),
        _joint("a", "b", "revolute", inner=LIMIT),
        _joint("b", "c", "revolute", "0 0 1", inner=LIMIT),
        _joint("b", "d", "prismatic", "1 0 0", inner=LIMIT.replace('lower="-1"', 'lower="0.5"') + '<mimic joint="x"/>'),
    )
    path = _write(tmp_path, text)
    assert arm_from_urdf(path, "b").tree.link_name == ["b"]
    arm = arm_from_urdf(path, "c")
    assert arm.tree.link_name == ["b", "c"]
    np.testing.assert_allclose(arm.tree.mass, [2, 1])
    np.testing.assert_allclose(arm.tree.com[0], [0.5, 0, 0.25])  # the slide stands at its limit nearest to zero
    with pytest.raises(InputError, match="a prismatic joint"):
        arm_from_urdf(path, "d")


def test_collision_shapes_become_capsules(tmp_path):
    """Take cylinder, sphere, box and mesh; a package's mesh is looked for in folders above the file."""
    (tmp_path / "my_robot" / "meshes").mkdir(parents=True)
    trimesh.creation.capsule(height=0.5, radius=0.05).export(tmp_path / "my_robot" / "meshes" / "rod.stl")
    item = '<collision><origin xyz="0 0 2"/><geometry>{}</geometry></collision>'
    shapes = ('<cylinder radius="0.1" length="0.6"/>', '<sphere radius="0.2"/>', '<box size="0.06 0.08 1"/>')
    shapes += ('<mesh filename="package://my_robot/meshes/rod.stl" scale="2 2 2"/>',)
    links = [_link(n, shape=item.format(s)) for n, s in zip("bcde", shapes, strict=True)]
    joints = [_joint(a, b, "revolute", inner=LIMIT) for a, b in zip("abcd", "bcde", strict=True)]
    arm = arm_from_urdf(_write(tmp_path / "my_robot", _robot(_link("a"), *links, *joints)))
    tree = arm.tree
    np.testing.assert_array_equal(tree.shape_link, [0, 1, 2, 3])
    np.testing.assert_allclose(tree.shape_radius[:, 0], [0.1, 0.2, 0.05, 0.1], rtol=1e-3)  # the mesh has facets
    middle = (tree.shape_start + tree.shape_end) / 2
    np.testing.assert_allclose(middle, [[0, 0, 2]] * 4, atol=1e-6)
    half = np.abs(tree.shape_end - tree.shape_start) / 2
    # the box's corners lie on the capsule's cylinder: its half-spheres bulge beyond the box
    np.testing.assert_allclose(half, [[0, 0, 0.3], [0, 0, 0], [0, 0, 0.5], [0, 0, 0.5]], atol=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_enclosing_capsule_encloses(seed):
    """Hold random points, flat or straight clouds too, inside to round-off, and touch at least one."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(40, 3)) * [(1, 1, 1), (3, 1, 0.1), (1, 1, 0), (1, 1e-3, 0)][seed % 4]
    points = points @ quat_matrix(_unit(rng.normal(size=4))).T + rng.normal(size=3)
    start, end, radius = enclosing_capsule(points)
    along = end - start
    share = np.clip((points - start) @ along / max(along @ along, 1e-300), 0, 1)
    distance = np.linalg.norm(points - start - share[:, None] * along, axis=1)
    np.testing.assert_allclose(distance.max(), radius, rtol=1e-9)


def _unit(v):
    return v / np.linalg.norm(v)


TWO = (_link("a"), _link("b"))
BAD_URDF = {
    "missing link": ((*TWO, _joint("b", "c", "revolute", inner=LIMIT)), None, "'c', which does not exist"),
    "prismatic": ((*TWO, _joint("a", "b", "prismatic", inner=LIMIT)), None, "found a prismatic joint"),
    "mimic": ((*TWO, _joint("a", "b", "revolute", inner=LIMIT + '<mimic joint="x"/>')), None, "<mimic> in the chain"),
    "no inertial": (
        (_link("a"), f'<link name="b">{BALL}</link>', _joint("a", "b", "revolute", inner=LIMIT)),
        None,
        "link b: found no mass",
    ),
    "planar": ((*TWO, _joint("a", "b", "planar")), None, "type='planar'"),
    "loop": (
        (*TWO, _joint("a", "b", "revolute", inner=LIMIT), _joint("b", "a", "revolute", inner=LIMIT)),
        None,
        "closed loop",
    ),
    "two parents": (
        (*TWO, _link("c"), *(_joint(p, "c", "revolute", inner=LIMIT).replace("joint_c", p) for p in "ab")),
        None,
        "a second joint to link 'c'",
    ),
    "branching": (
        (*TWO, _link("c"), *(_joint("a", c, "revolute", inner=LIMIT) for c in "bc")),
        None,
        "branching chain: 'b' and 'c' both move on the base",
    ),
    "branching later": (
        (*TWO, _link("c"), _link("d"), *(_joint(p, c, "revolute", inner=LIMIT) for p, c in ("ab", "bc", "bd"))),
        None,
        "'c' and 'd' both move on link 'b'",
    ),
    "no joint": ((_link("a"),), None, "no joint that moves"),
    "fixed only": ((*TWO, _joint("a", "b", "fixed")), None, "no joint that moves"),
    "end link on the base": ((*TWO, _joint("a", "b", "revolute", inner=LIMIT)), "a", "end_link a: found no joint"),
    "no such end link": ((*TWO, _joint("a", "b", "revolute", inner=LIMIT)), "x", "end_link: found 'x'"),
    "no limit": ((*TWO, _joint("a", "b", "revolute")), None, "no <limit>"),
    "no effort": ((*TWO, _joint("a", "b", "continuous", inner='<limit velocity="1"/>')), None, "'effort'"),
    "no velocity": ((*TWO, _joint("a", "b", "continuous", inner='<limit effort="1"/>')), None, "'velocity'"),
    "effort zero": ((*TWO, _joint("a", "b", "continuous", inner='<limit effort="0" velocity="1"/>')), None, "effort 0"),
    "no range": ((*TWO, _joint("a", "b", "revolute", inner='<limit effort="1" velocity="1"/>')), None, "upper 0 rad"),
    "no mass": (
        (_link("a"), _link("b", 0.0), _joint("a", "b", "revolute", inner=LIMIT)),
        None,
        "link b: found no mass",
    ),
    "nothing to touch": (
        (_link("a"), _link("b", shape=""), _joint("a", "b", "revolute", inner=LIMIT)),
        None,
        "no <collision>",
    ),
    "missing mesh": (
        (
            _link("a"),
            _link("b", shape='<collision><geometry><mesh filename="gone.stl"/></geometry></collision>'),
            _joint("a", "b", "revolute", inner=LIMIT),
        ),
        None,
        "gone.stl",
    ),
    "ball of no size": (
        (_link("a"), _link("b", shape=BALL.replace("0.1", "0")), _joint("a", "b", "revolute", inner=LIMIT)),
        None,
        "radius='0'",
    ),
    "flat box": (
        (
            _link("a"),
            _link("b", shape='<collision><geometry><box size="1 0 1"/></geometry></collision>'),
            _joint("a", "b", "revolute", inner=LIMIT),
        ),
        None,
        "size='1 0 1'",
    ),
    "no shape": (
        (
            _link("a"),
            _link("b", shape="<collision><geometry/></collision>"),
            _joint("a", "b", "revolute", inner=LIMIT),
        ),
        None,
        "no known shape",
    ),
}


@pytest.mark.parametrize("case", BAD_URDF)
def test_bad_urdf_gives_one_line(tmp_path, case):
    """Refuse the file with one line that names it, the place and what was found."""
    parts, end_link, found = BAD_URDF[case]
    with pytest.raises(InputError) as e:
        arm_from_urdf(_write(tmp_path, _robot(*parts)), end_link)
    message = str(e.value)
    assert "\n" not in message and "arm.urdf: " in message and found in message and "allowed: " in message


def test_unreadable_mesh_is_refused(tmp_path):
    """Name the mesh that is no mesh."""
    (tmp_path / "bad.stl").write_bytes(b"solid nothing")
    shape = '<collision><geometry><mesh filename="bad.stl"/></geometry></collision>'
    text = _robot(_link("a"), _link("b", shape=shape), _joint("a", "b", "revolute", inner=LIMIT))
    with pytest.raises(InputError, match=r"bad\.stl") as e:
        arm_from_urdf(_write(tmp_path, text))
    assert "\n" not in str(e.value)


def test_a_read_arm_is_an_arm(tmp_path):
    """Exchange a field of a read arm: the checks run again."""
    arm = arm_from_urdf(_write(tmp_path, _robot(*TWO, _joint("a", "b", "revolute", inner=LIMIT))))
    assert isinstance(replace(arm, gain=[20.0]), Arm)
    with pytest.raises(InputError, match="gain"):
        replace(arm, gain=[-20.0])
