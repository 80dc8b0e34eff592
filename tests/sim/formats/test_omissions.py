"""What a tree does not have: refused with its line and the word that leaves it out, left out by that word, listed."""

from __future__ import annotations

import bough
import mujoco
import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.engine.stepping import Stepping
from bough.sim.engine.trajectory import own_bodies
from bough.sim.formats.import_mjcf import load_mjcf
from bough.sim.formats.import_urdf import load_urdf
from bough.sim.formats.load import load_mechanism
from bough.sim.formats.omissions import WORDS, touching
from bough.sim.trees.tree import Joint

GEOM = '<geom size=".1" contype="0" conaffinity="0"/>'
HINGE = f'<body name="b"><joint name="j"/>{GEOM}</body>'


def _mjcf(tmp_path, body, after=""):
    path = tmp_path / "model.xml"
    path.write_text(f"<mujoco>\n<worldbody>\n{body}\n</worldbody>\n{after}\n</mujoco>")
    return path


def _urdf(tmp_path, joint, links="abc"):
    inertial = '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1"/></inertial>'
    text = "".join(f'<link name="{n}">{inertial}</link>' for n in links)
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">{text}\n{joint}\n</robot>')
    return path


#: By name: the word, the line, what the message says, bodies, and sections after them.
MJCF = {
    "limit": ("limits", 3, "a joint limit", f'<body><joint range="-9 9"/>{GEOM}</body>', ""),
    "ball friction": ("friction", 3, "several axes", f'<body><joint type="ball" frictionloss="1"/>{GEOM}</body>', ""),
    "floor": ("contacts", 4, "such as a floor",
              '<geom type="plane" size="1 1 1"/>\n<body><freejoint/><geom size=".1"/></body>', ""),
    "links": ("contacts", 3, "touch body 'a'",
              '<body name="a"><joint/><geom size=".1"/><body><joint/><geom size=".1"/>'
              '<body name="c"><joint/><geom size=".1"/></body></body></body>', ""),
    "pair": ("contacts", 5, "a contact <pair>", HINGE, '<contact><pair geom1="x" geom2="y"/></contact>'),
    "servo": ("actuators", 5, "an actuator", HINGE, '<actuator><position joint="j" kp="9"/></actuator>'),
    "weld": ("equality", 5, "closed loop", HINGE, '<equality><weld body1="b"/></equality>'),
    "tendon": ("tendons", 5, "a tendon with stiffness", HINGE,
               '<tendon><fixed stiffness="3"><joint joint="j" coef="1"/></fixed></tendon>'),
    "weightless": ("gravcomp", 3, "gravcomp='0.5'", f'<body gravcomp=".5"><joint/>{GEOM}</body>', ""),
    "water": ("fluid", 5, "density='1000'", HINGE, '<option density="1000"/>'),
}  # fmt: skip


@pytest.mark.parametrize("case", MJCF)
def test_mjcf_is_refused_by_name_and_read_without(tmp_path, case):
    """Name file, line and word; with that word alone read the file and list what was left out."""
    word, line, says, body, after = MJCF[case]
    path = _mjcf(tmp_path, body, after)
    with pytest.raises(InputError, match=f"--ignore {word} to leave it out") as e:
        load_mjcf(path)
    assert says in str(e.value) and str(path) in str(e.value) and f"line {line}, <" in str(e.value)
    assert word in WORDS
    assert len(load_mjcf(path, (word,)).ignored) == 1
    assert load_mjcf(path, ("all",)).ignored == load_mjcf(path, (word,)).ignored


URDF = {
    "hinge's limit": ("limits", "revolute", '<limit lower="-1" upper="1" effort="1" velocity="1"/>'),
    "slide's limit": ("limits", "prismatic", '<limit lower="0" upper="0.5" effort="1" velocity="1"/>'),
    "one end": ("limits", "prismatic", '<limit lower="-2000" upper="0.5" effort="1" velocity="1"/>'),
    "mimic": ("mimic", "continuous", '<mimic joint="k"/>'),
    "floating friction": ("friction", "floating", '<dynamics friction="0.1"/>'),
}


@pytest.mark.parametrize("case", URDF)
def test_urdf_is_refused_by_name_and_read_without(tmp_path, case):
    """Name the joint's line and the word; a slide's limits are no longer passed over."""
    word, kind, inner = URDF[case]
    ends = '<parent link="{}"/><child link="{}"/>'
    text = f'<joint name="j" type="{kind}">{ends.format("a", "b")}{inner}</joint>'
    path = _urdf(tmp_path, text + f'<joint name="k" type="fixed">{ends.format("b", "c")}</joint>')
    with pytest.raises(InputError, match=f"line 2, <joint name='j'>.*--ignore {word} to leave"):
        load_urdf(path)
    assert len(load_urdf(path, (word,)).ignored) == 1


def test_all_words_that_a_file_needs_are_said_at_once(tmp_path):
    """Name the first thing and every word; a word that does not exist is answered with those that do."""
    body = f'<body><joint range="-9 9"/><geom size=".1"/></body><geom type="plane" size="1 1 1"/>{HINGE}'
    path = _mjcf(tmp_path, body, '<actuator><position joint="j"/></actuator>')
    with pytest.raises(InputError, match="--ignore actuators,limits,contacts to leave it out"):
        load_mjcf(path)
    mechanism = load_mechanism(path, ignore=("limits", "contacts", "actuators"))
    assert mechanism.ignored == ["actuators (1)", "joint limits (1)", "pairs that could touch (1)"]
    with pytest.raises(InputError, match="--ignore: found 'limit'; allowed: limits, friction"):
        load_mechanism(path, ignore=("limit",))


def test_motors_and_keyframes_are_only_named(tmp_path):
    """Read a file with a motor, which exerts nothing at zero control, and list it."""
    after = '<actuator><motor joint="j"/></actuator><keyframe><key qpos="1"/></keyframe>'
    ignored = load_mjcf(_mjcf(tmp_path, HINGE, after)).ignored
    assert ignored == ["motors, which are at rest (1)", "keyframes (1)"]
    assert load_mjcf(_mjcf(tmp_path, HINGE)).ignored == []


def test_bodies_that_could_touch_are_those_that_mujoco_lets_touch():
    """Compare the pairs with C MuJoCo's contacts of geoms that all overlap, for random trees, masks and excludes."""
    rng = np.random.default_rng(6)
    for _ in range(30):
        count = int(rng.integers(2, 9))
        parent = [0, *(int(rng.integers(0, i)) for i in range(1, count))]
        moves = [False, *rng.integers(0, 2, count - 1).astype(bool).tolist()]
        masks = rng.integers(0, 4, (count, 2))
        spec = mujoco.MjSpec()
        bodies = [spec.worldbody]
        for i in range(count):
            if i:
                bodies.append(bodies[parent[i]].add_body(name=f"b{i}"))
            if moves[i]:
                bodies[i].add_joint()
            bodies[i].add_geom(size=[0.1, 0.1, 0.1], contype=int(masks[i, 0]), conaffinity=int(masks[i, 1]))
        left = (count > 3 and {(1, 2)}) or set()
        for a, b in left:
            spec.add_exclude(bodyname1=f"b{a}", bodyname2=f"b{b}")
        spec.compiler.fusestatic = False
        model = spec.compile()
        names = [model.body(i).name for i in range(count)]
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        touched = {tuple(sorted(int(names[model.geom_bodyid[g]].replace("world", "b0")[1:]) for g in pair)) for pair in
                   data.contact.geom[: data.ncon]}  # fmt: skip
        assert set(touching(parent, moves, masks, left)) == touched


FREE = """<body name="float" pos="0.1 0.2 1" euler="20 30 40"><freejoint name="f"/>
<geom type="capsule" size=".05 .2" contype="0" conaffinity="0"/>
<body name="limb" pos="0 0 .3"><joint type="hinge" axis="1 0 0" damping=".002" stiffness=".5"/>
<geom type="box" size=".03 .2 .04" pos="0 .2 0" contype="0" conaffinity="0"/></body></body>"""


def test_a_free_body_moves_as_in_c_mujoco(tmp_path):
    """Throw a body with a limb: coordinates and bodies as MuJoCo's at a 32nd of the step, to that step's error."""
    path = _mjcf(tmp_path, FREE)
    mechanism = load_mechanism(path)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    np.testing.assert_allclose(mechanism.qpos0, data.qpos, rtol=0, atol=1e-15)
    assert mechanism.tree.num_dofs == model.nv and mechanism.ignored == []
    qvel = np.array([0.5, -0.2, 3.0, 1.0, 2.0, -1.0, 2.0])
    simulator = mechanism.simulator(2, Stepping(dt=1e-3))
    assert simulator.model.has_free_trees
    simulator.state.set_qvel(qvel)
    simulator.step(200)
    model.opt.timestep, data.qvel[:] = 1e-3 / 32, qvel
    mujoco.mj_step(model, data, 200 * 32)
    np.testing.assert_allclose(simulator.tensors.get("qpos")[1], data.qpos, rtol=0, atol=2e-3)
    mujoco.mj_kinematics(model, data)
    bodies = own_bodies(mechanism.tree)
    np.testing.assert_allclose(simulator.observe()[0][0, bodies], data.xpos[1:], rtol=0, atol=1e-3)
    held = load_mechanism(path, ignore=("free",))
    assert held.ignored == ["free joints (1)"] and held.tree.joint[0] == Joint.FIXED and held.tree.num_links == 2


def test_a_torque_alone_changes_angular_momentum_by_itself(tmp_path):
    """Turn a free body in weightlessness: it gains torque times time, and no linear momentum."""
    mechanism = load_mechanism(_mjcf(tmp_path, FREE))
    model = bough.Model(mechanism.tree, gravity=(0, 0, 0), precision=64)
    simulator = bough.Simulator(model, dt=1e-3)
    simulator.tensors.set("torque", np.array([[0.0] * 3] * 3 + [[0.01, 0.02, 0.03], [0.0, 0.0, -0.01]]))
    before = simulator.energy()[1][0].copy()
    simulator.step(300)
    gained = simulator.energy()[1][0] - before
    np.testing.assert_allclose(gained, [[0.0] * 3, np.array([0.01, 0.02, 0.02]) * 0.3], rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ["hinge", "slide"])
def test_friction_of_a_file_acts_as_mujoco_s(tmp_path, kind):
    """Let a sprung joint with frictionloss swing out: it turns and comes to rest where MuJoCo's does.

    bough's friction bends by half a milliradian (or millimetre) before it slips, so that turning points agree to less
    than that; a joint leaves a turning point some 20 ms earlier.
    """
    stiff = 'solreffriction=".004 1" solimpfriction=".9999 .9999 .001"'
    joint = f'<joint type="{kind}" axis="0 1 0" stiffness="2" damping=".1" armature=".1" frictionloss=".2" {stiff}/>'
    path = _mjcf(
        tmp_path,
        f'<body>{joint}<geom size=".1" mass=".1" contype="0" conaffinity="0"/></body>',
        "<option gravity='0 0 0'/>",
    )
    mechanism = load_mechanism(path)
    assert mechanism.friction.tolist() == [0.2] and mechanism.ignored == []
    simulator = mechanism.simulator(1, Stepping(dt=1e-4))
    simulator.tensors.set("qpos", 0.6)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep = 1e-4
    data = mujoco.MjData(model)
    data.qpos[:] = 0.6
    got, want = [], []
    for _ in range(200):
        simulator.step(200)
        got.append(float(simulator.tensors.get("qpos")))
        mujoco.mj_step(model, data, 200)
        want.append(float(data.qpos[0]))
    np.testing.assert_allclose(min(got), min(want), rtol=0, atol=5e-4)
    np.testing.assert_allclose(got[-1], want[-1], rtol=0, atol=2e-3)  # held elastically: rings by up to 2 bends
    np.testing.assert_allclose(got, want, rtol=0, atol=0.02)
    assert np.ptp(want) > 0.8
    assert load_mechanism(path, ignore=("friction",)).friction.tolist() == [0.0]
    with pytest.raises(InputError, match="'dry_friction' beside the joint friction"):
        mechanism.simulator(1, effects={"dry_friction": {"torque_Nm": 1.0}})


@pytest.mark.parametrize(("kind", "slides"), [("floating", 3), ("planar", 2)])
def test_a_urdf_s_floating_and_planar_joints_move(tmp_path, kind, slides):
    """Let a link float on another: it falls as free fall says, or stays in its plane; the rest hangs on it."""
    ends = '<parent link="{}"/><child link="{}"/>'
    joint = f'<joint name="j" type="{kind}">{ends.format("a", "b")}<origin xyz="0 0 1"/><axis xyz="0 1 0"/></joint>'
    fixed = f'<joint name="k" type="fixed">{ends.format("b", "c")}<origin xyz="1 0 0"/></joint>'
    mechanism = load_urdf(_urdf(tmp_path, joint + fixed))
    assert mechanism.tree.link_name[1 : 1 + slides] == [f"b:{c}" for c in "xyz"[:slides]]
    simulator = mechanism.simulator(1, Stepping(dt=1e-3))
    simulator.step(100)
    position = dict(zip(mechanism.tree.link_name, simulator.observe()[0][0].tolist(), strict=True))
    fallen = -9.81 * 1e-6 * 100 * 101 / 2  # semi-implicit Euler's sum
    np.testing.assert_allclose(position["b"], [0, 0, 1 + fallen], rtol=0, atol=1e-12)
    np.testing.assert_allclose(position["c"], [1, 0, 1 + fallen], rtol=0, atol=1e-12)
    assert load_urdf(_urdf(tmp_path, joint + fixed), ("free",)).tree.num_links == 3
