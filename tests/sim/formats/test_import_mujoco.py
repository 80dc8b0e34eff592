"""MuJoCo models in memory: the trees of their files, and C MuJoCo's motion."""

from __future__ import annotations

import bough
import mujoco
import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.engine.stepping import Stepping
from bough.sim.engine.trajectory import own_bodies
from bough.sim.formats.export_mjcf import to_mjcf
from bough.sim.formats.import_mjcf import load_mjcf
from bough.sim.formats.load import load_mechanism
from oracles.mujoco_tree import OFF
from oracles.random_mjcf import RandomMjcf
from oracles.random_tree import random_tree

#: The compiler diagonalises inertia tensors and keeps directions at length one; the file's own numbers differ by that.
ROUNDING = 1e-12


def _same(got, want):
    """Compare all arrays of two mechanisms."""
    for name, value in vars(want.tree).items():
        if isinstance(value, np.ndarray):
            scale = max(1.0, np.abs(value).max(initial=0.0))
            np.testing.assert_allclose(getattr(got.tree, name), value, rtol=0, atol=ROUNDING * scale, err_msg=name)
    assert got.tree.link_name == want.tree.link_name and got.joint_name == want.joint_name
    np.testing.assert_allclose(got.qpos0, want.qpos0, rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(got.gravity, want.gravity)
    np.testing.assert_array_equal(got.friction, want.friction)


@pytest.mark.filterwarnings("ignore:compiler attribute")
@pytest.mark.parametrize("seed", range(6))
def test_a_model_in_memory_is_that_of_its_file(tmp_path, seed):
    """Read strange random files by path, compiled, as a specification and from MuJoCo's binary: the same arrays."""
    path = tmp_path / "model.xml"
    path.write_text(RandomMjcf(seed, 6).text)
    want = load_mjcf(path, ("all",))
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    model = spec.compile()
    mujoco.mj_saveModel(model, str(tmp_path / "model.mjb"))
    for got in (
        bough.from_mujoco(model, ("all",)),
        bough.from_mujoco(spec, ("all",)),
        load_mechanism(tmp_path / "model.mjb", ignore=("all",)),
    ):
        _same(got, want)
        assert len(got.ignored) == len(want.ignored)


def test_constant_forces_of_an_export_are_kept():
    """Carry the pre-loads that bough's own MJCF keeps beside the joints."""
    tree = random_tree(np.random.default_rng(1), 5, preloaded=True)
    got = bough.from_mujoco(mujoco.MjModel.from_xml_string(to_mjcf(tree)))
    np.testing.assert_allclose(got.tree.preload, tree.preload, rtol=1e-12)
    assert got.ignored == []


def test_a_specification_built_in_python_moves_as_in_mujoco():
    """Build a pendulum of two links in Python and let it swing for a second: MuJoCo's bodies, step by step.

    The step is MuJoCo's implicitfast; 1e-9 m is what rounding grows to in a thousand steps of a chaotic mechanism.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody
    for k in range(2):
        body = body.add_body(name=f"link{k}", pos=[0.0, 0.0, -0.5 * k])
        body.add_joint(name=f"j{k}", type=[mujoco.mjtJoint.mjJNT_BALL, mujoco.mjtJoint.mjJNT_HINGE][k], damping=0.01)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, 0.1, 0, -0.5], size=[0.02, 0, 0])
    spec.add_actuator(target="j1", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    model = spec.compile()
    mechanism = bough.from_mujoco(spec)
    assert mechanism.ignored == ["motors, which are at rest (1)"]
    simulator = mechanism.simulator(3, Stepping(dt=1e-3))
    model.opt.timestep, model.opt.integrator = 1e-3, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= int(OFF)
    data = mujoco.MjData(model)
    data.qvel[:] = [0.5, 1.0, -0.5, 2.0]
    simulator.state.set_qvel(data.qvel)
    bodies = own_bodies(mechanism.tree)
    for _ in range(10):
        simulator.step(100)
        mujoco.mj_step(model, data, 100)
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(simulator.observe()[0][2, bodies], data.xpos[1:], rtol=0, atol=1e-9)


def test_models_are_refused_by_the_names_in_them(tmp_path):
    """Name joints and bodies where there are no lines; refuse what is no model, has no body or does not compile."""
    text = """<mujoco model="robot"><worldbody><geom type="plane" size="1 1 1"/><body name="arm" pos="0 0 1">
    <joint name="elbow" range="-1 1"/><geom size=".1"/></body></worldbody>
    <actuator><position name="servo" joint="elbow"/></actuator></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    with pytest.raises(InputError, match=r"robot: actuator 'servo': found an actuator.*--ignore actuators,limits,cont"):
        bough.from_mujoco(model)
    with pytest.raises(InputError, match=r"robot: joint 'elbow': found a joint limit.*--ignore limits to"):
        bough.from_mujoco(model, ignore=("actuators", "contacts"))
    with pytest.raises(InputError, match=r"robot: body 'arm': found a body that can touch the world's geoms"):
        bough.from_mujoco(model, ignore=("actuators", "limits"))
    with pytest.raises(InputError, match=r"found str; allowed: mujoco.MjModel or mujoco.MjSpec"):
        bough.from_mujoco(text)
    with pytest.raises(InputError, match=r"no bodies"):
        bough.from_mujoco(mujoco.MjSpec())
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="empty").add_joint()
    with pytest.raises(InputError, match=r"MjSpec: found .*mass and inertia"):
        bough.from_mujoco(spec)
    (tmp_path / "no.mjb").write_bytes(b"no model")
    with pytest.raises(InputError, match=r"no.mjb: found .*a model saved by MuJoCo"):
        load_mechanism(tmp_path / "no.mjb")
