"""Import of MJCF and URDF against C MuJoCo, which compiles the same files."""

from __future__ import annotations

import re

import mujoco
import newton
import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_matrix
from bough.sim.formats.export_mjcf import to_mjcf
from bough.sim.formats.export_urdf import to_urdf
from bough.sim.formats.import_mjcf import Mechanism, load_mjcf
from bough.sim.formats.import_urdf import load_urdf
from bough.sim.trees.pose import pose
from bough.sim.trees.tree import Joint
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.random_mjcf import RandomMjcf
from oracles.random_tree import random_tree

# Both sides work in float64 from the same decimal text; what is left is round-off of a few operations on values of
# size one, and MuJoCo's own diagonalisation of inertia tensors.
ROUND_OFF = 1e-11
#: What tests of bodies, joints and poses are not about.
ASIDE = ("limits", "contacts", "actuators")


@pytest.fixture(scope="module", autouse=True)
def _elsewhere(tmp_path_factory):
    """Work in a scratch folder: C MuJoCo appends its warnings to MUJOCO_LOG.TXT in the current one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("log"))
        yield


def _write(tmp_path, text, name="model.xml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def _load(tmp_path, body="", before="", **attributes):
    options = " ".join(f'{k}="{v}"' for k, v in attributes.items())
    text = f"<mujoco {options}>\n{before}\n<worldbody>\n{body}\n</worldbody></mujoco>"
    return load_mjcf(_write(tmp_path, text), ASIDE)


def _random_qpos(rng, m):
    qpos = rng.normal(size=m.nq)
    for start in m.jnt_qposadr[m.jnt_type == mujoco.mjtJoint.mjJNT_BALL]:
        qpos[start : start + 4] /= np.linalg.norm(qpos[start : start + 4])
    return qpos


def _own_links(mechanism: Mechanism) -> list[int]:
    return [i for i, name in enumerate(mechanism.tree.link_name) if ":" not in name]


def _compare_bodies(mechanism, m):
    tree, own = mechanism.tree, _own_links(mechanism)
    assert len(own) == m.nbody - 1
    for link, body in zip(own, range(1, m.nbody), strict=True):
        assert m.body(body).name in ("", tree.link_name[link])
    np.testing.assert_allclose(tree.mass[own], m.body_mass[1:], rtol=ROUND_OFF)
    np.testing.assert_allclose(tree.com[own], m.body_ipos[1:], atol=ROUND_OFF)
    R = quat_matrix(m.body_iquat[1:])
    inertia = np.einsum("bij,bj,bkj->bik", R, m.body_inertia[1:], R)
    scale = np.abs(inertia).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(tree.inertia[own] / scale, inertia / scale, atol=ROUND_OFF)
    np.testing.assert_allclose(tree.mass.sum(), m.body_mass.sum(), rtol=ROUND_OFF)


def _compare_joints(mechanism, m):
    tree = mechanism.tree
    moving = np.flatnonzero(tree.joint != Joint.FIXED)
    kinds = {0: None, 1: Joint.SPHERICAL, 2: Joint.PRISMATIC, 3: Joint.REVOLUTE}
    assert [kinds[k] for k in m.jnt_type] == list(tree.joint[moving])
    scalar = m.jnt_type >= 2
    np.testing.assert_allclose(tree.anchor[moving], m.jnt_pos, atol=ROUND_OFF)
    np.testing.assert_allclose(tree.axis[moving][scalar], m.jnt_axis[scalar], atol=ROUND_OFF)
    np.testing.assert_allclose(tree.stiffness[moving], m.jnt_stiffness, rtol=ROUND_OFF)
    np.testing.assert_allclose(tree.damping[moving], m.dof_damping[m.jnt_dofadr], rtol=ROUND_OFF)
    np.testing.assert_allclose(tree.armature[moving], m.dof_armature[m.jnt_dofadr], rtol=ROUND_OFF)
    rest = m.qpos_spring[m.jnt_qposadr[scalar]]
    np.testing.assert_allclose(tree.rest[moving][scalar, 0], rest, atol=ROUND_OFF)
    np.testing.assert_allclose(mechanism.qpos0, m.qpos0, atol=ROUND_OFF)


def _compare_poses(mechanism, m, rng):
    own, data = _own_links(mechanism), mujoco.MjData(m)
    for _ in range(2):
        data.qpos[:] = _random_qpos(rng, m)
        mujoco.mj_kinematics(m, data)
        pos, quat = pose(mechanism.tree, data.qpos)
        np.testing.assert_allclose(pos[own], data.xpos[1:], atol=ROUND_OFF)
        np.testing.assert_allclose(np.abs(np.sum(quat[own] * data.xquat[1:], axis=1)), 1.0, atol=ROUND_OFF)


@pytest.mark.parametrize("batch", range(8))
def test_random_mjcf_is_what_c_mujoco_compiles(tmp_path, batch):
    """Compare every field and random poses on 30 random files a batch, in every way of writing the generator knows."""
    for seed in range(30 * batch, 30 * batch + 30):
        model = RandomMjcf(seed, bodies=1 + seed % 13)
        m = mujoco.MjModel.from_xml_string(model.text)
        mechanism = load_mjcf(_write(tmp_path, model.text), ASIDE)
        np.testing.assert_array_equal(mechanism.gravity, m.opt.gravity)
        _compare_bodies(mechanism, m)
        _compare_joints(mechanism, m)
        _compare_poses(mechanism, m, np.random.default_rng(seed))


def test_generator_exercises_the_language():
    """Check that the random files do hold the syntax that the comparison is about."""
    text = "".join(RandomMjcf(seed, bodies=1 + seed % 13).text for seed in range(240))
    words = "quat euler axisangle xyaxes zaxis fromto childclass class fullinertia diaginertia ref springref armature "
    words += "shellinertia boundmass settotalmass inertiafromgeom eulerseq mass density"
    for word in words.split():
        assert f'{word}="' in text, word
    for kind in ("ball", "slide", "hinge", "capsule", "cylinder", "box", "ellipsoid", "sphere"):
        assert f'type="{kind}"' in text, kind
    assert 'angle="radian"' in text and "<frame" in text


def test_two_hinges_on_one_body_by_hand(tmp_path):
    """Check names, order and masses of a body with two hinges: a massless link, then the body."""
    joints = '<joint name="yaw"/><joint axis="0 1 0" pos="0 0 .5"/>'
    tree = _load(tmp_path, f'<body name="a" pos="0 0 1">{joints}<geom size=".1" mass="2"/></body>').tree
    assert tree.link_name == ["a:yaw", "a"]
    np.testing.assert_array_equal(tree.parent, [-1, 0])
    np.testing.assert_array_equal(tree.mass, [0, 2])
    np.testing.assert_array_equal(tree.anchor, [[0, 0, 0], [0, 0, 0.5]])
    np.testing.assert_array_equal(tree.position, [[0, 0, 1], [0, 0, 0]])


def test_ref_moves_the_pose_of_joint_zero(tmp_path):
    """Check a hinge drawn at 90 degrees: at zero the body lies 90 degrees back, and qpos0 says where it was drawn."""
    mechanism = _load(tmp_path, '<body><joint ref="90" springref="30" pos="1 0 0"/><geom size=".1"/></body>')
    np.testing.assert_allclose(mechanism.qpos0, [np.pi / 2])
    np.testing.assert_allclose(mechanism.tree.rest[0, 0], np.pi / 6)
    np.testing.assert_allclose(mechanism.tree.position[0], [1, 1, 0], atol=1e-15)  # the anchor stays at (1, 0, 0)
    pos, quat = pose(mechanism.tree, mechanism.qpos0)
    np.testing.assert_allclose(pos[0], 0, atol=1e-15)
    np.testing.assert_allclose(quat[0], [1, 0, 0, 0], atol=1e-15)


@pytest.mark.parametrize("kind", ["mesh", "box"])
@pytest.mark.parametrize("weight", ['density="700"', 'mass="1.5"'])
def test_mesh_masses_match_mujoco(tmp_path, kind, weight):
    """Compare a body with a placed mesh and a sphere; also a box fitted to the mesh."""
    asset = '<asset><mesh name="wedge" scale="2 1 1" vertex="0 0 0 1 0 0 0 .5 0 0 0 .3 1 .5 0"/></asset>'
    geom = f'<geom type="{kind}" mesh="wedge" {weight} pos=".1 .2 .3" euler="20 30 40"/>'
    text = f'<mujoco>{asset}<worldbody><body><joint/>{geom}<geom size=".1"/></body></worldbody></mujoco>'
    m, tree = mujoco.MjModel.from_xml_string(text), load_mjcf(_write(tmp_path, text), ASIDE).tree
    R = quat_matrix(m.body_iquat[1])
    np.testing.assert_allclose(tree.mass[0], m.body_mass[1], rtol=ROUND_OFF)
    np.testing.assert_allclose(tree.com[0], m.body_ipos[1], atol=ROUND_OFF)
    scale = m.body_inertia[1].max()
    np.testing.assert_allclose(tree.inertia[0] / scale, R @ np.diag(m.body_inertia[1]) @ R.T / scale, atol=ROUND_OFF)


def test_includes_are_pasted(tmp_path):
    """Read a file whose default class and body come from included files, one of them in a subfolder."""
    (tmp_path / "parts").mkdir()
    _write(tmp_path / "parts", '<mujoco><default><joint damping="7"/></default></mujoco>', "defaults.xml")
    _write(tmp_path, '<mujocoinclude><body name="inner"><joint/><geom size=".1"/></body></mujocoinclude>', "body.xml")
    mechanism = _load(tmp_path, '<include file="body.xml"/>', '<include file="parts/defaults.xml"/>')
    assert mechanism.tree.link_name == ["inner"]
    np.testing.assert_array_equal(mechanism.tree.damping, [7])


def test_error_in_an_included_file_names_that_file_and_its_line(tmp_path):
    """Name the included file and the line in it where MuJoCo's compiler stops, and what it found there."""
    text = '<mujocoinclude>\n<body>\n<joint/>\n<geom type="capsule" size="-1 2"/>\n</body></mujocoinclude>'
    _write(tmp_path, text, "body.xml")
    with pytest.raises(InputError, match=r"body\.xml: line 4, <geom>: found size='-1 2' \(size 0 must be positive"):
        _load(tmp_path, '<body><include file="body.xml"/></body>')


def test_what_mujoco_makes_of_replicas_and_shells_is_read(tmp_path):
    """Compare replicated bodies and a hollow ellipsoid, which has no closed form, with the whole model."""
    body = '<body pos="1 0 0"><joint name="j"/><geom type="ellipsoid" size=".1 .2 .3" shellinertia="true"/></body>'
    inside = f'<replicate count="4" euler="0 0 90" offset="0 0 .1">{body}</replicate><geom size=".1"/>'
    text = f'<mujoco><worldbody><body name="hub"><joint/>{inside}</body></worldbody></mujoco>'
    m, mechanism = mujoco.MjModel.from_xml_string(text), load_mjcf(_write(tmp_path, text), ASIDE)
    assert m.nbody == 6 and mechanism.joint_name == ["", "j0", "j1", "j2", "j3"]
    _compare_bodies(mechanism, m)
    _compare_joints(mechanism, m)
    _compare_poses(mechanism, m, np.random.default_rng(0))


def test_files_of_pictures_and_of_the_world_may_be_missing(tmp_path, capfd):
    """Need no file that gives no body mass, and leave neither a warning nor MuJoCo's log behind."""
    assets = '<texture name="t" type="2d" file="no.png"/><material name="m" texture="t"/><mesh name="w" file="no.stl"/>'
    before = f"<asset>{assets}</asset><sensor><user name='s' dim='1'/></sensor><keyframe><key name='k'/></keyframe>"
    hinges = "<joint/><joint/>"  # about one axis: MuJoCo warns of a singular matrix
    body = f'<geom type="mesh" mesh="w"/><body>{hinges}<geom size=".1" material="m"/></body>'
    mechanism = _load(tmp_path, body, before)
    assert mechanism.ignored == ["keyframes (1)", "pairs that could touch (1)"]
    assert [p.name for p in tmp_path.iterdir()] == ["model.xml"] and capfd.readouterr().err == ""


def test_long_chain_needs_no_recursion(tmp_path):
    """Read a chain of 1500 bodies, deeper than Python's stack and than MuJoCo's XML reader goes; also a rigid one."""
    for joint in ("<joint/>", ""):
        body = f'<body pos="0 0 1">{joint}<geom size=".1"/>' * 1500 + "</body>" * 1500
        tree = _load(tmp_path, body).tree
        assert tree.num_links == 1500 and tree.parent[-1] == 1498


def test_deep_branching_tree_is_what_c_mujoco_compiles(tmp_path):
    """Compare a tree 45 bodies deep, with side branches, frames and classes all the way down, with the whole model."""
    default = '<default><default class="soft"><joint stiffness="2" damping=".1" type="ball"/></default></default>'
    text = ""
    for i in range(45, 0, -1):
        attributes = f'name="b{i}" pos=".1 0 .2" euler="{i} 5 9"' + (' childclass="soft"' if i == 3 else "")
        side = f'<body name="s{i}" pos="0 .3 0"><joint type="hinge"/><geom size=".05"/></body>'
        last = f'<frame euler="0 0 20"><body name="f{i}"><joint/><geom size=".03"/></body></frame>'
        text = f'<body {attributes}><joint ref="0"/><geom size=".1"/>{side}{text}{last}</body>'
    text = f"<mujoco>{default}<worldbody>{text}</worldbody></mujoco>"
    m, mechanism = mujoco.MjModel.from_xml_string(text), load_mjcf(_write(tmp_path, text), ASIDE)
    assert [m.body(i).name for i in range(1, m.nbody)] == mechanism.tree.link_name
    _compare_bodies(mechanism, m)
    _compare_joints(mechanism, m)
    _compare_poses(mechanism, m, np.random.default_rng(0))


def test_option_flags_switch_forces_off(tmp_path):
    """Take disabled gravity, springs and dampers as zero."""
    body = '<body><joint stiffness="3" damping="2"/><geom size=".1"/></body>'
    flags = '<option><flag gravity="disable" spring="disable" damper="disable"/></option>'
    mechanism = _load(tmp_path, body, flags)
    assert not mechanism.gravity.any() and not mechanism.tree.stiffness.any() and not mechanism.tree.damping.any()


BALL = '<joint type="ball"/><geom size=".1"/>'
BAD_BODIES = {
    "unknown joint": ("<body><joint type='screw'/><geom size='.1'/></body>", "type='screw'"),
    "negative mass": (f"<body>{BALL}<geom size='.1' mass='-1'/></body>", "mass='-1'"),
    "negative density": (f"<body>{BALL}<geom size='.1' density='-1'/></body>", "density='-1'"),
    "negative inertial mass": (f"<body>{BALL}<inertial pos='0 0 0' mass='-1'/></body>", "mass='-1'"),
    "negative stiffness": ("<body><joint stiffness='-4'/><geom size='.1'/></body>", "stiffness='-4'"),
    "nonlinear spring": ("<body><joint stiffness='4 1'/><geom size='.1'/></body>", "stiffness='4 1'"),
    "zero capsule": ("<body><joint/><geom type='capsule' size='0 .1'/></body>", "size='0 .1'"),
    "capsule without length": ("<body><joint/><geom type='capsule' size='.1'/></body>", "size='.1'"),
    "zero fromto": ("<body><joint/><geom type='capsule' size='.1' fromto='1 1 1 1 1 1'/></body>", "length zero"),
    "no mass": ("<body name='light'><joint/></body>", "without mass"),
    "flat inertia": ("<body><joint/><inertial pos='0 0 0' mass='1' diaginertia='1 1 4'/></body>", "A + B >= C"),
    "not a number": (f"<body pos='0 x 0'>{BALL}</body>", "pos='0 x 0'"),
    "nan": (f"<body pos='0 nan 0'>{BALL}</body>", "pos='0 nan 0'"),
    "two numbers": (f"<body pos='0 1'>{BALL}</body>", "pos='0 1'"),
    "zero quaternion": (f"<body quat='0 0 0 0'>{BALL}</body>", "length zero"),
    "two orientations": (f"<body quat='1 0 0 0' euler='1 2 3'>{BALL}</body>", "quat='1 0 0 0' and euler='1 2 3'"),
    "zero axis": ("<body><joint axis='0 0 0'/><geom size='.1'/></body>", "length zero"),
    "misspelt attribute": ("<body><joint stifness='4'/><geom size='.1'/></body>", "stifness"),
    "unknown class": ("<body><joint class='no'/><geom size='.1'/></body>", "class='no'"),
    "unknown childclass": (f"<body childclass='no'>{BALL}</body>", "childclass='no'"),
    "same name": (f"<body name='a'>{BALL}<body name='a'>{BALL}</body></body>", "'a' twice"),
    "soft body": (f"<body>{BALL}<flexcomp/></body>", "<flexcomp>"),
    "anti-gravity": (f"<body gravcomp='1'>{BALL}</body>", "gravcomp"),
    "missing include": ("<include file='nowhere.xml'/>", "nowhere.xml"),
    "unknown mesh": ("<body><joint/><geom type='mesh' mesh='no'/></body>", "mesh='no'"),
    "missing mesh file": ("<body><joint/><geom type='mesh' mesh='m'/></body>", "gone.stl"),
    "empty": ("", "no bodies"),
}


@pytest.mark.parametrize("case", BAD_BODIES)
def test_bad_body_gives_one_line_with_its_place(tmp_path, case):
    """Refuse the file with one line that names it, the line number where there is one, and what was found."""
    body, found = BAD_BODIES[case]
    with pytest.raises(InputError) as e:
        _load(tmp_path, body, '<asset><mesh name="m" file="gone.stl"/></asset>')
    message = str(e.value)
    assert "\n" not in message and "model.xml" in message and found in message and "allowed: " in message
    assert "line 2" in message or "line 4" in message or case == "empty"


BAD_SECTIONS = {
    "loop": ("<equality><connect body1='a' body2='b' anchor='0 0 0'/></equality>", "closed loop"),
    "weld": ("<equality><weld body1='a'/></equality>", "closed loop"),
    "springy tendon": ("<tendon><fixed stiffness='3'><joint joint='j' coef='1'/></fixed></tendon>", "tendon"),
    "flex": ("<deformable><flex name='f'/></deformable>", "flexible"),
    "unknown section": ("<wordlbody/>", "wordlbody"),
    "bad angle": ("<compiler angle='grad'/>", "angle='grad'"),
    "unknown setting": ("<compiler angel='radian'/>", "'angel'"),
    "bad eulerseq": ("<compiler eulerseq='xyw'/>", "eulerseq='xyw'"),
    "bad gravity": ("<option gravity='9.81'/>", "gravity='9.81'"),
    "class twice": ("<default><default class='c'/><default class='c'/></default>", "class='c'"),
}


@pytest.mark.parametrize("case", BAD_SECTIONS)
def test_bad_section_gives_one_line_with_its_place(tmp_path, case):
    """Refuse files whose physics no tree of joints can express, and malformed settings, naming line 2."""
    section, found = BAD_SECTIONS[case]
    with pytest.raises(InputError) as e:
        _load(tmp_path, f'<body name="a" euler="1 2 3">{BALL}</body>', section)
    assert "\n" not in str(e.value) and "line 2" in str(e.value) and found in str(e.value)


def test_inactive_constraint_is_no_loop(tmp_path):
    """Read a file whose equality constraint is switched off."""
    constraint = '<equality><weld body1="a" active="false"/></equality>'
    assert _load(tmp_path, f'<body name="a">{BALL}</body>', constraint).tree.num_links == 1


@pytest.mark.parametrize("load", [load_mjcf, load_urdf])
@pytest.mark.parametrize(
    ("text", "found"),
    [("<mujoco>\n<worldbody>\n</mujoco>", "line 3"), ("", "line 1"), ("hello", "line 1"), ("<other/>", "<other>")],
)
def test_malformed_xml_names_the_line(tmp_path, load, text, found):
    """Name the line where the XML breaks, or the wrong root element."""
    with pytest.raises(InputError, match=found):
        load(_write(tmp_path, text))


@pytest.mark.parametrize("load", [load_mjcf, load_urdf])
def test_unreadable_files_are_refused(tmp_path, load):
    """Refuse a missing file, a folder and bytes that are no text."""
    (tmp_path / "binary.xml").write_bytes(b"\xff\xfe\x00")
    for path in (tmp_path / "none.xml", tmp_path, tmp_path / "binary.xml"):
        with pytest.raises(InputError, match=str(path)):
            load(path)


def test_include_of_itself_is_refused(tmp_path):
    """Refuse a file that includes itself instead of reading it for ever."""
    with pytest.raises(InputError, match="second time"):
        _load(tmp_path, '<include file="model.xml"/>')


def _random_tree(seed, joints, links=12):
    rng = np.random.default_rng(seed)
    return random_tree(rng, links, joints=joints, armature=0.01, preloaded=True)


ALL = (Joint.SPHERICAL, Joint.REVOLUTE, Joint.PRISMATIC, Joint.FIXED)


def _assert_same_tree(tree, back, skip=()):
    moving = tree.joint != Joint.FIXED
    scalar = np.isin(tree.joint, (Joint.REVOLUTE, Joint.PRISMATIC))
    assert back.link_name == tree.link_name
    for key in ("parent", "joint"):
        np.testing.assert_array_equal(getattr(back, key), getattr(tree, key))
    for key in ("position", "rotation", "anchor", "mass", "com", "inertia"):
        if key not in skip:
            np.testing.assert_allclose(getattr(back, key), getattr(tree, key), rtol=1e-9, atol=1e-12, err_msg=key)
    back.preload[scalar, 1:] = tree.preload[scalar, 1:]  # scalar joints use the first number alone
    for key in ("stiffness", "damping", "armature", "rest", "preload"):
        np.testing.assert_allclose(getattr(back, key)[moving], getattr(tree, key)[moving], rtol=1e-9, err_msg=key)
    np.testing.assert_allclose(back.axis[scalar], tree.axis[scalar], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_exported_mjcf_reads_back(tmp_path, seed):
    """Write a random tree with bough's exporter and read it back: the same tree."""
    tree = _random_tree(seed, ALL)
    tree = tree.with_(preload=np.where((tree.joint == Joint.FIXED)[:, None], 0.0, tree.preload))
    back = load_mjcf(_write(tmp_path, to_mjcf(tree))).tree
    fixed = tree.joint == Joint.FIXED
    back.anchor[fixed] = tree.anchor[fixed]
    _assert_same_tree(tree, back)


@pytest.mark.parametrize("seed", range(4))
def test_exported_urdf_reads_back(tmp_path, seed):
    """Read a random tree back from bough's URDF: frames move to the anchors, so compare bodies by centre and axes."""
    tree = _random_tree(seed, ALL)
    back = load_urdf(_write(tmp_path, to_urdf(tree))).tree
    turning = np.isin(tree.joint, (Joint.REVOLUTE, Joint.SPHERICAL))
    shift = np.where(turning[:, None], tree.anchor, 0.0)
    np.testing.assert_allclose(back.com, tree.com - shift, atol=1e-12)
    _assert_same_tree(tree, back, skip=("position", "anchor", "com", "rotation"))
    qpos = np.random.default_rng(seed).normal(size=tree.num_coordinates)
    ours, theirs = pose(tree, qpos), pose(back, qpos)
    np.testing.assert_allclose(np.abs(np.sum(ours[1] * theirs[1], axis=1)), 1.0, atol=1e-9)
    centre = ours[0] + np.einsum("lij,lj->li", quat_matrix(ours[1]), tree.com)
    back_centre = theirs[0] + np.einsum("lij,lj->li", quat_matrix(theirs[1]), back.com)
    np.testing.assert_allclose(back_centre, centre, atol=1e-9)


def _random_urdf(rng, links):
    """Write a random URDF as text, root link included."""
    out = []
    for i in range(links):
        m = rng.normal(size=(3, 3))
        inertia = 0.05 * m @ m.T + 0.05 * np.trace(m @ m.T) * np.eye(3)
        keys = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
        numbers = " ".join(f'{k}="{inertia[ij]:.9g}"' for k, ij in keys.items())
        out.append(f'<link name="l{i}"><inertial>{_urdf_origin(rng)}<mass value="{rng.uniform(0.1, 3):.6g}"/>')
        out.append(f"<inertia {numbers}/></inertial></link>")
    for i in range(1, links):
        kind = rng.choice(["revolute", "continuous", "prismatic", "fixed"])
        axis = " ".join(f"{v:.6g}" for v in rng.normal(size=3))
        out.append(f'<joint name="j{i}" type="{kind}"><parent link="l{rng.integers(i)}"/><child link="l{i}"/>')
        out.append(f'{_urdf_origin(rng)}<axis xyz="{axis}"/><limit lower="-9" upper="9" effort="1" velocity="1"/>')
        out.append(f'<dynamics damping="{rng.uniform(0, 2):.6g}"/></joint>')
    # Without this MuJoCo merges the fixed links away.
    return f'<robot name="r"><mujoco><compiler fusestatic="false"/></mujoco>{"".join(out)}</robot>'


def _urdf_origin(rng):
    xyz, rpy = (" ".join(f"{v:.6g}" for v in rng.normal(size=3)) for _ in range(2))
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


@pytest.mark.parametrize("seed", range(12))
def test_random_urdf_is_what_c_mujoco_compiles(tmp_path, seed):
    """Compare masses, damping and random poses of a random URDF with MuJoCo's URDF reader."""
    rng = np.random.default_rng(seed)
    text = _random_urdf(rng, 2 + seed)
    m, tree = mujoco.MjModel.from_xml_string(text), load_urdf(_write(tmp_path, text, "r.urdf"), ASIDE).tree
    assert sorted(tree.link_name) == sorted(m.body(b).name for b in range(1, m.nbody))
    body = [m.body(name).id for name in tree.link_name]
    data = mujoco.MjData(m)
    np.testing.assert_allclose(tree.mass, m.body_mass[body], rtol=ROUND_OFF)
    np.testing.assert_allclose(tree.com, m.body_ipos[body], atol=ROUND_OFF)
    R = quat_matrix(m.body_iquat[body])
    inertia = np.einsum("bij,bj,bkj->bik", R, m.body_inertia[body], R)
    np.testing.assert_allclose(tree.inertia, inertia, atol=1e-9)
    data.qpos[:] = rng.normal(size=m.nq)
    mujoco.mj_kinematics(m, data)
    moving = [i for i in range(tree.num_links) if tree.joint[i] != Joint.FIXED]
    qpos = np.array([data.qpos[m.joint(f"j{tree.link_name[i][1:]}").qposadr[0]] for i in moving])
    damping = np.array([m.dof_damping[m.joint(f"j{tree.link_name[i][1:]}").dofadr[0]] for i in moving])
    np.testing.assert_allclose(tree.damping[moving], damping, rtol=ROUND_OFF)
    pos, quat = pose(tree, qpos)
    np.testing.assert_allclose(pos, data.xpos[body], atol=1e-10)
    np.testing.assert_allclose(np.abs(np.sum(quat * data.xquat[body], axis=1)), 1.0, atol=1e-10)


def test_urdf_mass_from_collision_shapes_is_newtons(tmp_path):
    """Take the mass of a link without <inertial> from its collision shape at Newton's density: r^3 4/3 pi 1000."""
    shape = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    text = f'<robot name="r"><link name="a">{shape}</link></robot>'
    expected = newton.ModelBuilder().default_shape_cfg.density * 4 / 3 * np.pi * 0.1**3
    np.testing.assert_allclose(load_urdf(_write(tmp_path, text)).tree.mass, [expected], rtol=1e-6)


LINK = '<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>'
JOINT = '<joint name="{0}{1}" type="{2}"><parent link="{0}"/><child link="{1}"/>{3}</joint>'
BAD_URDF = {
    "spherical": ("ab", [("a", "b", "spherical", "")], "type='spherical'"),
    "mimic": ("ab", [("a", "b", "revolute", '<mimic joint="x"/>')], "mimic"),
    "missing link": ("ab", [("a", "c", "fixed", "")], "'c', which does not exist"),
    "loop": ("abc", [("a", "b", "fixed", ""), ("b", "c", "fixed", ""), ("c", "b", "fixed", "")], "closed loop"),
    "ring": ("ab", [("a", "b", "fixed", ""), ("b", "a", "fixed", "")], "closed loop"),
    "ring beside a root": ("abc", [("b", "c", "fixed", ""), ("c", "b", "fixed", "")], "closed loop"),
    "two roots": ("abc", [("a", "b", "fixed", "")], "a, c"),
    "same link": ("aa", [], "twice"),
    "zero axis": ("ab", [("a", "b", "revolute", '<axis xyz="0 0 0"/>')], "length zero"),
    "bad axis": ("ab", [("a", "b", "revolute", '<axis xyz="0 0"/>')], "xyz='0 0'"),
    "bad origin": ("ab", [("a", "b", "fixed", '<origin rpy="0 0 x"/>')], "rpy='0 0 x'"),
    "negative damping": ("ab", [("a", "b", "revolute", '<dynamics damping="-1"/>')], "damping='-1'"),
    "no links": ("", [], "no <link>"),
    "only the world": (["world"], [], "no link besides"),
    "half a ball": ("ab", [("a", "b", "revolute", '<bough joint="spherical"/>')], "about x, y and z"),
}


@pytest.mark.parametrize("case", BAD_URDF)
def test_bad_urdf_gives_one_line_with_its_place(tmp_path, case):
    """Refuse the file with one line that names it, its line and what was found."""
    links, joints, found = BAD_URDF[case]
    text = "\n".join([*(LINK.format(name) for name in links), *(JOINT.format(*j) for j in joints)])
    with pytest.raises(InputError) as e:
        load_urdf(_write(tmp_path, f'<robot name="r">\n{text}\n</robot>', "r.urdf"))
    assert "\n" not in str(e.value) and "r.urdf: line " in str(e.value) and found in str(e.value)


def test_urdf_negative_mass_is_refused(tmp_path):
    """Name the negative mass."""
    with pytest.raises(InputError, match="value='-1'"):
        load_urdf(_write(tmp_path, f'<robot name="r">{LINK.format("a").replace("1", "-1", 1)}</robot>'))


JUNK = ("", "x", "nan", "-1", "0", "1e400", "1 2", "1 2 3 4 5 6 7 8", "true", "mesh", "ball", "l1")


def _damaged(text, rng):
    """Spoil one to three places: an attribute's value, an attribute's name, a tag, or a stretch of text."""
    for _ in range(rng.integers(1, 4)):
        spots = list(re.finditer(r'([\w]+)="([^"]*)"|<(/?\w+)', text))
        spot = spots[rng.integers(len(spots))]
        if rng.random() < 0.1:
            text = text[: spot.start()] + text[spot.end() + rng.integers(20) :]
        elif spot[3]:
            text = (
                text[: spot.start()]
                + "<"
                + str(rng.choice(["body", "joint", "geom", "link", "x"]))
                + text[spot.end() :]
            )
        else:
            name = spot[1] if rng.random() < 0.8 else "x"
            text = f'{text[: spot.start()]}{name}="{rng.choice(JUNK)}"{text[spot.end() :]}'
    return text


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 10**6), urdf=st.booleans())
def test_damaged_files_are_read_or_refused_in_one_line(tmp_path_factory, seed, urdf):
    """Damage random files: whatever comes out is a valid mechanism or an `InputError` of one line."""
    rng = np.random.default_rng(seed)
    text = _random_urdf(rng, 4) if urdf else RandomMjcf(seed, bodies=3).text
    path = _write(tmp_path_factory.mktemp("damaged"), _damaged(text, rng))
    try:
        (load_urdf if urdf else load_mjcf)(path).tree.validate()
    except InputError as e:
        assert "\n" not in str(e)


@pytest.mark.parametrize(
    ("suffix", "element", "count", "words"),
    [
        ("xml", "body", 20_000, "line 5000: found elements nested more than 5000 deep"),
        ("urdf", "body", 20_000, "line 5000: found elements nested more than 5000 deep"),
        ("xml", "default", 20_000, "line 5000: found elements nested more than 5000 deep"),
        # fewer than bough's own bound, more than MuJoCo's
        ("xml", "default", 3_000, r"line \d+, <default>: found XML parse error .* nesting is too deep"),
    ],
)
def test_elements_without_end_are_refused(tmp_path, suffix, element, count, words):
    """Refuse thousands of elements inside one another, in one line that says where; vast ones before any is read."""
    file = tmp_path / f"deep.{suffix}"
    root = "mujoco" if suffix == "xml" else "robot"
    file.write_text(f"<{root}>" + f"<{element}>\n" * count + f"</{element}>" * count + f"</{root}>")
    with pytest.raises(InputError, match=rf"deep\.{suffix}: {words}"):
        load_mjcf(file) if suffix == "xml" else load_urdf(file)
